"""Sprites of the simulated animals: drawn once, from above, for every phase of a stride.

The drawings are in the lengths of real animals, in metres: x towards the nose, y to the right.
DRAWN_SCALE enlarges all of them, since at 35 m height a real fox would be three pixels wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator

from dronemon.types import ImageArray
from sim.species import SPECIES, Field, Species

DRAWN_SCALE = 1.8
"""Drawn length over real length, the same for every animal."""
NUM_PHASES = 8
"""Pictures of one stride."""
SPRITE_PX_PER_M = 32.0
"""Finest resolution of sprites, in pixels per drawn metre."""
NUM_LEVELS = 4
"""Resolutions of each sprite, each half of the one before."""

_PX_PER_M = SPRITE_PX_PER_M * DRAWN_SCALE
_MARGIN_M = 0.2
_ANTLERS_M = 0.45
_TRUNK_HEIGHT = 0.65
"""Height of the plane that the trunk is drawn in, over the height of the back."""
_HORN = (0.42, 0.60, 0.72)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sprite:
    """One animal in one phase of its stride, seen from above, its nose towards column infinity.

    legs, body: (rows, columns, 4) uint8 BGRA, premultiplied by alpha, at SPRITE_PX_PER_M and at
    each half of it. The animal's centre is the sprite's; a row further down is further right.
    """

    legs: tuple[ImageArray, ...]
    body: tuple[ImageArray, ...]
    body_height_m: float


@cache
def draw_sprites(appearance: str) -> tuple[Sprite, ...]:
    """The NUM_PHASES sprites of one stride."""
    species = SPECIES[appearance]
    canvas = _Canvas.around(species)
    return tuple(_draw_sprite(species, canvas, i / NUM_PHASES) for i in range(NUM_PHASES))


def stride_m(appearance: str) -> float:
    """Ground covered in one stride, as drawn."""
    return SPECIES[appearance].stride_m * DRAWN_SCALE


def drawn_size_m(appearance: str) -> tuple[float, float, float]:
    """Length from nose to tail, both legs' and ears' width, and height of the trunk, as drawn."""
    species = SPECIES[appearance]
    length = 2.0 * species.half_length_m
    width = 2.0 * max(_half_breadth_m(species), species.legs[2] + 0.1)
    height = _TRUNK_HEIGHT * species.back_height_m
    return length * DRAWN_SCALE, width * DRAWN_SCALE, height * DRAWN_SCALE


def _half_breadth_m(species: Species) -> float:
    """Of the trunk or the antlers."""
    return max(*species.half_width_m, _ANTLERS_M if species.has_antlers else 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Canvas:
    """A grid of real metres around an animal's centre.

    x, y: (rows, columns) m
    """

    x: Field
    y: Field

    @staticmethod
    def around(species: Species) -> _Canvas:
        """Large enough for the whole animal, its outline's centre of area in the middle."""
        reach = species.half_length_m + _MARGIN_M
        breadth = _half_breadth_m(species) + _MARGIN_M
        multiple = 2**NUM_LEVELS
        columns = math.ceil(reach * _PX_PER_M / multiple) * multiple
        rows = math.ceil(breadth * _PX_PER_M / multiple) * multiple
        axis_x = (np.arange(-columns, columns) + 0.5) / _PX_PER_M + species.centre_x_m
        axis_y = (np.arange(-rows, rows) + 0.5) / _PX_PER_M
        grid_y, grid_x = np.meshgrid(axis_y, axis_x, indexing="ij")
        return _Canvas(x=grid_x.astype(np.float32), y=grid_y.astype(np.float32))

    def inside(self, depth_m: Field) -> Field:
        """Coverage of a shape by the signed depth of each pixel below its edge. -> 0 to 1."""
        coverage: Field = np.clip(depth_m * _PX_PER_M + 0.5, 0.0, 1.0)
        return coverage

    def disc(self, x_m: float, y_m: float, radius_m: float) -> Field:
        """Coverage of a disc."""
        return self.inside(radius_m - np.hypot(self.x - x_m, self.y - y_m))

    def capsule(
        self, start_m: tuple[float, float], end_m: tuple[float, float], radius_m: float
    ) -> Field:
        """Coverage of a thick line with round ends."""
        along = np.array(end_m) - np.array(start_m)
        dx, dy = self.x - start_m[0], self.y - start_m[1]
        t = np.clip((dx * along[0] + dy * along[1]) / (along @ along), 0.0, 1.0)
        return self.inside(radius_m - np.hypot(dx - t * along[0], dy - t * along[1]))


class _Layer:
    """Premultiplied colour and alpha, painted over piece by piece."""

    def __init__(self, canvas: _Canvas) -> None:
        self._bgra = np.zeros((*canvas.x.shape, 4), np.float32)

    def paint(self, coverage: Field, colour: tuple[float, float, float] | Field) -> None:
        """Lay a colour, or one colour for each pixel, over what is there."""
        a = coverage[..., None]
        bgr = np.broadcast_to(np.array(colour, np.float32), (*coverage.shape, 3))
        self._bgra[..., :3] += a * (bgr - self._bgra[..., :3])
        self._bgra[..., 3:] += a * (1.0 - self._bgra[..., 3:])

    def images(self) -> tuple[ImageArray, ...]:
        """-> NUM_LEVELS times (rows, columns, 4) uint8"""
        rows, columns = self._bgra.shape[:2]
        images = []
        for level in range(NUM_LEVELS):
            size = (columns >> level, rows >> level)
            small = cv2.resize(self._bgra, size, interpolation=cv2.INTER_AREA)
            images.append(np.rint(np.clip(small, 0.0, 1.0) * 255.0).astype(np.uint8))
        return tuple(images)


def _draw_sprite(species: Species, canvas: _Canvas, phase: float) -> Sprite:
    swing = math.sin(2.0 * math.pi * phase)
    legs, body = _Layer(canvas), _Layer(canvas)
    _draw_legs(legs, species, canvas, phase)

    # The spine bends from side to side by a few centimetres with the stride.
    y = canvas.y - 0.02 * swing * np.sin(3.0 * canvas.x)
    _draw_tail(body, species, canvas, swing)
    x_m = np.array(species.outline_x_m)
    outline = PchipInterpolator(x_m, species.half_width_m)
    half_width = outline(np.clip(canvas.x, x_m[0], x_m[-1]))
    ends = np.minimum(canvas.x - x_m[0], x_m[-1] - canvas.x)
    roundness = np.clip(1.0 - (y / np.maximum(half_width, 1e-3)) ** 2, 0.0, 1.0)
    shade = (0.72 + 0.30 * np.sqrt(roundness))[..., None]
    colour = np.clip(species.coat(canvas.x, y) * shade, 0.0, 1.0)
    body.paint(canvas.inside(np.minimum(half_width - np.abs(y), ends)), colour)

    ear_x, ear_y, ear_radius, ear_colour = species.ears
    for side in (-1.0, 1.0):
        body.paint(canvas.disc(ear_x, side * ear_y, ear_radius), ear_colour)
        if species.has_antlers:
            _draw_antler(body, canvas, ear_x, side)
    return Sprite(
        legs=legs.images(),
        body=body.images(),
        body_height_m=_TRUNK_HEIGHT * species.back_height_m * DRAWN_SCALE,
    )


def _draw_legs(layer: _Layer, species: Species, canvas: _Canvas, phase: float) -> None:
    """Four legs in the order of a walk: each a quarter of a stride after the one before."""
    hind_x, fore_x, half_distance, radius, colour = species.legs
    reach = 0.25 * species.stride_m
    walk = ((hind_x, -1), (fore_x, -1), (hind_x, 1), (fore_x, 1))
    for quarter, (x, side) in enumerate(walk):
        foot = x + reach * math.sin(2.0 * math.pi * (phase - 0.25 * quarter))
        y = side * half_distance
        layer.paint(canvas.capsule((x, 0.8 * y), (foot, y), radius), colour)


def _draw_tail(layer: _Layer, species: Species, canvas: _Canvas, swing: float) -> None:
    rump_m, (length, radius, root, tip) = species.outline_x_m[0], species.tail
    middle = (rump_m - 0.65 * length, 0.10 * length * swing)
    end = (rump_m - length, -0.18 * length * swing)
    layer.paint(canvas.capsule((rump_m + 0.05, 0.0), middle, radius), root)
    layer.paint(canvas.capsule(middle, end, radius), tip)


def _draw_antler(layer: _Layer, canvas: _Canvas, x: float, side: float) -> None:
    beam = (x - 0.20, side * 0.34)
    layer.paint(canvas.capsule((x, side * 0.08), beam, 0.025), _HORN)
    layer.paint(canvas.capsule(beam, (x + 0.08, side * 0.42), 0.025), _HORN)
    layer.paint(canvas.capsule((x - 0.1, side * 0.2), (x + 0.1, side * 0.26), 0.02), _HORN)
