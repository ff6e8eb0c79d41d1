"""A field on the ground in metres, wherever it came from."""

from __future__ import annotations

from dataclasses import dataclass

import shapely

from dronemon.types import FloatArray

_LEAST_M2 = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaidZone:
    """A no-fly zone. corners_ned_m: (K, 2) float64 north, east in m, in order, not closed."""

    name: str
    corners_ned_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """Where a drone may fly: within a border, but in no zone.

    border_ned_m: (K, 2) float64 north, east in m of a local frame, in order, not closed
    no_fly:       some of it may be outside of the border
    """

    border_ned_m: FloatArray
    no_fly: tuple[LaidZone, ...]

    def flaw(self) -> str | None:
        """Say why it cannot be flown in, if so: what crosses itself, or that nothing is left."""
        border = shapely.Polygon(self.border_ned_m)
        zones = [shapely.Polygon(zone.corners_ned_m) for zone in self.no_fly]
        named = [("the field", border)]
        named += [(repr(zone.name), shape) for zone, shape in zip(self.no_fly, zones, strict=True)]
        for name, shape in named:
            if not shape.is_valid:
                return f"{name} crosses or touches itself; redraw it"
        if border.difference(shapely.union_all(zones)).area >= _LEAST_M2:
            return None
        alone = [name for name, zone in named[1:] if border.difference(zone).area < _LEAST_M2]
        names = ", ".join(alone[:1] or [name for name, _ in named[1:]])
        return f"no-fly {names} covers all of the field, so that nothing is left to fly in"
