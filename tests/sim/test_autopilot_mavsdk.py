"""The simulator as a process, flown by the real MAVSDK at 20 times real time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import socket
import struct
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw, VelocityNedYaw
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from pymavlink.dialects.v20 import common as mavlink
from simulated_vehicle import StartMockVehicle, free_udp_port

from sim.modes import Px4Mode

SPEED_UP = 20.0
OFFBOARD, LOITER, RTL = Px4Mode.OFFBOARD, Px4Mode.LOITER, Px4Mode.RTL
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


class Pilot:
    """Keeps the newest telemetry, and waits for it to show what was asked for."""

    def __init__(self, system: Any) -> None:
        self.telemetry = TelemetryAsync(system)
        self.action = ActionAsync(system)
        self.offboard = OffboardAsync(system)
        self.direct = MavlinkDirectAsync(system)
        self.newest: dict[str, dict[str, Any]] = {}

    async def listen(self, kind: str) -> None:
        async for message in self.direct.subscribe_message(kind):
            self.newest[kind] = json.loads(message.fields_json)

    async def until(self, is_done: Callable[[], bool], limit_s: float) -> None:
        async with asyncio.timeout(limit_s):
            while not is_done():  # noqa: ASYNC110 (the telemetry is MAVSDK's)
                await asyncio.sleep(0.01)

    @property
    def time_s(self) -> float:
        return float(self.newest["LOCAL_POSITION_NED"]["time_boot_ms"]) / 1000.0

    @property
    def place(self) -> tuple[float, float, float]:
        p = self.newest["LOCAL_POSITION_NED"]
        return p["x"], p["y"], p["z"]

    @property
    def mode(self) -> int:
        return int(self.newest["HEARTBEAT"]["custom_mode"])

    @property
    def is_armed(self) -> bool:
        return bool(self.newest["HEARTBEAT"]["base_mode"] & ARMED)

    async def follow_carrot(self, legs: list[tuple[float, float]], down_m: float) -> list[float]:
        """Fly legs of (heading, length) at 5 m/s with a moving setpoint. -> speed on each."""
        north, east, _ = self.place
        speeds = []
        for heading, length_m in legs:
            along = math.cos(heading), math.sin(heading)
            begun_s, done_m, last_s = self.time_s, 0.0, self.time_s
            while done_m < length_m:
                await asyncio.sleep(0.002)
                now_s = self.time_s
                flown = (self.place[0] - north) * along[0] + (self.place[1] - east) * along[1]
                ahead_m = done_m - flown
                speed = 5.0 * min(1.0, max(0.0, 1.0 - (ahead_m - 5.0) / 6.0))
                done_m, last_s = min(length_m, done_m + speed * (now_s - last_s)), now_s
                await self.offboard.set_position_velocity_ned(
                    PositionNedYaw(north + done_m * along[0], east + done_m * along[1], down_m, 0),
                    VelocityNedYaw(speed * along[0], speed * along[1], 0.0, 0.0),
                )
            speeds.append(length_m / (self.time_s - begun_s))
            north, east = north + length_m * along[0], east + length_m * along[1]
        return speeds


@contextlib.asynccontextmanager
async def connected(url: str) -> AsyncIterator[Pilot]:
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=10)
        assert system is not None
        pilot = Pilot(system)
        kinds = ("LOCAL_POSITION_NED", "HEARTBEAT", "EXTENDED_SYS_STATE")
        listeners = [asyncio.create_task(pilot.listen(kind), name=kind) for kind in kinds]
        try:
            yield pilot
        finally:
            for listener in listeners:
                listener.cancel()
            await asyncio.gather(*listeners, return_exceptions=True)


async def fly(url: str) -> None:
    async with connected(url) as pilot:
        async with asyncio.timeout(20.0):
            async for is_ok in pilot.telemetry.subscribe_health_all_ok():
                if is_ok:
                    break
        await pilot.action.set_takeoff_altitude(15.0)
        await pilot.action.arm()
        home = pilot.place
        await pilot.action.takeoff()
        await pilot.until(lambda: pilot.mode == LOITER and home[2] - pilot.place[2] > 14.0, 10.0)

        await pilot.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await pilot.offboard.start()
        legs = [(0.0, 20.0), (math.radians(100.0), 15.0), (math.radians(30.0), 20.0)]
        speeds = await pilot.follow_carrot(legs, home[2] - 15.0)
        assert min(speeds) > 4.2
        await pilot.until(lambda: pilot.mode == OFFBOARD, 5.0)

        await pilot.action.return_to_launch()
        await pilot.until(lambda: pilot.mode == RTL, 5.0)
        await pilot.until(lambda: not pilot.is_armed, 20.0)
        assert pilot.newest["EXTENDED_SYS_STATE"]["landed_state"] == 1
        assert math.dist(home[:2], pilot.place[:2]) < 1.5


@pytest.mark.slow
def test_mavsdk_flies_a_whole_mission_and_a_second_world_follows(
    mock_vehicle: StartMockVehicle,
) -> None:
    port = free_udp_port()
    follower = mock_vehicle("animals", "--follow", f"udpin://127.0.0.1:{port}")
    vehicle = mock_vehicle(
        "animals", "--speed-up", str(SPEED_UP), "--mavlink-out", f"127.0.0.1:{port}"
    )
    assert follower.targets_au == vehicle.targets_au
    asyncio.run(fly(vehicle.url))
    for one in (vehicle, follower):
        assert take_picture(one.camera_url).startswith(b"\xff\xd8\xff")
    (true,), (followed,) = vehicle.scenes(), follower.scenes()
    assert true["agent_au"] == pytest.approx([0.5, 0.5], abs=0.01)
    assert followed["agent_au"] == pytest.approx([0.5, 0.5], abs=0.01)
    for here, there in zip(true["targets_au"], followed["targets_au"], strict=True):
        assert here == pytest.approx(there, abs=0.02)
    assert vehicle.stop() == 0


def take_picture(camera_url: str) -> bytes:
    """-> JPEG."""
    host, port = camera_url.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=10.0) as connection:
        connection.sendall(b"SHOT")
        answer = connection.makefile("rb")
        _, _, size = struct.unpack("!4sdI", answer.read(16))
        return answer.read(size)
