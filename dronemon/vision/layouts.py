"""What networks put out: boxes and scores, in the layouts of the YOLO and DETR families.

A layout is told from a first output where that leaves no doubt. n boxes, C classes:

    yolov5      (1, n, 5 + C)            also v6, v7: centre, size, chance of a thing, of each class
    yolov8      (1, 4 + C, n)            also v9, v11: centre, size, chance of each class
    yolov10     (1, n, 6)                also any file that chooses among boxes by itself: corners,
                                         score, class
    rtdetr      (1, n, 4 + C)            centre and size as shares of the input, chance of each
                                         class
    rtdetr-top  (1, n, 6)                centre and size as shares, score, class
    detr        (1, n, K) and (1, n, 4)  logits of K > C classes, the last of which is "none", or of
                                         K = C by themselves; centre and size as shares
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, softmax

from dronemon.errors import OptionError
from dronemon.types import LAYOUTS, FloatArray, Layout
from dronemon.vision.boxes import Boxes

_FEWEST = 10
"""Boxes that every network puts out, at least."""
_IN_SHARES: tuple[Layout, ...] = ("rtdetr", "rtdetr-top")
_MOST_SHARE = 2.0
"""Of the input's size that boxes reach; in pixels they reach further."""


def layout_of(
    outputs: Sequence[NDArray[np.floating[Any]]], num_classes: int, given: Layout | None = None
) -> Layout:
    """The layout of outputs like these: the one given, if it fits.

    Raises OptionError if none fits, or several do.
    """
    shapes = [of.shape for of in outputs]
    fewest = 0 if given else _FEWEST  # some put out none where they find nothing
    fitting = [
        layout
        for layout in LAYOUTS
        if given in (None, layout) and _fits(layout, shapes, num_classes, fewest)
    ]
    if len(outputs) == 1:
        fitting = _of_such_places(fitting, outputs[0])
    if len(fitting) == 1:
        return fitting[0]
    told = " and ".join(str(shape) for shape in shapes)
    if fitting:
        raise OptionError(
            f"the network's output {told} for {num_classes} classes may be {' or '.join(fitting)}; "
            "say which as detector.layout"
        )
    raise OptionError(
        f"the network's output {told} for {num_classes} classes is not "
        f"{given or 'any of ' + ', '.join(LAYOUTS)}; say detector.layout, and all classes that it "
        "was trained for, in their order, as detector.classes"
    )


def _of_such_places(layouts: list[Layout], output: NDArray[np.floating[Any]]) -> list[Layout]:
    """Those of the layouts that have boxes in shares, or in pixels, as an output has.

    Boxes of zeros, or below, fill up a list of corners.
    """
    if "yolov8" in layouts:
        output = output.transpose(0, 2, 1)
    places = output[0, :, :4][(output[0, :, :4] > 0.0).any(axis=1)] if layouts else output[:0]
    are_shares = len(places) > 0 and bool(np.abs(places).max() <= _MOST_SHARE)
    are_known = len(places) > 0 or "yolov10" in layouts
    return [of for of in layouts if not are_known or (of in _IN_SHARES) == are_shares]


def _fits(layout: Layout, shapes: Sequence[tuple[int, ...]], num_classes: int, fewest: int) -> bool:
    if any(len(shape) != 3 or shape[0] != 1 for shape in shapes):
        return False
    if layout == "detr":
        boxes, *logits = sorted((shape[1:] for shape in shapes), key=lambda shape: shape[1] != 4)
        is_pair = len(logits) == 1 and boxes[1] == 4 != logits[0][1]
        return is_pair and boxes[0] == logits[0][0] and logits[0][1] >= num_classes
    if len(shapes) != 1:
        return False
    _, rows, columns = shapes[0]
    if layout == "yolov8":
        return rows == 4 + num_classes and columns >= fewest
    width = {"yolov5": 5 + num_classes, "rtdetr": 4 + num_classes}.get(layout, 6)
    return columns == width and rows >= fewest


def boxes_of(
    layout: Layout,
    outputs: Sequence[NDArray[np.floating[Any]]],
    num_classes: int,
    size_px: tuple[int, int],
) -> Boxes:
    """The boxes in a network's outputs, in pixels of its input.

    outputs: as the layout has them; size_px: width and height of the input
    """
    rows = np.asarray(outputs[0][0], dtype=np.float64)
    shares = np.array([*size_px, *size_px])
    match layout:
        case "yolov5":
            return _likeliest(rows[:, :4], rows[:, 4:5] * rows[:, 5:])
        case "yolov8":
            return _likeliest(rows[:4].T, rows[4:].T)
        case "yolov10":
            return Boxes(rows[:, :4], rows[:, 4], rows[:, 5].round().astype(np.int64))
        case "rtdetr":
            return _likeliest(shares * rows[:, :4], rows[:, 4:])
        case "rtdetr-top":
            corners_px = _corners(shares * rows[:, :4])
            return Boxes(corners_px, rows[:, 4], rows[:, 5].round().astype(np.int64))
        case "detr":
            logits, places = sorted((of[0] for of in outputs), key=lambda of: of.shape[1] == 4)
            is_none_last = logits.shape[1] > num_classes
            chances = softmax(logits, axis=1)[:, :-1] if is_none_last else expit(logits)
            return _likeliest(shares * places, np.asarray(chances, np.float64))


def _likeliest(places_px: FloatArray, chances: FloatArray) -> Boxes:
    """Each box as what it is most likely of. places_px: (n, 4) centre, size; chances: (n, C)"""
    classes = chances.argmax(axis=1).astype(np.int64)
    return Boxes(_corners(places_px), chances.max(axis=1), classes)


def _corners(places_px: FloatArray) -> FloatArray:
    """Left, top, right, bottom of centres and sizes. (n, 4) -> (n, 4)"""
    half = 0.5 * places_px[:, 2:]
    return np.concatenate([places_px[:, :2] - half, places_px[:, :2] + half], axis=1)
