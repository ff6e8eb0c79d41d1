"""Every conversion goes there and back, and points the right way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dronemon.frames import (
    AreaFrame,
    GeoPoint,
    attitude_of,
    body_to_ned,
    camera_to_ned,
    degrees_to_ned,
    geo_to_ned,
    gimbal_to_camera,
    ground_to_pixel,
    ned_to_degrees,
    ned_to_geo,
    off_down_rad,
    pixel_to_ground,
    quaternion_to_rotation,
)
from dronemon.types import CameraModel, GimbalAttitude, Pose
from sim.gimbal import Gimbal
from sim.streams import quaternion

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.radians(90))
angles = st.floats(-math.pi, math.pi)
tilts = st.floats(-0.3, 0.3)
metres = st.floats(-500, 500)
shares = st.floats(-0.5, 1.5)


def _frame(heading_rad: float = 0.0, centre: tuple[float, float] = (0.0, 0.0)) -> AreaFrame:
    return AreaFrame(
        centre_ned_m=centre,
        ground_down_m=-1.0,
        side_m=200.0,
        heading_rad=heading_rad,
        cruise_speed_m_s=5.0,
    )


def _pose(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, height_m: float = 35.0) -> Pose:
    return Pose(
        time_s=0.0,
        position_ned_m=(10.0, -20.0, -1.0 - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(roll, pitch, yaw),
    )


@given(shares, shares, angles, metres, metres)
def test_au_to_ned_and_back(x: float, y: float, heading: float, north: float, east: float):
    frame = _frame(heading, (north, east))
    point = np.array([x, y])
    np.testing.assert_allclose(frame.ned_to_au(frame.au_to_ned(point)), point, atol=1e-9)


def test_area_lies_where_its_heading_says():
    # Without heading x_au runs east, y_au north; turned by 90 degrees: y_au east, x_au south.
    np.testing.assert_allclose(_frame().au_to_ned(np.array([1.0, 0.5])), [0.0, 100.0], atol=1e-9)
    np.testing.assert_allclose(_frame().au_to_ned(np.array([0.5, 1.0])), [100.0, 0.0], atol=1e-9)
    turned = _frame(math.pi / 2)
    np.testing.assert_allclose(turned.au_to_ned(np.array([0.5, 1.0])), [0.0, 100.0], atol=1e-9)
    np.testing.assert_allclose(turned.au_to_ned(np.array([1.0, 0.5])), [-100.0, 0.0], atol=1e-9)


def test_time_unit_is_one_side_at_cruise_speed():
    assert _frame().s_to_au(40.0) == pytest.approx(1.0)
    assert _frame().au_to_s(30.0) == pytest.approx(1200.0)


@given(metres, metres, st.floats(-100, 100), st.floats(-90, 90), st.floats(-180, 180))
@example(500.0, 300.0, -35.0, 90.0, 0.0)
@example(-500.0, 300.0, -35.0, -90.0, 180.0)
def test_geo_to_ned_and_back(north: float, east: float, down: float, lat: float, lon: float):
    origin = GeoPoint(latitude_deg=lat, longitude_deg=lon, altitude_m=400.0)
    there = ned_to_geo(np.array([north, east, down]), origin)
    np.testing.assert_allclose(geo_to_ned(there, origin), [north, east, down], atol=1e-5)


def test_north_is_more_latitude_and_up_is_less_down():
    origin = GeoPoint(latitude_deg=47.0, longitude_deg=8.0, altitude_m=400.0)
    north = GeoPoint(latitude_deg=47.001, longitude_deg=8.0, altitude_m=410.0)
    ned = geo_to_ned(north, origin)
    assert ned[0] == pytest.approx(111.2, abs=0.3)  # a thousandth of a degree
    assert ned[2] == pytest.approx(-10.0, abs=0.01)


@given(tilts, tilts, angles, st.floats(-15, 15), st.floats(-15, 15), st.floats(20, 60))
def test_ground_to_pixel_and_back(
    roll: float, pitch: float, yaw: float, north: float, east: float, height: float
):
    pose = _pose(roll, pitch, yaw, height)
    ground = np.array([10.0 + north, -20.0 + east])
    pixel = ground_to_pixel(ground, CAMERA, pose, -1.0)
    np.testing.assert_allclose(pixel_to_ground(pixel, CAMERA, pose, -1.0), ground, atol=1e-6)


def test_picture_axes_of_a_level_vehicle():
    # Nose north: up in the picture is north, right is east; nose east: up is east, right is south.
    above_right = np.array([400.0, 180.0])
    north, east = pixel_to_ground(above_right, CAMERA, _pose(), -1.0) - [10.0, -20.0]
    assert north > 0
    assert east > 0
    north, east = pixel_to_ground(above_right, CAMERA, _pose(yaw=math.pi / 2), -1.0) - [10.0, -20.0]
    assert north < 0
    assert east > 0


def test_tilt_moves_the_picture_the_right_way():
    centre = np.array([320.0, 240.0])
    # Nose up: the camera looks ahead. Right wing down: it looks to the left.
    nose_up = pixel_to_ground(centre, CAMERA, _pose(pitch=0.2), -1.0) - [10.0, -20.0]
    np.testing.assert_allclose(nose_up, [35.0 * math.tan(0.2), 0.0], atol=1e-9)
    wing_down = pixel_to_ground(centre, CAMERA, _pose(roll=0.2), -1.0) - [10.0, -20.0]
    np.testing.assert_allclose(wing_down, [0.0, -35.0 * math.tan(0.2)], atol=1e-9)


def test_rays_above_the_horizon_meet_no_ground():
    sky = pixel_to_ground(np.array([320.0, 0.0]), CAMERA, _pose(pitch=1.2), -1.0)
    assert np.isnan(sky).all()


@given(angles, tilts, angles)
def test_body_to_ned_is_a_rotation(roll: float, pitch: float, yaw: float):
    rotation = body_to_ned((roll, pitch, yaw))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_a_rotation_tells_its_attitude(roll: float, pitch: float, yaw: float):
    there = attitude_of(body_to_ned((roll, pitch, yaw)))
    np.testing.assert_allclose(body_to_ned(there), body_to_ned((roll, pitch, yaw)), atol=1e-9)
    assert there[0] == pytest.approx(roll, abs=1e-6)
    assert there[1] == pytest.approx(pitch, abs=1e-6)


@given(angles, angles, angles)
def test_a_quaternion_is_the_rotation_of_its_angles(roll: float, pitch: float, yaw: float):
    rotation = quaternion_to_rotation(quaternion(roll, pitch, yaw))
    np.testing.assert_allclose(rotation, body_to_ned((roll, pitch, yaw)), atol=1e-9)


def _gimbal(roll: float, pitch: float, yaw: float, *, is_from_heading: bool) -> GimbalAttitude:
    rotation = quaternion_to_rotation(quaternion(roll, pitch, yaw))
    return GimbalAttitude(time_s=0.0, rotation=rotation, is_from_heading=is_from_heading)


@pytest.mark.parametrize("is_from_heading", [True, False])
@pytest.mark.parametrize("yaw_deg", [0.0, 40.0, 90.0, 130.0, 180.0, -130.0, -90.0, -40.0])
@pytest.mark.parametrize("heading_deg", [0.0, 70.0, 160.0, -110.0, -20.0])
def test_a_gimbal_that_looks_down_is_a_level_camera(
    heading_deg: float, yaw_deg: float, is_from_heading: bool
):
    """At 90 degrees below the horizon, where its own roll and yaw cannot be told apart."""
    yaw, heading = math.radians(yaw_deg), math.radians(heading_deg)
    gimbal = _gimbal(0.0, -math.pi / 2.0, yaw, is_from_heading=is_from_heading)
    camera = camera_to_ned(gimbal, heading)
    roll, pitch, turned = attitude_of(camera)
    assert (roll, pitch) == pytest.approx((0.0, 0.0), abs=1e-9)
    expected = yaw + heading if is_from_heading else yaw
    assert math.remainder(turned - expected, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert off_down_rad(camera) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("is_from_heading", [True, False])
@given(roll=tilts, off=st.floats(-0.5, 0.5), yaw=angles, heading=angles)
def test_a_gimbals_picture_shows_what_lies_along_its_axes(
    roll: float, off: float, yaw: float, heading: float, is_from_heading: bool
):
    """Against its axis turned one angle after the other, by another's rotations."""
    gimbal = _gimbal(roll, off - math.pi / 2.0, yaw, is_from_heading=is_from_heading)
    camera = attitude_of(camera_to_ned(gimbal, heading))
    over_ground = yaw + heading if is_from_heading else yaw
    turned = Rotation.from_euler("ZYX", [over_ground, off - math.pi / 2.0, roll])
    ahead, below = turned.apply([1.0, 0.0, 0.0]), turned.apply([0.0, 0.0, 1.0])
    assert off_down_rad(camera_to_ned(gimbal, heading)) == pytest.approx(abs(off), abs=1e-6)
    pose = replace(_pose(), attitude_rad=camera)
    for pixel, ray in (((320.0, 240.0), ahead), ((320.0, 180.0), ahead - 60.0 / 320.0 * below)):
        place = pixel_to_ground(np.array(pixel), CAMERA, pose, -1.0) - [10.0, -20.0]
        np.testing.assert_allclose(place, 35.0 * ray[:2] / ray[2], atol=1e-6)


def test_the_simulators_gimbal_looks_as_its_camera_does():
    """Two derivations of one convention."""
    gimbal = Gimbal()
    gimbal.is_controlled = True
    assert gimbal.point(math.radians(-70.0), math.radians(30.0))
    for _ in range(300):
        gimbal.step(0.01)
    heard = _gimbal(0.0, gimbal.pitch_rad, gimbal.yaw_rad, is_from_heading=True)
    assert attitude_of(camera_to_ned(heard, 1.1)) == pytest.approx(gimbal.camera_attitude_rad(1.1))


@given(angles, st.floats(-math.pi / 2, math.pi / 2), angles)
def test_a_camera_on_a_gimbal_looks_where_the_gimbal_does(roll: float, pitch: float, yaw: float):
    ahead, right, below = body_to_ned((roll, pitch, yaw)).T
    forward, starboard, down = body_to_ned(gimbal_to_camera((roll, pitch, yaw))).T
    np.testing.assert_allclose(down, ahead, atol=1e-6)
    np.testing.assert_allclose(starboard, right, atol=1e-6)
    np.testing.assert_allclose(forward, -below, atol=1e-6)


@pytest.mark.parametrize(
    ("gimbal_deg", "camera_deg"),
    [
        ((0, -90, 0), (0, 0, 0)),
        ((0, -90, 77), (0, 0, 77)),
        ((30, -90, 50), (0, 0, 80)),  # straight down, roll is yaw
        ((180, -89, 170), (0, -1, -10)),  # as drones tell a gimbal that is a degree beyond
        ((0, -60, 20), (0, 30, 20)),
        ((10, -90, 0), (0, 0, 10)),
    ],
)
def test_gimbals_angles_that_people_know(gimbal_deg, camera_deg):
    roll, pitch, yaw = np.radians(gimbal_deg)
    told_deg = np.degrees(gimbal_to_camera((roll, pitch, yaw)))
    np.testing.assert_allclose((told_deg - camera_deg + 180.0) % 360.0 - 180.0, 0.0, atol=1e-9)


@given(
    st.tuples(st.floats(-89.9, 89.9), angles.map(math.degrees)),
    st.floats(-5000.0, 5000.0),
    st.floats(-5000.0, 5000.0),
    st.floats(-100.0, 3000.0),
)
def test_degrees_to_metres_and_back(
    place: tuple[float, float], north_m: float, east_m: float, altitude_m: float
):
    latitude_deg, longitude_deg = place
    origin = GeoPoint(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m)
    there = ned_to_degrees(np.array([[north_m, east_m]]), origin)
    back = degrees_to_ned(there, origin)
    assert back.shape == (1, 3)
    as_geo = GeoPoint(latitude_deg=there[0, 0], longitude_deg=there[0, 1], altitude_m=altitude_m)
    assert back[0] == pytest.approx(geo_to_ned(as_geo, origin), abs=1e-6)
    assert back[0, :2] == pytest.approx((north_m, east_m), abs=0.02)
    assert 0.0 <= back[0, 2] + 1e-6 < 10.0
