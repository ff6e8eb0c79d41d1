"""A world that follows a vehicle it does not fly: here the mock itself, over UDP."""

from __future__ import annotations

import asyncio
import math
from typing import cast

import pytest
from ground_station import GroundStation, make_mission

from dronemon.mission.addresses import parse_udpin
from sim.camera import CameraServer
from sim.flight import MockFlight
from sim.follow import Follower
from sim.modes import Px4Mode
from sim.scene import Scene
from sim.world import World


class Shutter:
    """What a follower needs of a camera server."""

    silent = False


async def follow_a_flight(scenes: list[tuple[Scene, Scene]]) -> None:
    """Collects what is seen in truth and by the follower, from take-off on."""
    mission = make_mission(simulation={"seed": 10_004, "wind_m_s": 4.0})
    simulation = MockFlight(mission, World(mission))
    station, camera = GroundStation(simulation), Shutter()
    async with Follower(World(mission), ("127.0.0.1", 0)) as follower:
        await simulation.open_links([follower.address])
        await station.open()
        running = asyncio.create_task(follower.run(cast("CameraServer", camera)), name="follow")
        await station.fly(4.0)
        assert camera.silent
        assert not follower.is_ready
        follower.ask()
        await station.fly(5.0)
        assert follower.is_ready
        assert not camera.silent
        simulation.autopilot.parameters.set("MIS_TAKEOFF_ALT", 15.0)
        assert simulation.autopilot.arm()
        assert simulation.autopilot.request_mode(Px4Mode.TAKEOFF)
        for _ in range(6):
            await station.fly(5.0)
            scenes.append((simulation.scene(), follower.scene()))
        running.cancel()
        station.close()
        simulation.close_links()


@pytest.mark.lengthy
def test_follower_sees_what_the_vehicle_sees() -> None:
    scenes: list[tuple[Scene, Scene]] = []
    asyncio.run(follow_a_flight(scenes))
    for true, followed in scenes:
        assert -1e-9 <= true.pose.time_s - followed.pose.time_s <= 0.04
        assert math.dist(true.pose.position_ned_m, followed.pose.position_ned_m) < 1.0
        for angle in (0, 1):
            assert abs(true.pose.attitude_rad[angle] - followed.pose.attitude_rad[angle]) < 0.02
        # Home is an estimate.
        assert math.dist(true.frame.centre_ned_m, followed.frame.centre_ned_m) < 0.6
        for a, b in zip(true.animals, followed.animals, strict=True):
            assert math.dist(a.position_ned_m, b.position_ned_m) < 1.0
    assert scenes[-1][1].pose.position_ned_m[2] < scenes[0][1].pose.position_ned_m[2] - 5.0
    assert scenes[-1][1].animals[0].walked_m > 5.0


@pytest.mark.parametrize("url", ["", "127.0.0.1:1", "tcp://127.0.0.1:14550", "udpin://127.0.0.1:0"])
def test_only_udpin_can_be_followed(url: str) -> None:
    with pytest.raises(ValueError, match="udpin"):
        parse_udpin(url)
