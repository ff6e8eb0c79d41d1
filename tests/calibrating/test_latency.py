"""`dronemon calibrate latency` measures what a camera's stamps lack, and commands nothing."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from dronemon.calibrating import latency
from dronemon.calibrating.latency import latency_command
from dronemon.errors import OptionError
from dronemon.types import ImageArray, Picture, Pose

MISSION = """
area: {side_m: 100}
camera: {width_px: 320, height_px: 240, url: "rtsp://127.0.0.1/eye", latency_s: 0.05}
targets: [{name: Ann, appearance: cow}]
vehicle: {url: "udpin://127.0.0.1:14540"}
flight: {altitude_m: 25}
detector: {needed_px_per_m: 1}
"""
LATENCY_S, STEP_S = 0.24, 0.02
GROUND = np.random.default_rng(10_000).integers(0, 255, (60, 60, 3), dtype=np.uint8)


def yaw_rad(time_s: float) -> float:
    return 0.5 * math.sin(2.9 * time_s) + 0.2 * math.sin(1.1 * time_s)


class TurnedVehicle:
    """What a link hears of a vehicle that somebody turns; nothing of it can be commanded."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self._moved = asyncio.Condition()

    async def next_pose(self) -> Pose:
        async with self._moved:
            await self._moved.wait()
            still = (0.0, 0.0, 0.0)
            return Pose(
                time_s=self.time_s,
                position_ned_m=still,
                velocity_ned_m_s=still,
                attitude_rad=(0.0, 0.0, yaw_rad(self.time_s)),
            )

    async def move(self) -> None:
        async with self._moved:
            self.time_s += STEP_S
            self._moved.notify_all()
        await asyncio.sleep(0)


class LateCamera:
    """Ten pictures a second, of the ground as it lay some time ago."""

    def __init__(self, vehicle: TurnedVehicle) -> None:
        self._vehicle = vehicle

    async def capture(self) -> Picture:
        for _ in range(5):
            await self._vehicle.move()
        arrived_s = self._vehicle.time_s
        return Picture(time_s=arrived_s - 0.05, image=ground(yaw_rad(arrived_s - LATENCY_S)))


def ground(turned_rad: float) -> ImageArray:
    large = cv2.resize(GROUND, (600, 600), interpolation=cv2.INTER_CUBIC)
    turn = cv2.getRotationMatrix2D((300.0, 300.0), math.degrees(turned_rad), 1.0)
    return np.asarray(cv2.warpAffine(large, turn, (600, 600))[180:420, 140:460], np.uint8)


def test_what_is_printed_is_what_the_mission_is_to_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is the whole age, whatever the mission said of it before."""

    @asynccontextmanager
    async def watching(_: Any) -> AsyncIterator[tuple[TurnedVehicle, LateCamera]]:
        vehicle = TurnedVehicle()
        yield vehicle, LateCamera(vehicle)

    monkeypatch.setattr(latency, "watching", watching)
    (tmp_path / "mission.yaml").write_text(MISSION)
    latency_command(str(tmp_path / "mission.yaml"), None, 12.0)
    said = yaml.safe_load(capsys.readouterr().out.strip().splitlines()[-1])
    assert said["camera"]["latency_s"] == pytest.approx(LATENCY_S, abs=0.01)


def test_what_is_simulated_is_not_measured() -> None:
    with pytest.raises(OptionError, match="a camera of your own on a vehicle of your own"):
        latency_command("animals")
    with pytest.raises(OptionError, match="name the mission"):
        latency_command()
