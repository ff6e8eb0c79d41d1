"""Telemetry from plain dictionaries: what each message says of the vehicle."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import VehicleError
from dronemon.vehicle import Landed, Mode, StatusText
from dronemon.vehicle.telemetry import Telemetry

HEARTBEAT = {
    "autopilot": mavlink.MAV_AUTOPILOT_PX4,
    "base_mode": mavlink.MAV_MODE_FLAG_SAFETY_ARMED,
    "custom_mode": 393216,
    "system_status": mavlink.MAV_STATE_ACTIVE,
}
LONG = "Preflight Fail: the heading estimate is not stable, wait or move the vehicle away from iron"


def position(time_s, x=0.0, vx=0.0):
    still = {"y": 2.0, "z": -3.0, "vy": 0.0, "vz": 0.0}
    return {"time_boot_ms": round(time_s * 1000.0), "x": x, "vx": vx, **still}


def attitude(time_s, yaw=0.0):
    return {"time_boot_ms": round(time_s * 1000.0), "roll": 0.0, "pitch": 0.0, "yaw": yaw}


def posed(*times_s):
    telemetry = Telemetry()
    for time_s in times_s:
        telemetry.take("LOCAL_POSITION_NED", position(time_s))
        telemetry.take("ATTITUDE", attitude(time_s))
    return telemetry


def chunks(text, number, severity=4):
    """STATUSTEXT's fields as PX4 cuts a text."""
    pieces = [text[i : i + 50] for i in range(0, len(text), 50)]
    return [
        {"severity": severity, "text": piece, "id": number, "chunk_seq": i}
        for i, piece in enumerate(pieces)
    ]


def say(telemetry, *messages):
    for fields in messages:
        telemetry.take("STATUSTEXT", fields)
    return [said.text for said in telemetry.texts()]


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        (196608, Mode.POSITION),
        (393216, Mode.OFFBOARD),
        (33816576, Mode.TAKEOFF),
        (50593792, Mode.HOLD),
        (84148224, Mode.RETURN),
        (100925440, Mode.LAND),
        (67371008, Mode.OTHER),
    ],
)
def test_heartbeat_says_mode_and_arming(custom_mode, mode):
    telemetry = Telemetry()
    telemetry.take("HEARTBEAT", HEARTBEAT | {"custom_mode": custom_mode})
    assert telemetry.state.mode is mode
    assert telemetry.state.is_armed
    assert not telemetry.state.is_failsafe
    telemetry.take("HEARTBEAT", HEARTBEAT | {"base_mode": 0, "system_status": 5})
    assert not telemetry.state.is_armed
    assert telemetry.state.is_failsafe
    assert telemetry.num_heartbeats == 2


def test_a_gimbals_heartbeat_is_not_the_autopilots():
    telemetry = Telemetry()
    telemetry.take("HEARTBEAT", HEARTBEAT | {"autopilot": mavlink.MAV_AUTOPILOT_INVALID})
    assert not telemetry.state.is_armed
    assert telemetry.num_heartbeats == 0


def test_slow_state_is_read():
    telemetry = Telemetry()
    assert len(telemetry.missing()) == 4
    place = {"latitude": 473977420, "longitude": 85455940, "altitude": 488000}
    telemetry.take("HOME_POSITION", place)
    telemetry.take("GPS_GLOBAL_ORIGIN", place)
    telemetry.take("EXTENDED_SYS_STATE", {"landed_state": mavlink.MAV_LANDED_STATE_LANDING})
    telemetry.take("ESTIMATOR_STATUS", {"flags": 0})
    health = {"onboard_control_sensors_health": mavlink.MAV_SYS_STATUS_PREARM_CHECK}
    telemetry.take("SYS_STATUS", {"battery_remaining": 73, **health})
    state = telemetry.state
    assert state.home == state.origin
    assert state.home.latitude_deg == pytest.approx(47.397742)
    assert state.home.altitude_m == 488.0
    assert state.landed is Landed.LANDING
    assert not state.is_position_good
    assert state.battery == 0.73
    assert telemetry.missing() == ["no local position"]
    telemetry.take("SYS_STATUS", {"battery_remaining": -1, "onboard_control_sensors_health": 0})
    assert telemetry.state.battery is None
    assert not telemetry.state.is_armable


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


def test_late_attitude_is_dropped_and_a_reboot_is_seen():
    telemetry = posed(5.0, 5.1)
    telemetry.take("ATTITUDE", attitude(5.05))
    assert telemetry.pose.time_s == 5.1
    assert not telemetry.has_rebooted
    telemetry.take("LOCAL_POSITION_NED", position(1.0))
    telemetry.take("ATTITUDE", attitude(1.0))
    assert telemetry.has_rebooted
    assert telemetry.pose.time_s == 1.0


def test_poses_around_an_instant():
    telemetry = posed(1.0, 1.1, 1.2)
    assert [pose.time_s for pose in telemetry.poses_around(1.15)] == [1.1, 1.2]
    with pytest.raises(VehicleError, match=r"no pose is kept for vehicle time 0.50 s"):
        telemetry.poses_around(0.5)


def test_long_text_is_put_together():
    telemetry = Telemetry()
    for fields in chunks(LONG + "\t", number=7, severity=2):
        telemetry.take("STATUSTEXT", fields)
    assert telemetry.texts() == [StatusText(severity=2, text=LONG)]
    assert telemetry.texts() == []


def test_short_texts_lose_their_padding_only():
    padded = [{"severity": 6, "text": "Ready for takeoff!\t\0\0\0"}, *chunks("Armed", number=3)]
    assert say(Telemetry(), *padded) == ["Ready for takeoff!", "Armed"]


@pytest.mark.parametrize(
    ("lost", "text"),
    [(0, f"…{LONG[50:]}"), (1, f"{LONG[:50]}…")],
)
def test_a_lost_chunk_is_marked(lost, text):
    heard = chunks(LONG, number=7)
    del heard[lost]
    assert say(Telemetry(), *heard, *chunks("Landing detected", number=8)) == [
        text,
        "Landing detected",
    ]


def test_a_chunk_lost_in_the_middle_is_marked():
    first, _, last = chunks(2 * LONG[:50] + "end", number=7)
    assert say(Telemetry(), first, last) == [f"{LONG[:50]}…end"]


def test_a_text_without_its_end_waits_a_second_of_vehicle_time():
    telemetry = posed(10.0)
    assert say(telemetry, chunks(LONG, number=7)[0]) == []
    telemetry.take("LOCAL_POSITION_NED", position(10.9))
    telemetry.take("ATTITUDE", attitude(10.9))
    assert telemetry.texts() == []
    telemetry.take("ATTITUDE", attitude(11.0))
    assert [said.text for said in telemetry.texts()] == [f"{LONG[:50]}…"]


def test_a_text_that_fills_its_chunk_ends_with_px4s_tab():
    assert say(Telemetry(), *chunks(LONG[:49] + "\t", number=7)) == [LONG[:49]]
