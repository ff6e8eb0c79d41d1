"""Commands to an autopilot that refuses, is silent, or does something else."""

from __future__ import annotations

import pytest
from air import Air
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CommandRejected, CommandUnconfirmed, ControlTaken
from dronemon.vehicle import Landed, Mode, Setpoint, mavsdk_link

HERE = Setpoint(position_ned_m=(0.0, 0.0, 0.0), velocity_ned_m_s=(0.0, 0.0, 0.0), yaw_rad=0.0)
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
TAKE_OFF = mavlink.MAV_CMD_NAV_TAKEOFF
LAND = mavlink.MAV_CMD_NAV_LAND
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
VEHICLE = (1, 1)


def flying(mode=Mode.HOLD, **fields):
    air = Air()
    air.beats(VEHICLE, mode, is_armed=True, **fields)
    air.flies(VEHICLE)
    origin = mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488000)
    air.speakers[*VEHICLE, "origin"] = lambda: origin
    return air


def test_a_refusal_says_what_the_autopilot_says():
    air = Air()
    air.beats(VEHICLE)
    air.flies(VEHICLE)
    air.results[ARM] = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    reason = "Arming denied: GPS fix too low"
    air.on_command = lambda number: air.says(reason) if number == ARM else None

    async def story(link):
        await link.next_pose()
        with pytest.raises(CommandRejected) as caught:
            await link.arm()
        assert str(caught.value) == (
            "arming: asked 3 times without effect (refused for now); telemetry says mode 'hold', "
            f"disarmed, unknown, arming checks not passed; the autopilot says: {reason}"
        )
        assert [said.text for said in await link.next_texts()] == [reason]

    air.run(story, command_timeout_s=3.0)


def test_a_pilot_who_takes_it_while_it_is_armed_is_left_alone():
    air = Air()
    air.beats(VEHICLE)
    air.flies(VEHICLE)
    taken = {ARM: lambda: air.beats(VEHICLE, Mode.POSITION, is_armed=True)}
    air.on_command = lambda number: taken.get(number, lambda: None)()

    async def story(link):
        await link.next_pose()
        with pytest.raises(ControlTaken, match="the pilot chose mode 'position'"):
            await link.arm()

    air.run(story)


@pytest.mark.slow
def test_a_command_that_is_not_answered_is_sent_again():
    air = flying()
    heard = []

    def obey_the_third(number):
        heard.append(number)
        if heard.count(SET_MODE) == 3:
            air.beats(VEHICLE, Mode.RETURN, is_armed=True)

    air.on_command = obey_the_third
    air.results[SET_MODE] = None

    async def story(link):
        await link.next_pose()
        await link.return_home()
        assert link.state.mode is Mode.RETURN

    air.run(story)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("result", "error"),
    [
        (mavlink.MAV_RESULT_ACCEPTED, ControlTaken),
        (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, CommandRejected),
    ],
)
def test_a_landing_that_a_pilots_sticks_ended_between_two_heartbeats_is_not_repeated(result, error):
    air = flying(Mode.ALTITUDE, status=mavlink.MAV_STATE_CRITICAL)
    air.results[LAND] = result

    async def story(link):
        await link.next_pose()
        await link.next_heartbeat()
        with pytest.raises(error):
            await link.land()
        assert air.commands().count(LAND) == (1 if error is ControlTaken else 3)

    air.run(story, command_timeout_s=3.0)


def test_after_a_pause_no_setpoint_is_sent_before_the_mode_is_known(monkeypatch):
    monkeypatch.setattr(mavsdk_link, "_SETPOINT_GAP_S", 0.0)  # what lies between two is a pause
    air = flying()

    async def story(link):
        await link.next_pose()
        await link.hold()
        await link.send_setpoint(HERE)
        air.beats(VEHICLE, Mode.RETURN, is_armed=True, status=mavlink.MAV_STATE_CRITICAL)
        with pytest.raises(ControlTaken, match="a failsafe of the autopilot chose mode 'return'"):
            await link.send_setpoint(HERE)
        assert air.num_told("SET_POSITION_TARGET_LOCAL_NED") == 1

    air.run(story)


def test_motors_that_stop_end_the_take_off_at_once_and_leave_it_in_hold():
    air = flying()
    reason = "Disarmed by auto preflight disarming"

    def stop(number):
        if number == TAKE_OFF:
            air.beats(VEHICLE, Mode.TAKEOFF)
            air.says(reason)
        elif number == SET_MODE:
            air.beats(VEHICLE, Mode.HOLD)

    air.on_command = stop

    async def story(link):
        await link.next_pose()
        await link.wait_until(lambda: link.state.origin is not None, "origin", 5.0)
        began_s = link.time_s
        with pytest.raises(CommandRejected, match=rf"the motors stopped .* says: {reason}"):
            await link.take_off(45.0)
        assert link.time_s - began_s < 5.0
        assert link.state.mode is Mode.HOLD

    air.run(story)


def test_what_a_pilot_has_armed_and_flies_is_not_sent_up():
    air = flying(Mode.POSITION)
    air.speakers[*VEHICLE, "landed"] = lambda: mavlink.MAVLink_extended_sys_state_message(0, 2)

    async def story(link):
        await link.next_pose()
        await link.wait_until(lambda: link.state.landed is Landed.IN_AIR, "landed", 5.0)
        with pytest.raises(ControlTaken, match="the pilot flies"):
            await link.take_off(35.0)
        assert TAKE_OFF not in air.commands()

    air.run(story)


@pytest.mark.lengthy
def test_nothing_that_a_late_copy_of_our_request_needs_is_sent_while_others_fly():
    air = flying()

    def obey(number):
        if number == SET_MODE:
            air.beats(VEHICLE, Mode.OFFBOARD, is_armed=True)

    air.on_command = obey

    async def story(link):
        await link.next_pose()
        await link.start_offboard(HERE)
        link.release()
        await link.next_pose()
        before, asked_s = air.num_told("SET_POSITION_TARGET_LOCAL_NED"), link.time_s
        while link.time_s < asked_s + 9.0:
            await link.send_setpoint(HERE)
            await link.next_pose()
        assert air.num_told("SET_POSITION_TARGET_LOCAL_NED") == before
        while link.time_s < asked_s + 11.0:
            await link.send_setpoint(HERE)
            await link.next_pose()
        assert air.num_told("SET_POSITION_TARGET_LOCAL_NED") > before

    air.run(story)


@pytest.mark.slow
def test_a_vehicle_that_does_not_climb_is_an_error():
    air = flying()

    def complete(number):
        if number == TAKE_OFF:
            air.beats(VEHICLE, Mode.TAKEOFF, is_armed=True)
            air.says("Already higher than takeoff altitude")

    air.on_command, air.step_ms = complete, 400
    reason = "does not climb: 0.0 m of 45 m .* says: Already higher than takeoff altitude"

    async def story(link):
        await link.next_pose()
        await link.wait_until(lambda: link.state.origin is not None, "origin", 5.0)
        with pytest.raises(CommandUnconfirmed, match=reason):
            await link.take_off(45.0)
        told = [message for message in air.told if message.get_type() == "COMMAND_LONG"]
        assert next(m.param7 for m in told if m.command == TAKE_OFF) == 533.0
        assert air.num_told("PARAM_SET") == 0

    air.run(story)
