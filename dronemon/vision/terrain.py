"""Ground that is not flat: heights over a grid, and rays cast onto them.

Only differences of heights count, from the place of the take-off, where the vehicle says how high
the ground is: so it does not matter from which sea level a file counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from dronemon.errors import MissionFileError
from dronemon.frames import GeoPoint, ned_to_degrees, pixel_to_ray
from dronemon.types import CameraModel, FloatArray, Pose

_MAX_BYTES, _MAX_CELLS = 2**27, 10_000_000
_HIGHEST_M = 9000.0
_MOST_REACH = 5.0
"""Metres that a ray goes aside for each down; what looks farther is as good as at the horizon."""
_MOST_STEPS = 1000
_HALVINGS = 24
_SLOPE_STEP_M = 0.5
_HEADER = ("ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize")
_NO_DATA = "nodata_value"
_DEGREE_M = 111_320.0
"""Of latitude."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightGrid:
    """Heights of the ground by latitude and longitude.

    heights_m:           (R, C) float64 above any level, the southernmost row first; NaN: unknown
    south_deg, west_deg: of the first height of the first row
    cell_deg:            from one to the next
    """

    heights_m: FloatArray
    south_deg: float
    west_deg: float
    cell_deg: float

    @property
    def cell_m(self) -> float:
        """From one height to the next, northwards."""
        return self.cell_deg * _DEGREE_M

    def at(self, places_deg: FloatArray) -> FloatArray:
        """Between the four heights about a place. (..., 2) latitude, longitude -> (...); NaN off.

        Source: bilinear interpolation.
        """
        rows, columns = self.heights_m.shape
        row = (places_deg[..., 0] - self.south_deg) / self.cell_deg
        column = (places_deg[..., 1] - self.west_deg) / self.cell_deg
        is_off = ~((row >= 0.0) & (row <= rows - 1) & (column >= 0.0) & (column <= columns - 1))
        row, column = np.where(is_off, 0.0, row), np.where(is_off, 0.0, column)
        below = np.minimum(row.astype(np.int64), rows - 2)
        left = np.minimum(column.astype(np.int64), columns - 2)
        up, right = row - below, column - left
        h = self.heights_m
        south = h[below, left] * (1.0 - right) + h[below, left + 1] * right
        north = h[below + 1, left] * (1.0 - right) + h[below + 1, left + 1] * right
        return np.where(is_off, np.nan, south * (1.0 - up) + north * up)


@cache
def read_heights(path: str) -> HeightGrid:
    """An ESRI ASCII grid of longitudes and latitudes, WGS 84. Raises MissionFileError.

    Source: ESRI, "ASCII raster file format".
    """
    lines = _lines(path)
    header = _header(path, lines)
    for keys in (("ncols",), ("nrows",), _HEADER[2:4], _HEADER[4:6], ("cellsize",)):
        if sum(key in header for key in keys) != 1:
            raise MissionFileError(
                f"{path}:{len(header) + 1}: no height grid: a line `{' or '.join(keys)} NUMBER` is"
                " to come first, as ESRI ASCII grids have it"
            )
    grid = _heights(path, lines[len(header) :], header)
    cell_deg = header["cellsize"]
    west_deg = header.get("xllcenter", header.get("xllcorner", 0.0) + 0.5 * cell_deg)
    south_deg = header.get("yllcenter", header.get("yllcorner", 0.0) + 0.5 * cell_deg)
    north_deg, east_deg = np.array([south_deg, west_deg]) + cell_deg * (np.array(grid.shape) - 1)
    if not (-90.0 <= south_deg < north_deg <= 90.0 and -180.0 <= west_deg < east_deg <= 180.0):
        raise MissionFileError(
            f"{path}:1: reaches from {south_deg:g}, {west_deg:g} to {north_deg:g}, {east_deg:g},"
            " which are no latitudes and longitudes; `gdalwarp -t_srs EPSG:4326` makes them"
        )
    return HeightGrid(heights_m=grid, south_deg=south_deg, west_deg=west_deg, cell_deg=cell_deg)


def _header(path: str, lines: list[str]) -> dict[str, float]:
    """The lines before the heights, which are a key and a number each."""
    header: dict[str, float] = {}
    for number, line in enumerate(lines, start=1):
        key, *words = line.lower().split() or [""]
        if key not in (*_HEADER, _NO_DATA):
            break
        if key in header:
            raise MissionFileError(f"{path}:{number}: {key} is given twice")
        header[key] = _number(path, number, words)
    return header


def _lines(path: str) -> list[str]:
    try:
        with Path(path).open("rb") as file:
            text = file.read(_MAX_BYTES + 1).decode("ascii")
    except (OSError, UnicodeDecodeError) as exc:
        raise MissionFileError(f"{path}: cannot be read: {exc}") from exc
    if len(text) > _MAX_BYTES:
        raise MissionFileError(f"{path}: larger than {_MAX_BYTES} bytes; cut the area out of it")
    return text.rstrip().splitlines()


def _number(path: str, line: int, words: list[str]) -> float:
    """The one number of a line."""
    try:
        (number,) = map(float, words)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise MissionFileError(f"{path}:{line}: {' '.join(words)[:40]!r} is not one number")
    return number


def _heights(path: str, lines: list[str], header: dict[str, float]) -> FloatArray:
    """The rows of a grid, the southernmost first."""
    first = len(header) + 1
    rows, columns, cell = header["nrows"], header["ncols"], header["cellsize"]
    if not (min(rows, columns) >= 2 and rows * columns <= _MAX_CELLS and cell > 0.0):
        raise MissionFileError(
            f"{path}:1: nrows {rows:g}, ncols {columns:g}, cellsize {cell:g}: there are to be 2 or"
            f" more of each, {_MAX_CELLS} in all at most, more than 0 apart"
        )
    if len(lines) != rows:
        raise MissionFileError(f"{path}:{first}: {len(lines)} rows follow, nrows is {rows:g}")
    heights_m = np.empty((len(lines), int(columns)))
    for number, line in enumerate(lines):
        words = line.split()
        try:
            if len(words) != columns:
                raise ValueError(f"{len(words)} heights, ncols is {columns:g}")
            row = np.array(words, dtype=np.float64)
            row[row == header.get(_NO_DATA, -9999.0)] = np.nan
            if (is_wrong := ~(np.abs(row) <= _HIGHEST_M) & ~np.isnan(row)).any():
                raise ValueError(f"{row[is_wrong][0]:g} m is no height on Earth")
        except ValueError as exc:
            raise MissionFileError(f"{path}:{first + number}: {exc}") from exc
        heights_m[-1 - number] = row
    if np.isnan(heights_m).all():
        raise MissionFileError(f"{path}:{first}: there are no heights in it")
    return heights_m


class Terrain:
    """A `Surface` with the heights of a grid."""

    def __init__(
        self, grid: HeightGrid, origin: GeoPoint, home_ned_m: FloatArray, home_down_m: float
    ) -> None:
        """origin: of the local frame; home_ned_m, home_down_m: of the ground at the take-off."""
        self._grid, self._origin = grid, origin
        home_m = float(grid.at(ned_to_degrees(home_ned_m, origin)))
        self._level_down_m = home_down_m + home_m  # of a height of 0
        lowest, highest = np.nanmin(grid.heights_m), np.nanmax(grid.heights_m)
        self._top_m, self._bottom_m = self._level_down_m - highest, self._level_down_m - lowest

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`; NaN where no height is known."""
        down: FloatArray = self._level_down_m - self._grid.at(
            ned_to_degrees(place_ned_m, self._origin)
        )
        return down

    def slope(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`."""
        steps = _SLOPE_STEP_M * np.eye(2)
        ahead, behind = (
            self.down_m(np.asarray(place_ned_m)[..., None, :] + sign * steps)
            for sign in (1.0, -1.0)
        )
        return np.nan_to_num((ahead - behind) / (2.0 * _SLOPE_STEP_M))  # flat at the grid's edge

    def places(self, pixel_px: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
        """See `Surface`: steps of half a cell at most find the first cut, halvings its place."""
        ray = pixel_to_ray(pixel_px, camera, pose.attitude_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(ray[..., 2:] > 1e-6, ray[..., :2] / ray[..., 2:], np.nan)
            reach[np.linalg.norm(reach, axis=-1) > _MOST_REACH] = np.nan
        eye_m, eye_down_m = np.array(pose.position_ned_m[:2]), pose.position_ned_m[2]

        def above_m(depth_m: FloatArray) -> FloatArray:
            """How far above the ground rays are, so far below the camera. (...) -> (...)"""
            return self.down_m(eye_m + depth_m[..., None] * reach) - (eye_down_m + depth_m)

        start_m = max(0.0, self._top_m - eye_down_m - _SLOPE_STEP_M)
        end_m = max(start_m, self._bottom_m - eye_down_m) + _SLOPE_STEP_M
        most = np.nan_to_num(np.linalg.norm(reach, axis=-1)).max(initial=0.1)
        count = math.ceil(2.0 * most * (end_m - start_m) / self._grid.cell_m) + 1
        depths_m = np.linspace(start_m, end_m, min(count, _MOST_STEPS) + 1)
        high_m, low_m = np.full(reach.shape[:-1], np.nan), np.full(reach.shape[:-1], np.nan)
        for before_m, after_m in pairwise(depths_m):
            is_cut = np.isnan(low_m) & (above_m(np.full_like(low_m, after_m)) <= 0.0)
            high_m, low_m = np.where(is_cut, before_m, high_m), np.where(is_cut, after_m, low_m)
        for _ in range(_HALVINGS):
            middle_m = 0.5 * (high_m + low_m)
            is_above = above_m(middle_m) > 0.0
            high_m = np.where(is_above, middle_m, high_m)
            low_m = np.where(is_above, low_m, middle_m)
        places: FloatArray = eye_m + low_m[..., None] * reach
        return places
