"""What sprites are painted with: shapes of soft edges, laid one over the other.

Lengths are in metres: x towards the nose, y to the right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dronemon.types import ImageArray, Vector3

SPRITE_PX_PER_M = 32.0
"""Finest resolution of most sprites, in pixels per drawn metre."""
NUM_PHASES = 8
"""Pictures of one stride."""
NUM_LEVELS = 4
"""Resolutions of each sprite, each half of the one before."""

Field = NDArray[np.floating]
"""One value for every pixel of a drawing."""

_MARGIN_M, _MOST_MARGIN_PX = 0.2, 16.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Canvas:
    """A grid of real metres, larger on the picture by how much larger things are drawn.

    x, y: (rows, columns) m
    """

    px_per_m: float
    x: Field
    y: Field

    @staticmethod
    def around(
        centre_x_m: float, half_length_m: float, half_breadth_m: float, px_per_m: float
    ) -> Canvas:
        """Large enough for something of that size, with its centre in the middle."""
        margin_m, multiple = min(_MARGIN_M, _MOST_MARGIN_PX / px_per_m), 2**NUM_LEVELS
        columns = math.ceil((half_length_m + margin_m) * px_per_m / multiple) * multiple
        rows = math.ceil((half_breadth_m + margin_m) * px_per_m / multiple) * multiple
        axis_x = (np.arange(-columns, columns) + 0.5) / px_per_m + centre_x_m
        axis_y = (np.arange(-rows, rows) + 0.5) / px_per_m
        grid_y, grid_x = np.meshgrid(axis_y, axis_x, indexing="ij")
        return Canvas(px_per_m=px_per_m, x=grid_x.astype(np.float32), y=grid_y.astype(np.float32))

    def inside(self, depth_m: Field) -> Field:
        """Coverage of a shape by the signed depth of each pixel below its edge. -> 0 to 1."""
        coverage: Field = np.clip(depth_m * self.px_per_m + 0.5, 0.0, 1.0)
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

    def box(self, x_m: tuple[float, float], half_width_m: float, radius_m: float) -> Field:
        """Coverage of a rectangle with round corners, from one x to another."""
        dx = np.abs(self.x - 0.5 * (x_m[0] + x_m[1])) - 0.5 * (x_m[1] - x_m[0]) + radius_m
        dy = np.abs(self.y) - half_width_m + radius_m
        outside = np.hypot(np.maximum(dx, 0.0), np.maximum(dy, 0.0))
        return self.inside(radius_m - outside - np.minimum(np.maximum(dx, dy), 0.0))


class Layer:
    """Premultiplied colour and alpha, painted over piece by piece."""

    def __init__(self, canvas: Canvas) -> None:
        self._bgra = np.zeros((*canvas.x.shape, 4), np.float32)

    def paint(self, coverage: Field, colour: Vector3 | Field) -> None:
        """Lay a colour (BGR, 0 to 1), or one colour for each pixel, over what is there."""
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
