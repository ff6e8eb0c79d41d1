"""A field's outline on the globe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.frames import GeoPoint, degrees_to_ned
from dronemon.outline.feature import Ring
from dronemon.outline.field import Field, LaidZone


@dataclass(frozen=True, slots=True, kw_only=True)
class Zone:
    """A no-fly zone.

    corners_deg: latitude and longitude of each in order, not closed
    below_m:     how far up it reaches, where that is said: see `LaidZone`
    height_m:    of what stands there; None: nothing
    """

    name: str
    corners_deg: Ring
    below_m: float | None = None
    height_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """A field's border and its no-fly zones, some of which may be outside.

    border_deg: latitude and longitude of each corner in order, not closed; longitudes go on beyond
                180 rather than leap to -180, those of zones too
    """

    border_deg: Ring
    no_fly: tuple[Zone, ...]

    def laid(self, origin: GeoPoint) -> Field:
        """The same in metres. origin: of the local frame, whose height is taken as the ground's."""
        return Field(
            border_ned_m=degrees_to_ned(np.array(self.border_deg), origin)[:, :2],
            no_fly=tuple(
                LaidZone(
                    name=zone.name,
                    corners_ned_m=degrees_to_ned(np.array(zone.corners_deg), origin)[:, :2],
                    below_m=zone.below_m,
                    height_m=zone.height_m,
                )
                for zone in self.no_fly
            ),
        )
