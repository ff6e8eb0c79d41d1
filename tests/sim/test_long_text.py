"""A long text of the simulated autopilot, over real MAVSDK and UDP."""

from __future__ import annotations

import asyncio

from ground_station import make_mission
from simulated_vehicle import free_udp_port

from dronemon.vehicle import StatusText
from dronemon.vehicle.mavsdk_link import MavsdkLink
from sim.flight import MockFlight
from sim.world import World

LONG = "RTL: start return at 30 m" + ", with words until three chunks are full" * 3


def test_a_text_of_three_chunks_arrives_as_one():
    said: list[StatusText] = []

    async def listen(mock: MockFlight, port: int) -> None:
        await mock.open_links([("127.0.0.1", port)])
        flying = asyncio.create_task(mock.run(20.0), name="mock")
        try:
            async with asyncio.timeout(30), MavsdkLink(f"udpin://127.0.0.1:{port}") as link:
                await link.wait_ready(20.0)
                mock.autopilot.say(5, LONG + "\t")
                while not any(text.severity == 5 for text in said):
                    said.extend(await link.next_texts())
        finally:
            flying.cancel()
            mock.close_links()

    mission = make_mission()
    asyncio.run(listen(MockFlight(mission, World(mission)), free_udp_port()))
    assert StatusText(severity=5, text=LONG) in said
    assert all("…" not in text.text for text in said)
