"""Markers of the targets are found where they lie, at the size that they have."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from dronemon.errors import OptionError
from dronemon.frames import ground_to_pixel
from dronemon.mission.detector import DetectorSection
from dronemon.types import CameraModel, ImageArray, Pose
from dronemon.vision.markers import FAMILIES, MarkerDetector

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
FAMILY = "apriltag_36h11"
SIDE_M = 1.5


def pose(attitude: tuple[float, float, float] = (0.1, -0.1, 0.7)) -> Pose:
    return Pose(
        time_s=0.0,
        position_ned_m=(5.0, -3.0, -12.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude,
    )


def picture(at_m: dict[int, tuple[float, float]], side_m: float = SIDE_M) -> ImageArray:
    """Markers that lie on the ground, seen from the pose."""
    image = np.full((CAMERA.height_px, CAMERA.width_px, 3), 120, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{FAMILY.upper()}"))
    for number, (north_m, east_m) in at_m.items():
        # A white border of half the side, without which none is found.
        marker = cv2.copyMakeBorder(
            cv2.aruco.generateImageMarker(dictionary, number, 200), *[100] * 4, 0, value=255
        )
        corners_m = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * side_m + (north_m, east_m)
        corners_px = ground_to_pixel(corners_m, CAMERA, pose(), 0.0)
        turn = cv2.getPerspectiveTransform(
            np.array([[0, 0], [399, 0], [399, 399], [0, 399]], np.float32),
            (corners_px - 0.5).astype(np.float32),
        )
        drawn = cv2.warpPerspective(marker, turn, (CAMERA.width_px, CAMERA.height_px))
        shape = cv2.warpPerspective(
            np.full_like(marker, 255), turn, (CAMERA.width_px, CAMERA.height_px)
        )
        image[shape > 127] = drawn[shape > 127, None]
    return image


def detector_of(
    *numbers: str, family: str = FAMILY, side_m: float | None = SIDE_M
) -> MarkerDetector:
    return MarkerDetector(DetectorSection(family=family, side_m=side_m), numbers, CAMERA)


def test_markers_are_found_on_the_ground_where_they_lie() -> None:
    at_m = {7: (8.0, -5.0), 42: (2.0, -1.0), 9: (5.0, -7.0)}
    detector = detector_of("42", "7")
    found = {d.appearance: d.pixel_px for d in detector.detect(picture(at_m), pose(), 0.0)}
    assert set(found) == {"42", "7"}
    for number, pixel_px in found.items():
        where_px = ground_to_pixel(np.array(at_m[int(number)]), CAMERA, pose(), 0.0)
        assert math.dist(pixel_px, where_px) < 1.0


@pytest.mark.parametrize(("said_m", "count"), [(SIDE_M, 1), (0.6 * SIDE_M, 0), (None, 1)])
def test_a_marker_of_another_size_is_none(said_m: float | None, count: int) -> None:
    detector = detector_of("7", side_m=said_m)
    assert len(detector.detect(picture({7: (5.0, -3.0)}), pose(), 0.0)) == count


@pytest.mark.parametrize("number", ["cow", "-1", "587", "1.5", "07", "٣"])
def test_what_is_no_marker_of_the_family_is_told(number: str) -> None:
    with pytest.raises(OptionError, match=r"no marker of apriltag_36h11.*0 to 586"):
        detector_of(number)


def test_a_family_that_there_is_not_is_told() -> None:
    assert FAMILY in FAMILIES
    with pytest.raises(OptionError, match="did you mean apriltag_36h11"):
        detector_of("1", family="apriltag_36h12")
