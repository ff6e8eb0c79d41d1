"""The ways of a flight that keep to its field: to where it patrols, and home."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

from dronemon.arena import Arena
from dronemon.frames import AreaFrame
from dronemon.guidance import Point
from dronemon.types import FloatArray

_MOVED_AU = 0.02
"""How far the drone flies before its way home is sought anew."""
_ROOM = 1.5
"""Room about a home outside of the field, in margins that the drone keeps."""


class Routes:
    """Straight in a square; else within the field and around no-fly zones.

    From a home outside of the field, or in a zone, the way is the nearest that keeps out of zones.
    """

    def __init__(self, frame: AreaFrame, home_m: Point) -> None:
        """home_m: north and east."""
        self._frame, self._home_m = frame, home_m
        home_au = frame.ned_to_au(np.array(home_m))
        self._arena = frame.arena
        if not (self._arena.is_rectangle or self._arena.contains(home_au)):
            self._arena = _widened(self._arena, home_au)
        self._end_au = self._arena.clip_free(home_au)
        self._sought_m: Point = (math.inf, math.inf)
        self._home_legs_m: Sequence[Point] = ()

    @property
    def are_straight(self) -> bool:
        """Whether all of them are: the autopilot may return by itself."""
        return self._arena.is_rectangle

    def to(self, start_m: Point, goal_m: Point) -> list[Point]:
        """Places to fly to, one after the other, the goal last."""
        if self.are_straight:
            return [goal_m]
        goal_au = self._frame.ned_to_au(np.array(goal_m))
        return self._way(start_m, self._arena.clip_free(goal_au))

    def home(self, start_m: Point) -> list[Point]:
        """The same to home, or to the nearest place where the drone may be."""
        return self._way(start_m, self._end_au)

    def legs_home(self, start_m: Point) -> Sequence[Point]:
        """Each leg of the way home, (north, east) in m: of one found a little before."""
        if math.dist(start_m, self._sought_m) > _MOVED_AU * self._frame.side_m:
            self._sought_m = start_m
            places = [start_m, *self.home(start_m), self._home_m]
            self._home_legs_m = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(places)]
        return self._home_legs_m

    def _way(self, start_m: Point, end_au: FloatArray) -> list[Point]:
        way_au = self._arena.way(self._frame.ned_to_au(np.array(start_m)), end_au)
        return [(float(north), float(east)) for north, east in self._frame.au_to_ned(way_au)]


def _widened(arena: Arena, home_au: FloatArray) -> Arena:
    """An area with a place outside of it, some room about that, and all between them."""
    angle = 2.0 * np.pi * np.arange(8) / 8.0
    room_au = home_au + _ROOM * arena.margin_au * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    places_au = np.concatenate([arena.outline_au[:-1], home_au[None], room_au])
    hull_au = places_au[ConvexHull(places_au).vertices]
    zones_au = [np.array(zone) for zone in arena.no_fly_au]
    return Arena.polygon(hull_au, zones_au, margin_au=arena.margin_au)
