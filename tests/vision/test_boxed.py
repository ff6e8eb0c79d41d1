"""Networks from ONNX files find what is in a picture, however they are shown it and say so."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from squares import SIDE_PX, draw_squares, write_squares

from dronemon.errors import DronemonError, OptionError
from dronemon.mission.detector import DetectorSection
from dronemon.types import LAYOUTS, CameraModel, ImageArray, Layout, Pose
from dronemon.vision.boxed import BoxDetector

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
LEVEL = Pose.level(30.0)
TOLD: dict[str, Any] = {"classes": ("red", "blue"), "input_px": (320, 320), "most_shared": 0.3}


def picture(
    *squares: tuple[str, int, int], side_px: int, camera: CameraModel = CAMERA
) -> ImageArray:
    return draw_squares((camera.width_px, camera.height_px), side_px, *squares)


def detector_of(
    path: Path, watched: tuple[str, ...] = ("red",), camera: CameraModel = CAMERA, **settings: Any
) -> BoxDetector:
    return BoxDetector(DetectorSection(kind="onnx", file=str(path), **settings), watched, camera)


def found(detector: BoxDetector, image: ImageArray) -> list[tuple[str, float, float]]:
    detections = detector.detect(image, LEVEL, 0.0)
    return sorted((d.appearance, *d.pixel_px) for d in detections)


@pytest.fixture
def without_onnxruntime(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_finds_squares_where_they_are(layout: Layout, tmp_path: Path) -> None:
    path = write_squares(tmp_path / "eyes.onnx", layout)
    detector = detector_of(path, ("red", "blue"), layout=layout, most_shared=0.3)
    # Half as large in the input, 40 rows of grey above it.
    image = picture(("red", 120, 104), ("blue", 600, 440), side_px=2 * SIDE_PX)
    (blue, *blue_px), (red, *red_px) = found(detector, image)
    assert (blue, red) == ("blue", "red")
    np.testing.assert_allclose([blue_px, red_px], [(600.0, 440.0), (120.0, 104.0)], atol=0.01)


@pytest.mark.usefixtures("without_onnxruntime")
def test_opencv_reads_what_onnxruntime_would(tmp_path: Path) -> None:
    path = write_squares(tmp_path / "eyes.onnx")
    detector = detector_of(path, **TOLD)
    image = picture(("red", 120, 104), ("blue", 600, 440), side_px=2 * SIDE_PX)
    assert found(detector, image) == [("red", 120.0, 104.0)]


def test_small_things_in_large_pictures_are_found_in_tiles(tmp_path: Path) -> None:
    camera = CameraModel(width_px=1600, height_px=1200, horizontal_fov_rad=1.5)
    path = write_squares(tmp_path / "eyes.onnx")
    # The second lies across the edges of tiles that begin every 256 pixels.
    image = picture(("red", 60, 52), ("red", 268, 268), side_px=SIDE_PX, camera=camera)
    whole, tiled = (
        detector_of(path, camera=camera, most_shared=0.2, tile_px=side) for side in (None, 320)
    )
    assert found(whole, image) == []
    places = [place for _, *place in found(tiled, image)]
    np.testing.assert_allclose(places, [[60.0, 52.0], [268.0, 268.0]], atol=4.0)


def test_a_thermal_network_is_shown_grey(tmp_path: Path) -> None:
    path = write_squares(tmp_path / "eyes.onnx", is_grey=True, names=["warm", "cold"])
    detector = detector_of(path, ("warm",), min_score=0.8, most_shared=0.3)
    image = picture(side_px=0)
    image[80:128, 96:144] = 255
    assert found(detector, image) == [("warm", 120.0, 104.0)]


def test_only_sure_finds_of_watched_classes_count(tmp_path: Path) -> None:
    path = write_squares(tmp_path / "eyes.onnx")
    detector = detector_of(path, most_shared=0.3)
    image = picture(("blue", 600, 440), side_px=2 * SIDE_PX)
    image[80:128, 96:144] = (60, 60, 160)  # reddish: 0.39
    assert found(detector, image) == []
    unsure = detector_of(path, min_score=0.35, most_shared=0.3)
    assert found(unsure, image) == [("red", 120.0, 104.0)]


WRONG: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    r"eyes\.onnx: has no class 'rde'; did you mean red": (("rde",), {}),
    r"eyes\.onnx: its input is 320 x 320 pixels, detector.input_px says 640 x 640": (
        ("red",),
        {"input_px": (640, 640)},
    ),
    r"eyes\.onnx: its classes are red, blue, detector.classes says otherwise": (
        ("red",),
        {"classes": ("blue", "red")},
    ),
    r"is not detr; .*detector.classes": (("red",), {"layout": "detr"}),
    r"is not yolov5; .*detector.classes": (("red",), {"layout": "yolov5"}),
    r"tile_px 64 would show it pictures in .* parts": (("red",), {"tile_px": 64}),
}


@pytest.mark.parametrize("message", WRONG)
def test_what_does_not_fit_the_file_is_told_at_once(message: str, tmp_path: Path) -> None:
    watched, settings = WRONG[message]
    path = write_squares(tmp_path / "eyes.onnx")
    camera = replace(CAMERA, width_px=1200, height_px=900) if "tile_px" in settings else CAMERA
    with pytest.raises(OptionError, match=message):
        detector_of(path, watched, camera, **settings)


FLAWS: dict[str, tuple[str, dict[str, Any]]] = {
    "no names": (r"its classes cannot be told", {"names": "{0: 'red', []: 3}"}),
    "names twice": (r"has a class twice among red, red", {"names": ["red", "red"]}),
    "three classes": (r"is not any of yolov5", {"names": ["red", "blue", "green"]}),
    "a small input": (r"its input is 24 x 24 pixels, not 32", {"size_px": (24, 24)}),
    "a batch": (r"takes 4 pictures of tensor\(float\)", {"batch": 4}),
    "no sigmoid": (r"scores go to \d+", {"layout": "yolov8", "gain": 50.0}),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_file_that_is_no_detectors_is_told(flaw: str, tmp_path: Path) -> None:
    words, written = FLAWS[flaw]
    path = write_squares(tmp_path / "eyes.onnx", **written)
    image = picture(("red", 120, 104), side_px=2 * SIDE_PX)
    with pytest.raises(DronemonError, match=words):
        found(detector_of(path), image)


@pytest.mark.lengthy
@pytest.mark.parametrize("has_onnxruntime", [True, False])
@pytest.mark.parametrize("flaw", ["damaged", "cut", "none"])
def test_a_file_that_is_none_is_told(
    flaw: str, has_onnxruntime: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_onnxruntime:
        monkeypatch.setitem(sys.modules, "onnxruntime", None)
    path = write_squares(tmp_path / "eyes.onnx")
    whole = path.read_bytes()
    match flaw:
        case "damaged":
            path.write_bytes(b"not a network at all\n" * 40)
        case "cut":
            path.write_bytes(whole[: len(whole) // 2])
        case "none":
            path.unlink()
    with pytest.raises(OptionError, match=r"eyes\.onnx: (no ONNX file|No such file)"):
        detector_of(path, **TOLD)


@pytest.mark.usefixtures("without_onnxruntime")
def test_without_onnxruntime_the_mission_must_say_what_the_file_does(tmp_path: Path) -> None:
    path = write_squares(tmp_path / "eyes.onnx")
    with pytest.raises(OptionError, match=r"detector.input_px.*dronemon\[detector\]"):
        detector_of(path, classes=("red", "blue"))
    with pytest.raises(OptionError, match=r"detector.classes.*dronemon\[detector\]"):
        detector_of(path, input_px=(320, 320))
    with pytest.raises(OptionError, match=r"failed on a picture of 32 x 32.*input_px"):
        detector_of(path, classes=("red", "blue"), input_px=(32, 32))
