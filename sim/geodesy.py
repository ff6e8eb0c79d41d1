"""Latitude and longitude near an origin, fast: linear in metres, with `frames`' own scale."""

from __future__ import annotations

import math

import numpy as np

from dronemon.frames import GeoPoint, ned_to_geo
from dronemon.types import Vector3

_BASE_M = 100.0


class LocalMap:
    """Converts between the local frame and degrees; within 0.1 m of `frames` up to 1 km away."""

    def __init__(self, origin: GeoPoint) -> None:
        self._origin = origin
        north = ned_to_geo(np.array([_BASE_M, 0.0, 0.0]), origin)
        east = ned_to_geo(np.array([0.0, _BASE_M, 0.0]), origin)
        self._deg_per_m_north = (north.latitude_deg - origin.latitude_deg) / _BASE_M
        self._deg_per_m_east = (east.longitude_deg - origin.longitude_deg) / _BASE_M

    def to_geo(self, position_ned_m: list[float] | Vector3) -> tuple[float, float, float]:
        """Latitude, longitude in degrees and altitude in metres above mean sea level."""
        north, east, down = position_ned_m
        return (
            self._origin.latitude_deg + north * self._deg_per_m_north,
            self._origin.longitude_deg + east * self._deg_per_m_east,
            self._origin.altitude_m - down,
        )

    def to_ned(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Vector3:
        """Local position; a NaN altitude gives a NaN down."""
        turn_deg = math.remainder(longitude_deg - self._origin.longitude_deg, 360.0)
        return (
            (latitude_deg - self._origin.latitude_deg) / self._deg_per_m_north,
            turn_deg / self._deg_per_m_east,
            self._origin.altitude_m - altitude_m,
        )
