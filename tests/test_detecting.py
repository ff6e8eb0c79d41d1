"""`dronemon detect` tells what a detector finds in pictures, and which picture is at fault."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from squares import SIDE_PX, draw_squares, write_squares

from dronemon.detecting import detect_command
from dronemon.errors import CameraError, DronemonError, OptionError
from dronemon.types import ImageArray

MISSION = """
camera: {width_px: 320, height_px: 320, url: "rtsp://127.0.0.1/eyes"}
flight: {altitude_m: 60}
targets: [{name: Ann, appearance: red}, {name: Ben, appearance: blue}]
detector: {kind: onnx, file: eyes.onnx, most_shared: 0.3}
"""


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("mission")
    write_squares(folder / "eyes.onnx")
    (folder / "mission.yaml").write_text(MISSION)
    return str(folder / "mission.yaml")


def picture(*squares: tuple[str, int, int]) -> ImageArray:
    return draw_squares((320, 320), SIDE_PX, *squares)


def test_a_folder_of_pictures_is_told_marked_and_tabled(
    mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "pictures", tmp_path / "found"
    folder.mkdir()
    cv2.imwrite(str(folder / "b.png"), picture())
    cv2.imwrite(str(folder / "a.png"), picture(("red", 60, 60), ("blue", 204, 100)))
    cv2.imwrite(str(folder / "c.png"), picture(("red", 100, 196)))
    (folder / "notes.txt").write_text("not a picture")
    detect_command(str(folder), mission, out)
    a, b, c, total, _ = capsys.readouterr().out.splitlines()
    assert a.startswith("a.png: ")
    assert "red 0." in a
    assert "blue 0." in a
    assert (b, c[:14]) == ("b.png: nothing", "c.png: red 0.8")
    assert total.startswith("3 pictures: blue in 1, red in 2; ")
    rows = csv.DictReader((out / "detections.csv").read_text().splitlines())
    places = {(r["picture"], r["appearance"], r["u_px"], r["v_px"], r["left_px"]) for r in rows}
    assert places == {
        ("a.png", "red", "60.000", "60.000", "48.000"),
        ("a.png", "blue", "204.000", "100.000", "192.000"),
        ("c.png", "red", "100.000", "196.000", "88.000"),
    }
    for name in "abc":
        before = cv2.imread(str(folder / f"{name}.png"))
        after = cv2.imread(str(out / f"{name}.png.found.jpg"))
        assert after.shape == before.shape
        assert (cv2.absdiff(after, before).max() > 100) == (name != "b")


def test_every_second_picture_of_a_video_is_looked_at(
    mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "walk.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 320))
    for step in range(5):
        video.write(picture(("red", 60 + 8 * step, 60)))
    video.release()
    detect_command(str(path), mission, every=2)
    *lines, total = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["000001", "000003", "000005"]
    assert total.startswith("3 pictures: red in 3; ")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere", "nowhere: no picture, folder, video or stream"),
        ("empty", "empty: no pictures in it"),
        ("text.jpg", r"text\.jpg: is no picture"),
        ("gone.jpg", r"gone\.jpg: cannot be read: .*No such file"),
        ("small.png", r"small\.png: .*30 x 20 pixels, the mission says 320 x 320"),
        ("clip.mp4", r"clip\.mp4: no picture, folder, video or stream"),
    ],
)
def test_what_cannot_be_looked_at_is_named(
    mission: str, tmp_path: Path, name: str, words: str
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.jpg").write_text("not a picture")
    (tmp_path / "clip.mp4").write_text("not a video")
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((20, 30, 3), np.uint8))
    with pytest.raises(CameraError, match=words):
        detect_command(str(tmp_path / name), mission)


def test_a_folder_that_cannot_be_written_is_named(mission: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture())
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OptionError, match="--out"):
        detect_command(str(tmp_path / "a.png"), mission, tmp_path / "file")


def test_a_table_that_is_there_stays(mission: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture(("red", 60, 60)))
    detect_command(str(tmp_path / "a.png"), mission, tmp_path / "out")
    table = (tmp_path / "out" / "detections.csv").read_text()
    for source, words in (("a.png", "has a table already"), ("nowhere", "no picture, folder")):
        with pytest.raises(DronemonError, match=words):
            detect_command(str(tmp_path / source), mission, tmp_path / "out")
    assert (tmp_path / "out" / "detections.csv").read_text() == table


def test_what_came_of_the_others_is_told_where_one_is_no_picture(
    mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture(("red", 60, 60)))
    cv2.imwrite(str(tmp_path / "b.png"), np.full((320, 320), 7000, np.uint16))
    (tmp_path / "._a.png").write_text("what some systems leave")
    with pytest.raises(CameraError, match=r"b\.png: has uint16 values"):
        detect_command(str(tmp_path), mission)
    assert "1 pictures: red in 1; " in capsys.readouterr().out


@pytest.mark.parametrize("source", ["pictures", "pictures/a.png"])
def test_copies_do_not_go_where_the_pictures_are(mission: str, tmp_path: Path, source: str) -> None:
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "a.png"), picture())
    with pytest.raises(OptionError, match="is where the pictures are"):
        detect_command(str(tmp_path / source), mission, tmp_path / "pictures")


def test_a_failing_detector_is_blamed_for_its_picture(
    mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fragile_detector.py").write_text(
        "class Fragile:\n    def __init__(self, *given): ...\n"
        "    def detect(self, image, pose, ground_down_m): return 1 // 0\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "mission.yaml"
    path.write_text(
        MISSION.replace(
            "kind: onnx, file: eyes.onnx, most_shared: 0.3", "kind: 'fragile_detector:Fragile'"
        )
    )
    cv2.imwrite(str(tmp_path / "a.png"), picture())
    with pytest.raises(DronemonError, match=r"a\.png: the detector failed: ZeroDivisionError"):
        detect_command(str(tmp_path / "a.png"), str(path))
