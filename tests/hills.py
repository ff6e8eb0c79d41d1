"""Files of made ground, for flights over it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dronemon.frames import GeoPoint, geo_to_ned
from dronemon.types import FloatArray

Height = Callable[[FloatArray, FloatArray], FloatArray]
"""From north and east in m of the middle, both (R, C), to heights in m."""


def write_hills(
    path: Path, middle: GeoPoint, height_m: Height, *, cells: int = 60, cell_deg: float = 5e-5
) -> None:
    """An ESRI ASCII grid around a place."""
    half_deg = 0.5 * (cells - 1) * cell_deg
    south, west = middle.latitude_deg - half_deg, middle.longitude_deg - half_deg
    latitude_m = geo_to_ned(GeoPoint.at((south, west)), GeoPoint.at((middle.latitude_deg, west)))
    longitude_m = geo_to_ned(GeoPoint.at((middle.latitude_deg, west)), middle)
    north = np.linspace(latitude_m[0], -latitude_m[0], cells)[:, None]
    east = np.linspace(longitude_m[1], -longitude_m[1], cells)[None, :]
    heights = np.broadcast_to(500.0 + height_m(north, east), (cells, cells))
    rows = [" ".join(f"{height:.3f}" for height in row) for row in heights[::-1]]
    head = f"ncols {cells}\nnrows {cells}\nxllcenter {west:.9f}\nyllcenter {south:.9f}\n"
    path.write_text(f"{head}cellsize {cell_deg}\n" + "\n".join(rows) + "\n")


def hill(top_m: float, wide_m: float, place_m: tuple[float, float] = (0.0, 0.0)) -> Height:
    """A round hill, or a hollow; its steepest flank is 0.6 times top over width."""

    def height_m(north: FloatArray, east: FloatArray) -> FloatArray:
        away = np.square(north - place_m[0]) + np.square(east - place_m[1])
        return np.asarray(top_m * np.exp(-0.5 * away / wide_m**2))

    return height_m
