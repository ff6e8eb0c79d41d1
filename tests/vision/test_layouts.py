"""Outputs of the families of networks are read as the boxes that they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from dronemon.errors import OptionError
from dronemon.types import LAYOUTS, FloatArray, Layout
from dronemon.vision.boxes import Boxes
from dronemon.vision.layouts import boxes_of, layout_of

SIZE_PX = (320, 256)
NUM_CLASSES = 5
NUM_BOXES = 40
RNG = np.random.default_rng(3)
CORNERS_PX = np.sort(RNG.uniform(0.0, 256.0, (NUM_BOXES, 2, 2)), axis=1).reshape(-1, 4)
CLASSES = RNG.integers(NUM_CLASSES, size=NUM_BOXES)
SCORES = RNG.uniform(0.6, 1.0, NUM_BOXES)


def written(layout: str, num_classes: int = NUM_CLASSES) -> list[FloatArray]:
    """What a network of a layout puts out for the boxes above."""
    size = CORNERS_PX[:, 2:] - CORNERS_PX[:, :2]
    centres = np.concatenate([CORNERS_PX[:, :2] + 0.5 * size, size], axis=1)
    shares = centres / [*SIZE_PX, *SIZE_PX]
    classes = CLASSES % num_classes
    chances = np.full((NUM_BOXES, num_classes), 0.01)
    chances[np.arange(NUM_BOXES), classes] = SCORES
    match layout:
        case "yolov5":
            things = np.full((NUM_BOXES, 1), 0.5)
            return [np.concatenate([centres, things, 2.0 * chances], axis=1)[None]]
        case "yolov8":
            return [np.concatenate([centres, chances], axis=1).T[None]]
        case "yolov10":
            return [np.column_stack([CORNERS_PX, SCORES, classes])[None]]
        case "rtdetr":
            return [np.concatenate([shares, chances], axis=1)[None]]
        case "rtdetr-top":
            return [np.column_stack([shares, SCORES, classes])[None]]
        case "detr":
            return [np.log(chances / (1.0 - chances))[None], shares[None]]
    none = 1.0 - SCORES[:, None]
    spread = np.full((NUM_BOXES, num_classes), 1e-9)
    spread[np.arange(NUM_BOXES), classes] = SCORES
    return [shares[None], np.log(np.concatenate([spread, none], axis=1))[None]]


@pytest.mark.parametrize("layout", [*LAYOUTS, "detr with none"])
def test_a_layout_is_told_from_its_shapes_and_read(layout: str) -> None:
    outputs = written(layout)
    found = layout_of(outputs, NUM_CLASSES)
    assert found == layout.split()[0]
    boxes = boxes_of(found, outputs, NUM_CLASSES, SIZE_PX)
    np.testing.assert_allclose(boxes.corners_px, CORNERS_PX, atol=1e-9)
    np.testing.assert_allclose(boxes.scores, SCORES, atol=1e-6)
    np.testing.assert_array_equal(boxes.classes, CLASSES)


@pytest.mark.parametrize(
    ("layout", "num_classes", "either"),
    [("yolov10", 1, "yolov5 or yolov10"), ("rtdetr-top", 2, "rtdetr or rtdetr-top")],
)
def test_what_may_be_two_layouts_is_asked_for(layout: str, num_classes: int, either: str) -> None:
    with pytest.raises(OptionError, match=f"{either}.*detector.layout"):
        layout_of(written(layout, num_classes), num_classes)


@pytest.mark.parametrize(("layout", "num_classes"), [("yolov10", 2), ("rtdetr-top", 1)])
def test_pixels_are_told_from_shares(layout: str, num_classes: int) -> None:
    assert layout_of(written(layout, num_classes), num_classes) == layout


@pytest.mark.parametrize(
    "shapes",
    [
        [(1, 20, 6), (1, 30, 4)],
        [(1, 20, 4), (1, 20, 4)],
        [(1, 100, 7)],
        [(1, 9, 5)],
        [(9, 100)],
        [(2, 9, 100)],
        [(1, 100, 5)] * 2,
        [(1, 9, 100)] * 3,
    ],
)
def test_other_shapes_are_refused(shapes: list[tuple[int, ...]]) -> None:
    with pytest.raises(OptionError, match="is not any of yolov5"):
        layout_of(list(map(np.ones, shapes)), NUM_CLASSES)


def test_a_layout_that_is_given_need_not_show_how_many_boxes_it_has() -> None:
    shapes = [(1, 0, 6)]
    with pytest.raises(OptionError, match=r"say detector.layout"):
        layout_of(list(map(np.ones, shapes)), NUM_CLASSES)
    assert layout_of(list(map(np.ones, shapes)), NUM_CLASSES, "yolov10") == "yolov10"
    assert len(boxes_of("yolov10", [np.zeros((1, 0, 6))], NUM_CLASSES, SIZE_PX).scores) == 0


def test_what_fills_up_a_list_tells_nothing() -> None:
    assert layout_of([np.zeros((1, 300, 6))], NUM_CLASSES) == "yolov10"
    assert layout_of([np.full((1, 300, 6), -1.0)], NUM_CLASSES) == "yolov10"
    (output,) = written("rtdetr-top")
    filled = np.concatenate([output, np.full((1, 20, 6), -1.0)], axis=1)
    assert layout_of([filled], NUM_CLASSES) == "rtdetr-top"


@pytest.mark.parametrize(
    ("layout", "given"), [("yolov10", "rtdetr-top"), ("rtdetr-top", "yolov10")]
)
def test_a_layout_that_the_boxes_contradict_is_refused(layout: str, given: Layout) -> None:
    with pytest.raises(OptionError, match=f"is not {given}; say detector.layout"):
        layout_of(written(layout), NUM_CLASSES, given)


def test_two_boxes_of_one_thing_are_one_find_the_surer_whatever_their_classes() -> None:
    corners_px = np.array([[10.0, 10, 50, 50], [12, 10, 52, 50], [100, 10, 140, 50]])
    boxes = Boxes(corners_px, np.array([0.6, 0.9, 0.7]), np.array([0, 1, 0]))
    left = boxes.without_doubles(0.5)
    assert sorted(zip(left.scores.tolist(), left.classes.tolist(), strict=True)) == [
        (0.7, 0),
        (0.9, 1),
    ]
    assert len(boxes.without_doubles(0.95).scores) == 3
