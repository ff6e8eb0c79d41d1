"""A carrot that runs along the legs of the flight, just ahead of the vehicle.

The path is the mean of the legs over a window of +-w around arc length s, its tangent the
derivative by s. A corner so becomes a parabola: flown at ds/dt = v it takes the constant
acceleration v^2 |d2 - d1| / (2 w), where d1 and d2 are the directions of the legs, and
w = v^2 / (2 a) makes that a for a turn of 60 degrees. Where the tangent is shorter than 1, s moves
faster, so that the vehicle keeps its ground speed in all but the sharpest corners.

PX4 flies at the velocity of a setpoint plus MPC_XY_P times what it is off the position. Velocity
and acceleration are the path's at cruise speed; a carrot that waits when it leads by too much, and
a shorter velocity where the vehicle is off the path, keep the sum within `max_speed_m_s`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from dronemon.energy import Wind
from dronemon.types import GRAVITY_M_S2, Pose

Point = tuple[float, float]
POSITION_GAIN_PER_S = 0.95
"""PX4's MPC_XY_P as it comes."""
_SHORTEST_TANGENT = 0.75
"""Corners are flown at cruise speed where the tangent is longer, slower where it is shorter."""
_LEAD_SHARE = 0.8
"""A lead takes this share of what is between cruise and bound; the rest is for gusts."""
_LEAD_FREE = 0.6
"""The carrot keeps its speed below this share of the lead at which it waits."""
_ASIDE_S = 0.5
"""Being off the path counts as a lead from here on, in seconds of cruise."""
_PREVIEW_S = 0.3
"""Acceleration is the mean over this time to come: the vehicle must tilt first."""
_ASK_AHEAD_S = 0.25
"""The next leg should be there so long before the carrot would brake for want of it."""
_DOUBT_M2_S2 = 40.0
"""Squares of velocity changes, summed, that it takes to half believe in a drag; at first, none."""
_DRAG_MAX_PER_S = 1.0
_MEMORY_S = 300.0
"""After so long what was learned of drag and wind counts a third."""
_DOUBT_POSES = 20
"""Poses that it takes to half believe in a wind: a second's, the noise of their accelerations."""


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

    window_m: how long before a leg's end the next one is needed; with none known the carrot brakes
    from there on. The path is off its legs by half of it at most.
    """

    def __init__(
        self,
        start_m: Point,
        *,
        speed_m_s: float,
        max_speed_m_s: float,
        max_acceleration_m_s2: float,
        window_m: float,
        ground_speed_m_s: float = 0.0,
    ) -> None:
        self._cruise_m_s = speed_m_s
        self._max_m_s = max_speed_m_s
        self.window_m = window_m
        self._acceleration_m_s2 = max_acceleration_m_s2
        self._speed_m_s = min(ground_speed_m_s, speed_m_s)  # of a vehicle on the path
        self._legs: deque[_Leg] = deque()
        self.off_m = 0.0
        """How far the vehicle is from the carrot."""
        self.end_m = start_m
        """Last waypoint of the path."""
        self._s_m = 0.0

    @property
    def travelled_m(self) -> float:
        """Path behind the carrot."""
        return self._s_m

    @property
    def remaining_m(self) -> float:
        """Path left from the carrot to the last waypoint."""
        return max(self._legs[-1].end_m - self._s_m, 0.0) if self._legs else 0.0

    @property
    def ahead_m(self) -> list[Point]:
        """The carrot's place on its legs, and the ends of these, one after the other."""
        here_m = self._at(self._s_m) if self._legs else self.end_m
        return [here_m, *(leg.b for leg in self._legs if leg.end_m > self._s_m)]

    def needs_waypoint(self, answer_s: float = 0.0) -> bool:
        """Whether to ask for the next leg, which takes `answer_s` to come."""
        ahead_s = _ASK_AHEAD_S + answer_s
        return self.remaining_m <= self.window_m + ahead_s * self._cruise_m_s

    def extend(self, waypoint_m: Point) -> None:
        """Add a leg from the last waypoint to this one; one on the same spot adds nothing."""
        length_m = math.dist(self.end_m, waypoint_m)
        if length_m < 1e-6:
            return
        start_m = self._legs[-1].end_m if self._legs else self._s_m
        self._legs.append(_Leg(self.end_m, waypoint_m, start_m, length_m))
        self.end_m = waypoint_m

    def turn_off(self) -> Point:
        """Cut the path as near ahead as it can be left without haste. -> its new end."""
        end_m = self._s_m + self.window_m + _ASK_AHEAD_S * self._cruise_m_s
        while len(self._legs) > 1 and self._legs[-1].start_m >= end_m:
            self._legs.pop()
        if self._legs and self._legs[-1].end_m > end_m:
            leg = self._legs.pop()
            place_m = leg.at(end_m)
            self._legs.append(_Leg(leg.a, place_m, leg.start_m, end_m - leg.start_m))
        if self._legs:
            self.end_m = self._legs[-1].b
        return self.end_m

    def advance(self, duration_s: float, vehicle_m: Point) -> tuple[Point, Point, Point]:
        """Move on. -> what to ask for (north, east): position in m, velocity, acceleration."""
        self._speed_m_s = self._speed_after(duration_s, self.remaining_m)
        position_m, tangent = self._smoothed(self._s_m)
        rate_m_s = self._speed_m_s / _stretch(tangent)
        pace = self._pace(position_m, tangent, vehicle_m)
        self._s_m += min(rate_m_s * pace * duration_s, self.remaining_m)
        while len(self._legs) > 1 and self._legs[0].end_m < self._s_m - self.window_m:
            self._legs.popleft()
        position_m, velocity_m_s = self._motion(self._s_m, self._speed_m_s)
        self.off_m = math.dist(position_m, vehicle_m)
        ahead_m = min(rate_m_s * _PREVIEW_S, self.remaining_m)
        soon_m_s = self._speed_after(_PREVIEW_S, self.remaining_m - ahead_m)
        _, then_m_s = self._motion(self._s_m + ahead_m, soon_m_s)
        # A carrot that waits is not on its way round the corner: what would take the vehicle there
        # would hold it back here, for good.
        share = min(2.0 * pace, 1.0) / _PREVIEW_S
        north, east = (share * (b - a) for a, b in zip(velocity_m_s, then_m_s, strict=True))
        return *self._bounded(position_m, velocity_m_s, vehicle_m), (north, east)

    def _speed_after(self, duration_s: float, remaining_m: float) -> float:
        """Ground speed that is reached by then, and from which it can stop at the path's end."""
        a = self._acceleration_m_s2
        stopping_m_s = math.sqrt(2.0 * a * remaining_m)
        return min(self._speed_m_s + a * duration_s, self._cruise_m_s, stopping_m_s)

    def _pace(self, position_m: Point, tangent: Point, vehicle_m: Point) -> float:
        """Share of its speed at which the carrot goes on: it must not lead by too much."""
        north_m, east_m = position_m[0] - vehicle_m[0], position_m[1] - vehicle_m[1]
        length = math.hypot(*tangent) or 1.0
        along_m = (north_m * tangent[0] + east_m * tangent[1]) / length
        aside_m = abs(north_m * tangent[1] - east_m * tangent[0]) / length
        # A vehicle that is ahead is never waited for: it would stand where its velocity and its
        # way back cancel each other.
        lead_m = max(along_m, aside_m - _ASIDE_S * self._cruise_m_s)
        most_m = _LEAD_SHARE * (self._max_m_s - self._cruise_m_s) / POSITION_GAIN_PER_S
        if lead_m <= _LEAD_FREE * most_m:
            return 1.0
        return max(most_m - lead_m, 0.0) / ((1.0 - _LEAD_FREE) * most_m) if most_m else 0.0

    def _bounded(
        self, position_m: Point, velocity_m_s: Point, vehicle_m: Point
    ) -> tuple[Point, Point]:
        """Position and velocity for which PX4 flies no faster than it may; position comes first."""
        gain, limit = POSITION_GAIN_PER_S, self._max_m_s
        off = [gain * (p - v) for p, v in zip(position_m, vehicle_m, strict=True)]
        off_m_s = math.hypot(*off)
        if off_m_s >= limit:
            near = [v + o / gain * limit / off_m_s for v, o in zip(vehicle_m, off, strict=True)]
            return (near[0], near[1]), (0.0, 0.0)
        north, east = velocity_m_s
        if math.hypot(off[0] + north, off[1] + east) <= limit:
            return position_m, velocity_m_s
        # The largest k with |off + k velocity| <= limit.
        size, along = north**2 + east**2, off[0] * north + off[1] * east
        k = (math.sqrt(along**2 + size * (limit**2 - off_m_s**2)) - along) / size
        return position_m, (north * k, east * k)

    def _motion(self, s_m: float, speed_m_s: float) -> tuple[Point, Point]:
        """Place and velocity on the path at s, at a ground speed that corners may take from."""
        position_m, tangent = self._smoothed(s_m)
        rate_m_s = speed_m_s / _stretch(tangent)
        return position_m, (tangent[0] * rate_m_s, tangent[1] * rate_m_s)

    def _smoothed(self, s_m: float) -> tuple[Point, Point]:
        """Mean of the path over the window around s, and its derivative by s."""
        if not self._legs:
            return self.end_m, (0.0, 0.0)
        first_m, last_m = self._legs[0].start_m, self._legs[-1].end_m
        half_m = min(self.window_m, s_m - first_m, last_m - s_m)
        if half_m < 1e-3:
            leg = next((leg for leg in self._legs if leg.end_m >= s_m), self._legs[-1])
            return leg.at(s_m), _direction(leg)
        low_m, high_m = s_m - half_m, s_m + half_m
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


class Drag:
    """Deceleration per ground speed, learned from how far the vehicle tilts to fly as it does.

    PX4 learns the wind and the drag of one direction together, in seconds; after a corner it would
    be slow for as long if the drag of the new direction were not fed forward.
    """

    def __init__(self) -> None:
        self._last: Pose | None = None
        self._num = 0.0
        self._sums = np.zeros(6)  # velocity, deceleration (north, east), and their products

    def take(self, pose: Pose) -> None:
        """Learn from how the vehicle moved since the last pose, and how it is tilted."""
        last, self._last = self._last, pose
        if last is None or pose.time_s <= last.time_s:
            return
        (roll, pitch, yaw), duration_s = pose.attitude_rad, pose.time_s - last.time_s
        forward, right = -math.tan(pitch), math.tan(roll) / math.cos(pitch)
        push = GRAVITY_M_S2 * np.array(
            [
                forward * math.cos(yaw) - right * math.sin(yaw),
                forward * math.sin(yaw) + right * math.cos(yaw),
            ]
        )
        velocity = np.array(pose.velocity_ned_m_s[:2])
        lost = push - (velocity - last.velocity_ned_m_s[:2]) / duration_s
        keep = math.exp(-duration_s / _MEMORY_S)
        self._num = keep * self._num + 1.0
        self._sums *= keep
        self._sums += [*velocity, *lost, velocity @ velocity, velocity @ lost]

    @property
    def per_s(self) -> float:
        """Slope of deceleration over velocity."""
        if not self._num:
            return 0.0
        mean_m_s, lost = self._sums[:2] / self._num, self._sums[2:4]
        spread = self._sums[4] - mean_m_s @ self._sums[:2]
        slope = (self._sums[5] - mean_m_s @ lost) / (spread + _DOUBT_M2_S2)
        return float(min(max(slope, 0.0), _DRAG_MAX_PER_S))

    @property
    def wind(self) -> Wind:
        """What brakes it: the deceleration that is left at rest, and the slope."""
        lost = self._sums[2:4] - self.per_s * self._sums[:2]
        north, east = lost / (self._num + _DOUBT_POSES)
        return Wind(at_rest_m_s2=(float(north), float(east)), drag_per_s=self.per_s)


def _stretch(tangent: Point) -> float:
    """Ground speed over ds/dt, but that s does not run through a sharp corner."""
    return max(math.hypot(*tangent), _SHORTEST_TANGENT)


def _direction(leg: _Leg) -> Point:
    return (leg.b[0] - leg.a[0]) / leg.length_m, (leg.b[1] - leg.a[1]) / leg.length_m


def _distance_to(leg: _Leg, point: Point) -> float:
    direction = _direction(leg)
    along = sum(d * (p - a) for d, p, a in zip(direction, point, leg.a, strict=True))
    return math.dist(point, leg.at(leg.start_m + min(max(along, 0.0), leg.length_m)))
