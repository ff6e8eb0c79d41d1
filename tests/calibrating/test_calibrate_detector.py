"""`dronemon calibrate detector` says what a mission is to say, or what is wrong with the labels."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
import yaml
from squares import SIDE_PX, draw_squares, write_squares

from dronemon.calibrating.detector import detector_command
from dronemon.errors import CameraError, OptionError
from dronemon.feasibility import load_checked

MISSION = """
area: {side_m: 200}
camera: {width_px: 320, height_px: 320, url: "rtsp://127.0.0.1/eyes"}
flight: {altitude_m: 60}
targets: [{name: Ann, appearance: red}, {name: Ben, appearance: blue}]
detector: {kind: onnx, file: eyes.onnx, most_shared: 0.3}
vehicle: {url: "udpin://127.0.0.1:14540"}
"""
HEAD = "picture,appearance,score,u_px,v_px"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three pictures: a red and a blue square, a red one, nothing; and a mission beside them."""
    folder = tmp_path_factory.mktemp("pictures")
    write_squares(folder / "eyes.onnx")
    (folder / "mission.yaml").write_text(MISSION)
    shown = {
        "a": [("red", 140, 140), ("blue", 180, 180), ("red", 20, 20)],
        "b": [("red", 140, 180)],
        "c": [],
    }
    for name, squares in shown.items():
        picture = draw_squares((320, 320), SIDE_PX, *squares)
        cv2.imwrite(str(folder / f"{name}.png"), picture)
    return folder


def measure(folder: Path, tmp_path: Path, *lines: str, head: str = HEAD) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text("\n".join([head, *lines]))
    detector_command(str(folder), labels, str(folder / "mission.yaml"))


def test_what_is_measured_is_what_a_mission_can_say(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beyond the sensor's circle, 53 pixels, nothing counts; nor what is not watched."""
    labels = [
        "a.png,red,0.9,140,140",
        "a.png,red,,20,20",  # out of the circle
        "a.png,green,,180,180",
        "b.png,red,,140,180",
        "b.png,blue,,180,140",  # not there: a miss
        "c.png,blue,,160,160",  # the same
    ]
    measure(folder, tmp_path, *labels)
    out, err = capsys.readouterr()
    said = yaml.safe_load(out[out.index("sensor:") :])
    assert said["sensor"]["miss"] == 0.5
    assert said["sensor"]["false_alarms"] == pytest.approx(1 / 3, abs=1e-4)
    assert said["sensor"]["confusion"] == 0.0
    assert said["sensor"]["position_au"] < 0.01
    assert "3 pictures from 60 m, 1 finds of nothing" in out
    assert "fewer than 100 labels of red, blue" in " ".join(err.split())
    said_of = " ".join(err.split())
    assert "blue is never found as itself" in said_of
    assert "1 labels of 'green', which the mission does not watch" in said_of
    assert "1 of 6 labels lie beyond the sensor's circle" in said_of
    (folder / "told.yaml").write_text(MISSION + yaml.safe_dump({"sensor": said["sensor"]}))
    told = load_checked(str(folder / "told.yaml"), {}, None).mission
    assert told.sensor.model.miss == 0.5


@pytest.mark.parametrize(
    ("lines", "head", "message"),
    [
        (["a.png,red,1,1"], "picture,appearance,u,v", "labels.csv, line 1: has no column u_px, v_"),
        (["a.png,red,1,x,1"], HEAD, "labels.csv, line 2: needs a picture"),
        (["a.png,red,1,1"], HEAD, "line 2: needs a picture"),
        (["a.png,red,,nan,1"], HEAD, "line 2: needs a picture"),
        (["a.png,,,1,1"], HEAD, "line 2: needs a picture"),
        (["a.png,red,,1,1", "a.png,red,,1,1"], HEAD, "line 3: is there already"),
        (["z.png,red,,140,140"], HEAD, "'z.png' is no picture of"),
        (["a.png,red,,1e9,20"], HEAD, "1e\\+09, 20 is no place in a.png"),
        (["a.png,red,,20,20"], HEAD, r"has nothing of what the mission watches \(red, blue\)"),
        ([], HEAD, "has nothing of what the mission watches"),
    ],
)
def test_wrong_labels_are_named(
    folder: Path, tmp_path: Path, lines: list[str], head: str, message: str
) -> None:
    with pytest.raises(OptionError, match=message):
        measure(folder, tmp_path, *lines, head=head)


def test_files_that_cannot_be_read_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"nowhere\.csv: cannot be read"):
        detector_command(str(folder), tmp_path / "nowhere.csv", str(folder / "mission.yaml"))
    with pytest.raises(OptionError, match=r"a\.png: cannot be read"):
        detector_command(str(folder), folder / "a.png", str(folder / "mission.yaml"))
    labels, small = tmp_path / "labels.csv", tmp_path / "small.png"
    labels.write_text(HEAD)
    cv2.imwrite(str(small), draw_squares((64, 64), SIDE_PX))
    with pytest.raises(CameraError, match=r"small\.png: the camera's pictures are 64 x 64"):
        detector_command(str(small), labels, str(folder / "mission.yaml"))
