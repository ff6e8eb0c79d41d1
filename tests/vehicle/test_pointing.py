"""A gimbal on a link over UDP: whose words count, and what it takes to believe that it looks down.

The vehicle's autopilot manages it; it speaks for itself.
"""

from __future__ import annotations

import math

import pytest
from air import Air
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CommandRejected, CommandUnconfirmed, ControlTaken
from dronemon.frames import attitude_of, camera_to_ned
from sim.streams import quaternion

CONFIGURE, POINT = (
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
)
FLAGS = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME


class GimbalAir(Air):
    """One vehicle, and gimbals that look ahead until told."""

    def __init__(self):
        super().__init__()
        self.beats((1, 1))
        self.flies((1, 1))
        self.pitch_deg, self.told_deg = 0.0, -90.0
        self.on_command = self.obey

    def obey(self, number):
        if number == POINT and self.results.get(POINT, 0) == 0:
            self.pitch_deg = self.told_deg

    def looks(self, sender, yaw_deg=0.0):
        self.speakers[*sender, "device"] = lambda: (
            mavlink.MAVLink_gimbal_device_attitude_status_message(
                *(0, 0, self.time_ms - 60_000, FLAGS),
                quaternion(0.0, math.radians(self.pitch_deg), math.radians(yaw_deg)),
                *(math.nan, math.nan, math.nan, 0),
            )
        )

    def looks_as_of_old(self, sender, yaw_deg):
        self.speakers[*sender, "mount"] = lambda: mavlink.MAVLink_mount_orientation_message(
            self.time_ms, 0.0, self.pitch_deg, math.nan, yaw_deg
        )

    def told_commands(self):
        return [m for m in self.told if m.get_type() == "COMMAND_LONG" and m.command > 999]


@pytest.mark.parametrize("is_old", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_it_is_taken_pointed_and_seen_to_look_down(is_old):
    """Others speak as well: another system's gimbal, and what is no gimbal."""
    air = GimbalAir()
    air.looks((2, 154), yaw_deg=10.0)
    air.looks((1, 191), yaw_deg=20.0)
    if is_old:
        air.looks_as_of_old((1, 1), yaw_deg=30.0)
    else:
        air.looks((1, 172), yaw_deg=30.0)

    async def story(link):
        await link.next_pose()
        await link.point_down()
        configure, point = air.told_commands()[:2]
        assert (configure.command, point.command) == (CONFIGURE, POINT)
        assert (configure.param1, configure.param2) == (245, 190)
        assert (point.param1, point.param2) == (-90.0, 0.0)
        for attitude in await link.gimbal_around(link.time_s):
            roll, pitch, yaw = attitude_of(camera_to_ned(attitude, heading_rad=1.0))
            assert (roll, pitch) == pytest.approx((0.0, 0.0), abs=1e-3)
            assert math.degrees(yaw) == pytest.approx(30.0, abs=0.01)
        assert link.state.num_unreadable == 0

    air.run(story, system_id=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("results", "told_deg", "error", "words"),
    [
        ({CONFIGURE: 2}, -90.0, CommandRejected, r"taking control: asked 3 times \(denied\)"),
        ({POINT: 3}, -90.0, CommandRejected, r"looking down: asked 3 times \(not supported\)"),
        ({}, -60.0, CommandUnconfirmed, "told to look down, and looks 30 degrees off"),
    ],
)
def test_a_gimbal_that_does_not_obey_is_told(results, told_deg, error, words):
    air = GimbalAir()
    air.looks((1, 154))
    air.results, air.told_deg = results, told_deg

    async def story(link):
        await link.next_pose()
        with pytest.raises(error, match=words):
            await link.point_down()

    air.run(story, command_timeout_s=3.0)


@pytest.mark.slow
def test_a_gimbal_that_looked_down_and_fell_silent_is_not_believed():
    air = GimbalAir()
    air.pitch_deg = -90.0
    air.looks((1, 154))

    async def story(link):
        await link.next_pose()
        await link.point_down()
        del air.speakers[1, 154, "device"]
        await link.wait_until(lambda at_s=link.time_s: link.time_s > at_s + 2.0, "a pause", 10.0)
        with pytest.raises(CommandUnconfirmed, match="no attitude of a gimbal is heard"):
            await link.point_down()

    air.run(story, command_timeout_s=3.0)


@pytest.mark.slow
def test_nothing_more_is_commanded_once_somebody_arms_the_vehicle():
    air = GimbalAir()
    air.looks((1, 154))
    air.told_deg = 0.0  # it looks ahead, so that it would be asked again
    sent = []

    def arms(number):
        sent.append(number)
        if number == POINT:
            air.beats((1, 1), is_armed=True)

    air.on_command = arms

    async def story(link):
        await link.next_pose()
        with pytest.raises(ControlTaken, match="armed meanwhile"):
            await link.point_down()
        assert link.state.is_armed

    air.run(story, command_timeout_s=6.0)
    assert sent.count(POINT) == 1
