"""What it takes to come home: how the autopilot flies there, and what that drains.

Effort is time weighted by the power that carries the vehicle, in seconds of hovering without wind:
in wind it leans, and its rotors carry more than its weight. Source: momentum theory of a hovering
rotor, power ~ thrust^1.5; what forward flight saves of that counts as what the body's drag takes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from dronemon.types import GRAVITY_M_S2

Point = tuple[float, float]
RETURN_PARAMETERS: Mapping[str, float] = MappingProxyType(
    {
        "RTL_RETURN_ALT": 30.0,
        "RTL_LAND_DELAY": 0.0,
        "MPC_XY_CRUISE": 5.0,
        "MPC_Z_V_AUTO_UP": 3.0,
        "MPC_Z_V_AUTO_DN": 1.5,
        "MPC_LAND_ALT1": 10.0,
        "MPC_LAND_ALT2": 5.0,
        "MPC_LAND_SPEED": 0.7,
        "MPC_TILTMAX_AIR": 45.0,
    }
)
"""What decides how PX4 v1.17 returns, and a multicopter's values as they come."""
_SETTLE_S = 4.0
"""To turn, to gain and lose speed in each of climb, cruise and descent: PX4 v1.17 takes 3 to 5."""
_LEAST, _LEAST_COS_LEAN = 0.1, 0.3
_THERE_M = 1.0
"""So near it neither climbs nor cruises: about NAV_MC_ALT_RAD and NAV_ACC_RAD."""
_STEP = 0.01
"""Levels come in whole percents."""
_WINDOW_S, _SHORTEST_S = 240.0, 40.0
"""Time over which the drain is measured: at most, so that a rising wind shows, and at least, since
PX4's simulated battery falls to a half in the first 30 s and then stays."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wind:
    """How the air brakes the vehicle.

    at_rest_m_s2: (north, east) deceleration where it hovers; drag_per_s: more per ground speed
    """

    at_rest_m_s2: Point = (0.0, 0.0)
    drag_per_s: float = 0.0


CALM = Wind()


class Cost(NamedTuple):
    """What flying takes; both infinite where it cannot be done.

    time_s: time in the air; effort_s: seconds of hovering without wind that take as much
    """

    time_s: float
    effort_s: float


def cost_home(
    legs_m: Sequence[Point], height_m: float, parameters: Mapping[str, float], wind: Wind = CALM
) -> Cost:
    """What it takes to return and touch down as PX4 does from farther away than RTL_MIN_DIST.

    legs_m: (north, east) of each leg of the way home; height_m: above home
    parameters: the vehicle's RETURN_PARAMETERS, those that are known
    """
    p = {**RETURN_PARAMETERS, **parameters}
    climb_m = max(p["RTL_RETURN_ALT"] - height_m, 0.0)
    turns = sum(math.hypot(*leg_m) > _THERE_M for leg_m in legs_m)
    stages = 1 + (climb_m > _THERE_M) + turns
    upright_s = (
        climb_m / max(p["MPC_Z_V_AUTO_UP"], _LEAST)
        + _descent_s(height_m + climb_m, p)
        + max(p["RTL_LAND_DELAY"], 0.0)
        + stages * _SETTLE_S
    )
    ways = [_way(leg_m, p, wind) for leg_m in legs_m]
    over = _push_rate(math.hypot(*wind.at_rest_m_s2))
    return Cost(
        upright_s + sum(way_s for way_s, _ in ways),
        upright_s * over + sum(way_s * _push_rate(push_m_s2) for way_s, push_m_s2 in ways),
    )


def _descent_s(top_m: float, p: Mapping[str, float]) -> float:
    """Fast down to MPC_LAND_ALT1, slow from MPC_LAND_ALT2 on, and in between from one to other."""
    fast, slow = (max(p[name], _LEAST) for name in ("MPC_Z_V_AUTO_DN", "MPC_LAND_SPEED"))
    high_m = min(top_m, p["MPC_LAND_ALT1"])
    low_m = min(high_m, p["MPC_LAND_ALT2"])
    return (top_m - high_m) / fast + (high_m - low_m) / (0.5 * (fast + slow)) + low_m / slow


def lean_rate(roll_rad: float, pitch_rad: float) -> float:
    """Effort per time of a vehicle that leans so, at its height."""
    return math.pow(max(math.cos(roll_rad) * math.cos(pitch_rad), _LEAST_COS_LEAN), -1.5)


def _push_rate(push_m_s2: float) -> float:
    """Effort per time while the lean pushes sideways so much."""
    return math.pow(math.hypot(1.0, push_m_s2 / GRAVITY_M_S2), 1.5)


def _way(way_m: Point, p: Mapping[str, float], wind: Wind) -> tuple[float, float]:
    """The way at MPC_XY_CRUISE, or as fast as MPC_TILTMAX_AIR lets it go against the wind.

    -> time in s, infinite where the wind is too strong; push sideways in m/s2
    """
    length_m = math.hypot(*way_m)
    if length_m <= _THERE_M:
        return 0.0, 0.0
    (north, east), (still_n, still_e) = (d / length_m for d in way_m), wind.at_rest_m_s2
    along, across = still_n * north + still_e * east, still_n * east - still_e * north
    most = GRAVITY_M_S2 * math.tan(math.radians(min(p["MPC_TILTMAX_AIR"], 80.0)))
    left = math.sqrt(max(most**2 - across**2, 0.0)) - along
    if left <= 0.0:
        return math.inf, most
    speed_m_s = max(p["MPC_XY_CRUISE"], _LEAST)
    if wind.drag_per_s * speed_m_s > left:
        speed_m_s = left / wind.drag_per_s
    return length_m / speed_m_s, math.hypot(along + wind.drag_per_s * speed_m_s, across)


class Drain:
    """What flight takes of a level: as measured of late, but no less than the mission says.

    Some batteries know how far the vehicle leans, and some know the time alone: each measure goes
    with a cost of its own kind, and the larger sum counts.
    """

    def __init__(self, endurance_s: float) -> None:
        self._least_per_s = 1.0 / endurance_s
        self._level: float | None = None
        self._lows: deque[tuple[Cost, float]] = deque()
        self._untold = _STEP

    def take(self, flown: Cost, level: float) -> None:
        """Hear a level; only one that is a step lower than all before counts, for it is exact.

        flown: since the flight began
        """
        if self._level is None:
            self._level = level  # somewhere within its step
        if level <= self._level - 0.99 * _STEP:
            self._level = level
            self._lows.append((flown, level))
            while len(self._lows) > 2 and self._lows[1][0].time_s <= flown.time_s - _WINDOW_S:
                self._lows.popleft()
        if self._lows:
            since_s = flown.time_s - self._lows[-1][0].time_s
            self._untold = min(since_s * self.per_s, _STEP)

    @property
    def per_s(self) -> float:
        """Level per second."""
        return self._rates[0]

    @property
    def _rates(self) -> tuple[float, float]:
        """Level per second, and per second of hovering without wind."""
        least = self._least_per_s
        if not self._lows:
            return least, least
        (began, full), (ended, left) = self._lows[0], self._lows[-1]
        if ended.time_s - began.time_s < _SHORTEST_S:
            return least, least
        by_time, by_effort = ((full - left) / (b - a) for a, b in zip(began, ended, strict=True))
        return max(least, by_time), max(least, by_effort)

    def needed(self, cost: Cost) -> float:
        """The level that it takes, and what is used up since a level was told; all of it at most.

        All of it, too, for a cost that is no number.
        """
        by_time, by_effort = self._rates
        level = max(cost.time_s * by_time, cost.effort_s * by_effort) + self._untold
        return level if level < 1.0 else 1.0
