"""Whose each find is: detections of one picture, and targets of which several may look alike.

A target that alone has its look, and that is taken for no other, owns the best find of that look.
Those that look alike share theirs out so that all together is likeliest: global nearest neighbour,
by where each was last seen, how fast such targets are, and who should be in the picture.

Source: Bar-Shalom, Willett & Tian (2011), "Tracking and Data Fusion", global nearest neighbour.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chndtr

from dronemon.mission import Mission
from dronemon.problem import SENSOR_AREA_AU2, SENSOR_RADIUS_AU
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, IntArray

NOBODY = -1
_ERROR_AU = 0.015
"""Of a place seen, one sigma per axis, where the vehicle's own place and tilt are off."""
_TURNING = 0.75
"""A target is away by a reach times time to this power: 1 if it walked straight, 0.5 at random."""
_USUAL_REACH, _USUAL_WEIGHT = 0.05, 4
"""Reach that is expected at first, and how many pairs of sights it counts for."""
_LEAST_PAIR_AU = 0.3
"""Time between two sights from which they tell the reach."""
_NUM_SIGHTS = 32
_ANYWHERE = 0.02
"""Chance that a target is not where its last sight lets it be."""
_OTHERS = 0.02
"""Density per au^2 of finds that are none of the targets, at least."""
_MOST_SEEN = 0.98
"""A target in view is never surer to be found than that."""
_NEVER = 1e-300
Confusion = Mapping[str, Mapping[str, float]]
_NONE: Confusion = MappingProxyType({})


class Owners:
    """Shares finds out among the targets of one mission."""

    def __init__(
        self, appearances: Sequence[str], confusion: Confusion = _NONE, miss: float = 0.0
    ) -> None:
        """appearances: of the targets, in their order; miss: chance that one in view is not found.

        confusion: of targets of the first look, the share that is found as the second
        """
        self._found = min(1.0 - miss, _MOST_SEEN)
        self._looks = list(appearances)
        self._taken = {look: _taken_for(look, confusion) for look in self._looks}
        names = [set(taken) for taken in self._taken.values()]
        self._is_alone = np.array(
            [
                self._looks.count(look) == 1
                and set(self._taken[look]) == {look}
                and sum(look in each for each in names) == 1
                for look in self._looks
            ]
        )

    @classmethod
    def of_mission(cls, mission: Mission) -> Owners:
        """Those of a mission's targets."""
        looks = [target.appearance for target in mission.targets]
        return cls(looks, mission.detector.confusion, mission.sensor.model.untold)

    @property
    def num_targets(self) -> int:
        """N."""
        return len(self._looks)

    def of(
        self,
        looks: Sequence[str],
        scores: Sequence[float],
        places_au: FloatArray,
        *,
        agent_au: FloatArray,
        time_au: float,
        sightings: Sightings,
    ) -> list[int]:
        """Which target each find is, or `NOBODY`.

        looks, scores, places_au: of the finds, (D,), (D,), (D, 2)
        agent_au:                 (2,) centre of the view
        sightings:                what was seen before
        """
        owners = [NOBODY] * len(looks)
        for target in np.flatnonzero(self._is_alone).tolist():
            own = [d for d, look in enumerate(looks) if look == self._looks[target]]
            if own:
                owners[max(own, key=lambda d: scores[d])] = target
        alike = np.flatnonzero(~self._is_alone).tolist()
        finds = [
            d
            for d, look in enumerate(looks)
            if any(look in self._taken[self._looks[i]] for i in alike)
        ]
        if not finds:
            return owners
        own_looks = [looks[find] for find in finds]
        cost = self._costs(own_looks, places_au[finds], alike, agent_au, time_au, sightings)
        chosen: IntArray = linear_sum_assignment(cost)[1]
        for find, column in zip(finds, chosen.tolist(), strict=True):
            if column < len(alike):
                owners[find] = alike[column]
        return owners

    def _costs(
        self,
        looks: Sequence[str],
        places_au: FloatArray,
        targets: Sequence[int],
        agent_au: FloatArray,
        time_au: float,
        sightings: Sightings,
    ) -> FloatArray:
        """How unlikely each find is each target, and then nobody. -> (D, N + D)"""
        cost = np.full((len(looks), len(targets) + len(looks)), -math.log(_OTHERS))
        reach = _reach(sightings, targets)
        for column, target in enumerate(targets):
            where = _whereabouts(sightings, target, time_au, reach)
            gain = self._found / (1.0 - self._found * _in_view(*where, agent_au))
            for row, look in enumerate(looks):
                taken = self._taken[self._looks[target]].get(look, 0.0)
                density = _density(places_au[row], *where)
                cost[row, column] = -math.log(max(gain * taken * density, _NEVER))
        return cost


def _taken_for(look: str, confusion: Confusion) -> dict[str, float]:
    """How often a target of a look is found as what."""
    others = {other: share for other, share in confusion.get(look, {}).items() if share > 0.0}
    return {look: 1.0 - sum(others.values()), **others}


def _reach(sightings: Sightings, targets: Sequence[int]) -> float:
    """How far targets are away after 1 au: median over pairs of sights, with some usual ones."""
    reaches = [_USUAL_REACH] * _USUAL_WEIGHT
    for target in targets:
        for then, now in pairwise(sightings.sights(target, math.inf, _NUM_SIGHTS)):
            since_au = now.time_au - then.time_au
            if since_au > _LEAST_PAIR_AU:
                reaches.append(math.dist(then[1:], now[1:]) / since_au**_TURNING)
    return float(np.median(reaches))


def _whereabouts(
    sightings: Sightings, target: int, time_au: float, reach: float
) -> tuple[float, FloatArray | None]:
    """Standard deviation per axis and centre of where a target may be; None if anywhere."""
    sights = sightings.sights(target, math.inf, 1)
    if not sights:
        return math.inf, None
    since_au = max(time_au - sights[-1].time_au, 0.0)
    spread_au = math.hypot(math.sqrt(2.0) * _ERROR_AU, reach * since_au**_TURNING)
    return spread_au, np.array(sights[-1][1:])


def _density(at_au: FloatArray, spread_au: float, place_au: FloatArray | None) -> float:
    """Of a target at a place, per au^2; one that may be anywhere is as likely here as there."""
    if place_au is None:
        return 1.0
    squared = float(((at_au - place_au) ** 2).sum())
    near = math.exp(-0.5 * squared / spread_au**2) / (math.tau * spread_au**2)
    return (1.0 - _ANYWHERE) * near + _ANYWHERE


def _in_view(spread_au: float, place_au: FloatArray | None, agent_au: FloatArray) -> float:
    """Chance that a target is in view."""
    if place_au is None:
        return SENSOR_AREA_AU2
    squared = float(((agent_au - place_au) ** 2).sum())
    inside = chndtr((SENSOR_RADIUS_AU / spread_au) ** 2, 2.0, squared / spread_au**2)
    return (1.0 - _ANYWHERE) * float(inside) + _ANYWHERE * SENSOR_AREA_AU2
