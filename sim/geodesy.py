"""Latitude and longitude of local places: `frames`' own, with heights as PX4 has them."""

from __future__ import annotations

from dataclasses import replace

from dronemon.frames import GeoPoint, geo_to_ned, ned_to_geo
from dronemon.types import Vector3


class LocalMap:
    """Converts between the local frame and degrees, anywhere on earth.

    Height is altitude above the origin, as PX4 has it: the earth does not fall away with distance.
    """

    def __init__(self, origin: GeoPoint) -> None:
        self._origin = origin

    def to_geo(self, position_ned_m: list[float] | Vector3) -> tuple[float, float, float]:
        """Latitude, longitude in degrees and altitude in metres above mean sea level."""
        north, east, down = position_ned_m
        place = ned_to_geo((north, east, 0.0), self._origin)
        return place.latitude_deg, place.longitude_deg, self._origin.altitude_m - down

    def to_ned(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Vector3:
        """Local position; a NaN altitude gives a NaN down."""
        place = replace(self._origin, latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        north, east, _ = geo_to_ned(place, self._origin).tolist()
        return north, east, self._origin.altitude_m - altitude_m
