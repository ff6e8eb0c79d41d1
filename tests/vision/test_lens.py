"""Pictures of real lenses, made those of a perfect camera; and lenses measured from pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from boards import COLUMNS, FISHEYE, MATRIX, ROWS, WIDE, photographs

from dronemon.errors import CameraError, OptionError
from dronemon.types import CameraModel, FloatArray, ImageArray
from dronemon.vision.calibration import Board, calibrate
from dronemon.vision.lens import Lens, Rectifier

MODEL = CameraModel(width_px=320, height_px=240, horizontal_fov_rad=math.radians(60.0))
LENSES = [WIDE, FISHEYE]
CIRCLE = np.hypot(COLUMNS - 159.5, ROWS - 119.5) < 118.0


def ground() -> ImageArray:
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(240, 320, 3)), (0, 0), 4.0)
    return (128.0 + 400.0 * noise).clip(0, 255).astype(np.uint8)


@pytest.mark.lengthy
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("mount_deg", [(0.0, 0.0, 0.0), (1.0, 3.0, 90.0), (-2.0, 0.0, 180.0)])
def test_what_passes_a_lens_is_made_straight_again(
    lens: Lens, mount_deg: tuple[float, float, float]
) -> None:
    roll, pitch, yaw = (math.radians(angle) for angle in mount_deg)
    rectifier = Rectifier(lens, (roll, pitch, yaw), MODEL)
    seen = rectifier.as_seen(ground())
    off = np.abs(seen.astype(int) - ground())[CIRCLE].mean()
    straight = np.abs(rectifier(seen).astype(int) - ground())[CIRCLE]
    assert off > 10.0
    assert np.mean(straight) < 1.5
    assert rectifier.sees_circle()


@pytest.mark.parametrize(
    ("mount_deg", "middle_px"),
    [
        ((0.0, 10.0, 0.0), (159.5, 119.5 - MODEL.focal_px * math.tan(math.radians(10.0)))),
        ((-10.0, 0.0, 0.0), (159.5 + MODEL.focal_px * math.tan(math.radians(10.0)), 119.5)),
        ((0.0, 10.0, 90.0), (159.5 + MODEL.focal_px * math.tan(math.radians(10.0)), 119.5)),
    ],
)
def test_a_tilted_camera_sees_what_lies_to_that_side(
    mount_deg: tuple[float, float, float], middle_px: tuple[float, float]
) -> None:
    """Its nose up it looks ahead, up in the picture; its right side up it looks right; and if it is
    turned to the right first, its ahead is the drone's right."""
    roll, pitch, yaw = (math.radians(angle) for angle in mount_deg)
    pinhole = Lens.of(MODEL)
    image = np.zeros((240, 320, 3), np.uint8)
    image[118:122, 158:162] = 255
    level = Rectifier(pinhole, (roll, pitch, yaw), MODEL)(image)
    v, u = np.argwhere(level[..., 0] > 100).mean(axis=0)
    assert (u, v) == pytest.approx(middle_px, abs=0.7)


def test_a_lens_that_sees_less_than_is_looked_at_is_told_and_black_there() -> None:
    wide = CameraModel(width_px=320, height_px=240, horizontal_fov_rad=math.radians(120.0))
    rectifier = Rectifier(WIDE, (0.0, 0.0, 0.0), wide)
    assert not rectifier.sees_circle()
    white = np.full((240, 320, 3), 255, np.uint8)
    assert rectifier(white)[2:5, 2:5].max() == 0
    assert rectifier(white)[120, 160].min() == 255
    for mount_deg in ((0.0, 60.0, 0.0), (0.0, 90.0, 0.0), (180.0, 0.0, 0.0), (0.0, 0.0, 45.0)):
        roll, pitch, yaw = (math.radians(angle) for angle in mount_deg)
        sees = Rectifier(WIDE, (roll, pitch, yaw), MODEL).sees_circle()
        assert sees == (mount_deg == (0.0, 0.0, 45.0))


FILES = {
    "ours": WIDE.text(),
    "opencv": """%YAML:1.0
---
image_width: 320
image_height: 240
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 200., 0., 165., 0., 202., 122., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.28, 0.09, 0.001, -5.0e-04, -0.01 ]
""",
    "ros": """
image_width: 320
image_height: 240
camera_name: eye
distortion_model: plumb_bob
camera_matrix: {rows: 3, cols: 3, data: [200, 0, 165, 0, 202, 122, 0, 0, 1]}
distortion_coefficients: {rows: 1, cols: 5, data: [-0.28, 0.09, 0.001, -0.0005, -0.01]}
""",
    "json": json.dumps(
        {
            "width": 320,
            "height": 240,
            "K": MATRIX.tolist(),
            "D": WIDE.distortion.tolist(),
        }
    ),
}


@pytest.mark.parametrize("text", FILES.values(), ids=FILES)
def test_calibrations_of_others_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "eye.yaml").write_text(text)
    lens = Lens.read(tmp_path / "eye.yaml")
    np.testing.assert_allclose(lens.matrix, MATRIX)
    np.testing.assert_allclose(lens.distortion, WIDE.distortion)
    assert (lens.width_px, lens.height_px, lens.is_fisheye) == (320, 240, False)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("camera_matrix", "matrix", "no camera_matrix"),
        ("image_width: 320", "image_width: wide", "size"),
        ("200", "-200", "focal lengths f of"),
        ("165", ".nan", "not finite"),
        ("165", "900", "outside the picture"),
        ("-0.28, 0.09, 0.001", "-0.28", "3 distortion coefficients"),
        ("plumb_bob", "equidistant", "5 distortion coefficients, not (4,)"),
        ("plumb_bob", "plumb_bob\nfisheye_model: 1", "5 distortion coefficients, not (4,)"),
        ("plumb_bob", "fov", "'fov' is not known"),
        ("data: [200, 0,", "data: [200, 7,", "camera matrix is not"),
        ("[200, 0,", "[1e308, 0,", "focal lengths f of"),
        ("200", "1" + 400 * "0", "eye.yaml"),
        ("camera_name: eye", "camera_name: !!int ''", "eye.yaml"),
        ("camera_name: eye", "camera_name: !!timestamp foo", "eye.yaml"),
        ("camera_name: eye", "a: &a [1]\nb: [*a, *a]", "aliases"),
        ("camera_name: eye", "camera_name: !!python/object/apply:os.getcwd []", "constructor"),
        ("[200, 0,", "[two, 0,", "two"),
        ("image_width", "- image_width", "calibration"),
    ],
)
def test_what_is_no_calibration_is_told(tmp_path: Path, old: str, new: str, words: str) -> None:
    (tmp_path / "eye.yaml").write_text(FILES["ros"].replace(old, new, 1))
    with pytest.raises(CameraError, match=r"eye\.yaml") as caught:
        Lens.read(tmp_path / "eye.yaml")
    assert words in str(caught.value)


def test_files_that_are_not_there_not_text_or_too_large(tmp_path: Path) -> None:
    (tmp_path / "noise").write_bytes(b"\xff\xfe\x00\x01")
    (tmp_path / "huge").write_text("a" * (2**20 + 1))
    for name, words in (("none", "cannot be read"), ("noise", "cannot be"), ("huge", "too large")):
        with pytest.raises(CameraError, match=words):
            Lens.read(tmp_path / name)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("lens", "board"),
    [
        (WIDE, Board(columns=7, rows=6, square_m=0.02)),
        (FISHEYE, Board(columns=7, rows=6, square_m=0.02)),
        (WIDE, Board(columns=6, rows=5, square_m=0.03, markers="4x4_50")),
    ],
    ids=["wide", "fisheye", "markers"],
)
def test_a_lens_is_measured_from_pictures_of_a_board(lens: Lens, board: Board) -> None:
    found = [board.find(picture) for picture in photographs(lens, board)]
    seen = [pair for pair in found if pair is not None]
    assert len(seen) >= 8
    result = calibrate(seen, (320, 240), is_fisheye=lens.is_fisheye)
    assert result.error_px < 0.5
    assert result.lens.matrix[0, 0] == pytest.approx(lens.matrix[0, 0], rel=0.02)
    pixels = np.array([[160.0, 120.0], [60.0, 60.0], [220.0, 160.0]])
    off_rad = [  # two of these small pictures' pixels
        math.acos(min(1.0, float(_unit(a) @ _unit(b))))
        for a, b in zip(lens.rays(pixels), result.lens.rays(pixels), strict=True)
    ]
    assert max(off_rad) < 2.0 / lens.matrix[0, 0]


def _unit(ray: FloatArray) -> FloatArray:
    return ray / np.linalg.norm(ray)


def test_a_board_of_unknown_markers_is_refused() -> None:
    with pytest.raises(OptionError, match="did you mean 4x4_50"):
        Board(columns=6, rows=5, square_m=0.03, markers="4x4_5")
