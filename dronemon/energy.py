"""What it takes to come home: how the autopilot flies there, and what that drains.

Effort is time weighted by the power that carries the vehicle, in seconds of hovering without wind:
in wind it leans, and its rotors carry more than its weight. Source: momentum theory of a hovering
rotor, power ~ thrust^1.5; what forward flight saves of that counts as what the body's drag takes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

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
        "MPC_LAND_SPEED": 0.7,
        "MPC_TILTMAX_AIR": 45.0,
    }
)
"""What decides how PX4 v1.17 returns, and a multicopter's values as they come."""
_SETTLE_S = 20.0
"""To turn, to gain and lose speed at each stage, and to be sure of the ground: as PX4 takes."""
_LEAST = 0.1
_STEP = 0.01
"""Levels come in whole percents."""
_WINDOW_S, _SHORTEST_S = 240.0, 60.0
"""Time over which the drain is measured: at most, so that a rising wind shows, and at least."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wind:
    """How the air brakes the vehicle.

    at_rest_m_s2: (north, east) deceleration where it hovers; drag_per_s: more per ground speed
    """

    at_rest_m_s2: Point = (0.0, 0.0)
    drag_per_s: float = 0.0


CALM = Wind()


def effort_home_s(
    way_m: Point, height_m: float, parameters: Mapping[str, float], wind: Wind = CALM
) -> float:
    """Effort to return and land as PX4 does; infinite against too strong a wind.

    way_m: (north, east) to home; height_m: above home
    parameters: the vehicle's RETURN_PARAMETERS, those that are known
    """
    p = {**RETURN_PARAMETERS, **parameters}
    top_m = max(height_m, p["RTL_RETURN_ALT"])
    slow_m = min(top_m, p["MPC_LAND_ALT1"])
    upright_s = (
        (top_m - height_m) / max(p["MPC_Z_V_AUTO_UP"], _LEAST)
        + (top_m - slow_m) / max(p["MPC_Z_V_AUTO_DN"], _LEAST)
        + slow_m / max(p["MPC_LAND_SPEED"], _LEAST)
        + max(p["RTL_LAND_DELAY"], 0.0)
        + _SETTLE_S
    )
    over = _push_rate(math.hypot(*wind.at_rest_m_s2))
    return upright_s * over + _effort_of_way_s(way_m, p, wind)


def _push_rate(push_m_s2: float) -> float:
    """Effort per time while the lean pushes sideways so much."""
    return math.pow(math.hypot(1.0, push_m_s2 / GRAVITY_M_S2), 1.5)


def _effort_of_way_s(way_m: Point, p: Mapping[str, float], wind: Wind) -> float:
    """The way at MPC_XY_CRUISE, or as fast as MPC_TILTMAX_AIR lets it go against the wind."""
    length_m = math.hypot(*way_m)
    if length_m < 1.0:
        return 0.0
    (north, east), (still_n, still_e) = (d / length_m for d in way_m), wind.at_rest_m_s2
    along, across = still_n * north + still_e * east, still_n * east - still_e * north
    most = GRAVITY_M_S2 * math.tan(math.radians(min(p["MPC_TILTMAX_AIR"], 80.0)))
    left = math.sqrt(max(most**2 - across**2, 0.0)) - along
    if left <= 0.0:
        return math.inf
    speed_m_s = max(p["MPC_XY_CRUISE"], _LEAST)
    if wind.drag_per_s * speed_m_s > left:
        speed_m_s = left / wind.drag_per_s
    push = math.hypot(along + wind.drag_per_s * speed_m_s, across)
    return length_m / speed_m_s * _push_rate(push)


class Drain:
    """Battery level per second of flight: as measured of late, but no less than the mission says.

    It is taken for that of an effort, though some of it was leaning, too: not every battery knows.
    """

    def __init__(self, endurance_s: float) -> None:
        self._least_per_s = 1.0 / endurance_s
        self._level: float | None = None
        self._lows: deque[tuple[float, float]] = deque()

    def take(self, airborne_s: float, level: float) -> None:
        """Hear a level; only one that is a step lower than all before counts, for it is exact."""
        if self._level is None:
            self._level = level  # somewhere within its step
        if level > self._level - 0.99 * _STEP:
            return
        self._level = level
        self._lows.append((airborne_s, level))
        while len(self._lows) > 2 and self._lows[1][0] <= airborne_s - _WINDOW_S:
            self._lows.popleft()

    @property
    def per_s(self) -> float:
        """Level per second."""
        if not self._lows:
            return self._least_per_s
        (began_s, full), (ended_s, left) = self._lows[0], self._lows[-1]
        if ended_s - began_s < _SHORTEST_S:
            return self._least_per_s
        return max(self._least_per_s, (full - left) / (ended_s - began_s))

    def needed(self, effort_s: float) -> float:
        """The level that an effort takes, and what is not told of a level; all of it at most.

        All of it, too, for an effort that is no number.
        """
        level = effort_s * self.per_s + _STEP
        return level if level < 1.0 else 1.0
