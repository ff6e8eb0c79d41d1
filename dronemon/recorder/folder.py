"""The run folder as it is read: names of its files, and what they hold."""

from __future__ import annotations

import fcntl
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from dronemon.errors import RecordError
from dronemon.mission import Mission, load_mission

MISSION_FILE = "mission.yaml"
OBSERVATIONS_FILE = "observations.jsonl"
DECISIONS_FILE = "decisions.jsonl"
EVENTS_FILE = "events.jsonl"
POSES_FILE = "poses.jsonl"
RRD_FILE = "flight.rrd"
SUMMARY_FILE = "summary.json"
LINE_FILES = (OBSERVATIONS_FILE, DECISIONS_FILE, EVENTS_FILE, POSES_FILE)
RUN_FILES = (MISSION_FILE, *LINE_FILES, RRD_FILE, SUMMARY_FILE)
TRUTH_FILE, SIMULATOR_LOG = OTHER_FILES = ("truth.jsonl", "simulator.log")
"""What a simulator writes beside them."""
IN_FLIGHT = "in flight"
REWATCHED = "rewatched"
"""Of a summary, where its pictures were: it was not flown by this program."""
NEEDED_BYTES = 100_000_000
"""Free space asked for before a flight; one with 300 pictures takes less than half of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Earlier:
    """A flight of before whose pictures are looked at now.

    pictures: where they are; began: wall time of its time 0
    """

    pictures: Path
    began: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolder:
    """Reads one run folder, finished or not."""

    path: Path

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Open an existing run. Raises RecordError if `path` is not one."""
        for name in (SUMMARY_FILE, MISSION_FILE, *LINE_FILES):
            if not (path / name).is_file():
                raise RecordError(f"{path} is no run folder: it has no {name}")
        return cls(path=path)

    def is_flown(self) -> bool:
        """Whether a program flies it now."""
        with (self.path / MISSION_FILE).open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    @property
    def rrd_path(self) -> Path:
        """Where the Rerun recording is."""
        return self.path / RRD_FILE

    def recordings(self) -> list[str]:
        """Names of the recordings, one of each flight of the run."""
        first = [RRD_FILE] if self.rrd_path.exists() else []
        return first + sorted(file.name for file in self.path.glob("flight-*.rrd"))

    def new_rrd_path(self) -> Path:
        """Where the next Rerun recording goes."""
        if not self.rrd_path.exists():
            return self.rrd_path
        return self.path / f"flight-{len(self.recordings()) + 1}.rrd"

    def mission(self) -> Mission:
        """Read the mission as flown. Raises MissionFileError."""
        return load_mission(self.path / MISSION_FILE).mission

    def summary(self) -> dict[str, Any]:
        """Read the summary; its outcome is `in flight` if the program never came to the end."""
        file = self.path / SUMMARY_FILE
        try:
            return dict(json.loads(file.read_text(encoding="utf-8")))
        except (TypeError, ValueError, RecursionError) as exc:
            raise RecordError(f"{file} is damaged: {exc}") from exc

    def rewatched(self) -> str | None:
        """Where the pictures were that it was made from; None if it was flown."""
        pictures = self.summary().get(REWATCHED)
        return None if pictures is None else str(pictures)

    def observations(self) -> Iterator[dict[str, Any]]:
        """Read the measurements in order."""
        return _read_lines(self.path / OBSERVATIONS_FILE)

    def decisions(self) -> Iterator[dict[str, Any]]:
        """Read the waypoints chosen, in order."""
        return _read_lines(self.path / DECISIONS_FILE)

    def events(self) -> Iterator[dict[str, Any]]:
        """Read the events in order."""
        return _read_lines(self.path / EVENTS_FILE)

    def poses(self) -> Iterator[dict[str, Any]]:
        """Read where the vehicle was, in order."""
        return _read_lines(self.path / POSES_FILE)

    def damaged_files(self) -> list[str]:
        """List the files that are missing or not as `finish` left them.

        Rerun's own check finds a file cut short, but no flipped bytes.
        """
        files: dict[str, object] = self.summary().get("files", {})
        return [
            name
            for name, then in files.items()
            if not (self.path / name).exists() or fingerprint(self.path / name) != then
        ]


def fingerprint(path: Path) -> dict[str, object]:
    """Size and SHA-256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
    return {"bytes": path.stat().st_size, "sha256": digest.hexdigest()}


def _read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Read a file of JSON lines; a last line damaged by a crash is left out."""
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            try:
                record = json.loads(line)
            except (ValueError, RecursionError) as exc:
                if not file.read(1):
                    return
                raise RecordError(f"{path}, line {number} is damaged: {exc}") from exc
            if line.endswith(b"\n"):
                yield record
