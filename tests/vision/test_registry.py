"""What docs/detectors.md shows is made and finds; what a mission names wrongly is explained."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from squares import write_squares

from dronemon.errors import CameraError, MissionFileError
from dronemon.feasibility import load_checked
from dronemon.mission import Mission
from dronemon.runner.preparation import try_detector
from dronemon.types import ImageArray, Pose
from dronemon.vision.detector import Detector
from dronemon.vision.registry import make_detector

PAGE = (Path(__file__).parents[2] / "docs" / "detectors.md").read_text()
EXAMPLES = [
    yaml.safe_load(block)["detector"] for block in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
]
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0]
APPEARANCES = {"onnx": "zebra", "markers": "17", "blobs": "boat"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that we run in, with what the page has there, and some that is wrong."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "my_detector.py").write_text(CODE)
    (tmp_path / "wrong_detectors.py").write_text(
        "class Blind:\n    def __init__(self, *given): ...\n"
        "class Demanding:\n    def __init__(self): ...\n"
    )
    write_squares(tmp_path / "eyes.onnx", size_px=(640, 640), names=["zebra", "cow"])
    yield tmp_path
    for name in ("my_detector", "wrong_detectors"):
        sys.modules.pop(name, None)


def written(folder: Path, detector: dict[str, Any], appearance: str) -> Path:
    """A mission of a real vehicle with a camera, which has this detector."""
    path = folder / "mission.yaml"
    mission = {
        "vehicle": {"url": "udpin://127.0.0.1:14540"},
        "camera": {"url": "rtsp://127.0.0.1/eyes"},
        "targets": [{"name": "One", "appearance": appearance}],
        "detector": detector,
    }
    path.write_text(yaml.safe_dump(mission))
    return path


def detector_of(folder: Path, detector: dict[str, Any], appearance: str) -> Detector:
    path = written(folder, detector, appearance)
    mission: Mission = load_checked(str(path), {}, None).mission
    return make_detector(mission)


@pytest.mark.lengthy
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: str(example["kind"]))
def test_every_example_of_the_page_makes_a_detector(
    folder: Path, example: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    if "classes" in example:  # where onnxruntime is not installed
        monkeypatch.setitem(sys.modules, "onnxruntime", None)
        example = {**example, "classes": ["zebra", "cow"]}
    elif example["kind"] in ("onnx", "markers"):  # which need lower flight than this mission's
        example = {**example, "needed_px_per_m": 5}
    appearance = APPEARANCES.get(example["kind"], "lamp")
    detector = detector_of(folder, example, appearance)
    image = np.zeros((480, 640, 3), np.uint8)
    assert detector.detect(image, Pose.level(45.0), 0.0) == ()


def test_the_pages_detector_finds_the_lamp(folder: Path) -> None:
    image: ImageArray = np.full((480, 640, 3), 40, np.uint8)
    image[100, 200] = 255
    (found,) = detector_of(folder, EXAMPLES[-1], "lamp").detect(image, Pose.level(45.0), 0.0)
    assert (found.appearance, found.pixel_px, found.score) == ("lamp", (200.5, 100.5), 1.0)


@pytest.mark.parametrize(
    ("detector", "appearance", "words"),
    [
        (
            {"kind": "onnx", "file": "eyes.onnx"},
            "zebre",
            r"detector: .*has no class 'zebre'; did you mean zebra",
        ),
        ({"kind": "markers"}, "cow", r"detector: appearance 'cow' is no marker"),
        ({"kind": "markers", "family": "4x4"}, "1", r"detector: family .*did you mean 4x4_50"),
        (
            {"kind": "onxx"},
            "cow",
            r"detector: kind 'onxx': there is no .*you mean onnx",
        ),
        ({"kind": "nowhere:Eye"}, "cow", r"detector: .*module nowhere cannot be imported"),
        ({"kind": "wrong_detectors:Deaf"}, "cow", r"no class Deaf; its classes are: Blind, Dem"),
        ({"kind": "wrong_detectors:Blind"}, "cow", r"has no detect; see docs/detectors.md"),
        ({"kind": "wrong_detectors:Demanding"}, "cow", r"cannot be made from appearances"),
        (
            {"kind": "onnx", "file": "eyes.onnx", "needed_px_per_m": 8},
            "zebra",
            r"altitude_m: .*the detector needs 8|side_m: .*8.0 pixels that the detector needs",
        ),
    ],
)
def test_a_detector_that_will_not_do_is_told_before_anything_starts(
    folder: Path, detector: dict[str, Any], appearance: str, words: str
) -> None:
    with pytest.raises(MissionFileError, match=words):
        detector_of(folder, detector, appearance)


NONSENSE = {
    "nothing": "None",
    "a tuple": "[('lamp', (1, 2), 0.5)]",
    "a generator that fails": "(1 // 0 for _ in [1])",
    "no place": "[Detection(appearance='lamp', pixel_px=(float('nan'), 2.0), score=0.5)]",
    "too sure": "[Detection(appearance='lamp', pixel_px=(1.0, 2.0), score=9.0)]",
    "no score": "[Detection(appearance='lamp', pixel_px=(1.0, 2.0), score=float('nan'))]",
    "half a box": "[Detection(appearance='a', pixel_px=(1.0, 2.0), score=0.5, box_px=(1.0,))]",
    "a changed picture": "image.fill(0) or ()",
    "too late": "__import__('time').sleep(1.6) or ()",
}


@pytest.mark.lengthy
@pytest.mark.parametrize("nonsense", NONSENSE)
def test_a_detector_that_gives_nonsense_is_told_before_take_off(
    folder: Path, nonsense: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "odd_detectors.py").write_text(
        "from dronemon.types import Detection\n"
        "class Odd:\n    def __init__(self, *given): ...\n"
        f"    def detect(self, image, pose, ground_down_m): return {NONSENSE[nonsense]}\n"
    )
    monkeypatch.delitem(sys.modules, "odd_detectors", raising=False)
    path = written(folder, {"kind": "odd_detectors:Odd"}, "lamp")
    mission = load_checked(str(path), {}, None).mission
    with pytest.raises(CameraError, match=r"the detector (gave|failed|takes 1)"):
        try_detector(mission, make_detector(mission))
    sys.modules.pop("odd_detectors", None)
