"""Any datagrams from the autopilot, over UDP: the vehicle's state stays readable, nothing ends."""

from __future__ import annotations

import asyncio
import math

import pytest
from air import Air
from datagrams import datagrams
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.errors import VehicleError
from dronemon.vehicle import Mode
from dronemon.vehicle.telemetry import Telemetry

BATCH = 40
MEANT = (*Telemetry().messages, "COMMAND_ACK", "PING", "PARAM_VALUE")


@pytest.mark.timeout(250)
@pytest.mark.parametrize("num_batches", [10, pytest.param(250, marks=pytest.mark.slow)])
def test_any_datagrams_leave_the_link_whole(num_batches, capfd):
    air = Air()
    air.beats((1, 1), Mode.HOLD)
    air.flies((1, 1))

    async def look(link):
        await link._wire.round_trip()  # all that was sent before has been heard
        pose = link.pose
        numbers = (*pose.position_ned_m, *pose.velocity_ned_m_s, *pose.attitude_rad)
        assert all(math.isfinite(number) for number in numbers)
        assert link.state.describe()

    async def listen(link):
        while True:
            assert all(said.text.isprintable() for said in await link.next_texts())

    # Drawn beforehand: Hypothesis sets Python's recursion limit, and in CPython 3.11 that breaks
    # threads of C that are just being born to call back, as the link's are.
    batches = []

    @settings(max_examples=num_batches, database=None)
    @given(st.lists(datagrams(MEANT, (1, 1)), min_size=BATCH, max_size=BATCH))
    def draw(batch):
        batches.append(batch)

    draw()

    async def story(link):
        listening = asyncio.create_task(listen(link))
        await link.next_pose()
        for batch in batches:
            for datagram in batch:
                air.throws(datagram)
            try:
                await asyncio.wait_for(look(link), 10.0)
            except Exception as exc:
                exc.add_note(f"after {batch}")
                raise
        assert link.state.num_unreadable > num_batches
        num_calm = 0
        while num_calm < 3:
            try:
                await link.next_pose()
                num_calm += 1
            except VehicleError as said:  # rightly: nonsense of its own id, stamped beside its own
                if "two vehicles of one system id are heard" not in str(said):
                    raise
                num_calm = 0
        await link.wait_until(lambda: link.state.mode is Mode.HOLD, "it holds as it did", 30.0)
        await link.hold()
        assert not listening.done()
        listening.cancel()

    air.run(story, limit_s=240.0)
    assert capfd.readouterr() == ("", ""), "what a vehicle says reaches no terminal by itself"
