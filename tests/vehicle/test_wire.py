"""The link over UDP, with more on the port than one autopilot."""

from __future__ import annotations

import asyncio
import contextlib
import socket

import pytest
from pymavlink.dialects.v20 import common as mavlink
from simulated_vehicle import free_udp_port

from dronemon.errors import LinkLost, LinkTimeout, WrongVehicle
from dronemon.vehicle.mavsdk_link import MavsdkLink

PX4 = mavlink.MAV_AUTOPILOT_PX4
PERIOD_S = 0.05


class Air:
    """Whatever speaks on one port, as (system, component) and a message, again and again."""

    def __init__(self) -> None:
        self.port = free_udp_port()
        self.url = f"udpin://127.0.0.1:{self.port}"
        self.time_ms = 100_000
        self.speakers = {}
        self._packers = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def beats(self, sender, kind=2, autopilot=PX4, armed=0):
        self.speakers[(*sender, "beat")] = lambda: mavlink.MAVLink_heartbeat_message(
            kind, autopilot, armed, 4 << 16 | 3 << 24, 3, 3
        )

    def flies(self, sender, north_m=0.0, offset_ms=0, roll=0.0):
        self.speakers[(*sender, "turn")] = lambda: mavlink.MAVLink_attitude_message(
            self.time_ms + offset_ms, roll, 0, 0, 0, 0, 0
        )
        self.speakers[(*sender, "place")] = lambda: mavlink.MAVLink_local_position_ned_message(
            self.time_ms + offset_ms, north_m, 0, 0, 0, 0, 0
        )

    @contextlib.asynccontextmanager
    async def __call__(self):
        async def speak():
            while True:
                self.time_ms += round(PERIOD_S * 1000)
                for (system, component, _), message in self.speakers.items():
                    new = mavlink.MAVLink(None, system, component)
                    packer = self._packers.setdefault((system, component), new)
                    self._socket.sendto(message().pack(packer), ("127.0.0.1", self.port))
                    packer.seq = (packer.seq + 1) % 256
                await asyncio.sleep(PERIOD_S)

        task = asyncio.create_task(speak())
        try:
            yield
        finally:
            task.cancel()
            self._socket.close()


def run(air, story, **options):
    async def tell():
        async with air(), MavsdkLink(air.url, **options) as link:
            await story(link)

    asyncio.run(asyncio.wait_for(tell(), 20.0))


async def nothing(_link):
    raise AssertionError("it is connected")


def test_only_the_autopilot_is_heard_and_its_heartbeats_are_missed():
    air = Air()
    air.beats((1, 1))
    air.flies((1, 1))
    air.beats((1, 191), kind=18, armed=128)
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

    run(air, story, link_loss_timeout_s=1.0)


def test_an_ardupilot_is_refused_before_anything_is_asked_of_it():
    air = Air()
    air.beats((1, 1), autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    with pytest.raises(WrongVehicle, match=r"is ArduPilot \(autopilot 3\)"):
        run(air, nothing)


def test_the_second_of_two_vehicles_is_flown_where_it_is_chosen():
    air = Air()
    air.beats((1, 1))
    air.beats((2, 1))
    air.flies((1, 1), north_m=1.0)
    air.flies((2, 1), north_m=2.0)

    async def story(link):
        assert (await link.next_pose()).position_ned_m[0] == 2.0

    run(air, story, system_id=2)


def test_a_port_that_another_program_listens_on_is_refused():
    air = Air()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("0.0.0.0", air.port))
        with pytest.raises(LinkTimeout, match="another program listens on udpin"):
            run(air, nothing)
