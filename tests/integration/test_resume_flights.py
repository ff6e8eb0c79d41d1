"""Flights whose program is killed, alone or with its camera, and then goes on; over the wire."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from pymavlink import mavutil
from simulated_vehicle import StartMockVehicle, StartProgram, free_udp_port, judge_pictures

from dronemon.recorder import RunFolder

MISSION = """
name: killed
area: {side_m: 120}
flight: {altitude_m: 30, cruise_speed_m_s: 5, horizon_au: 1.5, start_au: [0.5, 0.5]}
targets:
  - {name: Bella, appearance: cow, prior_au: simulated}
  - {name: Zuri, appearance: zebra, prior_au: simulated}
planner: {kind: lawnmower}
view: {live: false}
"""
MOMENTS = {"take-off": ("armed", 2.0), "patrol": ("patrol", 8.0), "return": ("homecoming", 3.0)}
"""The event after which it is killed, and how long after it in vehicle time."""
SAFE_WITHIN_S = 2.0
OFFBOARD = 6
SPEED_UP = 1.0
LIMIT_S = 200.0
ROOT = Path(__file__).parents[2]


class Observer:
    """Hears a vehicle's mode, motors and clock, and says nothing."""

    def __init__(self) -> None:
        self.port = free_udp_port()
        self.time_s = 0.0
        self.modes: list[tuple[float, int]] = []
        self.is_armed = False
        self._is_over = False
        self._thread = threading.Thread(target=self._hear, daemon=True)
        self._link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{self.port}")
        self._thread.start()

    def close(self) -> None:
        self._is_over = True
        self._thread.join()
        self._link.close()

    def _hear(self) -> None:
        while not self._is_over:
            message = self._link.recv_match(blocking=True, timeout=0.2)
            match message and message.get_type():
                case "ATTITUDE":
                    self.time_s = message.time_boot_ms / 1e3
                case "HEARTBEAT":
                    self.is_armed = bool(message.base_mode & 128)
                    self.modes.append((self.time_s, message.custom_mode >> 16 & 0xFF))


@pytest.fixture
def observer() -> Iterator[Observer]:
    heard = Observer()
    yield heard
    heard.close()


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def has_event(run: Path, kind: str) -> bool:
    events = run / "events.jsonl"
    return events.exists() and f'"kind":"{kind}"' in events.read_text()


@pytest.mark.slow
@pytest.mark.timeout(500)
@pytest.mark.parametrize(
    ("moment", "is_power_cut", "is_from_the_ground"),
    [
        ("patrol", False, False),
        ("return", False, False),
        ("patrol", True, True),
        ("take-off", True, False),  # PX4 hovers: no failsafe ends that but the battery's
    ],
)
def test_a_killed_flight_is_safe_at_once_and_goes_on(
    mock_vehicle: StartMockVehicle,
    start_program: StartProgram,
    observer: Observer,
    tmp_path: Path,
    moment: str,
    is_power_cut: bool,
    is_from_the_ground: bool,
):
    mission, run, port = tmp_path / "killed.yaml", tmp_path / "run", free_udp_port()
    mission.write_text(MISSION)
    streams = [part for p in (port, observer.port) for part in ("--mavlink-out", f"127.0.0.1:{p}")]
    vehicle = mock_vehicle(mission, "--speed-up", f"{SPEED_UP:g}", *streams)
    where = ("--vehicle", vehicle.url, "--follow", f"udpin://127.0.0.1:{port}")
    program = [sys.executable, "-m", "dronemon.cli", "fly"]
    flying = start_program(
        [*program, str(mission), *where, "--out", str(run)], cwd=ROOT, stdout=subprocess.DEVNULL
    )
    kind, after_s = MOMENTS[moment]
    wait_until(lambda: has_event(run, kind) or flying.poll() is not None)
    begun_s = observer.time_s
    wait_until(lambda: observer.time_s >= begun_s + after_s)
    camera = psutil.Process(flying.pid).children() if is_power_cut else []
    for process in (*camera, flying):
        process.kill()
    killed_s = observer.time_s
    assert flying.wait() == -9
    before = list(RunFolder.open(run).observations())

    wait_until(lambda: observer.modes[-1][0] >= killed_s + SAFE_WITHIN_S)
    assert [mode for _, mode in observer.modes if mode != OFFBOARD][-1] == observer.modes[-1][1]
    if is_from_the_ground:
        wait_until(lambda: not observer.is_armed)
    done = subprocess.run(
        [*program, "--resume", str(run), *where],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert not observer.is_armed
    folder = RunFolder.open(run)
    summary, after = folder.summary(), list(folder.observations())
    assert (summary["outcome"], summary["is_landed"]) == ("completed", True), said
    assert after[: len(before)] == before
    judge_pictures(summary, after, due=15)
    assert folder.damaged_files() == []
    kinds = [event["kind"] for event in folder.events()]
    assert is_from_the_ground or "attached" in kinds, said
