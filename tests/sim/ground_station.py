"""A bare MAVLink client for tests, and the missions they fly."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.mission import Mission
from dronemon.mission.faults import parse_fault
from sim.flight import MockFlight
from sim.world import World


def make_mission(**sections: Any) -> Mission:
    targets = [
        {"name": "Bella", "appearance": "cow"},
        {"name": "Rusty", "appearance": "fox"},
    ]
    return Mission.model_validate({"targets": targets, "simulation": {"seed": 10_001}, **sections})


class GroundStation(asyncio.DatagramProtocol):
    """A bare MAVLink client; it moves the simulation itself, so nothing waits on a wall clock."""

    def __init__(self, simulation: MockFlight) -> None:
        self.simulation = simulation
        self.heard: list[Any] = []
        self._mav = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        self._vehicle: tuple[str, int] | None = None

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: self, local_addr=("127.0.0.1", 0)
        )
        await self.simulation.open_links([self._transport.get_extra_info("sockname")])

    def close(self) -> None:
        self._transport.close()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._vehicle = addr
        self.heard += self._mav.parse_buffer(data) or []

    async def fly(self, seconds: float) -> None:
        steps = round(seconds * 100)
        for step in range(1, steps + 1):
            self.simulation.step()
            if step % 10 == 0 or step == steps:
                self.simulation.flush()
                await self.settle()

    async def fly_until(self, is_done: Callable[[], bool], limit_s: float) -> None:
        for _ in range(round(limit_s * 10)):
            if is_done():
                return
            await self.fly(0.1)
        raise AssertionError(f"not within {limit_s} s of vehicle time")

    async def settle(self) -> None:
        """Let datagrams that are under way arrive, in both directions: loopback is at once."""
        for _ in range(6):
            await asyncio.sleep(0)

    def send(self, message: Any) -> None:
        self.send_bytes(message.pack(self._mav))

    def send_bytes(self, data: bytes) -> None:
        assert self._vehicle is not None, "nothing heard from the vehicle yet"
        self._transport.sendto(data, self._vehicle)

    def send_heartbeat(self) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def of(self, kind: str) -> list[Any]:
        return [m for m in self.heard if m.get_type() == kind]

    def last(self, kind: str) -> Any:
        return self.of(kind)[-1]

    async def ask(self, message: Any, kind: str) -> Any:
        """The next message of a kind after sending one."""
        count = len(self.of(kind))
        self.send(message)
        for _ in range(50):
            await self.settle()
            await self.fly(0.02)
            if len(self.of(kind)) > count:
                return self.of(kind)[count]
        raise AssertionError(f"no {kind} came back")

    async def command(self, number: int, *params: float) -> int:
        """Send COMMAND_LONG. -> result of its last acknowledgement."""
        padded = [*params, *[float("nan")] * (7 - len(params))]
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)
        await self.ask(message, "COMMAND_ACK")
        await self.fly(0.03)
        acks = [m for m in self.of("COMMAND_ACK") if m.command == number]
        result: int = acks[-1].result
        return result


def with_station(
    story: Callable[[GroundStation], Awaitable[None]], *faults: str, **sections: Any
) -> None:
    """Tell a story to a vehicle that has just booted, in a mission of these sections."""
    mission = make_mission(**sections)

    async def tell() -> None:
        parsed = tuple(parse_fault(text) for text in faults)
        station = GroundStation(MockFlight(mission, World(mission), parsed))
        await station.open()
        try:
            await station.fly(6.0)
            await story(station)
        finally:
            station.close()
            station.simulation.close_links()

    asyncio.run(tell())
