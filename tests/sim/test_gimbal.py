"""The simulated gimbal: obeys who controls it, stays level while the body tilts, says how it is."""

from __future__ import annotations

import math

import pytest
from ground_station import GroundStation, make_mission, with_station
from in_memory import fly, fly_offboard, hover, take_off
from pymavlink.dialects.v20 import common as mavlink

from dronemon.mission.faults import parse_fault
from sim.control import TrajectorySetpoint
from sim.flight import MockFlight
from sim.gimbal import BOOT_S
from sim.modes import Px4Mode
from sim.world import World

CONFIGURE, POINT = (
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
)
ACCEPTED, DENIED, UNSUPPORTED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED,
)
LOCK = float(mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK)
DOWN = (-90.0, 0.0, math.nan, math.nan, 44.0)
WITH_GIMBAL = {"camera": {"gimbal": True}}


def _pitch_deg(message) -> float:
    w, x, y, z = message.q
    return math.degrees(math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))))


def test_a_vehicle_without_a_gimbal_has_none() -> None:
    async def story(station: GroundStation) -> None:
        assert await station.command(CONFIGURE, 245.0, 190.0) == UNSUPPORTED
        assert await station.command(POINT, *DOWN) == UNSUPPORTED
        assert station.of("GIMBAL_DEVICE_ATTITUDE_STATUS") == []

    with_station(story)


def test_it_obeys_who_controls_it_and_says_where_it_looks() -> None:
    async def story(station: GroundStation) -> None:
        first = station.last("GIMBAL_DEVICE_ATTITUDE_STATUS")
        assert (first.get_srcSystem(), first.get_srcComponent()) == (1, 154)
        assert _pitch_deg(first) == pytest.approx(0.0, abs=0.1)
        assert first.time_boot_ms / 1000.0 == pytest.approx(6.0 - BOOT_S, abs=0.3)
        assert await station.command(POINT, *DOWN) == DENIED
        assert await station.command(CONFIGURE, 245.0, 190.0, -1.0, -1.0) == ACCEPTED
        assert await station.command(POINT, 80.0, 0.0) == DENIED
        assert await station.command(POINT, *DOWN[:4], LOCK) == DENIED
        assert await station.command(POINT, *DOWN) == ACCEPTED
        await station.fly(2.0)
        assert _pitch_deg(station.last("GIMBAL_DEVICE_ATTITUDE_STATUS")) == pytest.approx(
            -90.0, abs=0.1
        )
        station.simulation.faults.add(parse_fault("askew=30"))
        await station.fly(1.0)
        assert _pitch_deg(station.last("GIMBAL_DEVICE_ATTITUDE_STATUS")) == pytest.approx(
            -60.0, abs=0.1
        )
        station.simulation.faults.add(parse_fault("gimbal+5"))
        await station.fly(0.1)
        station.heard.clear()
        await station.fly(2.0)
        assert station.of("GIMBAL_DEVICE_ATTITUDE_STATUS") == []
        await station.fly(4.0)
        assert len(station.of("GIMBAL_DEVICE_ATTITUDE_STATUS")) == pytest.approx(5, abs=2)

    with_station(story, **WITH_GIMBAL)


def test_the_camera_stays_level_while_the_body_tilts() -> None:
    mission = make_mission(**WITH_GIMBAL)
    simulation = MockFlight(mission, World(mission))
    autopilot, gimbal = simulation.autopilot, simulation.autopilot.gimbal
    assert gimbal is not None
    gimbal.is_controlled = True
    assert gimbal.point(-math.pi / 2.0, 0.0)
    fly(autopilot, 6.0)
    take_off(autopilot, 10.0)
    fly_offboard(autopilot)
    north, east, down = hover(autopilot).position
    there = TrajectorySetpoint(position=(north + 40.0, east, down), yaw_rad=1.0)
    tilts = []
    for _ in range(40):
        fly(autopilot, 0.1, there)
        roll, pitch, _ = autopilot.body.pose(0.0).attitude_rad
        tilts.append(math.hypot(roll, pitch))
        expected = (0.0, 0.0, autopilot.body.yaw)
        assert simulation.scene().pose.attitude_rad == pytest.approx(expected, abs=1e-9)
    assert max(tilts) > math.radians(10.0)
    assert autopilot.body.yaw == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("mode", [Px4Mode.RTL, Px4Mode.LAND])
def test_on_the_way_home_it_looks_ahead_and_obeys_nobody(mode: Px4Mode) -> None:
    """As PX4 v1.17 has it, of which a flight that goes on must know."""
    mission = make_mission(**WITH_GIMBAL)
    autopilot = MockFlight(mission, World(mission)).autopilot
    gimbal = autopilot.gimbal
    assert gimbal is not None
    gimbal.is_controlled = True
    assert gimbal.point(-math.pi / 2.0, 0.0)
    fly(autopilot, 6.0)
    take_off(autopilot, 10.0)
    assert gimbal.pitch_rad == pytest.approx(-math.pi / 2.0)
    assert autopilot.request_mode(mode)
    fly(autopilot, 1.5)
    assert gimbal.pitch_rad == pytest.approx(0.0)
    assert not gimbal.point(-math.pi / 2.0, 0.0)
