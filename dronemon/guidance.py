"""A carrot that runs along the legs of the flight and never stops at a waypoint.

The carrot's position is the mean of the path over a window of +-w around its arc length s, its
velocity the derivative. A corner so becomes a parabola with constant acceleration
v^2 |d2 - d1| / (2 w), where d1 and d2 are the directions of the legs: w = v^2 / (2 a) keeps it at
or below a for turns to 60 degrees. The carrot slows down as it gets ahead of the vehicle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

Point = tuple[float, float]
_LEAD_FREE_S = 0.5
"""The carrot keeps its speed while it is less than this far ahead, in seconds of cruise."""
_LEAD_STOP_S = 2.5
"""And waits when it is this far ahead."""


@dataclass(frozen=True, slots=True)
class _Leg:
    """A straight piece of the path, beginning at arc length `start_m`."""

    a: Point
    b: Point
    start_m: float
    length_m: float

    @property
    def end_m(self) -> float:
        return self.start_m + self.length_m

    def at(self, s_m: float) -> Point:
        share = (s_m - self.start_m) / self.length_m
        return (
            self.a[0] + (self.b[0] - self.a[0]) * share,
            self.a[1] + (self.b[1] - self.a[1]) * share,
        )


class Carrot:
    """Moves along a growing path of legs in the horizontal plane (north, east in metres).

    window_m is how long before a leg's end the next one is needed.
    """

    def __init__(self, start_m: Point, *, speed_m_s: float, max_acceleration_m_s2: float) -> None:
        self._speed_m_s = speed_m_s
        self.window_m = 0.5 * speed_m_s**2 / max_acceleration_m_s2
        self._legs: deque[_Leg] = deque()
        self.end_m = start_m
        """Last waypoint of the path."""
        self._s_m = 0.0

    @property
    def remaining_m(self) -> float:
        """Path left from the carrot to the last waypoint."""
        return (self._legs[-1].end_m if self._legs else 0.0) - self._s_m

    @property
    def needs_waypoint(self) -> bool:
        """Whether the next leg must be known by now."""
        return self.remaining_m <= self.window_m

    def extend(self, waypoint_m: Point) -> None:
        """Add a leg from the last waypoint to this one; one on the same spot adds nothing."""
        length_m = math.dist(self.end_m, waypoint_m)
        if length_m < 1e-6:
            return
        start_m = self._legs[-1].end_m if self._legs else self._s_m
        self._legs.append(_Leg(self.end_m, waypoint_m, start_m, length_m))
        self.end_m = waypoint_m

    def advance(self, duration_s: float, vehicle_m: Point) -> tuple[Point, Point]:
        """Move on. -> carrot's position (north, east) in m, its velocity in m/s."""
        position, direction = self._smoothed()
        lead_s = math.dist(position, vehicle_m) / self._speed_m_s
        pace = min(max((_LEAD_STOP_S - lead_s) / (_LEAD_STOP_S - _LEAD_FREE_S), 0.0), 1.0)
        step_m = min(self._speed_m_s * pace * duration_s, max(self.remaining_m, 0.0))
        self._s_m += step_m
        while len(self._legs) > 1 and self._legs[0].end_m < self._s_m - self.window_m:
            self._legs.popleft()
        position, direction = self._smoothed()
        speed_m_s = step_m / duration_s if duration_s > 0.0 else 0.0
        return position, (direction[0] * speed_m_s, direction[1] * speed_m_s)

    def _smoothed(self) -> tuple[Point, Point]:
        """Mean of the path over the window around s, and its derivative by s."""
        if not self._legs:
            return self.end_m, (0.0, 0.0)
        first_m, last_m = self._legs[0].start_m, self._legs[-1].end_m
        half_m = min(self.window_m, self._s_m - first_m, last_m - self._s_m)
        if half_m < 1e-3:
            leg = next(leg for leg in self._legs if leg.end_m >= self._s_m)
            return leg.at(self._s_m), _direction(leg)
        low_m, high_m = self._s_m - half_m, self._s_m + half_m
        north = east = 0.0
        for leg in self._legs:
            a_m, b_m = max(low_m, leg.start_m), min(high_m, leg.end_m)
            if b_m > a_m:
                middle = leg.at((a_m + b_m) / 2.0)
                north += middle[0] * (b_m - a_m)
                east += middle[1] * (b_m - a_m)
        width_m = high_m - low_m
        (n0, e0), (n1, e1) = self._at(low_m), self._at(high_m)
        return (north / width_m, east / width_m), ((n1 - n0) / width_m, (e1 - e0) / width_m)

    def _at(self, s_m: float) -> Point:
        leg = next((leg for leg in self._legs if leg.end_m >= s_m), self._legs[-1])
        return leg.at(min(max(s_m, leg.start_m), leg.end_m))

    def cross_track_m(self, position_m: Point) -> float:
        """Distance from a place to the legs around the carrot."""
        return min((_distance_to(leg, position_m) for leg in self._legs), default=0.0)


def _direction(leg: _Leg) -> Point:
    return (leg.b[0] - leg.a[0]) / leg.length_m, (leg.b[1] - leg.a[1]) / leg.length_m


def _distance_to(leg: _Leg, point: Point) -> float:
    direction = _direction(leg)
    along = sum(d * (p - a) for d, p, a in zip(direction, point, leg.a, strict=True))
    return math.dist(point, leg.at(leg.start_m + min(max(along, 0.0), leg.length_m)))
