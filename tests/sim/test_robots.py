"""Ground robots are found by their markers, where they stand, from whatever height suits those."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dronemon.frames import AreaFrame, pixel_to_ground
from dronemon.mission.detector import DetectorSection
from dronemon.types import CameraModel, Pose
from dronemon.vision.markers import MarkerDetector
from sim.renderer import Renderer
from sim.robots import look_of
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
FRAME = AreaFrame(
    centre_ned_m=(0.0, 0.0), ground_down_m=1.0, side_m=80.0, heading_rad=0.3, cruise_speed_m_s=4.0
)


def robot(number: str, look: str, place: tuple[float, float]) -> Animal:
    return Animal(name=number, appearance=look, position_ned_m=place, heading_rad=0.7, walked_m=0.0)


@pytest.mark.parametrize(
    ("family", "side_m", "height_m"),
    [("4x4_50", 1.5, 20.0), ("apriltag_36h11", 1.5, 12.0), ("apriltag_16h5", 0.3, 3.0)],
)
@pytest.mark.parametrize("tilt_rad", [0.0, 0.2])
def test_each_is_found_where_it_stands(
    family: str, side_m: float, height_m: float, tilt_rad: float
):
    places = {"3": (0.25, -0.2), "7": (-0.2, 0.3), "11": (0.0, 0.0)}
    pose = Pose(
        time_s=2.0,
        position_ned_m=(5.0, -3.0, 1.0 - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(tilt_rad, -tilt_rad, 0.7),
    )
    at_m = {
        number: (5.0 + height_m * north, -3.0 + height_m * east)
        for number, (north, east) in places.items()
    }
    robots = [robot(n, look_of(family, n, side_m), place) for n, place in at_m.items()]
    image = Renderer(CAMERA, 10000).render(Scene(pose=pose, frame=FRAME, animals=tuple(robots)))
    section = DetectorSection(kind="markers", family=family, side_m=side_m)
    found = MarkerDetector(section, list(places), CAMERA).detect(image, pose, 1.0)
    assert {one.appearance for one in found} == set(places)
    for one in found:
        ground_m = pixel_to_ground(np.array(one.pixel_px), CAMERA, pose, 1.0)
        # It lies a quarter of its side above the ground, and is seen up to 30 degrees aslant.
        assert math.dist(ground_m, at_m[one.appearance]) < 0.25 * side_m
