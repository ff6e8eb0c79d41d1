"""The simulator as a supervised child process: started, listened to, ended with its parent.

The application meets it as it meets a drone: over MAVLink and a camera stream on loopback.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import sys
from collections.abc import AsyncIterator, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dronemon.errors import VehicleError
from dronemon.events import TruthTold
from dronemon.recorder import MISSION_FILE, SIMULATOR_LOG, TRUTH_FILE
from dronemon.runner.history import Newest
from dronemon.types import FloatArray

START_LIMIT_S = 90.0  # a large picture's lens takes seconds, on a busy machine many
STOP_LIMIT_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulator:
    """A running simulator; `ended` waits until it ends, which it should not do by itself.

    vehicle_url: where its autopilot is heard, None if it follows another one; camera_url: its
    pictures; targets_au: (N, 2) where its animals start.
    """

    vehicle_url: str | None
    camera_url: str
    targets_au: FloatArray
    process: asyncio.subprocess.Process
    log: Path

    async def ended(self) -> VehicleError:
        """Wait for its end. -> its last words"""
        await self.process.wait()
        return VehicleError(f"the simulator ended: {_last_words(self.log)}; see {self.log}")


@contextlib.asynccontextmanager
async def simulator(
    folder: Path, follow: str | None, newest: Newest | None = None
) -> AsyncIterator[Simulator]:
    """Run `python -m sim` on free loopback ports while the body runs.

    folder: of the run, with the mission; the simulator's log and truth go there
    follow: MAVLink URL of a vehicle whose pose and clock the simulated camera follows, instead of
    flying one
    newest: of a run that goes on: clock and animals go on from there
    Raises VehicleError if it does not start or ends early.
    """
    log = folder / SIMULATOR_LOG
    # -P: a `sim` that happens to lie in the current folder is not ours.
    files = [str(folder / MISSION_FILE), "--truth", str(folder / TRUTH_FILE)]
    with held_udp_port() as port, log.open("ab") as log_file:
        where = ["--follow", follow] if follow else ["--mavlink-out", f"127.0.0.1:{port}"]
        if newest is not None and newest.start_s is not None:
            where += ["--walked", f"{newest.now_s() - newest.start_s:.3f}"]
        if newest is not None and not follow:
            where += ["--clock", f"{newest.now_s():.3f}"]
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-P", "-m", "sim", *files, *where, "--parent"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=log_file,
            start_new_session=True,  # Ctrl-C is for the application: it brings the drone home first
        )
        try:
            ready = await _ready_line(process, log)
            yield Simulator(
                vehicle_url=None if follow else f"udpin://127.0.0.1:{port}",
                camera_url=ready["camera"],
                targets_au=np.array(ready["targets_au"], dtype=np.float64),
                process=process,
                log=log,
            )
        finally:
            await _stop(process)


async def _ready_line(process: asyncio.subprocess.Process, log: Path) -> dict[str, str]:
    assert process.stdout is not None
    try:
        async with asyncio.timeout(START_LIMIT_S):
            line = await process.stdout.readline()
        ready: dict[str, str] = json.loads(line)
    except TimeoutError as exc:
        raise VehicleError(
            f"the simulator did not start within {START_LIMIT_S:g} s; see {log}"
        ) from exc
    except ValueError as exc:
        raise VehicleError(f"the simulator did not start: {_last_words(log)}; see {log}") from exc
    return ready


def _last_words(log: Path) -> str:
    lines: list[str] = []
    with contextlib.suppress(OSError):
        lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "it said nothing"


async def _stop(process: asyncio.subprocess.Process) -> None:
    """End it by closing its input, then by signals."""
    assert process.stdin is not None
    process.stdin.close()
    for end in (process.terminate, process.kill):
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(STOP_LIMIT_S):
                await process.wait()
                return
        with contextlib.suppress(ProcessLookupError):
            end()
    await process.wait()


@contextlib.contextmanager
def held_udp_port() -> Iterator[int]:
    """A loopback port that nobody else is given meanwhile; a link can listen on it all the same.

    What holds it hears nobody but itself.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        holder.connect(holder.getsockname())
        # Not before it is bound: two who would share might be given the same one.
        holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        yield holder.getsockname()[1]


class Truth:
    """Where a run's simulator has its animals at each picture, read while it is written.

    told: in order, as far as it was read
    """

    def __init__(self, folder: Path) -> None:
        self.told: list[TruthTold] = []
        self._path = folder / TRUTH_FILE
        self._num_bytes = 0

    def read_on(self) -> list[TruthTold]:
        """Read what was written since the last time. -> that"""
        with contextlib.suppress(OSError), self._path.open("rb") as file:
            file.seek(self._num_bytes)
            whole, end, _ = file.read().rpartition(b"\n")
            self._num_bytes += len(whole) + len(end)
            further = list(_truth_told(whole.splitlines()))
            self.told += further
            return further
        return []


def _truth_told(lines: Iterable[bytes]) -> Iterator[TruthTold]:
    for line in lines:
        with contextlib.suppress(LookupError, TypeError, ValueError):  # it was killed meanwhile
            record = json.loads(line)
            places_au = np.array(record["targets_au"])
            yield TruthTold(time_s=record["time_s"], targets_au=places_au)


def read_truth(folder: Path) -> list[TruthTold]:
    """Where a run's simulator had its animals at each picture, in order."""
    return Truth(folder).read_on()
