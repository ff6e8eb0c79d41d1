"""The ground as a flight can follow it: never below the terrain, and never too steep."""

from __future__ import annotations

import math

import numpy as np

from dronemon.frames import GeoPoint, degrees_to_ned
from dronemon.types import FloatArray
from dronemon.vision.heights import HeightGrid

_SAMPLES = 7
"""Along each side of a grid, to learn where its places are."""
_REACH_M = 20_000.0
"""Places are laid for a flight so far from the origin, however large the grid is."""
_ONE = np.array([1.0, 0.0, 0.0])
_TO_KM = np.array([[0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]])


class Envelope:
    """Heights laid into the vehicle's local frame, known everywhere and quick to ask.

    Beyond the grid its edge goes on. Places within 20 km are laid to a few decimetres: in flight
    each setpoint asks three times, and the globe's own formulas take half a millisecond each.
    """

    def __init__(self, grid: HeightGrid, origin: GeoPoint, level_down_m: float) -> None:
        """origin: of the local frame; level_down_m: down coordinate of a height of 0."""
        self._grid, self._level_down_m = grid, level_down_m
        self._last = np.array(grid.heights_m.shape) - 1.0
        here = (
            np.array([origin.latitude_deg, origin.longitude_deg]) - [grid.south_deg, grid.west_deg]
        ) / grid.cell_deg
        reach = (
            _REACH_M / grid.cell_m / np.array([1.0, math.cos(math.radians(origin.latitude_deg))])
        )
        low = np.clip(here - reach, 0.0, self._last - 1.0)
        high = np.clip(here + reach, low + 1.0, self._last)
        shares = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, _SAMPLES)] * 2), axis=-1)
        cells = low + shares.reshape(-1, 2) * (high - low)
        places_deg = np.array([grid.south_deg, grid.west_deg]) + grid.cell_deg * cells
        places_m = degrees_to_ned(places_deg, origin)[:, :2]
        self._cells, *_ = np.linalg.lstsq(_squares(places_m), cells, rcond=None)  # (9, 2)

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """Down coordinate, always a number. place_ned_m: (..., 2) north, east -> (...)."""
        cell = np.minimum(np.maximum(_squares(place_ned_m) @ self._cells, 0.0), self._last)
        down: FloatArray = self._level_down_m - self._grid.between(cell[..., 0], cell[..., 1])
        return down


def _squares(place_m: FloatArray) -> FloatArray:
    """What rows and columns are made of, near enough: products of 1, north and east in km.

    place_m: (..., 2) -> (..., 9)
    """
    first = np.asarray(place_m) @ _TO_KM + _ONE
    squares: FloatArray = first[..., :, None] * first[..., None, :]
    return squares.reshape(*first.shape[:-1], 9)
