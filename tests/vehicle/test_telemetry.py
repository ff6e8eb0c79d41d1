"""Telemetry from plain dictionaries: what each message says of the vehicle."""

from __future__ import annotations

import math

import pytest
from messages import (
    ACCURACY,
    HEARTBEAT,
    HOME,
    PLACE,
    READY,
    attitude,
    pose,
    posed,
    position,
    silent_until,
)
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CameraError
from dronemon.types import GpsFix
from dronemon.vehicle import Landed, Mode
from dronemon.vehicle.px4 import MODES, REMOTE_ID_STATUS
from dronemon.vehicle.telemetry import Telemetry

DISARMED = {"base_mode": 0, "system_status": mavlink.MAV_STATE_STANDBY}

SYS_STATUS = {
    "battery_remaining": 50,
    "onboard_control_sensors_health": 0,
    "onboard_control_sensors_present": 0,
}
GPS = {"fix_type": 3, "eph": 70, "satellites_visible": 9}


def beat(telemetry, **fields):
    telemetry.take("HEARTBEAT", HEARTBEAT | fields)


def estimate(telemetry, flags, **fields):
    telemetry.take("ESTIMATOR_STATUS", {"flags": flags, **ACCURACY, **fields})


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        *((main << 16 | sub << 24, mode) for (main, sub), mode in MODES.items()),
        (50593792, Mode.HOLD),
        (4 << 16 | 11 << 24, Mode.OTHER),
        (255 << 16, Mode.OTHER),
    ],
)
def test_heartbeat_says_mode_and_arming(custom_mode, mode):
    telemetry = Telemetry()
    beat(telemetry, custom_mode=custom_mode)
    assert telemetry.state.mode is mode
    assert telemetry.state.is_armed
    assert not telemetry.state.is_failsafe
    beat(telemetry, system_status=5)
    assert telemetry.state.is_failsafe
    beat(telemetry, base_mode=0, system_status=5)
    assert (telemetry.state.is_armed, telemetry.state.is_doubted) == (True, True)
    beat(telemetry, base_mode=0)  # a mode may go with the motors
    assert (telemetry.state.is_armed, telemetry.state.is_doubted) == (False, False)
    assert telemetry.num_heartbeats == 4


@pytest.mark.parametrize("beats", [(DISARMED, {}), (DISARMED, {}, DISARMED, {}, DISARMED, {})])
def test_one_heartbeat_stops_no_motors(beats):
    telemetry = posed(100.0)
    beat(telemetry)
    for fields in beats:
        beat(telemetry, **fields)
        assert telemetry.state.is_armed
        assert telemetry.state.is_doubted is (fields is DISARMED)


def test_killed_or_terminated_it_flies_no_mode():
    telemetry = Telemetry()
    beat(telemetry, system_status=8)
    assert (telemetry.state.mode, telemetry.state.is_failsafe) == (Mode.TERMINATION, True)
    assert telemetry.state.is_armed


def test_a_place_from_the_future_does_not_stay():
    telemetry = posed(100.0)
    telemetry.take("LOCAL_POSITION_NED", position(109.0))
    pose(telemetry, 100.1)
    pose(telemetry, 100.2)
    assert telemetry.time_s == 100.2
    assert telemetry.state.num_unreadable == 0


@pytest.mark.parametrize(
    "fields",
    [
        {"autopilot": mavlink.MAV_AUTOPILOT_INVALID},
        {"autopilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA},
        {"type": mavlink.MAV_TYPE_ONBOARD_CONTROLLER},
        {"custom_mode": None},
        {"custom_mode": -1},
        {"base_mode": 256},
        {"system_status": "armed"},
    ],
)
def test_a_heartbeat_that_is_not_the_autopilots_is_counted_and_left_out(fields):
    telemetry = Telemetry()
    beat(telemetry, **fields)
    assert not telemetry.state.is_armed
    assert telemetry.num_heartbeats == 0
    assert telemetry.state.num_unreadable == 1


def test_heartbeats_that_are_repeated_late_change_nothing():
    telemetry = posed(100.0)
    for now_s in range(101, 121):
        pose(telemetry, now_s)
        beat(telemetry, **(DISARMED if now_s < 106 else {}))
        beat(telemetry, **(DISARMED if now_s < 112 else {}))  # by another route, 6 s late
        assert telemetry.state.is_armed == (now_s >= 106), now_s


def test_a_state_that_comes_back_soon_is_believed_once_nothing_says_otherwise_for_a_while():
    telemetry = posed(100.0)
    beat(telemetry, custom_mode=4 << 16 | 3 << 24)
    beat(telemetry, custom_mode=6 << 16)
    for now_s in (101.0, 102.0, 103.0):
        pose(telemetry, now_s)
        beat(telemetry, custom_mode=4 << 16 | 3 << 24)
        assert (telemetry.state.mode, telemetry.state.is_doubted) == (Mode.OFFBOARD, True)
    pose(telemetry, 104.0)
    beat(telemetry, custom_mode=4 << 16 | 3 << 24)
    assert (telemetry.state.mode, telemetry.state.is_doubted) == (Mode.HOLD, False)
    beat(telemetry, **DISARMED)
    beat(telemetry, **DISARMED)
    assert not telemetry.state.is_armed
    beat(telemetry)
    assert not telemetry.state.is_armed
    silent_until(telemetry, 109.0)
    silent_until(telemetry, 114.5)
    beat(telemetry)
    assert telemetry.state.is_armed


def test_a_late_word_of_the_ground_lands_nothing():
    telemetry = posed(100.0)
    for state in (1, 3, 2, 1, 2, 1, 1, 2):  # on the ground, taking off, in the air
        telemetry.take("EXTENDED_SYS_STATE", {"landed_state": state})
    assert telemetry.state.landed is Landed.IN_AIR


def test_how_far_down_the_estimate_jumped_is_told():
    telemetry = posed(100.0)
    for step, z in enumerate((-3.0, -7.0, -7.0, -4.5), 1):
        pose(telemetry, 100.0 + 0.02 * step, z=z)
    assert telemetry.state.num_resets == 2
    assert telemetry.state.jumped_down_m == pytest.approx(-1.5)


def test_slow_state_is_read():
    telemetry = posed(100.0)
    for name, fields in READY.items():
        telemetry.take(name, fields)
    telemetry.take("EXTENDED_SYS_STATE", {"landed_state": mavlink.MAV_LANDED_STATE_LANDING})
    state = telemetry.state
    assert state.home == state.origin == state.place
    assert state.home.latitude_deg == pytest.approx(47.397742)
    assert state.home.altitude_m == 488.0
    assert state.landed is Landed.LANDING
    assert state.is_position_good
    assert state.is_armable
    assert state.battery == 0.73
    telemetry.take("SYS_STATUS", SYS_STATUS | {"battery_remaining": -1})
    assert telemetry.state.battery is None
    assert not telemetry.state.is_armable
    assert telemetry.state.num_unreadable == 0


def test_what_is_asked_before_a_take_off_is_read():
    telemetry = posed(100.0)
    receiver = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    sensors = {f"onboard_control_sensors_{what}": receiver for what in ("health", "present")}
    telemetry.take("SYS_STATUS", {"battery_remaining": 50} | sensors)
    assert telemetry.state.has_sticks
    telemetry.take("SYS_STATUS", SYS_STATUS | {"onboard_control_sensors_health": receiver})
    assert not telemetry.state.has_sticks
    telemetry.take("GPS_RAW_INT", GPS)
    assert telemetry.state.gps == GpsFix(is_3d=True, num_satellites=9, dilution=0.7)
    telemetry.take("GPS_RAW_INT", {"fix_type": 1, "eph": 65535, "satellites_visible": 255})
    assert telemetry.state.gps == GpsFix(is_3d=False, num_satellites=None, dilution=None)
    telemetry.take("AUTOPILOT_VERSION", {"uid": 0, "uid2": [0] * 18})
    assert telemetry.state.hardware is None
    telemetry.take("AUTOPILOT_VERSION", {"uid": 17, "uid2": [0] * 18})
    assert telemetry.state.hardware == "0000000000000011"
    telemetry.take("AUTOPILOT_VERSION", {"uid": 17, "uid2": [1] * 18})
    assert telemetry.state.hardware == "01" * 18
    assert telemetry.state.remote_id is None
    telemetry.take(REMOTE_ID_STATUS, {"status": 1, "error": "no operator"})
    assert telemetry.state.remote_id == "no operator"
    telemetry.take(REMOTE_ID_STATUS, {"status": 0, "error": ""})
    assert telemetry.state.remote_id == ""
    estimate(telemetry, 63)
    assert telemetry.state.estimate_doubts == ()
    estimate(telemetry, 63 - 1 + mavlink.ESTIMATOR_GPS_GLITCH)
    assert telemetry.state.estimate_doubts == ("no attitude", "a GPS glitch")
    assert telemetry.state.num_unreadable == 0
    silent_until(telemetry, 109.0)
    silent_until(telemetry, 110.5)
    assert (telemetry.state.gps, telemetry.state.remote_id) == (None, None)
    assert not telemetry.state.has_sticks


@pytest.mark.parametrize(
    ("flags", "is_good"),
    [
        (mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_ATTITUDE, True),
        (mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_GPS_GLITCH, True),
        (mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_CONST_POS_MODE, True),
        (mavlink.ESTIMATOR_POS_HORIZ_REL, False),
    ],
)
def test_a_good_position_is_absolute_and_measured(flags, is_good):
    telemetry = Telemetry()
    estimate(telemetry, flags)
    assert telemetry.state.is_position_good == is_good


@pytest.mark.parametrize(
    ("told", "accuracy_m"), [(0.4, 0.4), (0.0, None), (-1.0, None), (math.inf, None), (None, None)]
)
def test_an_accuracy_that_is_none_is_unknown_and_spoils_nothing_else(told, accuracy_m):
    telemetry = Telemetry()
    for name, other in (("horiz", "vert"), ("vert", "horiz")):
        estimate(telemetry, mavlink.ESTIMATOR_POS_HORIZ_ABS, **{f"pos_{name}_accuracy": told})
        known_m = ACCURACY[f"pos_{other}_accuracy"]
        expected = (accuracy_m, known_m) if name == "horiz" else (known_m, accuracy_m)
        assert (telemetry.state.accuracy_m, telemetry.state.height_accuracy_m) == expected
    assert telemetry.state.is_position_good


def test_what_is_not_heard_for_ten_seconds_is_not_trusted():
    telemetry = posed(100.0)
    for name, fields in READY.items():
        telemetry.take(name, fields)
    telemetry.take("EXTENDED_SYS_STATE", {"landed_state": mavlink.MAV_LANDED_STATE_ON_GROUND})
    silent_until(telemetry, 109.0)
    assert telemetry.state.landed is Landed.ON_GROUND
    silent_until(telemetry, 110.5)
    state = telemetry.state
    assert state.landed is Landed.UNKNOWN
    assert state.battery is None
    assert not state.is_armable
    assert not state.is_position_good
    assert state.home is not None


@pytest.mark.parametrize(
    ("gps", "place_s", "was_good", "is_good"),
    [
        (GPS, 109.0, True, True),
        (GPS | {"fix_type": 1}, 109.0, True, False),
        (GPS, 100.0, True, False),
        (GPS, 109.0, False, False),
    ],
)
def test_where_the_estimator_is_silent_other_signs_say_whether_the_position_is_good(
    gps, place_s, was_good, is_good
):
    telemetry = posed(100.0)
    flags = mavlink.ESTIMATOR_POS_HORIZ_ABS if was_good else mavlink.ESTIMATOR_CONST_POS_MODE
    estimate(telemetry, flags)
    silent_until(telemetry, place_s)
    telemetry.take("GLOBAL_POSITION_INT", PLACE)
    silent_until(telemetry, 109.0)
    telemetry.take("GPS_RAW_INT", gps)
    assert telemetry.state.is_position_good == was_good
    assert telemetry.state.is_estimate_heard
    silent_until(telemetry, 110.5)
    assert telemetry.state.is_position_good == is_good
    assert not telemetry.state.is_estimate_heard


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("LOCAL_POSITION_NED", position(10.1, x=None)),
        ("LOCAL_POSITION_NED", position(10.1, vx=math.nan)),
        ("LOCAL_POSITION_NED", position(10.1, z=math.inf)),
        ("LOCAL_POSITION_NED", position(10.1, x=1e9)),
        ("ATTITUDE", attitude(10.1, roll=None)),
        ("ATTITUDE", attitude(10.1, yaw=-math.inf)),
        ("ATTITUDE", attitude(10.1, pitch=1e6)),
        ("SYS_STATUS", SYS_STATUS | {"battery_remaining": 101}),
        ("GPS_RAW_INT", GPS | {"eph": -1}),
        ("GPS_RAW_INT", GPS | {"satellites_visible": None}),
        ("AUTOPILOT_VERSION", {"uid": -1, "uid2": [0] * 18}),
        ("AUTOPILOT_VERSION", {"uid": 1, "uid2": [256] * 18}),
        (REMOTE_ID_STATUS, {"status": 1}),
        ("EXTENDED_SYS_STATE", {"landed_state": 77}),
        ("HOME_POSITION", HOME | {"latitude": 900000001}),
        ("HOME_POSITION", HOME | {"altitude": None}),
        ("ESTIMATOR_STATUS", {"flags": None}),
        ("STATUSTEXT", {"severity": None, "text": "hi"}),
        ("ATTITUDE", {}),
    ],
)
def test_a_message_with_numbers_that_cannot_be_is_counted_and_left_out(name, fields):
    telemetry = posed(10.0)
    before = telemetry.state
    telemetry.take(name, fields)
    assert telemetry.state.num_unreadable == before.num_unreadable + 1
    assert telemetry.pose.time_s == 10.0
    pose(telemetry, 10.2, x=1.0)
    assert telemetry.pose.position_ned_m[0] == 1.0


def test_pose_carries_a_position_along_its_velocity():
    telemetry = Telemetry()
    telemetry.take("ATTITUDE", attitude(1.0))
    assert telemetry.pose is None
    telemetry.take("LOCAL_POSITION_NED", position(1.0, x=10.0, vx=5.0))
    telemetry.take("ATTITUDE", attitude(1.02, yaw=0.5))
    assert telemetry.pose.time_s == 1.02
    assert telemetry.pose.position_ned_m == pytest.approx((10.1, 2.0, -3.0))
    assert telemetry.pose.attitude_rad == (0.0, 0.0, 0.5)
    telemetry.take("ATTITUDE", attitude(1.6))
    assert telemetry.pose.time_s == 1.02  # the position is too old to be carried so far


def test_late_messages_are_dropped():
    telemetry = posed(5.0)
    telemetry.take("LOCAL_POSITION_NED", position(5.1, x=7.0))
    estimate(telemetry, 16, time_usec=5_100_000)
    telemetry.take("LOCAL_POSITION_NED", position(3.6, x=1.0))
    telemetry.take("ATTITUDE", attitude(3.6, yaw=1.0))
    estimate(telemetry, 0, time_usec=3_600_000)
    telemetry.take("ATTITUDE", attitude(5.1))
    assert telemetry.pose.time_s == 5.1
    assert telemetry.pose.position_ned_m[0] == 7.0
    assert telemetry.state.is_position_good
    assert telemetry.state.num_unreadable == 0
    estimate(telemetry, 0, time_usec=1_800_000_000_000_000)
    assert not telemetry.state.is_position_good


def test_poses_go_on_where_the_boot_time_wraps():
    wrap_s = 2**32 / 1000.0
    telemetry = posed(*(wrap_s - 0.5 + 0.02 * i for i in range(50)))
    assert telemetry.pose.time_s == pytest.approx(wrap_s + 0.48, abs=0.002)
    assert telemetry.pop_problem() is None


def test_after_a_reboot_poses_come_of_the_new_boot():
    telemetry = posed(500.0)
    beat(telemetry)
    for i in range(80):
        pose(telemetry, 4.0 + 0.02 * i)
    assert "rebooted" in telemetry.pop_problem()
    assert telemetry.pose.time_s == pytest.approx(5.58)
    assert telemetry.state.num_resets == 0


def test_a_jump_that_the_velocity_does_not_explain_is_a_reset():
    telemetry = posed(10.0)
    pose(telemetry, 10.1, x=1.0, vx=12.0)
    pose(telemetry, 10.2, x=3.0, vx=12.0)
    assert telemetry.state.num_resets == 0
    pose(telemetry, 10.3, x=16.0, vx=12.0)
    assert telemetry.state.num_resets == 1
    pose(telemetry, 10.4, x=17.2, vx=12.0, z=-6.0)
    assert telemetry.state.num_resets == 1
    pose(telemetry, 10.5, x=18.4, vx=0.0, z=-13.0)
    assert telemetry.state.num_resets == 2
    pose(telemetry, 20.0, x=200.0)  # nothing was heard meanwhile: it may have flown
    assert telemetry.state.num_resets == 2


def test_poses_around_an_instant():
    telemetry = posed(1.0, 1.1, 1.2)
    assert [pose.time_s for pose in telemetry.poses_around(1.15)] == [1.1, 1.2]
    with pytest.raises(CameraError, match=r"no pose is kept for vehicle time 0.50 s"):
        telemetry.poses_around(0.5)
