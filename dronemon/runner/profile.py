"""How high a patrol is: at one height, or at one height above the ground below."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dronemon.guidance import Point
from dronemon.types import FloatArray

_PREVIEW_S = 0.25
"""A vertical velocity is the mean over this time before and after: it has no steps."""


class Floor(Protocol):
    """What a patrol is to stay above."""

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """Down coordinate, always a number. place_ned_m: (..., 2) north, east -> (...)."""


class Profile:
    """Height of the patrol over each place."""

    def __init__(self, floor: Floor, altitude_m: float) -> None:
        self._floor, self._altitude_m = floor, altitude_m

    def down_m(self, place_m: Point) -> float:
        """Down coordinate over a place."""
        return float(self._floor.down_m(np.array(place_m))) - self._altitude_m

    def heights_m(self, places_m: FloatArray, from_m: FloatArray | float) -> FloatArray:
        """Heights over places, from down coordinates such as the take-off's. (..., 2) -> (...)."""
        return self._altitude_m + (from_m - self._floor.down_m(places_m))

    def height_m(self, place_m: Point, from_m: float) -> float:
        """The same over one place."""
        return float(self.heights_m(np.array(place_m), from_m))

    def motion(self, place_m: Point, velocity_m_s: Point) -> tuple[float, float]:
        """What to ask for on the way over a place: down coordinate in m, velocity down in m/s."""
        step_m = _PREVIEW_S * np.array(velocity_m_s)
        places_m = np.array(place_m) + np.stack([0.0 * step_m, step_m, -step_m])
        here_m, ahead_m, behind_m = self._floor.down_m(places_m).tolist()
        return here_m - self._altitude_m, (ahead_m - behind_m) / (2.0 * _PREVIEW_S)
