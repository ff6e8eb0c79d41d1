"""What all tests share: one thread, the same examples, and the simulated vehicle as a process."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import settings
from simulated_vehicle import (
    END_TIMEOUT_S,
    ROOT,
    MockVehicle,
    StartMockVehicle,
    StartProgram,
    first_line,
    free_udp_port,
)

from dronemon.workers import num_cores

# Numba reads these once. Code for any processor of this architecture rounds alike on all of them,
# so that decisions can be compared to the last digit.
os.environ.setdefault("NUMBA_CPU_NAME", "generic")
os.environ.setdefault("NUMBA_CPU_FEATURES", "")
settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
settings.load_profile("repeatable")
torch.set_num_threads(1)  # a second thread is ruinous for small matrices on a busy machine


@pytest.fixture(autouse=True, scope="session")
def _state_folder_of_this_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The same for what flies before a test does: fixtures of a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(autouse=True)
def _own_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept for vehicles is this test's alone; its programs inherit that."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def start_program() -> Iterator[StartProgram]:
    """Starts processes as `Popen` does; what still runs when the test ends is killed."""
    with contextlib.ExitStack() as running:

        def start(command: Sequence[object], **options: Any) -> subprocess.Popen[Any]:
            process = running.enter_context(subprocess.Popen(command, **options))
            running.callback(process.kill)  # before the wait in which a Popen's context ends
            return process

        yield start


@pytest.fixture
def mock_vehicle(tmp_path: Path) -> Iterator[StartMockVehicle]:
    """Starts simulators on free ports: `mock_vehicle(mission_path, *more_arguments)`.

    Each is ended with the test. Without a mission it is the shipped `animals`.
    """
    running: list[subprocess.Popen[bytes]] = []

    def start(mission: Path | str = "animals", *arguments: str) -> MockVehicle:
        port, truth = free_udp_port(), tmp_path / f"truth-{len(running)}.jsonl"
        command = [sys.executable, "-m", "sim", str(mission), "--parent", "--truth", str(truth)]
        if "--follow" not in arguments:
            command += ["--mavlink-out", f"127.0.0.1:{port}"]
        process = subprocess.Popen(
            [*command, *arguments], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        running.append(process)
        line = json.loads(first_line(process))
        return MockVehicle(
            process=process,
            url=f"udpin://127.0.0.1:{port}",
            camera_url=line["camera"],
            targets_au=line["targets_au"],
            truth=truth,
        )

    yield start
    for process in running:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.close()  # --parent: this ends it
        try:
            assert process.wait(END_TIMEOUT_S) in (0, -signal.SIGTERM, -signal.SIGKILL)
        finally:
            process.kill()
            process.wait()
            process.stdout.close()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One more than cores: some tests wait for what other processes say."""
    return min(4, num_cores() + 1)
