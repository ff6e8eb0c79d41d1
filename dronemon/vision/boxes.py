"""Boxes around what a network finds, and the parts of a picture that it is shown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple, Self

import cv2
import numpy as np

from dronemon.types import FloatArray, ImageArray, IntArray

_GREY = 114
"""What networks of the YOLO family are trained to see beside a picture of another shape."""
_OVERLAP = 0.2
"""Of neighbouring tiles, as a share of their side."""
_EDGE_PX = 2.0
"""A box this near to a tile's inner edge is of something that the edge cuts."""


class Boxes(NamedTuple):
    """n boxes.

    corners_px: (n, 4) float64 left, top, right, bottom
    scores:     (n,)   float64 0 to 1
    classes:    (n,)   int64
    """

    corners_px: FloatArray
    scores: FloatArray
    classes: IntArray

    def chosen(self, index: IntArray | np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Self:
        """Some of them."""
        return self._replace(**{name: of[index] for name, of in self._asdict().items()})

    @classmethod
    def joined(cls, parts: Iterable[Boxes]) -> Boxes:
        """All boxes of several parts of a picture."""
        corners, scores, classes = zip(*parts, strict=True)
        return cls(np.concatenate(corners), np.concatenate(scores), np.concatenate(classes))

    def without_doubles(self, most_shared: float) -> Boxes:
        """One box for each thing: of two that share more than that, of whatever class, the surer.

        most_shared: their common area over that of both together
        """
        if not len(self.scores):
            return self
        places, ends = self.corners_px[:, :2], self.corners_px[:, 2:]
        sides = np.concatenate([places, ends - places], axis=1)
        kept = cv2.dnn.NMSBoxes(sides.tolist(), self.scores.tolist(), 0.0, most_shared)
        return self.chosen(np.array(kept, dtype=np.int64).reshape(-1))


class Tile(NamedTuple):
    """A part of a picture: its left top corner and its size, in pixels."""

    left: int
    top: int
    width: int
    height: int

    def cut(self, image: ImageArray) -> ImageArray:
        """The part of (height, width, channels)."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]

    def whole(self, boxes: Boxes, width_px: int, height_px: int) -> Boxes:
        """Boxes of the tile as boxes of the picture, less those that the tile's edge cuts."""
        start = np.array([self.left, self.top])
        end = start + np.array([self.width, self.height])
        corners_px = boxes.corners_px + np.tile(start, 2)
        is_cut = (corners_px[:, :2] < start + _EDGE_PX) & (start > 0)
        is_cut |= (corners_px[:, 2:] > end - _EDGE_PX) & (end < [width_px, height_px])
        return boxes._replace(corners_px=corners_px).chosen(~is_cut.any(axis=1))


def tiles(width_px: int, height_px: int, side_px: int | None) -> Iterator[Tile]:
    """Parts that cover a picture and overlap, each of a side at most; the whole for None."""
    if side_px is None:
        yield Tile(0, 0, width_px, height_px)
        return
    for top in _starts(height_px, side_px):
        for left in _starts(width_px, side_px):
            yield Tile(left, top, min(side_px, width_px), min(side_px, height_px))


def _starts(length_px: int, side_px: int) -> list[int]:
    """Where tiles begin along an axis: evenly, and overlapping by a share at least."""
    rest = max(0, length_px - side_px)
    count = 1 + int(np.ceil(rest / (side_px * (1.0 - _OVERLAP))))
    return [round(start) for start in np.linspace(0, rest, count).tolist()]


class Letterbox(NamedTuple):
    """How a picture lies, scaled and with grey beside it, in a network's input.

    scale: input pixels per pixel; left, top: input pixels of grey before it
    """

    scale: float
    left: int
    top: int

    def back(self, corners_px: FloatArray) -> FloatArray:
        """Boxes of the input as boxes of the picture. (n, 4) -> (n, 4)"""
        placed: FloatArray = (corners_px - [self.left, self.top] * 2) / self.scale
        return placed


def letterboxed(image: ImageArray, width_px: int, height_px: int) -> tuple[ImageArray, Letterbox]:
    """A picture (height, width, channels) as large as it fits into a size, centred on grey."""
    height, width = image.shape[:2]
    scale = min(width_px / width, height_px / height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    kind = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    small = cv2.resize(image, size, interpolation=kind).reshape(*size[::-1], image.shape[2])
    left, top = (width_px - size[0]) // 2, (height_px - size[1]) // 2
    filled = np.full((height_px, width_px, image.shape[2]), _GREY, np.uint8)
    filled[top : top + size[1], left : left + size[0]] = small
    return filled, Letterbox(scale, left, top)
