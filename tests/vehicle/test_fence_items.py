"""The fence's protocol with the simulator's side of it, which loses messages, in memory."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CommandRejected, LinkLost, VehicleError
from dronemon.vehicle import fence_items
from dronemon.vehicle.fence_items import FenceItem, FenceItems, areas_of, item_of, polygon_items
from sim.mission_protocol import MissionProtocol, MissionStore

PLACE = {"x": 474_000_000, "y": 85_000_000}
CIRCLE = FenceItem(command=mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, param1=12.5, **PLACE)
POLYGON = polygon_items([(47.39, 8.49), (47.41, 8.49), (47.4, 8.5200001)])


class Vehicle:
    """The simulator's own protocol; `lost` tells which of its answers never come, by number."""

    def __init__(self, lost: range = range(0)) -> None:
        self.store = MissionStore()
        self._protocol = MissionProtocol(self.store)
        self._lost, self._num_answers = lost, 0
        self.is_deaf = False
        self.fence = FenceItems(self._send)

    async def _send(self, name: str, **fields: Any) -> None:
        message = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        sent = message(**dict.fromkeys(message.fieldnames, 0) | fields)
        mav = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        heard = mavlink.MAVLink(None).parse_char(sent.pack(mav))
        for answer in [] if self.is_deaf else self._protocol.answer(heard):
            self._num_answers += 1
            if self._num_answers - 1 not in self._lost:
                told = answer.to_dict()
                self.fence.take(told.pop("mavpackettype"), told)

    def has(self) -> list[int]:
        return [item.command for item in self.store.items[mavlink.MAV_MISSION_TYPE_FENCE]]


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fence_items, "_USUAL_RESEND_S", 0.01)
    monkeypatch.setattr(fence_items, "_RESEND_S", {})


@pytest.mark.parametrize("items", [(), POLYGON, (*POLYGON, CIRCLE)])
@pytest.mark.parametrize("lost", [range(0), range(1), range(2, 4), range(3, 12, 2)])
def test_a_fence_is_handed_over_and_read_back_though_answers_are_lost(items, lost):
    vehicle = Vehicle(lost)

    async def exchange() -> tuple[FenceItem, ...]:
        await vehicle.fence.write((CIRCLE,))
        await vehicle.fence.write(items)
        return await vehicle.fence.read()

    assert asyncio.run(exchange()) == items
    assert vehicle.has() == [item.command for item in items]


def test_a_fence_that_reads_back_otherwise_is_refused():
    vehicle = Vehicle()
    finish = vehicle._protocol._finish

    def move(message: Any, items: list[Any]) -> list[Any]:
        items[1].x += 2
        return finish(message, items)

    vehicle._protocol._finish = move
    with pytest.raises(CommandRejected, match="reads back as another of 3"):
        asyncio.run(vehicle.fence.write(POLYGON))


def test_what_is_refused_and_silence_are_told_apart():
    vehicle = Vehicle()
    with pytest.raises(CommandRejected, match="no room; PX4 holds 64"):
        asyncio.run(vehicle.fence.write((CIRCLE,) * 65))
    with pytest.raises(CommandRejected, match="refused: an error; is a ground station"):
        asyncio.run(vehicle.fence.write(polygon_items([(47.0, 8.0)] * 2)))
    vehicle.is_deaf = True
    with pytest.raises(LinkLost, match="does not answer MISSION_COUNT about its fence"):
        asyncio.run(vehicle.fence.write(POLYGON))


def test_areas_are_made_of_corners_and_circles():
    return_point = FenceItem(command=mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT, param1=0.0, **PLACE)
    polygon, circle = areas_of((*POLYGON, return_point, CIRCLE))
    assert (polygon.is_inclusion, polygon.radius_m, len(polygon.corners_deg)) == (True, None, 3)
    assert polygon.corners_deg[2] == pytest.approx((47.4, 8.5200001), abs=1e-9)
    assert (circle.is_inclusion, circle.radius_m) == (False, 12.5)
    with pytest.raises(VehicleError, match="without all its corners"):
        areas_of(POLYGON[:2])


@pytest.mark.parametrize(
    "change",
    [{"command": 16}, {"x": None}, {"x": 10**10}, {"param1": float("inf")}, {"frame": "a"}],
)
def test_nonsense_is_no_item(change):
    fields = {"command": 5001, "frame": 0, "param1": 3.0, "x": 1, "y": 2, "z": None}
    assert item_of(fields).z == 0.0
    with pytest.raises(VehicleError, match="own fence cannot be read"):
        item_of(fields | change)
