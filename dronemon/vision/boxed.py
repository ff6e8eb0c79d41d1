"""Finds what a mission watches with a network from an ONNX file; a `Detector`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dronemon.errors import CameraError, OptionError, did_you_mean
from dronemon.mission.detector import DetectorSection
from dronemon.types import CameraModel, Detection, ImageArray, Pose
from dronemon.vision.boxes import Boxes, Letterbox, letterboxed, tiles
from dronemon.vision.layouts import boxes_of, layout_of
from dronemon.vision.network import EXTRA, open_network

_MOST_BOXES = 300
_MOST_TILES = 200
_MOST_SCORE = 1.001  # of a sum in float32


class BoxDetector:
    """Shows each picture to a network and reads boxes of the classes that are watched."""

    def __init__(self, of: DetectorSection, watched: Sequence[str], camera: CameraModel) -> None:
        """Open the file and try it once.

        watched: classes of the targets
        Raises OptionError for a file, a class or an output that cannot be used.
        """
        assert of.file is not None  # mission_problems
        self._of, path = of, Path(of.file)
        self._network = open_network(path)
        self._size_px, self._is_grey = self._input(path)
        self._names = self._class_names(path, watched)
        self._tiles = list(tiles(camera.width_px, camera.height_px, of.tile_px))
        if len(self._tiles) > _MOST_TILES:
            raise OptionError(
                f"tile_px {of.tile_px} would show it pictures in {len(self._tiles)} parts, and "
                f"{_MOST_TILES} are the most; make it larger"
            )
        self._watched = [self._names.index(name) for name in watched]
        blank = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
        try:
            outputs = self._network.run(self._prepared(blank)[0])
        except CameraError as exc:
            raise OptionError(f"{exc}; does detector.input_px suit the network?") from exc
        self._layout = layout_of(outputs, len(self._names), of.layout)

    def _input(self, path: Path) -> tuple[tuple[int, int], bool]:
        """Width and height of the input, and whether it takes one channel."""
        channels, height, width = self._network.shape
        told = (width, height) if width is not None and height is not None else None
        given = self._of.input_px
        if told and given and told != given:
            raise OptionError(
                f"{path}: its input is {told[0]} x {told[1]} pixels, detector.input_px says "
                f"{given[0]} x {given[1]}; leave that out"
            )
        if (size := told or given) is None:
            raise OptionError(
                f"{path}: the size of its input cannot be told; give detector.input_px as "
                f"[width, height], or install what reads it from most files: {EXTRA}"
            )
        if not all(32 <= length <= 8192 for length in size):
            raise OptionError(f"{path}: its input is {size[0]} x {size[1]} pixels, not 32 to 8192")
        if channels not in (None, 1, 3):
            raise OptionError(f"{path}: its input has {channels} channels, not 1 or 3")
        return size, channels == 1

    def _class_names(self, path: Path, watched: Sequence[str]) -> tuple[str, ...]:
        own = self._network.names
        names = self._of.classes or own
        if own and names != own:
            raise OptionError(
                f"{path}: its classes are {', '.join(own):.300}, detector.classes says otherwise; "
                "leave that out"
            )
        if len(set(names)) < len(names):
            raise OptionError(f"{path}: has a class twice among {', '.join(names):.300}")
        if not names:
            raise OptionError(
                f"{path}: its classes cannot be told; list all that it was trained for, in their "
                f"order, as detector.classes, or install what reads them from most files: {EXTRA}"
            )
        for name in watched:
            if name not in names:
                raise OptionError(
                    f"{path}: has no class {name!r}; {did_you_mean(name, names)}"
                    f"it has: {', '.join(names):.500}"
                )
        return names

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The targets' classes in a picture, the surest first.

        image: (height, width, 3) uint8 BGR
        Raises CameraError if the network fails.
        """
        del pose, ground_down_m
        height, width = image.shape[:2]
        parts = tiles(width, height, self._of.tile_px)
        found = Boxes.joined(
            part.whole(self._look(part.cut(image)), width, height) for part in parts
        )
        found = found.without_doubles(self._of.most_shared)
        return tuple(
            Detection(
                appearance=self._names[number],
                pixel_px=(float(left + right) / 2.0, float(top + bottom) / 2.0),
                score=float(score),
                box_px=(float(left), float(top), float(right), float(bottom)),
            )
            for (left, top, right, bottom), score, number in zip(*found, strict=True)
        )

    def _look(self, image: ImageArray) -> Boxes:
        """Boxes of what is watched in a part of a picture, in its pixels."""
        picture, letterbox = self._prepared(image)
        outputs = self._network.run(picture)
        if not all(np.isfinite(output).all() for output in outputs):
            raise CameraError("the detector's network put out what are no numbers")
        boxes = boxes_of(self._layout, outputs, len(self._names), self._size_px)
        if boxes.scores.max(initial=0.0) > _MOST_SCORE or boxes.scores.min(initial=0.0) < 0.0:
            raise CameraError(
                f"the network's scores go to {boxes.scores.max():.3g}, not from 0 to 1; export it "
                "with its last sigmoid, or say another detector.layout"
            )
        boxes = boxes._replace(scores=boxes.scores.clip(0.0, 1.0))
        centres = 0.5 * (boxes.corners_px[:, :2] + boxes.corners_px[:, 2:])
        is_inside = (centres >= 0.0) & (centres <= self._size_px)
        is_inside &= boxes.corners_px[:, :2] < boxes.corners_px[:, 2:]
        boxes = boxes.chosen(np.flatnonzero(is_inside.all(axis=1)))
        is_right = boxes.scores >= self._of.min_score
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
