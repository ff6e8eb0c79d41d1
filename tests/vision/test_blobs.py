"""Spots of a colour, or warm ones, are found if they have the size that is looked for."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest

from dronemon.frames import ground_to_pixel
from dronemon.mission.detector import DetectorSection
from dronemon.types import CameraModel, ImageArray, Pose
from dronemon.vision.blobs import BlobDetector

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
POSE = Pose(
    time_s=0.0,
    position_ned_m=(0.0, 0.0, -20.0),
    velocity_ned_m_s=(0.0, 0.0, 0.0),
    attitude_rad=(0.15, 0.1, 0.4),
)
ORANGE, RED, WARM = (30, 130, 250), (30, 20, 250), (240, 240, 240)


def look_of(**keys: Any) -> DetectorSection:
    return DetectorSection(**{"kind": "blobs", "min_score": 0.0, **keys})


def picture(*spots: tuple[tuple[int, int, int], tuple[float, float], float]) -> ImageArray:
    """Meadow with squares on the ground: colour, north and east, side in m."""
    image = np.full((CAMERA.height_px, CAMERA.width_px, 3), (62, 128, 104), np.uint8)
    for colour, at_m, side_m in spots:
        corners_m = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * 0.5 * side_m + at_m
        corners_px = ground_to_pixel(corners_m, CAMERA, POSE, 0.0)
        cv2.fillPoly(image, [corners_px.round().astype(np.int32)], colour)
    return image


@pytest.mark.parametrize(
    ("look", "colour"),
    [
        (look_of(hue_deg=(15.0, 40.0), saturation=0.6), ORANGE),
        (look_of(hue_deg=(345.0, 10.0), saturation=0.6), RED),
        (look_of(brightness=0.9), WARM),
    ],
)
def test_a_spot_of_the_look_is_found_where_it_is(
    look: DetectorSection, colour: tuple[int, int, int]
) -> None:
    others = [c for c in (ORANGE, RED, WARM) if c != colour]
    if look.hue_deg is None:
        others = []  # orange and red are as bright
    image = picture((colour, (3.0, -2.0), 1.5), *((c, (-4.0, 3.0), 1.5) for c in others))
    (found,) = BlobDetector(look, "thing", CAMERA).detect(image, POSE, 0.0)
    assert found.appearance == "thing"
    where_px = ground_to_pixel(np.array([3.0, -2.0]), CAMERA, POSE, 0.0)
    assert math.dist(found.pixel_px, where_px) < 1.5


def test_only_spots_of_the_size_count_the_largest_first() -> None:
    look = look_of(hue_deg=(15.0, 40.0), saturation=0.6, size_m=(1.0, 3.0))
    at_m = [(4.0, -4.0), (0.0, 0.0), (-5.0, 5.0), (5.0, 6.0)]
    image = picture(
        *((ORANGE, at, side) for at, side in zip(at_m, (0.6, 1.4, 2.4, 4.5), strict=True))
    )
    found = BlobDetector(look, "thing", CAMERA).detect(image, POSE, 0.0)
    places_px = ground_to_pixel(np.array([at_m[2], at_m[1]]), CAMERA, POSE, 0.0)
    np.testing.assert_allclose([d.pixel_px for d in found], places_px, atol=1.5)


def test_what_the_pictures_edge_cuts_is_not_told() -> None:
    look = look_of(hue_deg=(15.0, 40.0), saturation=0.6)
    image = picture()
    image[0:40, 100:140] = ORANGE
    assert BlobDetector(look, "thing", CAMERA).detect(image, POSE, 0.0) == ()


def test_what_fills_its_outline_badly_is_less_sure() -> None:
    image = picture()
    cv2.line(image, (100, 100), (150, 150), ORANGE, 5)
    cv2.circle(image, (400, 200), 20, ORANGE, -1)
    looks = (look_of(hue_deg=(15.0, 40.0), saturation=0.6, min_score=s) for s in (0.0, 0.6))
    every, sure = (BlobDetector(look, "thing", CAMERA).detect(image, POSE, 0.0) for look in looks)
    assert len(every) == 2
    (circle,) = sure
    np.testing.assert_allclose(circle.pixel_px, (400.5, 200.5), atol=0.6)
