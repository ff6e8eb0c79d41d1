"""Processes of a test, and the simulated vehicle as one, for tests of whatever flies it."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
START_TIMEOUT_S = 60.0
END_TIMEOUT_S = 10.0


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

    def begin_fault(self, text: str) -> None:
        """Have something go wrong now, such as `gps+10`."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{text}\n".encode())
        self.process.stdin.flush()

    def stop(self) -> int:
        """End it as a supervisor does. -> exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(END_TIMEOUT_S)


def first_line(process: subprocess.Popen[bytes]) -> str:
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


def judge_pictures(summary: dict[str, Any], observations: Sequence[object], due: int) -> None:
    """All pictures were due, and those taken were recorded: nearly all of them.

    Many times faster than real time a pause of a busy machine misses one, or in a long flight some.
    """
    assert summary["pictures_due"] == due
    assert len(observations) == summary["pictures"] >= 0.97 * due - 1


StartMockVehicle = Callable[..., MockVehicle]
StartProgram = Callable[..., subprocess.Popen[Any]]
