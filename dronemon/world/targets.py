"""Where targets are: each walks along a path, in the paper at constant speed between random points.

Source: paper, section V ("pre-solved TSP patterns, each consisting of 50 randomly generated
nodes").
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.types import FloatArray, IntArray

POINTS_PER_PATH = 50


@dataclass(frozen=True, kw_only=True)
class TargetPaths:
    """Paths of all targets; a target that reaches the end of its path walks it back.

    points_au: (N, P, 2) float64 au, each path's points in the order in which they are visited; the
               last again in paths of fewer
    marks_au:  (N, P)    distance walked at which each is reached, a rest counted as if it walked on
    is_closed: each path ends where it begins, and the target goes on the same way round
    """

    points_au: FloatArray
    marks_au: FloatArray
    is_closed: bool = False

    @classmethod
    def along(cls, ways_au: Iterable[FloatArray], *, is_closed: bool = False) -> TargetPaths:
        """Targets that never rest. ways_au: (P, 2) of each, not of one length perhaps."""
        points_au = stacked(ways_au)
        steps = np.diff(points_au, axis=1)
        lengths = np.sqrt(steps[..., 0] ** 2 + steps[..., 1] ** 2)
        marks = np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0)))
        return cls(points_au=points_au, marks_au=marks, is_closed=is_closed)

    @classmethod
    def random(
        cls, num_targets: int, rng: np.random.Generator, arena: Arena = ARENA
    ) -> TargetPaths:
        """Draw one path per target; the first targets of a larger draw are those of a smaller one.

        The two ends of a path are uniform random points, as in the authors' release, so targets
        start uniformly in the arena; only the order of the points between them is shortened, as
        if nothing were in the way.
        """
        drawn = [arena.sample(POINTS_PER_PATH, rng) for _ in range(num_targets)]
        return cls.along(inside(points[short_path_order(points)], arena) for points in drawn)

    def at_speeds(self, factors: FloatArray) -> TargetPaths:
        """The same paths, each target so many times as fast as the others take it. factors: (N,)"""
        return replace(self, marks_au=self.marks_au / factors[:, None])

    @property
    def num_targets(self) -> int:
        """N."""
        return int(self.points_au.shape[0])

    @cached_property
    def _directions_rad(self) -> FloatArray:
        """(N, P - 1) heading of each segment; where a target rests, the one with which it came."""
        steps = np.diff(self.points_au, axis=1)
        headings = np.arctan2(steps[..., 1], steps[..., 0])
        moves = (steps != 0.0).any(axis=-1)
        newest = np.maximum.accumulate(np.where(moves, np.arange(steps.shape[1]), 0), axis=1)
        directions: FloatArray = np.take_along_axis(headings, newest, axis=1)
        return directions

    @property
    def lengths_au(self) -> FloatArray:
        """(N,) of each path: in the paper 4.9 to 6.6 au, where its fastest targets walk 4.3."""
        lengths: FloatArray = self.marks_au[:, -1]
        return lengths

    def _arcs_au(self, target: int, distance_au: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance walked -> arc length from the path's start, and direction: +1 out, -1 back."""
        length = self.lengths_au[target]
        if self.is_closed:
            return np.mod(distance_au, length), np.ones_like(distance_au)
        phase = np.mod(distance_au, 2.0 * length)
        is_back = phase > length
        return np.where(is_back, 2.0 * length - phase, phase), np.where(is_back, -1.0, 1.0)

    def positions_au(self, distance_au: float | FloatArray) -> FloatArray:
        """Targets' positions after a distance walked. () or (S,) au -> (N, 2) or (S, N, 2) au."""
        walked = np.asarray(distance_au, dtype=np.float64)
        places = []
        for target, (points, marks) in enumerate(zip(self.points_au, self.marks_au, strict=True)):
            arcs, _ = self._arcs_au(target, walked)
            places.append(np.stack([np.interp(arcs, marks, points[:, k]) for k in (0, 1)], axis=-1))
        return np.stack(places, axis=-2)

    def headings_rad(self, distance_au: float | FloatArray) -> FloatArray:
        """Headings of targets, from the x axis towards y. () or (S,) au -> (N,) or (S, N) rad."""
        walked = np.asarray(distance_au, dtype=np.float64)
        headings = []
        for target, marks in enumerate(self.marks_au):
            arcs, direction = self._arcs_au(target, walked)
            segment = np.clip(np.searchsorted(marks, arcs, side="right") - 1, 0, len(marks) - 2)
            turned = np.where(direction < 0.0, np.pi, 0.0)
            headings.append(self._directions_rad[target, segment] + turned)
        return np.stack(headings, axis=-1)


def stacked(rows: Iterable[FloatArray]) -> FloatArray:
    """Arrays of any lengths as one, of shorter ones the last entry again. -> (N, P, ...)."""
    rows = list(rows)
    longest = max(map(len, rows))
    return np.stack([np.concatenate([row, row[-1:].repeat(longest - len(row), 0)]) for row in rows])


def inside(places_au: FloatArray, arena: Arena) -> FloatArray:
    """The shortest way through places in the arena that never leaves it. (P, 2) -> (P' >= P, 2)."""
    if arena.is_rectangle:
        return places_au
    legs = [arena.field_ways.way(here, there) for here, there in pairwise(places_au)]
    return np.concatenate([places_au[:1], *legs])


def short_path(distances_au: FloatArray) -> IntArray:
    """Order of a short open path from the first point to the second: nearest neighbour and 2-opt.

    Only correctly rounded elementwise operations decide, so the order is the same on any machine.

    distances_au: (P, P) -> (P,) indices, 0 first and 1 last
    """
    order = _nearest_neighbour_order(distances_au)
    num_legs = len(order) - 1
    is_pair = np.triu(np.ones((num_legs, num_legs), dtype=bool), k=2)
    while True:
        along = distances_au[np.ix_(order, order)]
        legs = along[np.arange(num_legs), np.arange(1, num_legs + 1)]
        # Cutting legs i and j and walking what lies between them backwards.
        change = along[:-1, :-1] + along[1:, 1:] - legs[:, None] - legs[None]
        change[~is_pair] = 0.0
        first, second = divmod(int(np.argmin(change)), num_legs)
        if not change[first, second] < -1e-9:  # nor where it is no number, for no way leads there
            return order
        order[first + 1 : second + 1] = order[first + 1 : second + 1][::-1]


def _nearest_neighbour_order(distances_au: FloatArray) -> IntArray:
    """Order from point 0, always to the nearest point left, point 1 last. (P, P) -> (P,)."""
    count = len(distances_au)
    is_left = np.ones(count, dtype=bool)
    is_left[:2] = False
    order = np.zeros(count, dtype=np.int64)
    order[-1] = 1
    for position in range(1, count - 1):
        nearest = int(np.argmin(np.where(is_left, distances_au[order[position - 1]], np.inf)))
        order[position] = nearest
        is_left[nearest] = False
    return order


def short_path_order(points_au: FloatArray) -> IntArray:
    """What `short_path` gives of places, by straight distances. (P, 2) -> (P,) indices."""
    offsets = points_au[:, None] - points_au[None]
    return short_path(np.sqrt(offsets[..., 0] ** 2 + offsets[..., 1] ** 2))
