"""MAVProxy, a ground station of other people's making, drives the simulated autopilot."""

from __future__ import annotations

import contextlib
import os
import re
import select
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from simulated_vehicle import StartMockVehicle, StartProgram

from sim.parameters import TABLE

MAVPROXY = os.environ.get("DRONEMON_MAVPROXY") or shutil.which("mavproxy.py")
LIMIT_S = 20.0
WAYPOINTS = """0 0 0 16 0 0 0 0 47.397742 8.545594 488 1
1 0 3 22 0 0 0 0 47.397742 8.545594 20 1
2 0 3 16 0 0 0 0 47.398200 8.545600 25 1
"""
FENCE = """0 0 3 5001 3 0 0 0 47.396 8.543 0 1
1 0 3 5001 3 0 0 0 47.400 8.543 0 1
2 0 3 5001 3 0 0 0 47.400 8.549 0 1
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        MAVPROXY is None, reason="mavproxy.py is not installed, nor named by DRONEMON_MAVPROXY"
    ),
]


class Shell:
    """MAVProxy's command line, with what it answers."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._unread = ""

    def expect(self, pattern: str, within_s: float = LIMIT_S) -> None:
        """Read on until it says this. Raises AssertionError."""
        assert self._process.stdout is not None
        limit_s = time.monotonic() + within_s
        while (found := re.search(pattern, self._unread)) is None:
            left_s = max(limit_s - time.monotonic(), 0.0)
            readable, _, _ = select.select([self._process.stdout], [], [], left_s)
            assert readable, f"no {pattern!r} in {self._unread!r}"
            said = os.read(self._process.stdout.fileno(), 65536)
            assert said, f"it ended: {self._unread}"
            self._unread += said.decode(errors="replace")
        self._unread = self._unread[found.end() :]

    def tell(self, command: str, answer: str) -> None:
        """Enter a command, and read on until it is answered like this."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{command}\n".encode())
        self._process.stdin.flush()
        self.expect(answer)

    def look(self, command: str, answer: str) -> None:
        """Enter a command once a second until it is answered like this."""
        for _ in range(round(LIMIT_S)):
            with contextlib.suppress(AssertionError):
                self.tell(command, "")
                self.expect(answer, within_s=1.0)
                return
        raise AssertionError(f"no {answer!r} in {self._unread!r}")


@pytest.fixture
def shell(mock_vehicle: StartMockVehicle, start_program: StartProgram, tmp_path: Path) -> Shell:
    vehicle = mock_vehicle("animals", "--speed-up", "4")
    process = start_program(
        [
            *(str(MAVPROXY), "--master", vehicle.url.replace("://", ":"), "--no-state"),
            "--default-modules=param,wp,fence,mode,arm,cmdlong",
        ],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    return Shell(process)


def test_mavproxy_sets_up_and_commands_the_autopilot(shell: Shell, tmp_path: Path) -> None:
    for name, items in (("waypoints.txt", WAYPOINTS), ("fence.txt", FENCE)):
        (tmp_path / name).write_text("QGC WPL 110\n" + items.replace(" ", "\t"))
    shell.expect("online system 1")
    shell.tell("param fetch", f"Received {len(TABLE)} parameters")
    shell.tell("param set MPC_XY_CRUISE 7", "")
    shell.look("param fetch MPC_XY_CRUISE", r"MPC_XY_CRUISE\s+=\s+7\.0")
    shell.tell("wp load waypoints.txt", "ACCEPTED")
    shell.tell("wp list", r"47\.3982")
    shell.tell("fence load fence.txt", "ACCEPTED")
    shell.tell("fence list", r"47\.4")
    shell.tell("long DO_SET_MODE 1 4 5", "Mode RTL")
    shell.tell("long DO_SET_MODE 1 4 3", "Mode LOITER")
    shell.tell("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
    shell.expect("ARMED")
    shell.tell("disarm", "DISARMED")
