"""A field on the ground in metres, wherever it came from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import shapely

from dronemon.types import FloatArray

_LEAST_M2 = 1.0
_MOST_CORNERS = 3000
"""Of all no-fly zones together: what they cover is found from how each meets each other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaidZone:
    """A no-fly zone.

    corners_ned_m: (K, 2) float64 north, east in m, in order, not closed
    below_m:       how far up it reaches, where that is said
    height_m:      of what stands there, above the ground; None: nothing
    """

    name: str
    corners_ned_m: FloatArray
    below_m: float | None = None
    height_m: float | None = None

    @property
    def top_m(self) -> float | None:
        """How far up it reaches: as far as what stands there unless it says; None: all the way."""
        return self.height_m if self.below_m is None else self.below_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """Where a drone may fly: within a border, but in no zone.

    border_ned_m: (K, 2) float64 north, east in m of a local frame, in order, not closed
    no_fly:       some of it may be outside of the border
    """

    border_ned_m: FloatArray
    no_fly: tuple[LaidZone, ...]

    def at(self, height_m: float) -> Field:
        """The field at a height: without the zones that do not reach up to it."""
        binding = (z for z in self.no_fly if z.top_m is None or height_m < z.top_m)
        return replace(self, no_fly=tuple(binding))

    def flaw(self) -> str | None:
        """Say why it cannot be flown in, if so: what crosses itself, or that nothing is left."""
        if (count := sum(len(zone.corners_ned_m) for zone in self.no_fly)) > _MOST_CORNERS:
            return (
                f"its no-fly zones have {count} corners, more than {_MOST_CORNERS}; simplify them"
            )
        border = shapely.Polygon(self.border_ned_m)
        shapes = [(zone, shapely.Polygon(zone.corners_ned_m)) for zone in self.no_fly]
        for name, shape in [("the field", border), *((repr(z.name), s) for z, s in shapes)]:
            if not shape.is_valid:
                return f"{name} crosses or touches itself; redraw it"
        always = [(repr(zone.name), shape) for zone, shape in shapes if zone.top_m is None]
        if border.difference(shapely.union_all([shape for _, shape in always])).area >= _LEAST_M2:
            return None
        alone = [name for name, shape in always if border.difference(shape).area < _LEAST_M2]
        names = ", ".join(alone[:1] or [name for name, _ in always])
        return f"no-fly {names} covers all of the field, so that nothing is left to fly in"
