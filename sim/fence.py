"""PX4's geofence: greatest distance and height from home, and uploaded polygons and circles.

All areas count together: a place must lie in every inclusion and in no exclusion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.types import Vector3
from sim.commander import Say
from sim.geodesy import LocalMap
from sim.mission_protocol import MAX_ITEMS, MissionStore
from sim.parameters import Parameters

_CIRCLES = (
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
)
_INCLUSIONS = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
)
_WARNING = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class _Area:
    """A polygon, or a circle of `radius_m` around its only corner."""

    is_inclusion: bool
    corners: tuple[tuple[float, float], ...]
    radius_m: float | None

    def allows(self, north: float, east: float) -> bool:
        return self._contains(north, east) is self.is_inclusion

    def _contains(self, north: float, east: float) -> bool:
        if self.radius_m is not None:
            return math.dist(self.corners[0], (north, east)) < self.radius_m
        is_inside = False
        for (n0, e0), (n1, e1) in zip(
            self.corners, (self.corners[-1], *self.corners), strict=False
        ):
            if (e0 >= east) != (e1 >= east) and north <= (n1 - n0) * (east - e0) / (e1 - e0) + n0:
                is_inside = not is_inside
        return is_inside


class Geofence:
    """What it says of a place depends on GF_ACTION, GF_MAX_HOR_DIST, GF_MAX_VER_DIST and upload."""

    def __init__(
        self, parameters: Parameters, missions: MissionStore, place: LocalMap, say: Say
    ) -> None:
        self._parameters = parameters
        self._missions = missions
        self._map = place
        self._say = say
        self._loaded: list[Any] = []
        self._areas: list[_Area] = []

    def breach(self, at: list[float] | Vector3, home: Vector3 | None) -> str | None:
        """What is wrong with a place, as PX4 says it; None if nothing is, or GF_ACTION is 0."""
        p = self._parameters
        if p["GF_ACTION"] == 0:
            return None
        if home is not None and 0.0 < p["GF_MAX_HOR_DIST"] <= math.dist(at[:2], home[:2]):
            return "Geofence: exceeding maximum distance to Home"
        if home is not None and 0.0 < p["GF_MAX_VER_DIST"] <= home[2] - at[2]:
            return "Geofence: exceeding maximum altitude above Home"
        if not all(area.allows(at[0], at[1]) for area in self._areas):
            return "Geofence: approaching or outside geofence"
        return None

    def refuses(self, target: Vector3, home: Vector3 | None) -> bool:
        """Whether it does not let the vehicle be sent to a place."""
        return self._parameters["GF_ACTION"] > _WARNING and self.breach(target, home) is not None

    def load(self, home: Vector3 | None, flying_at: list[float] | None) -> None:
        """Take a new upload, without the areas that home or a flying vehicle is against.

        flying_at: where the vehicle is; None on the ground
        """
        items = self._missions.items[mavlink.MAV_MISSION_TYPE_FENCE]
        if items is self._loaded:
            return
        self._loaded = items
        self._areas = [area for area in self._read(items) if self._is_sound(area, home, flying_at)]

    def _is_sound(self, area: _Area, home: Vector3 | None, flying_at: list[float] | None) -> bool:
        for place, name in ((home, "Home"), (flying_at, "current vehicle")):
            if place is not None and not area.allows(place[0], place[1]):
                text = f"Geofence invalid, doesn't contain {name} position\t"
                self._say(mavlink.MAV_SEVERITY_CRITICAL, text)
                return False
        return True

    def _read(self, items: list[Any]) -> list[_Area]:
        areas, index = [], 0
        while index < len(items):
            first = items[index]
            if first.command == mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT:
                index += 1
                continue
            is_circle = first.command in _CIRCLES
            count = int(first.param1) if not is_circle and 1.0 <= first.param1 <= MAX_ITEMS else 1
            corners = [
                self._map.to_ned(item.x / 1e7, item.y / 1e7, 0.0)[:2]
                for item in items[index : index + count]
            ]
            areas.append(
                _Area(
                    is_inclusion=first.command in _INCLUSIONS,
                    corners=tuple(corners),
                    radius_m=first.param1 if is_circle else None,
                )
            )
            index += count
        return areas
