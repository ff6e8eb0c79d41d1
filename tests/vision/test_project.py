"""Poses between two telemetry messages."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronemon.errors import CameraError
from dronemon.frames import body_to_ned, ground_to_pixel, pixel_to_ground
from dronemon.types import CameraModel, GimbalAttitude, Pose
from dronemon.vision.project import interpolate_pose, on_gimbal, shown_radius_m, turning

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
ANGLES = st.floats(-math.pi, math.pi)


def pose(time_s, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0)):
    return Pose(
        time_s=time_s,
        position_ned_m=position,
        velocity_ned_m_s=velocity,
        attitude_rad=attitude,
    )


def test_everything_is_interpolated():
    before = pose(1.0, (0.0, 10.0, -30.0), (5.0, 0.0, 0.0), (0.1, -0.2, 1.0))
    after = pose(1.5, (2.0, 10.0, -31.0), (3.0, 1.0, 0.0), (0.2, 0.0, 1.4))
    between = interpolate_pose(before, after, 1.2)
    assert between.time_s == 1.2
    assert between.position_ned_m == pytest.approx((0.8, 10.0, -30.4))
    assert between.velocity_ned_m_s == pytest.approx((4.2, 0.4, 0.0))
    assert between.attitude_rad == pytest.approx((0.14, -0.12, 1.16))


@given(start=ANGLES, turn=st.floats(-3.0, 3.0), fraction=st.floats(0.0, 1.0))
def test_yaw_turns_the_shorter_way(start, turn, fraction):
    end = math.remainder(start + turn, math.tau)
    between = interpolate_pose(
        pose(0.0, attitude=(0.0, 0.0, start)), pose(1.0, attitude=(0.0, 0.0, end)), fraction
    )
    yaw = between.attitude_rad[2]
    assert math.remainder(yaw - start - fraction * turn, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi <= yaw <= math.pi


def test_yaw_does_not_spin_across_south():
    before = pose(0.0, attitude=(0.0, 0.0, 3.1))
    after = pose(1.0, attitude=(0.0, 0.0, -3.1))
    yaw = interpolate_pose(before, after, 0.5).attitude_rad[2]
    assert abs(yaw) == pytest.approx(math.pi)


@pytest.mark.parametrize(("time_s", "north_m"), [(0.8, -1.0), (1.0, 0.0), (2.0, 5.0), (2.5, 7.0)])
def test_nearer_pose_moves_on_outside_the_interval(time_s, north_m):
    before = pose(1.0, (0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    after = pose(2.0, (5.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    moved = interpolate_pose(before, after, time_s)
    assert moved.time_s == time_s
    assert moved.position_ned_m[0] == pytest.approx(north_m)
    assert moved.attitude_rad[0] == (0.1 if time_s <= 1.0 else 0.3)


def test_two_messages_of_the_same_instant_are_no_problem():
    same = pose(1.0, (1.0, 2.0, 3.0))
    assert interpolate_pose(same, same, 1.0) == same


DOWN = -math.pi / 2.0


def gimbal(time_s, *, roll=0.0, pitch=DOWN, yaw=0.0, is_from_heading=True):
    rotation = body_to_ned((roll, pitch, yaw))
    return GimbalAttitude(time_s=time_s, rotation=rotation, is_from_heading=is_from_heading)


@pytest.mark.parametrize("tilt", [(0.17, 0.0), (0.0, 0.17), (-0.12, 0.12)])
@pytest.mark.parametrize("heading", [0.0, 2.0, -1.0])
def test_a_level_gimbal_under_a_tilted_body_shows_no_bias(tilt, heading):
    """Ten degrees at 35 m: six metres, were the body's attitude taken for the camera's."""
    body = pose(1.1, (3.0, 4.0, -35.0), attitude=(*tilt, heading))
    level = pose(1.1, (3.0, 4.0, -35.0), attitude=(0.0, 0.0, heading))
    places = np.array([[3.0, 4.0], [13.0, 4.0], [-5.0, -6.0], [3.0, 19.0]])
    pixels = ground_to_pixel(places, CAMERA, level, 0.0)

    def bias_m(seen_from):
        return np.linalg.norm(pixel_to_ground(pixels, CAMERA, seen_from, 0.0) - places, axis=1)

    assert bias_m(on_gimbal(body, gimbal(1.0), gimbal(1.2))).max() < 0.3
    assert bias_m(body).min() > 5.0
    assert bias_m(body)[0] == pytest.approx(35.0 * math.tan(math.hypot(*tilt)), rel=0.02)


@given(start=ANGLES, turn=st.floats(-3.0, 3.0), share=st.floats(0.0, 1.0), heading=ANGLES)
def test_a_gimbal_turns_the_shorter_way_with_the_vehicle(start, turn, share, heading):
    before, after = gimbal(2.0, yaw=start), gimbal(2.5, yaw=start + turn)
    seen = on_gimbal(pose(2.0 + 0.5 * share, attitude=(0.1, -0.1, heading)), before, after)
    assert seen.attitude_rad[:2] == pytest.approx((0.0, 0.0), abs=1e-6)
    off = seen.attitude_rad[2] - (heading + start + share * turn)
    assert math.remainder(off, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_a_tilting_gimbal_is_where_it_was_between():
    before, after = gimbal(2.0, pitch=DOWN), gimbal(3.0, pitch=DOWN + 0.2)
    assert on_gimbal(pose(2.25), before, after).attitude_rad == pytest.approx((0.0, 0.05, 0.0))
    # Frames may change on the way, and both be of one instant.
    turned = gimbal(3.0, pitch=DOWN + 0.2, yaw=0.7, is_from_heading=False)
    seen = on_gimbal(pose(2.25, attitude=(0.0, 0.0, 0.7)), before, turned)
    assert seen.attitude_rad == pytest.approx((0.0, 0.05, 0.7))
    assert on_gimbal(pose(2.0), before, before).attitude_rad == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize(("off_deg", "is_down"), [(19.0, True), (21.0, False), (90.0, False)])
def test_what_looks_elsewhere_than_down_says_nothing(off_deg, is_down):
    looks = gimbal(1.0, pitch=math.radians(off_deg - 90.0), yaw=1.0)
    if is_down:
        assert on_gimbal(pose(1.0), looks, looks).attitude_rad[1] == pytest.approx(0.3316, abs=1e-3)
        return
    with pytest.raises(CameraError, match=f"looks {off_deg:.0f} degrees off straight down, 20 are"):
        on_gimbal(pose(1.0), looks, looks)


def test_turning_goes_the_shorter_way_and_is_none_where_no_time_passes():
    before, after = pose(1.0, attitude=(0.1, 0.0, 3.1)), pose(1.5, attitude=(0.2, 0.0, -3.1))
    assert turning(before, after) == pytest.approx((0.2, 0.0, 2.0 * (math.tau - 6.2)))
    assert turning(before, before) == (0.0, 0.0, 0.0)


def shows(at: Pose, radius_m: float) -> bool:
    """Whether a picture shows all of a circle on the ground about the point below."""
    bearings = np.linspace(0.0, math.tau, 2000)
    circle_m = radius_m * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    pixels_px = ground_to_pixel(circle_m + at.position_ned_m[:2], CAMERA, at, 2.0)
    return bool(((pixels_px >= 0.0) & (pixels_px <= (640.0, 480.0))).all())  # NaN is not


@given(roll=st.floats(-0.6, 0.6), pitch=st.floats(-0.6, 0.6), yaw=ANGLES)
def test_a_picture_shows_the_ground_up_to_its_radius_and_no_farther(roll, pitch, yaw):
    at = pose(0.0, (7.0, -3.0, -38.0), attitude=(roll, pitch, yaw))
    radius_m = shown_radius_m(CAMERA, at, 2.0)
    assert radius_m == 0.0 or shows(at, 0.999 * radius_m)
    assert not shows(at, 1.002 * radius_m + 1e-3)


def test_what_a_level_picture_shows_and_one_that_does_not_show_what_is_below():
    level = pose(0.0, (0.0, 0.0, -38.0))
    assert shown_radius_m(CAMERA, level, 2.0) == pytest.approx(40.0 * 240.0 / 320.0)
    for turned in ((0.8, 0.0, 0.0), (0.0, -0.7, 1.0), (math.pi, 0.0, 0.0), (1.6, 0.0, 0.0)):
        assert shown_radius_m(CAMERA, pose(0.0, (0.0, 0.0, -38.0), attitude=turned), 2.0) == 0.0
