"""A gimbal's attitude, from plain dictionaries: what is believed of it, and when it was so."""

from __future__ import annotations

import math

import numpy as np
import pytest
from messages import pose, posed
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CameraError
from dronemon.frames import attitude_of, camera_to_ned
from sim.streams import quaternion

DOWN = -math.pi / 2.0
VEHICLE, EARTH = (
    mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
    mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME,
)
LOCK = mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
ABOUT = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
DEVICE, MOUNT = "GIMBAL_DEVICE_ATTITUDE_STATUS", "MOUNT_ORIENTATION"


def device(time_s, yaw=0.0, *, pitch=DOWN, flags=VEHICLE, component=154, **others):
    return {
        "time_boot_ms": round(time_s * 1000.0),
        "q": list(quaternion(0.0, pitch, yaw)),
        "flags": flags | ABOUT,
        "component": component,
        **others,
    }


def mount(time_s, **others):
    angles = {"roll": 0.0, "pitch": -90.0, "yaw": 0.0, "yaw_absolute": None}
    return {"time_boot_ms": round(time_s * 1000.0), "component": 1, **angles, **others}


def heard(telemetry, *messages, name=DEVICE):
    for fields in messages:
        telemetry.take(name, fields)
    return telemetry


def flown(telemetry, until_s, told=device, behind_s=0.0, interval_s=0.2):
    """Poses, and after each the gimbal's word by its own clock."""
    time_s = telemetry.time_s
    while time_s < until_s - 1e-9:
        time_s += interval_s
        pose(telemetry, time_s)
        telemetry.take(DEVICE, told(time_s - behind_s))
    return telemetry


def yaw_over_ground(telemetry, heading_rad):
    (_, newest) = telemetry.gimbal.around(telemetry.gimbal.newest_s)
    return attitude_of(camera_to_ned(newest, heading_rad))[2]


@pytest.mark.parametrize(
    ("flags", "is_from_heading"),
    [(VEHICLE, True), (EARTH, False), (0, True), (LOCK, False), (VEHICLE | LOCK, True)],
)
@pytest.mark.parametrize("yaw", [0.7, 2.2, -2.2, -0.7])
def test_flags_say_from_where_yaw_counts(flags, is_from_heading, yaw):
    telemetry = heard(posed(50.0), device(50.0, yaw, flags=flags))
    over_ground = yaw_over_ground(telemetry, heading_rad=0.4)
    expected = yaw + 0.4 if is_from_heading else yaw
    assert math.remainder(over_ground - expected, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("angles", "over_ground_deg"),
    [
        ({"yaw": 30.0}, 50.0),
        ({"yaw": -170.0, "yaw_absolute": -150.0}, -150.0),
        ({"yaw": None, "yaw_absolute": 120.0}, 120.0),
        ({"yaw": float("nan"), "yaw_absolute": -120.0}, -120.0),
    ],
)
def test_the_older_message_tells_it_too(angles, over_ground_deg):
    telemetry = heard(posed(50.0), mount(50.0, **angles), name=MOUNT)
    yaw = math.degrees(yaw_over_ground(telemetry, heading_rad=math.radians(20.0)))
    assert yaw == pytest.approx(over_ground_deg)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        (DEVICE, device(50.0, q=[0.0, 0.0, 0.0, 0.0])),
        (DEVICE, device(50.0, q=[1.0, None, 0.0, 0.0])),
        (DEVICE, device(50.0, q=[1.0, float("nan"), 0.0, 0.0])),
        (DEVICE, device(50.0, q=[1.0, 1.0, 0.0, 0.0])),
        (DEVICE, device(50.0, q=[1.0, 0.0, 0.0])),
        (DEVICE, device(50.0, flags=VEHICLE | EARTH)),
        (DEVICE, device(50.0) | {"flags": None}),
        (DEVICE, device(50.0) | {"time_boot_ms": None}),
        (DEVICE, device(50.0) | {"time_boot_ms": -1}),
        (MOUNT, mount(50.0, pitch=None)),
        (MOUNT, mount(50.0, roll=1e9)),
        (MOUNT, mount(50.0, yaw=None)),
        (MOUNT, mount(50.0, yaw=None, yaw_absolute=0.0)),  # not sent: MAVLink 1 has no such field
        (MOUNT, mount(50.0) | {"time_boot_ms": 2**32}),
    ],
)
def test_what_cannot_be_is_counted_and_left_out(name, fields):
    telemetry = heard(posed(50.0), fields, name=name)
    assert telemetry.state.num_unreadable == 1
    assert telemetry.gimbal.newest is None


@pytest.mark.parametrize("behind_s", [0.0, 3.0, 47.0, -3000.0])
def test_its_own_clock_is_read_as_the_vehicles(behind_s):
    """A gimbal that turns tells by its yaw when it was so."""
    telemetry = flown(
        posed(50.0), 56.0, lambda own_s: device(own_s, 0.1 * (own_s + behind_s - 50.0)), behind_s
    )
    before, after = telemetry.gimbal.around(55.1)
    assert (before.time_s, after.time_s) == (pytest.approx(55.0), pytest.approx(55.2))
    yaws = [attitude_of(camera_to_ned(sample, 0.0))[2] for sample in (before, after)]
    assert yaws == pytest.approx([0.5, 0.52])


def test_late_words_of_it_neither_turn_nor_delay_it():
    """Each comes again two seconds later, as over redundant routes."""
    telemetry = posed(50.0)
    for number in range(1, 100):
        time_s = 50.0 + 0.2 * number
        pose(telemetry, time_s)
        heard(telemetry, device(time_s), device(time_s - 2.0, yaw=1.0))
    (before, after) = telemetry.gimbal.around(69.5)
    assert (before.time_s, after.time_s) == (pytest.approx(69.4), pytest.approx(69.6))
    assert attitude_of(camera_to_ned(after, 0.0))[2] == pytest.approx(0.0)


def test_one_wild_stamp_does_not_make_it_old():
    telemetry = flown(posed(50.0), 60.0)
    heard(telemetry, device(5000.0))
    flown(telemetry, 61.0)
    telemetry.gimbal.around(60.9)


def test_switched_on_anew_it_is_heard_again():
    telemetry = flown(posed(50.0), 70.0)
    flown(telemetry, 75.0, behind_s=70.0)
    before, after = telemetry.gimbal.around(74.9)
    assert after.time_s - before.time_s == pytest.approx(0.2)


def test_what_was_not_heard_about_a_picture_is_not_known():
    telemetry = flown(posed(50.0), 60.0)
    with pytest.raises(CameraError, match=r"was not heard; the one before is 1\.5 s older, 1 s is"):
        telemetry.gimbal.around(61.5)
    with pytest.raises(CameraError, match="was not heard"):
        telemetry.gimbal.around(49.0)
    pose(telemetry, 62.0)
    heard(telemetry, device(62.0))
    with pytest.raises(CameraError, match="was not heard"):
        telemetry.gimbal.around(61.0)


def test_the_newer_message_is_believed_alone():
    telemetry = posed(50.0)
    heard(telemetry, mount(50.0, yaw=10.0), name=MOUNT)
    for time_s in (50.2, 50.4):
        pose(telemetry, time_s)
        heard(telemetry, device(time_s, math.radians(20.0)))
        heard(telemetry, mount(time_s, yaw=10.0), name=MOUNT)
    yaws = [attitude_of(camera_to_ned(sample, 0.0))[2] for sample in telemetry.gimbal.around(50.3)]
    assert np.degrees(yaws) == pytest.approx(20.0)


def test_of_two_gimbals_nobody_knows_which_has_the_camera():
    telemetry = flown(posed(50.0), 52.0)
    heard(telemetry, device(52.0, component=171))
    with pytest.raises(CameraError, match="several gimbals are heard, of components 154 and 171"):
        telemetry.gimbal.around(51.9)


def test_after_the_vehicles_reboot_it_is_heard_anew():
    telemetry = flown(posed(50.0), 60.0)
    for number in range(60):
        pose(telemetry, 2.0 + 0.02 * number)
    assert telemetry.gimbal.newest is None
    flown(telemetry, 5.0)
    telemetry.gimbal.around(4.9)
