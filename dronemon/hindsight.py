"""What an eye that errs is believed to have seen, in the light of all that it has said since.

Of a target's sights those are believed that make its likeliest story: a walk at one speed from one
to the next, with the rest false alarms and the pictures at odds with it misses. So a false alarm is
taken back once the target is seen where it could not have come to from there, and a target that was
missed is taken to have been on its way, or, since its last sight, where that was. Every target has
its own story. For each of some speeds the best is kept sight by sight (Viterbi's algorithm), and of
these the likeliest counts. Where something hides a part of the view, only what is nearer to the
drone than that counts as looked at.

The paper's sensor needs none.
"""

from __future__ import annotations

import math

import numpy as np

from dronemon.problem import SENSOR_AREA_AU2
from dronemon.sensor import Sensor
from dronemon.types import FloatArray, IntArray, Measurement

_SPEEDS = np.geomspace(0.03, 1.0, 10)
"""Over the agent's."""
_REACH, _REACH_AU = 1.1, 0.008
"""How much further than at its speed a target may have come: a factor, and a length."""
_BEYOND_AU = 0.01
"""Length over which the chance falls that it came further still, to e^_NO_CHANCE at least."""
_NO_CHANCE = -30.0
_STRAYING_AU = 0.004
"""Radius about where a target is taken to be at once after a sight."""
_MOST_SIGHTS, _OLDEST_AU = 24, 12.0
"""Latest sights that tell where the next one may be, and their age up to which they do."""
_LEAST_FALSE = 1e-9
"""False sights in a picture, at least: stories must be able to differ."""
_SEEN_THROUGH = 0.25
"""Chance of having been in view from which on a target missed is believed to have been."""


class Hindsight:
    """Folds over a log of measurements."""

    def __init__(self, sensor: Sensor, priors_au: FloatArray) -> None:
        """priors_au: (N, 2) places of the known targets at time 0, NaN where unknown."""
        self._sensor = sensor
        self._looks = np.empty((0, 4))  # time, x, y, radius of what was looked at
        self._stories = [_Story(sensor, prior_au) for prior_au in priors_au]

    def add(self, measurement: Measurement, num_known: int | None = None) -> None:
        """Take in what the sensor said of every target; new ones join.

        num_known: of these, how many are known of, and share false alarms; by default all
        """
        look = [measurement.time_au, *measurement.agent_au, measurement.view_au]
        self._looks = np.concatenate([self._looks, [look]])
        joined = len(measurement.seen) - len(self._stories)
        self._stories += [_Story(self._sensor, np.full(2, np.nan)) for _ in range(joined)]
        num_known = len(self._stories) if num_known is None else num_known
        false = max(self._sensor.false_sights, _LEAST_FALSE) / max(num_known, 1)
        density = false / SENSOR_AREA_AU2
        for target, story in enumerate(self._stories):
            is_seen = measurement.seen[target]
            story.add(self._looks, measurement.target_au[target] if is_seen else None, density)

    def believed_au(self, first: int) -> FloatArray:
        """Where targets are believed to have been seen by all measurements from one on.

        -> (n, N, 2) au, NaN where not
        """
        told_au = np.full((len(self._looks) - first, len(self._stories), 2), np.nan)
        for target, story in enumerate(self._stories):
            story.tell(self._looks, first, told_au[:, target])
        return told_au

    def sights(self) -> list[FloatArray]:
        """Time and place of each target's sights that are believed, a prior first. -> (S, 3) au"""
        return [story.sights for story in self._stories]


class _Story:
    """What may have become of one target, for each of V speeds.

    sights: (S, 3) time, x, y of each, a prior first
    at:     (S,)   the measurement that told of it, -1 for a prior
    score:  (S, V) log-likelihood of the best story with it, if no later one is believed
    before: (S, V) the sight before it in that story, -1 for none
    since:  (S, V) log-likelihood of the misses since
    """

    def __init__(self, sensor: Sensor, prior_au: FloatArray) -> None:
        self._untold = sensor.untold
        self._found = min(1.0 - sensor.untold, 0.999)
        self._blur_au = sensor.position_au
        width = len(_SPEEDS)
        self._sights = np.empty((0, 3))
        self._at: IntArray = np.empty(0, dtype=np.int64)
        self._score, self._since = np.empty((0, width)), np.empty((0, width))
        self._before: IntArray = np.empty((0, width), dtype=np.int64)
        self._all_false = 0.0  # log-likelihood of that no sight is believed
        if np.isfinite(prior_au).all():
            self._append(np.array([0.0, *prior_au]), -1, np.zeros(width), np.full(width, -1))
            self._all_false = -math.inf

    def add(self, looks: FloatArray, seen_au: FloatArray | None, false_density: float) -> None:
        """Take in the last of the looks. seen_au: (2,) where it told of the target, if it did."""
        told = None if seen_au is None else self._follow(looks, seen_au)
        sights = self._sights[:, None]
        strayed_au = _STRAYING_AU + _SPEEDS * (looks[-1, 0] - sights[..., 0])  # (S, V)
        self._since += self._missed(_share_in_view(sights[..., 1:], strayed_au, looks[-1]))
        if told is not None and seen_au is not None:
            self._score += math.log(false_density)
            self._all_false += math.log(false_density)
            self._append(np.array([looks[-1, 0], *seen_au]), len(looks) - 1, *told)

    def _append(self, sight: FloatArray, at: int, score: FloatArray, before: IntArray) -> None:
        self._sights = np.concatenate([self._sights, [sight]])
        self._at = np.append(self._at, at)
        self._score = np.concatenate([self._score, [score]])
        self._before = np.concatenate([self._before, [before]])
        self._since = np.concatenate([self._since, np.zeros((1, len(_SPEEDS)))])

    def _follow(self, looks: FloatArray, seen_au: FloatArray) -> tuple[FloatArray, IntArray]:
        """Score the best story with a new sight; the one that it follows. -> (V,), (V,)"""
        now = np.array([looks[-1, 0], *seen_au])
        count = len(self._sights)
        young = int(np.searchsorted(self._sights[:, 0], now[0] - _OLDEST_AU))
        offset = max(count - _MOST_SIGHTS, young, 0)
        # It may be anywhere if no sight is believed, or none that tells where it may be.
        ends = np.full((1 + offset, len(_SPEEDS)), self._all_false)
        ends[1:] = self._score[:offset] + self._since[:offset]
        scores = ends.max(axis=0)[None]
        if offset < count:
            sights, at = self._sights[offset:, None], self._at[offset:, None]  # (S, 1, 3), (S, 1)
            reach = self._reach(now[0] - sights[..., 0], _SPEEDS)  # (S, V)
            came = np.hypot(now[1] - sights[..., 1], now[2] - sights[..., 2])
            beyond = np.maximum(came - reach, 0.0) / _BEYOND_AU
            arrival = np.maximum(-np.log(math.pi * reach**2) - beyond, _NO_CHANCE)
            passed = np.arange(at[0, 0] + 1, len(looks) - 1)
            between = looks[passed, None]  # (L, 1, 4)
            place_au, aside_au = _walked(sights[:, None], now, reach[:, None], between[..., 0])
            share = _share_in_view(place_au, _STRAYING_AU + aside_au, between)  # (S, L, V)
            missed = np.where((passed > at)[..., None], self._missed(share), 0.0).sum(axis=1)
            scores = np.concatenate([scores, self._score[offset:] + arrival + missed])
        best = scores.argmax(axis=0)
        before = np.where(best == 0, ends.argmax(axis=0) - 1, best - 1 + offset)
        return scores.max(axis=0) + math.log(self._found), before

    def tell(self, looks: FloatArray, first: int, told_au: FloatArray) -> None:
        """Write where the likeliest story has the target seen. told_au: (n, 2) of looks[first:]"""
        story, of = self._likeliest(first)
        if not story:
            return
        sights, at = self._sights[story], self._at[story]
        told_au[at[at >= first] - first] = sights[at >= first, 1:]
        missed = np.setdiff1d(np.arange(max(first, at[0] + 1), len(looks)), at)
        if not len(missed):
            return
        speed, time_au, after = _SPEEDS[of], looks[missed, 0], np.searchsorted(at, missed)
        then, following = sights[after - 1], sights[np.minimum(after, len(at) - 1)]
        reach_au = self._reach(following[:, 0] - then[:, 0], speed)
        place_au, aside_au = _walked(then, following, reach_au, time_au)
        is_since = after == len(at)
        aside_au[is_since] = speed * (time_au - then[:, 0])[is_since]
        share = _share_in_view(place_au, _STRAYING_AU + aside_au, looks[missed])
        share = share * self._untold / (1.0 - (1.0 - self._untold) * share + 1e-9)
        is_seen = share > _SEEN_THROUGH
        told_au[missed[is_seen] - first] = place_au[is_seen]

    @property
    def sights(self) -> FloatArray:
        """Those of the likeliest story, a prior first. -> (S, 3)"""
        sights: FloatArray = self._sights[self._likeliest(0)[0]]
        return sights

    def _likeliest(self, first: int) -> tuple[list[int], int]:
        """Sights of the likeliest story, from the last before a look on, and which speed it has."""
        ends = self._score + self._since
        if not len(ends) or ends.max() < self._all_false:
            return [], 0
        last, of = (int(index) for index in np.unravel_index(ends.argmax(), ends.shape))
        story = [last]
        while self._at[story[-1]] >= first and self._before[story[-1], of] >= 0:
            story.append(int(self._before[story[-1], of]))
        return story[::-1], of

    def _reach(self, duration_au: FloatArray, speed: FloatArray | float) -> FloatArray:
        """How far a target may have come."""
        return _REACH * speed * duration_au + _REACH_AU + 2.0 * self._blur_au

    def _missed(self, share: FloatArray) -> FloatArray:
        """Log-likelihood of not being found where that share of the places was in view."""
        return np.log1p(-self._found * share)


def _walked(
    then: FloatArray, now: FloatArray, reach_au: FloatArray, time_au: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where a target was on its way from one sight to another, and within what radius of it.

    then, now: (..., 3); reach_au: (...) how far it may have come; time_au: (...) -> (..., 2), (...)
    """
    duration_au = now[..., 0] - then[..., 0]
    part = ((time_au - then[..., 0]) / np.maximum(duration_au, 1e-9)).clip(0.0, 1.0)
    way_au = now[..., 1:] - then[..., 1:]
    came_au2 = (way_au**2).sum(axis=-1)
    aside_au = np.sqrt(np.maximum(reach_au**2 - came_au2, 0.0)) * np.minimum(part, 1.0 - part)
    return then[..., 1:] + part[..., None] * way_au, aside_au


def _share_in_view(place_au: FloatArray, radius_au: FloatArray, look: FloatArray) -> FloatArray:
    """About how much of a disc was in view. (..., 2), (...), (..., 4) -> (...)"""
    away_au = np.hypot(place_au[..., 0] - look[..., 1], place_au[..., 1] - look[..., 2])
    view_au = np.maximum(look[..., 3], 1e-6)
    overlap = (view_au + radius_au - away_au) / (2.0 * np.minimum(view_au, radius_au))
    most = np.minimum(1.0, (view_au / radius_au) ** 2)
    return overlap.clip(0.0, 1.0) * most
