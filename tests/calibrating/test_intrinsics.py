"""`dronemon calibrate intrinsics` writes a file that a mission can name, or says what is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from boards import WIDE, photographs

from dronemon.calibrating.intrinsics import intrinsics_command
from dronemon.errors import CameraError, DronemonError
from dronemon.feasibility import load_checked
from dronemon.vision.calibration import Board
from dronemon.vision.lens import Lens

BOARD = Board(columns=7, rows=6, square_m=0.02)
MISSION = """
area: {side_m: 100}
camera:
  width_px: 320
  height_px: 240
  url: "rtsp://127.0.0.1/eye"
  horizontal_fov_deg: ANGLE
  calibration: eye.yaml
targets: [{name: Ann, appearance: cow}]
vehicle: {url: "udpin://127.0.0.1:14540"}
flight: {altitude_m: 60}
detector: {needed_px_per_m: 1}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    for number, picture in enumerate(photographs(WIDE, BOARD)):
        cv2.imwrite(str(folder / f"{number:02d}.png"), picture)
    return folder


def test_a_measured_lens_is_what_a_mission_flies_with(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "eye.yaml"
    intrinsics_command(str(folder), "7x6", 0.02, None, out)
    said = capsys.readouterr().out
    assert "1. 00.png: " in said
    assert "pixels off" in said
    assert Lens.read(out).matrix[0, 0] == pytest.approx(WIDE.matrix[0, 0], rel=0.02)
    (tmp_path / "mission.yaml").write_text(MISSION.replace("ANGLE", "60"))
    load_checked(str(tmp_path / "mission.yaml"), {}, None)
    (tmp_path / "wide.yaml").write_text(MISSION.replace("ANGLE", "140"))
    with pytest.raises(DronemonError, match="does not show all that is to be looked at"):
        load_checked(str(tmp_path / "wide.yaml"), {}, None)
    other = MISSION.replace("ANGLE", "60").replace("width_px: 320", "width_px: 640")
    (tmp_path / "other.yaml").write_text(other)
    with pytest.raises(DronemonError, match="is for pictures of 320 x 240 pixels"):
        load_checked(str(tmp_path / "other.yaml"), {}, None)
    with pytest.raises(DronemonError, match="is there already"):
        intrinsics_command(str(folder), "7x6", 0.02, None, out)


@pytest.mark.parametrize(
    ("board", "words"),
    [("7by6", "no size such as 9x6"), ("1x6", "no size"), ("9x8", "found in 0 pictures")],
)
def test_what_cannot_be_measured_is_told(
    folder: Path, tmp_path: Path, board: str, words: str
) -> None:
    with pytest.raises(DronemonError, match=words):
        intrinsics_command(str(folder), board, 0.02, None, tmp_path / "eye.yaml", every=8)
    assert not (tmp_path / "eye.yaml").exists()


def test_pictures_of_two_cameras_are_told_apart(folder: Path, tmp_path: Path) -> None:
    for name, image in (("a", np.zeros((240, 320, 3))), ("b", np.zeros((120, 160, 3)))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    with pytest.raises(CameraError, match=r"b\.png: has 160 x 120 pixels, the others 320 x 240"):
        intrinsics_command(str(tmp_path), "7x6", 0.02, None, tmp_path / "eye.yaml")
