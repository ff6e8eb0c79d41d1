"""One mission's log of what the sensor said; all else that is known of the targets is read off it.

Beliefs, particles, tracks, tours and the summary of a flight read it or fold over it: who folds
remembers how many measurements it has taken in, and asks for those `since`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dronemon.errors import BeliefError
from dronemon.hindsight import Hindsight
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.sensor import PERFECT, Sensor
from dronemon.types import BoolArray, FloatArray, Measurement

LEAST_VIEW_AU = 0.5 * SENSOR_RADIUS_AU
"""The one point that a process is given stands for a view of about the sensor's radius."""


class Window(NamedTuple):
    """What a Gaussian process of each target is given. Column 0 is the prior, then oldest first.

    points: (N, n, 3) float64 au x, y, t: the target's place where seen, the agent's where not
    values: (N, n)    float64 1 where seen, as far as that is believed, 0 where not
    mask:   (N, n)    bool    whether there is such an observation; of a target not seen there is
                              none where less than half of the sensor's radius was looked at

    Source: paper, equation 1 and section III-C.
    """

    points: FloatArray
    values: FloatArray
    mask: BoolArray


class Sight(NamedTuple):
    """When and where a target was seen, in au."""

    time_au: float
    x_au: float
    y_au: float


def is_in_view(look: Measurement, places_au: FloatArray) -> BoolArray:
    """Which places were looked at, so that a target not seen is not there. (..., 2) -> (...).

    Its compiled twin is in `dronemon.planner.walking`.
    """
    away = np.asarray(places_au) - look.agent_au
    away_au: FloatArray = np.hypot(away[..., 0], away[..., 1])
    if look.hidden_au is None:
        return away_au < look.view_au
    share = np.arctan2(away[..., 1], away[..., 0]) / math.tau
    count = len(look.hidden_au)
    first_au, last_au = np.moveaxis(
        look.hidden_au[np.floor(count * share).astype(int) % count], -1, 0
    )
    is_shown: BoolArray = (away_au < first_au) | (away_au > last_au)
    return is_shown & (away_au < SENSOR_RADIUS_AU)


def told(time_au: float, agent_au: FloatArray, target_au: FloatArray) -> Measurement:
    """A measurement by where each target was said to be seen. target_au: (N, 2), NaN where not."""
    seen = ~np.isnan(target_au[:, 0])
    return Measurement(time_au=time_au, agent_au=agent_au, seen=seen, target_au=target_au)


class Sightings:
    """Grows by a measurement at a time; index i always means the same target.

    A measurement of more targets than before lets these join: earlier ones did not see them. Where
    the eye errs, seen is what is believed to have been by now: see `dronemon.hindsight`.
    """

    def __init__(self, priors_au: FloatArray, sensor: Sensor = PERFECT) -> None:
        """Begin a log.

        priors_au: (N, 2) float64 au places of the known targets at time 0, NaN where unknown
        sensor:    how the eye errs
        """
        self.sensor = sensor
        priors_au = priors_au.reshape(-1, 2)
        self._hindsight = Hindsight(sensor, priors_au) if sensor.needs_hindsight else None
        self._believed: list[list[Sight]] | None = None
        self._measurements: list[Measurement] = []
        self._sights: list[list[Sight]] = [
            [] if np.isnan(prior_au).any() else [Sight(0.0, *prior_au.tolist())]
            for prior_au in priors_au
        ]
        self.priors_au: FloatArray = priors_au

    def __len__(self) -> int:
        """Measurements taken."""
        return len(self._measurements)

    @property
    def num_targets(self) -> int:
        """N: targets known of."""
        return len(self._sights)

    @property
    def time_au(self) -> float:
        """When the last measurement was taken; 0 before the first."""
        return self._measurements[-1].time_au if self._measurements else 0.0

    @property
    def _believed_sights(self) -> Sequence[Sequence[Sight]]:
        """Of each target, as far as they are believed by now."""
        if self._hindsight is None:
            return self._sights
        if self._believed is None:
            all_sights = self._hindsight.sights()
            self._believed = [[Sight(*row) for row in rows.tolist()] for rows in all_sights]
        return self._believed

    @property
    def last_seen_au(self) -> FloatArray:
        """(N,) float64 au when each target was last seen, a prior counted; -inf if never."""
        return np.array([s[-1].time_au if s else -math.inf for s in self._believed_sights])

    @property
    def last_places_au(self) -> FloatArray:
        """(N, 2) float64 au where each target was last seen, a prior counted; NaN if never."""
        nowhere = (math.nan, math.nan)
        places = [sights[-1][1:] if sights else nowhere for sights in self._believed_sights]
        return np.array(places, dtype=np.float64).reshape(-1, 2)

    @property
    def num_seen(self) -> list[int]:
        """Measurements that saw each target."""
        sights, has_prior = self._believed_sights, self._has_prior
        return [len(s) - int(p) for s, p in zip(sights, has_prior, strict=True)]

    @property
    def _has_prior(self) -> BoolArray:
        """(N,) whether each target's place was known at time 0."""
        has_prior: BoolArray = np.isfinite(self.priors_au.sum(axis=1))
        return has_prior

    def add(self, measurement: Measurement) -> None:
        """Take in what the sensor said about every target.

        Raises BeliefError if it is older than the last one, not finite, or of fewer targets.
        """
        self._check(measurement)
        joined = len(measurement.seen) - self.num_targets
        self.priors_au = np.pad(self.priors_au, ((0, joined), (0, 0)), constant_values=np.nan)
        self._sights += [[] for _ in range(joined)]
        self._measurements.append(measurement)
        for target in np.flatnonzero(measurement.seen):
            x_au, y_au = measurement.target_au[target].tolist()
            self._sights[target].append(Sight(measurement.time_au, x_au, y_au))
        if self._hindsight:
            self._hindsight.add(measurement)
            self._believed = None

    def _check(self, measurement: Measurement) -> None:
        seen, target_au = measurement.seen, measurement.target_au
        if len(seen) < self.num_targets or target_au.shape != (len(seen), 2):
            raise BeliefError(
                f"measurement of {len(seen)} targets, with places of {len(target_au)}, given where"
                f" {self.num_targets} are known; say of each one whether and where it was seen"
            )
        if not measurement.time_au >= self.time_au:
            raise BeliefError(
                f"measurement at {measurement.time_au:g} au given after {self.time_au:g} au;"
                " add measurements in the order of their time"
            )
        if not (np.isfinite(measurement.agent_au).all() and np.isfinite(target_au[seen]).all()):
            raise BeliefError(
                f"measurement at {measurement.time_au:g} au has positions that are not finite:"
                f" agent {measurement.agent_au}, targets seen {target_au[seen].tolist()}"
            )

    def since(self, count: int) -> Sequence[Measurement]:
        """All measurements after the first `count`, oldest first."""
        return self._measurements[count:]

    def sights(self, target: int, before_au: float, most: int) -> Sequence[Sight]:
        """The latest sights of a target before a time, oldest first; a prior is the first."""
        sights = self._believed_sights[target] if target < self.num_targets else []
        end = len(sights)
        while end > 0 and sights[end - 1].time_au >= before_au:
            end -= 1
        return sights[max(0, end - most) : end]

    def _told_au(self, first: int) -> FloatArray:
        """Where each target was said to be seen by the measurements from one on, NaN where not."""
        told_au = np.full((len(self) - first, self.num_targets, 2), np.nan)
        for row, measurement in enumerate(self._measurements[first:]):
            if measurement.seen.any():
                seen = np.flatnonzero(measurement.seen)
                told_au[row, seen] = measurement.target_au[seen]
        return told_au

    def believed_au(self, first: int) -> FloatArray:
        """Where each target was seen by the measurements from one on, as is believed by now.

        -> (n, N, 2) au, NaN where it was not
        """
        return self._hindsight.believed_au(first) if self._hindsight else self._told_au(first)

    def window(
        self, span_au: float, num_targets: int | None = None, *, in_hindsight: bool = True
    ) -> Window:
        """Observations younger than a span at the time of the last measurement.

        num_targets:  by default all that are known; more of them were never seen
        in_hindsight: as they are believed by now, not as they were told
        """
        num_targets = self.num_targets if num_targets is None else num_targets
        first = len(self)
        while first > 0 and self.time_au - self._measurements[first - 1].time_au < span_au:
            first -= 1
        recent = self._measurements[first:]
        told_au = self.believed_au(first) if in_hindsight else self._told_au(first)
        seen = ~np.isnan(told_au[..., 0]).T  # (K, n)
        points = np.zeros((num_targets, 1 + len(recent), 3))
        values = np.zeros(points.shape[:2])
        mask = np.ones(points.shape[:2], dtype=np.bool_)
        points[:, 1:, :2] = np.reshape([m.agent_au for m in recent], (-1, 2))
        points[:, 1:, 2] = [m.time_au for m in recent]
        mask[:, 1:] = [m.view_au >= LEAST_VIEW_AU for m in recent]
        target, column = np.nonzero(seen)
        points[target, 1 + column, :2] = told_au[column, target]
        values[target, 1 + column], mask[target, 1 + column] = 1.0, True
        known = np.flatnonzero(self._has_prior)
        mask[:, 0] = False
        mask[known, 0] = self.time_au < span_au
        points[known, 0, :2], values[known, 0] = self.priors_au[known], 1.0
        return Window(points, values, mask)
