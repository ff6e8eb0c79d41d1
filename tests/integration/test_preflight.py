"""`dronemon preflight` and what it asks, over the wire: of the mock, and of a PX4 if one is named.

DRONEMON_PX4 is a command line that runs what follows it beside a fresh PX4, which streams to
127.0.0.1:14540 and :14550.
"""

from __future__ import annotations

import asyncio
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import pytest
import wrong_setups
from simulated_vehicle import MockVehicle, StartMockVehicle, free_udp_port

from dronemon.vehicle.changes import state_folder
from dronemon.vehicle.fence_items import FenceItem, are_alike, polygon_items
from dronemon.vehicle.mavsdk_link import MavsdkLink

T = TypeVar("T")
PX4 = shlex.split(os.environ.get("DRONEMON_PX4", ""))
PX4_URL, PX4_FOLLOW = "udpin://127.0.0.1:14540", "udpin://127.0.0.1:14550"
PROGRAM = [sys.executable, "-m", "dronemon.cli"]
ROOT = Path(__file__).parents[2]
beside_a_px4 = pytest.mark.skipif(not PX4, reason="no PX4 is named by DRONEMON_PX4")


@pytest.mark.slow
def test_each_wrong_set_up_is_refused_with_what_mends_it(mock_vehicle: StartMockVehicle):
    vehicle = mock_vehicle("animals", "--speed-up", "4")
    assert asyncio.run(wrong_setups.refused(vehicle.url)) == []


@pytest.mark.slow
@pytest.mark.timeout(300)
@beside_a_px4
def test_a_real_px4_is_refused_alike():
    command = [*PX4, sys.executable, wrong_setups.__file__, PX4_URL]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr


def _say(*command: str) -> tuple[int, str]:
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=250, stdin=subprocess.DEVNULL
    )
    return done.returncode, done.stdout + done.stderr


def _told(vehicle: MockVehicle, ask: Callable[[MavsdkLink], Awaitable[T]]) -> T:
    async def tell() -> T:
        async with MavsdkLink(vehicle.url) as link:
            await link.wait_ready(60.0)
            return await ask(link)

    return asyncio.run(tell())


def _parameter(vehicle: MockVehicle, name: str) -> float:
    return _told(vehicle, lambda link: link.read_parameters([name]))[name]


async def _lay_own_fence(link: MavsdkLink) -> tuple[FenceItem, ...]:
    """A circle that one must stay in, and a triangle a long way off that one must not enter."""
    home = link.state.home
    assert home is not None
    corners = [(0.008, 0.0), (0.009, 0.0), (0.008, 0.001)]
    places = [(home.latitude_deg + a, home.longitude_deg + b) for a, b in corners]
    exclusion = [replace(item, command=5002) for item in polygon_items(places)]
    (centre,) = polygon_items([(home.latitude_deg, home.longitude_deg)])
    fence = (*exclusion, replace(centre, command=5003, param1=600.0))
    await link.write_fence(fence)
    return fence


async def _wait_until_landed(link: MavsdkLink) -> None:
    """By its own failsafe: nobody flies it."""
    await link.wait_until(lambda: not link.state.is_armed, "disarming", 300.0)


@pytest.fixture
def followed(mock_vehicle: StartMockVehicle):
    """A vehicle that is no child of the program, and the options to meet it."""
    port = free_udp_port()
    vehicle = mock_vehicle("animals", "--speed-up", "10", "--mavlink-out", f"127.0.0.1:{port}")
    options = ("--vehicle", vehicle.url, "--follow", f"udpin://127.0.0.1:{port}")
    return vehicle, (*options, "--planner", "tsp")


@pytest.mark.slow
def test_go_and_no_go_and_what_is_set_is_put_back(followed):
    vehicle, options = followed
    code, output = _say(*PROGRAM, "preflight", *options)
    assert code == 0, output
    assert output.splitlines()[-1].startswith("GO")
    code, output = _say(*PROGRAM, "preflight", *options, "--set", "GF_ACTION=4")
    assert code == 2
    assert "nobody to ask; add --yes" in output
    code, output = _say(*PROGRAM, "preflight", *options, "--set", "GF_ACTION=4", "--yes")
    assert code == 3, output
    assert "no-go: fence crossed (GF_ACTION=4): at a fence it stops the motors" in output
    assert "--set GF_ACTION=3" in output
    assert "GF_ACTION is 2 again" in output
    assert _parameter(vehicle, "GF_ACTION") == 2.0


@pytest.mark.slow
def test_what_was_set_for_a_flight_that_was_killed_is_put_back_at_the_next_start(
    followed, tmp_path: Path
):
    vehicle, options = followed
    own = _told(vehicle, _lay_own_fence)
    out = tmp_path / "run"
    command = [*PROGRAM, "fly", *options, "--out", str(out), "--set", "GF_ACTION=3", "--yes"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL) as program:
        deadline = time.monotonic() + 60.0
        while '"patrol"' not in _text(out / "events.jsonl"):
            assert program.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        program.send_signal(signal.SIGKILL)
    assert len(list(state_folder().glob("*.json"))) == 2
    _told(vehicle, _wait_until_landed)
    code, output = _say(*PROGRAM, "preflight", *options)
    assert code == 0, output
    assert "GF_ACTION is 2 again, as before it was changed for us" in output
    assert "its own fence is back: 4 corners and circles" in output
    assert list(state_folder().iterdir()) == []
    assert _parameter(vehicle, "GF_ACTION") == 2.0
    assert are_alike(_told(vehicle, MavsdkLink.read_fence), own)


def _text(path: Path) -> str:
    return path.read_text() if path.exists() else ""


@pytest.mark.slow
@pytest.mark.timeout(300)
@beside_a_px4
def test_a_real_px4_is_go_and_flies_with_a_parameter_that_is_put_back(tmp_path: Path):
    options = ("--vehicle", PX4_URL, "--follow", PX4_FOLLOW, "--planner", "tsp")
    settings = ("--set", "GF_ACTION=3", "--yes")
    flight = ("fly", *options, *settings, "--horizon-au", "0.2", "--out", str(tmp_path / "run"))
    both = " && ".join(
        shlex.join([*PROGRAM, *words]) for words in (("preflight", *options), flight)
    )
    code, output = _say(*PX4, "bash", "-c", both)
    assert code == 0, output
    assert "GO, with 2 warnings" in output
    assert "GF_ACTION is 2 again" in output
