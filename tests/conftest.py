"""The simulated vehicle as a process, for tests of whatever flies it."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

ROOT = Path(__file__).resolve().parents[1]
START_TIMEOUT_S = 60.0
END_TIMEOUT_S = 10.0
torch.set_num_threads(1)  # a second thread is ruinous for small matrices on a busy machine


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@dataclass(frozen=True, slots=True, kw_only=True)
class MockVehicle:
    """A running `python -m sim`. `url` is where a client listens for its autopilot."""

    process: subprocess.Popen[bytes]
    url: str
    camera_url: str
    targets_au: list[list[float]]
    truth: Path

    def scenes(self) -> list[dict[str, Any]]:
        """The truth at each picture so far."""
        lines = self.truth.read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines]

    def stop(self) -> int:
        """End it as a supervisor does. -> exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(END_TIMEOUT_S)


def _first_line(process: subprocess.Popen[bytes]) -> str:
    """The line that says that all is up."""
    assert process.stdout is not None
    text, limit_s = b"", time.monotonic() + START_TIMEOUT_S
    while not text.endswith(b"\n"):
        left_s = limit_s - time.monotonic()
        readable, _, _ = select.select([process.stdout], [], [], max(left_s, 0.0))
        chunk = os.read(process.stdout.fileno(), 65536) if readable else b""
        if not chunk:
            raise AssertionError(f"the simulator did not start: {process.poll()}")
        text += chunk
    return text.decode()


StartMockVehicle = Callable[..., MockVehicle]


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
        line = json.loads(_first_line(process))
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
