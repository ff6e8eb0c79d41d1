from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from ground_station import FAULTLESS, GroundStation, make_mission

from dronemon.mission import Mission
from sim.faults import Fault
from sim.simulation import Simulation
from sim.world import World


@pytest.fixture
def mission() -> Mission:
    return make_mission()


@pytest.fixture
def with_station(mission: Mission) -> Callable[..., None]:
    """Runs `story(station)` with a vehicle that has just booted; faults may be given."""

    def run(
        story: Callable[[GroundStation], Awaitable[None]], faults: tuple[Fault, ...] = FAULTLESS
    ) -> None:
        async def tell() -> None:
            station = GroundStation(Simulation(mission, World(mission), faults))
            await station.open()
            try:
                await station.fly(6.0)
                await story(station)
            finally:
                station.close()
                station.simulation.close_links()

        asyncio.run(tell())

    return run
