"""How far off a place on the ground is: derivatives, and the covariance they make."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronemon.frames import pixel_to_ground
from dronemon.mission.camera import PlaceErrors
from dronemon.types import CameraModel, Pose
from dronemon.vision.ground_error import (
    ground_covariance,
    ground_jacobian,
    radius_m,
    told_covariance,
)
from dronemon.vision.surface import Plane

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.radians(90))
GROUND_DOWN_M = 1.5
GROUND = Plane(GROUND_DOWN_M)
NO_ERRORS = dict.fromkeys(PlaceErrors.model_fields, 0.0)
tilts = st.floats(-0.5, 0.5)


def pose_at(height_m=40.0, attitude=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)):
    return Pose(
        time_s=0.0,
        position_ned_m=(10.0, -20.0, GROUND_DOWN_M - height_m),
        velocity_ned_m_s=velocity,
        attitude_rad=attitude,
    )


def covariance(pose, at_px=(320.0, 240.0), turn=(0.0, 0.0, 0.0), told=(None, None), **errors):
    """With these errors alone."""
    s = told_covariance(PlaceErrors(**NO_ERRORS | errors), pose, turn, *told)
    return ground_covariance(np.array(at_px), CAMERA, pose, GROUND, s)


def place(told, pixel_px, pose):
    """Where a pixel is if everything is off by `told`, in the order of the Jacobian's columns."""
    north, east, down = pose.position_ned_m
    off = replace(
        pose,
        position_ned_m=(north + told[0], east + told[1], down - told[2]),
        attitude_rad=tuple(pose.attitude_rad + told[3:6]),
    )
    focal_px = CAMERA.focal_px * (1.0 + told[6])
    fov_rad = 2.0 * math.atan(CAMERA.width_px / 2.0 / focal_px)
    camera = replace(CAMERA, horizontal_fov_rad=fov_rad)
    return pixel_to_ground(pixel_px + told[7:], camera, off, GROUND_DOWN_M)


@pytest.mark.lengthy
@given(
    st.floats(0.0, 640.0),
    st.floats(0.0, 480.0),
    st.floats(2.0, 300.0),
    tilts,
    tilts,
    st.floats(-3.0, 3.0),
)
def test_the_jacobian_is_that_of_central_differences(u, v, height_m, roll, pitch, yaw):
    pixel_px, pose = np.array([u, v]), pose_at(height_m, (roll, pitch, yaw))
    jacobian = ground_jacobian(pixel_px, CAMERA, pose, GROUND)
    if np.linalg.norm(place(np.zeros(9), pixel_px, pose) - (10.0, -20.0)) > 5.0 * height_m:
        return  # so near to the horizon that the differences themselves are off
    for column in range(9):
        step = np.zeros(9)
        step[column] = 1e-5
        ahead, behind = place(step, pixel_px, pose), place(-step, pixel_px, pose)
        slope = (ahead - behind) / 2e-5
        np.testing.assert_allclose(jacobian[:, column], slope, rtol=1e-5, atol=1e-5 * height_m)


def test_many_pixels_are_as_each_alone_and_those_above_the_horizon_are_nowhere():
    pose = pose_at(attitude=(0.3, 0.4, 1.0))
    pixels_px = np.array([[[10.0, 20.0], [600.0, 300.0]], [[320.0, 240.0], [np.nan, np.nan]]])
    together = ground_jacobian(pixels_px, CAMERA, pose, GROUND)
    assert together.shape == (2, 2, 2, 9)
    for index in np.ndindex(2, 2):
        alone = ground_jacobian(pixels_px[index], CAMERA, pose, GROUND)
        np.testing.assert_allclose(together[index], alone)
    assert np.isnan(covariance(pose_at(attitude=(1.5, 0.0, 0.0)), (0.0, 240.0))).all()


def test_below_a_level_drone_each_error_counts_as_it_is():
    pose = pose_at(40.0, velocity=(5.0, 0.0, 0.0))
    np.testing.assert_allclose(covariance(pose, position_m=2.0), 4.0 * np.eye(2))
    tilt_m = 40.0 * math.radians(2.0)
    np.testing.assert_allclose(covariance(pose, tilt_deg=2.0), tilt_m**2 * np.eye(2))
    np.testing.assert_allclose(covariance(pose, pixel_px=2.0), 0.25**2 * np.eye(2))  # 8 px/m
    np.testing.assert_allclose(covariance(pose, time_s=0.1), [[0.25, 0.0], [0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(
        covariance(pose, height_m=9.0, ground_m=9.0, heading_deg=9.0, focal_share=0.1),
        np.zeros((2, 2)),
        atol=1e-12,
    )


def test_aside_height_focal_length_and_heading_count():
    """30 m to the east, 40 m below: along the way there, and across it."""
    pose, pixel_px = pose_at(40.0), (560.0, 240.0)
    height_m = covariance(pose, pixel_px, height_m=3.0, ground_m=4.0)
    np.testing.assert_allclose(height_m, np.diag([0.0, (0.75 * 5.0) ** 2]), atol=1e-9)
    focal = covariance(pose, pixel_px, focal_share=0.01)
    np.testing.assert_allclose(focal, np.diag([0.0, 0.3**2]), atol=1e-9)
    heading = covariance(pose, pixel_px, heading_deg=1.0)
    np.testing.assert_allclose(heading, np.diag([(30.0 * math.radians(1.0)) ** 2, 0.0]), atol=1e-9)


def test_what_the_vehicle_says_of_itself_comes_first():
    pose, errors = pose_at(40.0), {"position_m": 9.0, "height_m": 9.0}
    told = covariance(pose, (560.0, 240.0), told=(0.5, 2.0), **errors)
    np.testing.assert_allclose(told, np.diag([0.25, 0.25 + 1.5**2]), atol=1e-9)


def test_a_late_picture_of_a_turning_drone_is_off_by_both_together():
    """Flying north while the nose comes up at the same time: what is seen runs ahead twice."""
    pose, rate = pose_at(40.0, velocity=(8.0, 0.0, 0.0)), 0.1
    late = covariance(pose, turn=(0.0, rate, 0.0), time_s=0.5)
    np.testing.assert_allclose(late, [[(0.5 * (8.0 + 40.0 * rate)) ** 2, 0.0], [0.0, 0.0]])


def test_the_radius_is_that_of_the_ellipse():
    assert radius_m(np.eye(2)) == pytest.approx(2.4477, abs=1e-4)
    turned = np.array([[5.0, 4.0], [4.0, 5.0]])  # of 9 and 1
    assert radius_m(turned) == pytest.approx(3.0 * 2.4477, abs=1e-3)
    many = radius_m(np.array([np.eye(2), np.full((2, 2), np.nan)]))
    assert np.isnan(many).tolist() == [False, True]
