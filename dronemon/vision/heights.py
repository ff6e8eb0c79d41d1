"""Files of the ground's heights: ESRI ASCII grids, and GeoTIFFs by the extra `terrain`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dronemon.errors import MissionFileError
from dronemon.types import FloatArray

_MAX_BYTES, _MAX_CELLS = 2**27, 10_000_000
_HIGHEST_M = 9000.0
_ROUNDING = 1e-6
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
        return np.where(is_off, np.nan, self.between(row, column))

    @property
    def bounds_deg(self) -> tuple[float, float, float, float]:
        """South, west, north, east."""
        rows, columns = self.heights_m.shape
        north_deg = self.south_deg + (rows - 1) * self.cell_deg
        east_deg = self.west_deg + (columns - 1) * self.cell_deg
        return self.south_deg, self.west_deg, north_deg, east_deg

    def between(self, row: FloatArray, column: FloatArray) -> FloatArray:
        """Height at a place on the grid, counted in rows and columns from 0. (...) -> (...)."""
        rows, columns = self.heights_m.shape
        below = np.minimum(row.astype(np.int64), rows - 2)
        left = np.minimum(column.astype(np.int64), columns - 2)
        up, right = row - below, column - left
        h = self.heights_m
        south = h[below, left] * (1.0 - right) + h[below, left + 1] * right
        north = h[below + 1, left] * (1.0 - right) + h[below + 1, left + 1] * right
        height: FloatArray = south * (1.0 - up) + north * up
        return height

    def enveloped(self, steepest: float) -> HeightGrid:
        """The lowest heights that are nowhere below these, nor steeper; all of them are known.

        A cone hangs from every height, and the highest counts. Along rows and columns it falls by
        `steepest` over the root of 2, so that between the heights, too, no way is steeper.

        steepest: metres down for each metre aside
        """
        north_deg = self.south_deg + self.cell_deg * (len(self.heights_m) - 1)
        farthest_deg = max(abs(self.south_deg), abs(north_deg))
        east_m = self.cell_m * math.cos(math.radians(farthest_deg))  # where cells are narrowest
        heights_m = np.where(np.isnan(self.heights_m), -np.inf, self.heights_m)
        for lines, cell_m in ((heights_m, self.cell_m), (heights_m.T, east_m)):
            for ahead in (lines, lines[::-1]):
                for before, line in pairwise(ahead):
                    np.maximum(line, before - steepest * cell_m / math.sqrt(2.0), out=line)
        return replace(self, heights_m=heights_m)


@cache
def read_heights(path: str) -> HeightGrid:
    """Heights of a GeoTIFF (.tif, .tiff), else an ESRI ASCII grid. Raises MissionFileError."""
    return _geotiff(path) if path.lower().endswith((".tif", ".tiff")) else _ascii_grid(path)


def _geotiff(path: str) -> HeightGrid:
    """A raster of any projection, brought to latitudes and longitudes, by rasterio."""
    try:
        import rasterio
        from rasterio.errors import RasterioError
        from rasterio.vrt import WarpedVRT
    except ImportError as exc:
        raise MissionFileError(
            f"{path}: rasterio is not installed, which reads GeoTIFFs; pip install"
            " 'dronemon[terrain]' brings it"
        ) from exc
    _refuse_no_file(path)
    try:
        with rasterio.open(Path(path).absolute(), driver="GTiff") as file:
            if file.crs is None:
                raise MissionFileError(f"{path}: does not say in what coordinates it is")
            if file.count * max(rows * columns for rows, columns in file.block_shapes) > _MAX_CELLS:
                raise MissionFileError(
                    f"{path}: is stored in parts of more than {_MAX_CELLS} heights; "
                    "`gdal_translate -b 1 -co TILED=YES` makes smaller ones"
                )
            with WarpedVRT(file, **_in_degrees(path, file)) as vrt:
                heights_m = vrt.read(1) * file.scales[0] + file.offsets[0]
                transform = vrt.transform
    except (OSError, RasterioError) as exc:
        raise MissionFileError(f"{path}: cannot be read: {exc}") from exc
    if (is_wrong := np.abs(heights_m) > _HIGHEST_M).any():
        raise MissionFileError(f"{path}: {heights_m[is_wrong][0]:g} m is no height on Earth")
    if np.isnan(heights_m).all():
        raise MissionFileError(f"{path}: there are no heights in it")
    south_deg = transform.f + transform.e * (len(heights_m) - 0.5)
    west_deg = transform.c + 0.5 * transform.a
    flipped = np.ascontiguousarray(heights_m[::-1])
    return HeightGrid(
        heights_m=flipped, south_deg=south_deg, west_deg=west_deg, cell_deg=transform.a
    )


def _in_degrees(path: str, file: Any) -> dict[str, Any]:
    """On what grid of latitudes and longitudes a raster of rasterio's is to be laid."""
    from affine import Affine
    from rasterio.enums import Resampling
    from rasterio.warp import calculate_default_transform

    transform, width, height = calculate_default_transform(
        file.crs, "EPSG:4326", file.width, file.height, *file.bounds
    )
    cell_deg = min(transform.a, -transform.e)
    width = math.ceil(width * transform.a / cell_deg - _ROUNDING)
    height = math.ceil(-height * transform.e / cell_deg - _ROUNDING)
    transform = Affine(cell_deg, 0.0, transform.c, 0.0, -cell_deg, transform.f)
    if not (min(width, height) >= 2 and width * height <= _MAX_CELLS):
        raise MissionFileError(
            f"{path}: {width} by {height} heights; there are to be 2 or more of each, {_MAX_CELLS}"
            " in all at most; cut the area out of it"
        )
    return {
        "crs": "EPSG:4326",
        "transform": transform,
        "width": width,
        "height": height,
        "resampling": Resampling.bilinear,
        "nodata": math.nan,
        "dtype": "float64",
    }


def _ascii_grid(path: str) -> HeightGrid:
    """An ESRI ASCII grid of longitudes and latitudes, WGS 84.

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


def _refuse_no_file(path: str) -> None:
    """Neither a pipe, which may never end, nor an address, which rasterio would follow."""
    if not Path(path).is_file():
        raise MissionFileError(f"{path}: cannot be read: no such file")


def _lines(path: str) -> list[str]:
    _refuse_no_file(path)
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
