"""The ground that the simulated camera looks at: a procedural savanna, endless by repetition.

One seeded square tile of texture is fixed to the local NED frame and repeats in both directions, so
that the same place always looks the same. All fields are built in the Fourier domain, which makes
them periodic without seams.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from dronemon.types import ImageArray

TILE_PX = 2048
TEXEL_M = 0.125
TILE_M = TILE_PX * TEXEL_M
"""The ground repeats after 256 m."""

_Field = NDArray[np.floating]

# Colours are BGR, 0 to 255.
_LUSH = (46, 98, 74)
_MEADOW = (62, 128, 104)
_DRY = (92, 150, 142)
_SOIL = (92, 130, 152)
_RUT = (80, 112, 132)
_BUSH = (38, 74, 46)
_STONE = (138, 142, 146)


@lru_cache(maxsize=1)
def draw_ground(seed: int) -> ImageArray:
    """One tile of ground, its rows from north to south and its columns from west to east.

    -> (TILE_PX, TILE_PX, 3) uint8 BGR
    """
    rng = np.random.default_rng(seed)
    height = _field(rng, slope=2.6)
    moisture = _field(rng, slope=2.2)
    tufts = _field(rng, slope=1.1)
    grain = rng.standard_normal((TILE_PX, TILE_PX), np.float32)

    image = np.empty((3, TILE_PX, TILE_PX), np.float32)
    image[:] = np.array(_MEADOW, np.float32)[:, None, None]
    _blend(image, _LUSH, _step(moisture, 0.2, 1.6))
    _blend(image, _DRY, _step(-moisture, 0.1, 1.7))
    _blend(image, _SOIL, 0.85 * _step(height - 0.25 * tufts, 1.75, 2.15))
    _draw_trail(image, _field(rng, slope=3.4), tufts)
    _draw_track(image, _field(rng, slope=4.2), tufts)
    image *= 1.0 + 0.045 * tufts + 0.035 * grain + 0.03 * height
    _draw_bushes(image, rng, moisture)
    _draw_stones(image, rng)
    return np.asarray(cv2.merge([np.clip(plane, 0, 255).astype(np.uint8) for plane in image]))


def draw_clouds(seed: int, darkness: float) -> ImageArray:
    """One tile of the light that clouds let through, over the same ground; half of it is full.

    -> (TILE_PX, TILE_PX) uint8
    """
    cover = _step(_field(np.random.default_rng((seed, 2)), slope=3.4), -0.1, 0.1)
    return np.asarray(np.rint(255.0 * (1.0 - darkness * cover)), np.uint8)


def pyramid(tile: ImageArray, num_levels: int) -> list[ImageArray]:
    """The tile at 1, 1/2, 1/4 ... of its resolution, for views from higher up."""
    levels = [tile]
    for _ in range(num_levels - 1):
        half = cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, np.uint8))
    return levels


def _field(rng: np.random.Generator, *, slope: float) -> _Field:
    """Periodic noise of zero mean and unit variance; larger slopes are smoother."""
    spectrum = scipy.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX), np.float32))
    rows = (np.fft.fftfreq(TILE_PX) * TILE_PX).astype(np.float32)
    columns = (np.fft.rfftfreq(TILE_PX) * TILE_PX).astype(np.float32)
    spectrum *= (np.hypot(rows[:, None], columns[None, :]) + 3.0) ** -slope
    spectrum[0, 0] = 0.0
    field = scipy.fft.irfft2(spectrum)
    return np.asarray(field / field.std(), np.float32)


def _step(field: _Field, low: float, high: float) -> _Field:
    """0 below low, 1 above high, smooth between."""
    t: _Field = np.clip((field - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _blend(image: _Field, colour: tuple[float, float, float], weight: _Field) -> None:
    """Mix a colour into an image of three planes, plane by plane to spare memory."""
    for plane, value in zip(image, colour, strict=True):
        plane += weight * (np.float32(value) - plane)


def _level_set_distance_m(field: _Field) -> _Field:
    """Distance to the curve where the field is zero, to first order; good near the curve."""
    down, right = np.gradient(field, TEXEL_M)
    distance_m: _Field = np.abs(field) / (np.hypot(down, right) + 1e-3)
    return distance_m


def _draw_trail(image: _Field, field: _Field, tufts: _Field) -> None:
    """A footpath of trodden soil, half a metre wide, with worn edges."""
    distance_m = _level_set_distance_m(field) + 0.12 * tufts
    _blend(image, _SOIL, 0.7 * _step(-distance_m, -0.7, -0.15))


def _draw_track(image: _Field, field: _Field, tufts: _Field) -> None:
    """A vehicle track: two ruts 1.8 m apart with grass between them."""
    distance_m = np.abs(_level_set_distance_m(field) - 0.9) + 0.06 * tufts
    _blend(image, _RUT, 0.8 * _step(-distance_m, -0.5, -0.1))


def _draw_bushes(image: _Field, rng: np.random.Generator, moisture: _Field) -> None:
    """Round bushes where it is moist, each lit from the south-west and shading the north-east."""
    for row, column in rng.integers(0, TILE_PX, (700, 2)):
        if moisture[row, column] < rng.uniform(-0.4, 1.6):
            continue
        radius_px = rng.uniform(0.5, 1.7) / TEXEL_M
        rows, columns, y, x = _patch(row, column, radius_px * 1.9)
        wobble = 1.0 + 0.22 * np.sin(rng.integers(3, 7) * np.arctan2(y, x) + rng.uniform(0, 6.28))
        r = np.hypot(x, y) / (radius_px * wobble)
        shadow = _step(-np.hypot(x - 0.4 * radius_px, y + 0.4 * radius_px) / radius_px, -1.15, -0.8)
        leaf = 0.85 + 0.3 * rng.random(r.shape, np.float32) + 0.22 * (y - x) / radius_px
        crown = _step(-r, -1.05, -0.85)
        for plane, value in zip(image, _BUSH, strict=True):
            patch = plane[rows, columns] * (1.0 - 0.45 * shadow)
            plane[rows, columns] = patch + crown * (value * leaf - patch)


def _draw_stones(image: _Field, rng: np.random.Generator) -> None:
    """A few grey stones, 0.3 to 0.9 m across."""
    for row, column in rng.integers(0, TILE_PX, (160, 2)):
        radius_px = rng.uniform(0.15, 0.45) / TEXEL_M
        rows, columns, y, x = _patch(row, column, radius_px + 3.0)
        r = np.hypot(x, y * rng.uniform(1.0, 1.5))
        light = np.clip(1.0 + 0.12 * (y - x) / radius_px, 0.7, 1.25)
        weight = np.clip(radius_px - r + 0.5, 0.0, 1.0)
        for plane, value in zip(image, _STONE, strict=True):
            plane[rows, columns] += weight * (value * light - plane[rows, columns])


def _patch(
    row: int, column: int, radius_px: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], _Field, _Field]:
    """Wrapped indices around a texel and the offsets (south, east) from it in texels."""
    reach = np.arange(-int(radius_px) - 1, int(radius_px) + 2)
    rows, columns = (row + reach) % TILE_PX, (column + reach) % TILE_PX
    y, x = np.meshgrid(reach.astype(np.float32), reach.astype(np.float32), indexing="ij")
    return rows[:, None], columns[None, :], y, x
