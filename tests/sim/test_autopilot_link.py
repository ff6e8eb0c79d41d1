"""The vehicle over real UDP, message by message."""

from __future__ import annotations

import math
import struct
from collections.abc import Awaitable, Callable
from itertools import pairwise
from typing import Any

import pytest
from ground_station import GroundStation, with_station
from pymavlink.dialects.v20 import common as mavlink

from sim.flight import HOME_NED_M
from sim.modes import Px4Mode

Story = Callable[[GroundStation], Awaitable[None]]
NAN = float("nan")
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
POSITION_AND_YAW, VELOCITY_AND_YAW = 2552, 2503


def velocity_setpoint(frame: int, north: float, mask: int = VELOCITY_AND_YAW) -> Any:
    zeros = [0.0] * 3
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, *zeros, north, 0.0, 0.0, *zeros, 0.0, 0.0
    )


async def take_off(station: GroundStation, height_m: float = 10.0) -> None:
    home_m = station.simulation.autopilot.origin.altitude_m - HOME_NED_M[2]
    assert await station.command(ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    takeoff = mavlink.MAV_CMD_NAV_TAKEOFF
    result = await station.command(takeoff, NAN, NAN, NAN, NAN, NAN, NAN, home_m + height_m)
    assert result == mavlink.MAV_RESULT_ACCEPTED
    await station.fly(8.0 + height_m)


def mode(station: GroundStation) -> int:
    current: int = station.last("HEARTBEAT").custom_mode
    return current


PX4_RATES_HZ = {  # on the ground, where no setpoint is told
    "ATTITUDE": 98.0,
    **dict.fromkeys(("GLOBAL_POSITION_INT", "ATTITUDE_QUATERNION"), 49.0),
    **dict.fromkeys(("LOCAL_POSITION_NED", "ODOMETRY"), 30.0),
    **dict.fromkeys(("ALTITUDE", "VFR_HUD"), 10.0),
    "GPS_RAW_INT": 8.0,
    **dict.fromkeys(("SYS_STATUS", "EXTENDED_SYS_STATE"), 5.0),
    **dict.fromkeys(("HEARTBEAT", "MISSION_CURRENT", "ESTIMATOR_STATUS", "SYSTEM_TIME"), 1.0),
    **dict.fromkeys(("BATTERY_STATUS", "HOME_POSITION"), 0.5),
}


def test_streams_have_px4_rates_and_stamps() -> None:
    async def story(station: GroundStation) -> None:
        station.heard.clear()
        await station.fly(10.0)
        for kind, rate_hz in PX4_RATES_HZ.items():
            count = 10.0 * rate_hz
            assert abs(len(station.of(kind)) - count) <= 0.02 * count + 1, kind
        stamps = [m.time_boot_ms for m in station.of("LOCAL_POSITION_NED")]
        assert stamps == sorted(set(stamps))
        assert stamps[-1] - stamps[0] == pytest.approx(10_000, abs=50)

    with_station(story)


def test_first_heartbeat_comes_after_boot_and_ready_later() -> None:
    async def story(station: GroundStation) -> None:
        assert len(station.of("HEARTBEAT")) == 5
        ready = [
            bool(m.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
            for m in station.of("SYS_STATUS")
        ]
        assert not ready[0]
        assert ready[-1]

    with_station(story)


def test_origin_is_not_home_and_both_agree() -> None:
    async def story(station: GroundStation) -> None:
        await station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 49.0)
        await station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242.0)
        origin, home = station.last("GPS_GLOBAL_ORIGIN"), station.last("HOME_POSITION")
        assert math.hypot(home.x, home.y) > 20.0
        north_m = (home.latitude - origin.latitude) / 1e7 * 111_200.0
        assert north_m == pytest.approx(home.x, abs=0.2)
        assert (home.altitude - origin.altitude) / 1000.0 == pytest.approx(-home.z, abs=0.01)

    with_station(story)


def test_mode_change_is_acknowledged_twice() -> None:
    async def story(station: GroundStation) -> None:
        await take_off(station)
        station.heard.clear()
        await station.command(SET_MODE, 1.0, 6.0, 0.0)
        results = [m.result for m in station.of("COMMAND_ACK")]
        assert results == [
            mavlink.MAV_RESULT_ACCEPTED,
            mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
        ]
        await station.fly(1.1)
        assert mode(station) == Px4Mode.LOITER

    with_station(story)


def test_offboard_on_the_ground_is_accepted_but_arming_is_not() -> None:
    async def story(station: GroundStation) -> None:
        assert await station.command(SET_MODE, 1.0, 6.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
        assert await station.command(ARM, 1.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        await station.fly(1.1)
        assert mode(station) == Px4Mode.OFFBOARD

    with_station(story)


@pytest.mark.lengthy
@pytest.mark.parametrize(("frame", "is_flown"), [(1, True), (8, True), (7, False), (9, False)])
def test_setpoint_frames(frame: int, is_flown: bool) -> None:
    async def story(station: GroundStation) -> None:
        await take_off(station)
        for _ in range(5):
            station.send(velocity_setpoint(frame, 3.0))
            await station.fly(0.1)
        result = await station.command(SET_MODE, 1.0, 6.0, 0.0)
        assert (result == mavlink.MAV_RESULT_ACCEPTED) == is_flown
        for _ in range(40):
            station.send(velocity_setpoint(frame, 3.0))
            await station.fly(0.1)
        speed = station.last("LOCAL_POSITION_NED").vx
        assert speed == pytest.approx(3.0 if is_flown else 0.0, abs=0.4)

    with_station(story)


@pytest.mark.lengthy
def test_global_setpoint_is_relative_to_home() -> None:
    async def story(station: GroundStation) -> None:
        await take_off(station)
        north_deg, east_deg, _ = station.simulation.autopilot.map.to_geo(
            (HOME_NED_M[0] + 15.0, HOME_NED_M[1], 0.0)
        )
        setpoint = mavlink.MAVLink_set_position_target_global_int_message(
            *(0, 1, 1, 6, POSITION_AND_YAW, round(north_deg * 1e7), round(east_deg * 1e7), 14.0),
            *([0.0] * 8),
        )
        station.send(setpoint)
        await station.fly(0.1)
        await station.command(SET_MODE, 1.0, 6.0, 0.0)
        for _ in range(100):
            station.send(setpoint)
            await station.fly(0.1)
        at = station.last("LOCAL_POSITION_NED")
        assert at.x == pytest.approx(HOME_NED_M[0] + 15.0, abs=0.5)
        assert at.z == pytest.approx(HOME_NED_M[2] - 14.0, abs=0.5)

    with_station(story)


def test_setpoint_of_nothing_and_infinities_do_no_harm() -> None:
    async def story(station: GroundStation) -> None:
        await take_off(station)
        station.send(velocity_setpoint(1, 0.0, mask=0xFFF))
        station.send(velocity_setpoint(1, math.inf))
        await station.fly(0.2)
        result = await station.command(SET_MODE, 1.0, 6.0, 0.0)
        assert result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        for number in (SET_MODE, ARM, mavlink.MAV_CMD_REQUEST_MESSAGE, 510, 511, 192, 178, 179):
            await station.command(number, math.inf, NAN, -math.inf)
        await station.fly(1.0)
        assert math.isfinite(station.last("LOCAL_POSITION_NED").x)

    with_station(story)


@pytest.mark.lengthy
def test_reposition_takes_altitude_above_sea_level() -> None:
    async def story(station: GroundStation) -> None:
        await take_off(station)
        home_m = station.simulation.autopilot.origin.altitude_m - HOME_NED_M[2]
        place = station.simulation.autopilot.map.to_geo(
            (HOME_NED_M[0], HOME_NED_M[1] + 12.0, -home_m)
        )
        message = mavlink.MAVLink_command_int_message(
            *(1, 1, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_CMD_DO_REPOSITION, 0, 0),
            *(-1.0, 1.0, 0.0, NAN, round(place[0] * 1e7), round(place[1] * 1e7), home_m + 13.0),
        )
        ack = await station.ask(message, "COMMAND_ACK")
        assert ack.result == mavlink.MAV_RESULT_ACCEPTED
        await station.fly(12.0)
        at = station.last("LOCAL_POSITION_NED")
        assert at.y == pytest.approx(HOME_NED_M[1] + 12.0, abs=0.6)
        assert at.z == pytest.approx(HOME_NED_M[2] - 13.0, abs=0.6)
        assert math.degrees(station.last("ATTITUDE").yaw) == pytest.approx(90.0, abs=5.0)

    with_station(story)


def test_unknown_command_is_unsupported() -> None:
    async def story(station: GroundStation) -> None:
        assert await station.command(31010) == mavlink.MAV_RESULT_UNSUPPORTED

    with_station(story)


def test_message_rate_can_be_changed_and_switched_off() -> None:
    async def story(station: GroundStation) -> None:
        set_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        assert await station.command(set_interval, 30.0, 1e6 / 10.0) == 0
        assert await station.command(set_interval, 32.0, -1.0) == 0
        station.heard.clear()
        await station.fly(5.0)
        assert len(station.of("ATTITUDE")) == pytest.approx(50, abs=2)
        assert not station.of("LOCAL_POSITION_NED")
        assert await station.command(set_interval, 32.0, 0.0) == 0
        await station.fly(1.0)
        assert len(station.of("LOCAL_POSITION_NED")) == pytest.approx(30, abs=3)

    with_station(story)


def test_parameters_come_by_name_by_index_and_as_a_paced_list() -> None:
    async def story(station: GroundStation) -> None:
        read = mavlink.MAVLink_param_request_read_message
        value = await station.ask(read(1, 1, b"MIS_TAKEOFF_ALT", -1), "PARAM_VALUE")
        assert value.param_value == 2.5
        same = await station.ask(read(1, 1, b"", value.param_index), "PARAM_VALUE")
        assert same.param_id == "MIS_TAKEOFF_ALT"
        station.heard.clear()
        station.send(mavlink.MAVLink_param_request_list_message(1, 1))
        await station.settle()
        await station.fly(0.2)
        assert 0 < len(station.of("PARAM_VALUE")) < value.param_count
        await station.fly(1.0)
        indices = [m.param_index for m in station.of("PARAM_VALUE")]
        assert indices == list(range(value.param_count))

    with_station(story)


def test_integer_parameter_travels_as_its_bytes() -> None:
    async def story(station: GroundStation) -> None:
        as_float = struct.unpack("<f", struct.pack("<i", 3))[0]
        message = mavlink.MAVLink_param_set_message(1, 1, b"COM_LOW_BAT_ACT", as_float, 6)
        value = await station.ask(message, "PARAM_VALUE")
        assert value.param_type == 6
        assert struct.unpack("<i", struct.pack("<f", value.param_value))[0] == 3
        assert station.simulation.autopilot.parameters["COM_LOW_BAT_ACT"] == 3
        wrong_type = mavlink.MAVLink_param_set_message(1, 1, b"COM_LOW_BAT_ACT", 1.0, 9)
        await station.ask(wrong_type, "PARAM_VALUE")
        assert station.simulation.autopilot.parameters["COM_LOW_BAT_ACT"] == 3

    with_station(story)


@pytest.mark.parametrize("mission_type", [0, 1])
def test_plan_is_uploaded_read_back_and_cleared(mission_type: int) -> None:
    def item(seq: int) -> Any:
        return mavlink.MAVLink_mission_item_int_message(
            1,
            1,
            seq,
            6,
            16,
            0,
            1,
            0.0,
            2.0,
            0.0,
            NAN,
            473977420 + seq,
            85455940,
            10.0,
            mission_type,
        )

    async def story(station: GroundStation) -> None:
        count = mavlink.MAVLink_mission_count_message(1, 1, 2, mission_type)
        for _ in range(2):  # a client that hears no answer begins again
            assert (await station.ask(count, "MISSION_REQUEST_INT")).seq == 0
        for _ in range(2):  # or repeats an item
            assert (await station.ask(item(0), "MISSION_REQUEST_INT")).seq == 1
        for _ in range(2):
            assert (await station.ask(item(1), "MISSION_ACK")).type == 0
        wanted = mavlink.MAVLink_mission_request_list_message(1, 1, mission_type)
        assert (await station.ask(wanted, "MISSION_COUNT")).count == 2
        get = mavlink.MAVLink_mission_request_int_message(1, 1, 1, mission_type)
        assert (await station.ask(get, "MISSION_ITEM_INT")).x == 473977421
        clear = mavlink.MAVLink_mission_clear_all_message(1, 1, mission_type)
        assert (await station.ask(clear, "MISSION_ACK")).type == 0
        assert (await station.ask(wanted, "MISSION_COUNT")).count == 0

    with_station(story)


def test_file_transfer_is_refused_at_once() -> None:
    async def story(station: GroundStation) -> None:
        list_directory = [7, 0, 0, 3, 1, 0, 0, 0, 0, 0, 0, 0, ord("/")]
        payload = list_directory + [0] * (251 - len(list_directory))
        message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload)
        reply = bytes((await station.ask(message, "FILE_TRANSFER_PROTOCOL")).payload)
        assert reply[0] == 8
        assert (reply[3], reply[5]) == (129, 3)

    with_station(story)


def test_ping_and_timesync_are_answered() -> None:
    async def story(station: GroundStation) -> None:
        ping = await station.ask(mavlink.MAVLink_ping_message(123, 4, 0, 0), "PING")
        assert (ping.time_usec, ping.seq, ping.target_system) == (123, 4, 245)
        sync = await station.ask(mavlink.MAVLink_timesync_message(0, 99), "TIMESYNC")
        assert sync.ts1 == 99
        assert sync.tc1 > 6e9

    with_station(story)


def test_texts_need_a_ground_station() -> None:
    async def story(station: GroundStation) -> None:
        await station.command(ARM, 0.0)
        await station.command(ARM, 1.0)
        assert not station.of("STATUSTEXT")
        for _ in range(12):  # one that is silent for long on the wall clock is gone
            station.send_heartbeat()
            await station.fly(1.0)
        assert station.last("STATUSTEXT").text.startswith("Disarmed by auto")

    with_station(story)


def test_message_for_another_vehicle_is_ignored() -> None:
    async def story(station: GroundStation) -> None:
        other = mavlink.MAVLink_command_long_message(2, 1, ARM, 0, 1.0, *[NAN] * 6)
        station.send(other)
        await station.settle()
        await station.fly(1.1)
        assert not station.of("COMMAND_ACK")
        assert not station.simulation.autopilot.commander.is_armed

    with_station(story)


def test_second_link_also_streams_and_commands() -> None:
    async def story(station: GroundStation) -> None:
        second = GroundStation(station.simulation)
        await second.open()
        await second.fly(1.5)
        assert second.of("HEARTBEAT")
        assert await second.command(ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
        second.close()

    with_station(story)


def test_garbage_is_ignored() -> None:
    async def story(station: GroundStation) -> None:
        packet = velocity_setpoint(1, 3.0).pack(mavlink.MAVLink(None, 245, 190))
        for junk in (b"", b"\xfd", bytes(300), packet[:-1] + b"\x00", packet[5:]):
            station.send_bytes(junk)
        await station.settle()
        assert await station.command(ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED

    with_station(story)


@pytest.mark.lengthy
def test_faults_begin_and_end_after_arming() -> None:
    async def story(station: GroundStation) -> None:
        await station.fly(20.0)  # before arming no fault is due
        await take_off(station)
        station.heard.clear()
        await station.fly(4.0)  # silence from 20 s, the take-off took 18 s
        silent_s = [
            (after.time_boot_ms - before.time_boot_ms) / 1000.0
            for before, after in pairwise(station.heard)
            if before.get_type() == after.get_type() == "ATTITUDE"
        ]
        assert not silent_s or max(silent_s) < 0.1
        await station.fly(6.0)
        stamps = [m.time_boot_ms for m in station.of("ATTITUDE")]
        gaps = [b - a for a, b in pairwise(stamps)]
        assert max(gaps) == pytest.approx(3000, abs=60)
        assert await station.command(ARM, 0.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        await station.fly(2.0)
        assert mode(station) == Px4Mode.POSCTL

    faults = ("silence@22+3", "reject@26", "pilot@28")
    with_station(story, *faults)


def test_deaf_vehicle_obeys_nobody() -> None:
    async def story(station: GroundStation) -> None:
        await station.command(ARM, 1.0)
        await station.fly(1.0)
        with pytest.raises(AssertionError, match="no COMMAND_ACK"):
            await station.command(ARM, 0.0)
        await station.fly(3.0)
        assert await station.command(ARM, 0.0) == mavlink.MAV_RESULT_ACCEPTED

    with_station(story, "deaf@0.5+3")


@pytest.mark.lengthy
def test_reboot_in_the_air_is_seen_on_the_link() -> None:
    async def story(station: GroundStation) -> None:
        await take_off(station)
        station.heard.clear()
        await station.fly(10.0)
        stamps = [m.time_boot_ms for m in station.of("ATTITUDE")]
        restart = next(b for a, b in pairwise(stamps) if b < a)
        assert restart == pytest.approx(1600, abs=30)
        beat = station.last("HEARTBEAT")
        assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        assert station.last("EXTENDED_SYS_STATE").landed_state == 1

    with_station(story, "reboot@20")
