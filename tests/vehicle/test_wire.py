"""Who is heard on a link over UDP, with more on the port than one autopilot."""

from __future__ import annotations

import asyncio
import socket

import pytest
from air import Air
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import LinkLost, LinkTimeout, VehicleError, WrongVehicle
from dronemon.simulator import held_udp_port
from dronemon.vehicle import Mode
from dronemon.vehicle.mavsdk_link import MavsdkLink


async def nothing(_link):
    raise AssertionError("it is connected")


@pytest.mark.slow
def test_only_the_autopilot_is_heard_and_its_heartbeats_are_missed():
    air = Air()
    air.beats((1, 1))
    air.flies((1, 1))
    air.beats((1, 191), kind=18, is_armed=True)
    air.flies((1, 154), north_m=50.0, offset_ms=-60_000)
    air.beats((1, 154), kind=26, autopilot=8)
    air.beats((255, 190), kind=6, autopilot=8)

    async def story(link):
        for _ in range(20):
            assert (await link.next_pose()).position_ned_m == (0.0, 0.0, 0.0)
        assert not link.state.is_armed
        assert link.state.num_unreadable == 0
        assert link.heartbeat_age_s < 0.5
        del air.speakers[1, 1, "beat"]
        with pytest.raises(LinkLost, match=r"no heartbeat of .* for 1\.\d s, while other messages"):
            await link.wait_until(lambda: False, "never", 60.0)

    air.run(story, link_loss_timeout_s=1.0)


def test_an_ardupilot_is_refused_before_anything_is_asked_of_it():
    air = Air()
    air.beats((1, 1), autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    with pytest.raises(WrongVehicle, match=r"is ArduPilot \(autopilot 3\)"):
        air.run(nothing)


def test_of_two_vehicles_the_chosen_one_is_flown():
    air = Air()
    for system in (1, 2):
        air.beats((system, 1))
        air.flies((system, 1), north_m=float(system))

    async def story(link):
        assert (await link.next_pose()).position_ned_m[0] == 2.0

    air.run(story, system_id=2)


def test_two_vehicles_of_one_id_are_named():
    air = Air()
    air.beats((1, 1))
    air.flies((1, 1))
    air.flies((1, 1), north_m=9.0, offset_ms=-25_000, who="another")

    async def story(link):
        with pytest.raises(VehicleError, match="two vehicles of one system id"):
            await link.wait_until(lambda: False, "never", 60.0)

    air.run(story)


def test_a_port_that_another_program_listens_on_is_refused():
    air = Air()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("0.0.0.0", air.port))
        with pytest.raises(LinkTimeout, match="another program listens on udpin"):
            air.run(nothing)


def test_a_port_that_is_held_for_a_link_is_given_to_no_other_one():
    with held_udp_port() as port:
        air = Air()
        air.port, air.url = port, f"udpin://127.0.0.1:{port}"
        air.beats((1, 1))
        air.flies((1, 1))

        async def story(link):
            await link.next_pose()
            with pytest.raises(LinkTimeout, match="another program listens"):
                await MavsdkLink(air.url).__aenter__()
            await link.next_heartbeat()

        with pytest.raises(LinkTimeout, match="another program listens"):
            asyncio.run(MavsdkLink(air.url).__aenter__())
        air.run(story, is_port_held=True)


def test_a_heartbeat_that_stays_away_is_asked_for():
    air = Air()
    air.beats((1, 1))
    air.flies((1, 1))

    def send_once(number):
        if number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            air.beats((1, 1), Mode.OFFBOARD)

    async def story(link):
        await link.next_pose()
        del air.speakers[1, 1, "beat"]
        air.on_command = send_once
        await link.wait_until(lambda: link.state.mode is Mode.OFFBOARD, "a heartbeat", 60.0)

    air.run(story)


@pytest.mark.lengthy
def test_what_cannot_be_sent_is_given_up(monkeypatch):
    air = Air()
    air.beats((1, 1))
    air.flies((1, 1))

    async def story(link):
        await link.next_pose()
        monkeypatch.setattr(MavlinkDirectAsync, "send_message", lambda *_: asyncio.sleep(60.0))
        with pytest.raises(LinkLost, match=r"nothing can be sent to udpin.* than 2 s"):
            await link.arm()
        monkeypatch.undo()
        await link.next_heartbeat()

    air.run(story)
