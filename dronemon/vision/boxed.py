"""Finds what a mission watches with a network from an ONNX file; a `Detector`."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dronemon.errors import CameraError
from dronemon.types import CameraModel, Detection, ImageArray, Layout, Pose
from dronemon.vision.boxes import Boxes, Letterbox, letterboxed, tiles
from dronemon.vision.detector import check_size
from dronemon.vision.layouts import boxes_of, layout_of
from dronemon.vision.network import EXTRA, open_network

_MOST_BOXES = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxSettings:
    """How a network is shown pictures and how its boxes are read; None where its file tells.

    layout:      of its outputs
    classes:     all that it was trained for, in their order
    input_px:    width and height of its input
    tile_px:     side of the parts in which pictures are shown, which helps with small targets;
                 whole pictures for None
    min_score:   of boxes that count
    most_shared: common area, over that of both together, above which two boxes are of one target
    """

    layout: Layout | None = None
    classes: tuple[str, ...] = ()
    input_px: tuple[int, int] | None = None
    tile_px: int | None = None
    min_score: float = 0.5
    most_shared: float = 0.5


class BoxDetector:
    """Shows each picture to a network and reads boxes of the classes that are watched."""

    def __init__(
        self, path: Path, settings: BoxSettings, watched: Sequence[str], camera: CameraModel
    ) -> None:
        """Open the file and try it once.

        watched: classes of the targets
        Raises CameraError for a file, a class or an output that cannot be used.
        """
        self._settings, self._camera = settings, camera
        self._network = open_network(path)
        self._size_px, self._is_grey = self._input(path)
        self._names = self._class_names(path, watched)
        self._watched = [self._names.index(name) for name in watched]
        blank = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
        shapes = [of.shape for of in self._network.run(self._prepared(blank)[0])]
        self._layout = settings.layout or layout_of(shapes, len(self._names))

    def _input(self, path: Path) -> tuple[tuple[int, int], bool]:
        """Width and height of the input, and whether it takes one channel."""
        channels, height, width = self._network.shape
        told = (width, height) if width is not None and height is not None else None
        given = self._settings.input_px
        if told and given and told != given:
            raise CameraError(
                f"{path}: its input is {told[0]} x {told[1]} pixels, detector.input_px says "
                f"{given[0]} x {given[1]}; leave that out"
            )
        if (size := told or given) is None:
            raise CameraError(
                f"{path}: the size of its input cannot be told; give detector.input_px as "
                f"[width, height], or install what reads it from most files: {EXTRA}"
            )
        if channels not in (None, 1, 3):
            raise CameraError(f"{path}: its input has {channels} channels, not 1 or 3")
        return size, channels == 1

    def _class_names(self, path: Path, watched: Sequence[str]) -> tuple[str, ...]:
        names = self._settings.classes or self._network.names
        if not names:
            raise CameraError(
                f"{path}: its classes cannot be told; list all that it was trained for, in their "
                f"order, as detector.classes, or install what reads them from most files: {EXTRA}"
            )
        for name in watched:
            if name not in names:
                near = "".join(
                    f"did you mean {n!r}? " for n in difflib.get_close_matches(name, names, n=1)
                )
                raise CameraError(
                    f"{path}: has no class {name!r}; {near}it has: {', '.join(names):.500}"
                )
        return names

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The targets' classes in a picture, the surest first.

        image: (height, width, 3) uint8 BGR
        Raises CameraError if the picture's size is not the camera's, or the network fails.
        """
        del pose, ground_down_m
        check_size(image, self._camera)
        height, width = image.shape[:2]
        parts = tiles(width, height, self._settings.tile_px)
        found = Boxes.joined(
            part.whole(self._look(part.cut(image)), width, height) for part in parts
        )
        found = found.without_doubles(self._settings.most_shared)
        return tuple(
            Detection(
                appearance=self._names[number],
                pixel_px=(float(x + right) / 2.0, float(y + bottom) / 2.0),
                score=float(score),
                box_px=(float(x), float(y), float(right), float(bottom)),
            )
            for (x, y, right, bottom), score, number in zip(*found, strict=True)
        )

    def _look(self, image: ImageArray) -> Boxes:
        """Boxes of what is watched in a part of a picture, in its pixels."""
        picture, letterbox = self._prepared(image)
        outputs = self._network.run(picture)
        if not all(np.isfinite(of).all() for of in outputs):
            raise CameraError("the detector's network put out what are no numbers")
        boxes = boxes_of(self._layout, outputs, len(self._names), self._size_px)
        is_right = boxes.scores >= self._settings.min_score
        boxes = boxes.chosen(is_right & np.isin(boxes.classes, self._watched))
        boxes = boxes.chosen(np.argsort(-boxes.scores)[:_MOST_BOXES])
        return boxes._replace(corners_px=letterbox.back(boxes.corners_px))

    def _prepared(self, image: ImageArray) -> tuple[NDArray[np.float32], Letterbox]:
        """A part of a picture as the network takes it. -> (1, channels, height, width) 0 to 1"""
        colour = cv2.COLOR_BGR2GRAY if self._is_grey else cv2.COLOR_BGR2RGB
        turned = np.asarray(cv2.cvtColor(image, colour), np.uint8)
        filled, letterbox = letterboxed(turned.reshape(*image.shape[:2], -1), *self._size_px)
        planes = np.ascontiguousarray(np.moveaxis(filled, -1, 0)[None], dtype=np.float32)
        return planes / np.float32(255.0), letterbox
