"""The run folder: what a flight leaves behind, append-only, readable whenever the program stops.

    mission.yaml         the mission as flown
    observations.jsonl   one line per measurement
    decisions.jsonl      one line per waypoint chosen
    events.jsonl         one line per event: armed, mode changes, warnings, failures
    flight.rrd           pictures, beliefs and time series for the Rerun viewer (written by `viz`);
                         flight-2.rrd and so on: after a resume
    summary.json         `"outcome": "in flight"` from the start, replaced as a whole at the end

Each line is one write and one fsync (0.2 ms median on a solid-state disk, half a second on one that
is busy), each in a thread of its own: no setpoint waits for the disk, and no write for an fsync. A
line that cannot be written whole is taken back. While a program flies a run it holds a lock on
mission.yaml.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import itertools
import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from dronemon.clock import machine_time
from dronemon.durable import LineWriter, replace_text, write_new
from dronemon.errors import RecordError
from dronemon.events import Decided, Event, Measured, Noted
from dronemon.json_values import json_line, json_text
from dronemon.mission import Mission
from dronemon.mission.scalars import Dumper

MISSION_FILE = "mission.yaml"
OBSERVATIONS_FILE = "observations.jsonl"
DECISIONS_FILE = "decisions.jsonl"
EVENTS_FILE = "events.jsonl"
RRD_FILE = "flight.rrd"
SUMMARY_FILE = "summary.json"
LINE_FILES = (OBSERVATIONS_FILE, DECISIONS_FILE, EVENTS_FILE)
RUN_FILES = (MISSION_FILE, *LINE_FILES, RRD_FILE, SUMMARY_FILE)
TRUTH_FILE, SIMULATOR_LOG = OTHER_FILES = ("truth.jsonl", "simulator.log")
"""What a simulator writes beside them."""
IN_FLIGHT = "in flight"
NEEDED_BYTES = 100_000_000
"""Free space asked for before a flight; one with 300 pictures takes less than half of it."""


class RunRecorder:
    """Writes one run folder.

    The next event after a line that could not be written raises, which makes the caller bring the
    drone home; `lost_lines` counts them.
    """

    def __init__(
        self,
        folder: RunFolder,
        names: Sequence[str],
        *,
        is_new: bool = False,
        before: Mapping[str, Any] | None = None,
    ) -> None:
        """is_new: whether the folder was made for it; before: summary of a run that goes on."""
        self.folder = folder
        self._is_new, self._before = is_new, before
        self._names = tuple(names)
        self._head: dict[str, object] = {"started": _stamp("seconds"), "targets": self._names}
        if before is not None:
            resumed = [*before.get("resumed", ()), _stamp("seconds")]
            self._head |= {
                "started": before.get("started"),
                "resumed": resumed,
                "events_before": sum(1 for _ in folder.events()),
            }
        self._lock = (folder.path / MISSION_FILE).open("rb")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as exc:
            self._lock.close()
            raise RecordError(f"{folder.path} is being flown by another program") from exc
        self._lines = LineWriter(folder.path / name for name in LINE_FILES)

    @classmethod
    def create(
        cls,
        mission: Mission,
        *,
        root: Path = Path("runs"),
        out: Path | None = None,
        needed_bytes: int = NEEDED_BYTES,
    ) -> RunRecorder:
        """Make a run folder: `out`, or a new one named by time and mission under `root`.

        Raises RecordError: `out` holds a run already, the folder cannot be written, or its disk has
        less than `needed_bytes` free.
        """
        is_new = out is None or not out.exists()
        try:
            path = _new_folder(root, mission.name) if out is None else _chosen_folder(out)
            _check_space(path, needed_bytes)
            write_new(path / MISSION_FILE, _as_flown(mission))
            names = [target.name for target in mission.targets]
            recorder = cls(RunFolder(path=path), names, is_new=is_new)
            recorder._write_summary({"outcome": IN_FLIGHT})
        except OSError as exc:
            raise RecordError(
                f"cannot make the run folder {exc.filename or out or root}: {exc.strerror};"
                " choose another one with --out"
            ) from exc
        return recorder

    @classmethod
    def resume(cls, folder: RunFolder, mission: Mission) -> RunRecorder:
        """Go on with a run that has ended, or whose program has. Raises RecordError."""
        before = folder.summary()
        names = [target.name for target in mission.targets]
        try:
            _check_space(folder.path, NEEDED_BYTES)
            recorder = cls(folder, names, before=before)
            recorder._write_summary({"outcome": IN_FLIGHT})
        except OSError as exc:
            raise RecordError(
                f"cannot write {exc.filename or folder.path}: {exc.strerror}"
            ) from exc
        return recorder

    def __enter__(self) -> RunRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def take(self, event: Event) -> None:
        """Record what the folder has a line for. Raises RecordError if a line before was lost."""
        match event:
            case Measured():
                self._append(OBSERVATIONS_FILE, self._observation(event))
            case Decided():
                self._append(DECISIONS_FILE, asdict(event))
            case Noted():
                boot, up_s = machine_time()
                said: dict[str, object] = {"time_s": event.time_s, "wall": _stamp("milliseconds")}
                said |= {"boot": boot, "up_s": round(up_s, 3)}
                said |= {"kind": event.kind, "text": event.text, **event.fields}
                self._append(EVENTS_FILE, said)
        with self._naming_the_disk():
            self._lines.check()

    def _observation(self, event: Measured) -> dict[str, object]:
        measurement = event.measurement
        return {
            "time_s": event.time_s,
            "time_au": measurement.time_au,
            "agent_au": measurement.agent_au,
            "battery": event.battery,
            "battery_needed": event.battery_needed,
            "stretch": asdict(event.stretch),
            "targets": {
                name: {"seen": seen, "position_au": position if seen else None, "score": confidence}
                for name, seen, position, confidence in zip(
                    self._names, measurement.seen, measurement.target_au, event.score, strict=True
                )
            },
        }

    @property
    def lost_lines(self) -> int:
        """Number of lines that could not be written."""
        return self._lines.num_lost

    @property
    def is_empty(self) -> bool:
        """Whether there was nothing to record."""
        return not self._lines.num_lines

    def flush(self) -> None:
        """Wait until all lines so far are on disk. Raises RecordError if one is not."""
        with self._naming_the_disk():
            self._lines.flush()

    def discard(self) -> None:
        """Remove a run in which nothing happened; the folder too if it was made for it alone.

        The summary of one that was to go on is as it was.
        """
        if self._before is not None:
            replace_text(self.folder.path / SUMMARY_FILE, json_text(self._before))
        self.close()
        if self._before is not None:
            return
        for file in self.folder.path.iterdir():
            if file.name in RUN_FILES + OTHER_FILES:
                file.unlink()
        if self._is_new:
            with contextlib.suppress(OSError):  # something else is in it
                self.folder.path.rmdir()

    def finish(self, outcome: str, summary: Mapping[str, object]) -> None:
        """Write the final summary, with size and SHA-256 of every file; close flight.rrd first.

        Raises RecordError if it cannot be written; the summary from the start then stays.
        """
        with contextlib.suppress(RecordError):  # counted in the summary
            self.flush()
        try:
            files = {
                name: _fingerprint(self.folder.path / name)
                for name in (*RUN_FILES, *self.folder.more_recordings())
                if name != SUMMARY_FILE and (self.folder.path / name).exists()
            }
            head = {"outcome": outcome, "ended": _stamp("seconds")}
            tail = {"lost_lines": self.lost_lines, "files": files}
            self._write_summary({**head, **summary, **tail})
        except OSError as exc:
            raise RecordError(
                f"cannot write {self.folder.path / SUMMARY_FILE}: {exc.strerror};"
                " the lines recorded in flight are beside it"
            ) from exc

    def close(self) -> None:
        """Close all files; the folder stays as it is."""
        self._lines.close()
        self._lock.close()

    def _append(self, name: str, record: Mapping[str, object]) -> None:
        self._lines.add(self.folder.path / name, json_line(record))

    @contextlib.contextmanager
    def _naming_the_disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as exc:
            where = exc.filename or self.folder.path
            raise RecordError(
                f"cannot write {where}: {exc.strerror}; free space on its disk"
            ) from exc

    def _write_summary(self, summary: Mapping[str, object]) -> None:
        replace_text(self.folder.path / SUMMARY_FILE, json_text({**self._head, **summary}))


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

    def more_recordings(self) -> list[str]:
        """Names of the recordings after each resume."""
        return sorted(file.name for file in self.path.glob("flight-*.rrd"))

    def new_rrd_path(self) -> Path:
        """Where the next Rerun recording goes."""
        if not self.rrd_path.exists():
            return self.rrd_path
        return self.path / f"flight-{len(self.more_recordings()) + 2}.rrd"

    def mission_text(self) -> str:
        """Read the mission as flown."""
        return (self.path / MISSION_FILE).read_bytes().decode()

    def summary(self) -> dict[str, Any]:
        """Read the summary; its outcome is `in flight` if the program never came to the end."""
        file = self.path / SUMMARY_FILE
        try:
            return dict(json.loads(file.read_text(encoding="utf-8")))
        except (TypeError, ValueError) as exc:
            raise RecordError(f"{file} is damaged: {exc}") from exc

    def observations(self) -> Iterator[dict[str, Any]]:
        """Read the measurements in order."""
        return _read_lines(self.path / OBSERVATIONS_FILE)

    def decisions(self) -> Iterator[dict[str, Any]]:
        """Read the waypoints chosen, in order."""
        return _read_lines(self.path / DECISIONS_FILE)

    def events(self) -> Iterator[dict[str, Any]]:
        """Read the events in order."""
        return _read_lines(self.path / EVENTS_FILE)

    def damaged_files(self) -> list[str]:
        """List the files that are missing or not as `finish` left them.

        Rerun's own check finds a file cut short, but no flipped bytes.
        """
        files: dict[str, object] = self.summary().get("files", {})
        return [
            name
            for name, fingerprint in files.items()
            if not (self.path / name).exists() or _fingerprint(self.path / name) != fingerprint
        ]


def _as_flown(mission: Mission) -> str:
    """The mission with every default and override, as a file that can be flown again."""
    data = mission.model_dump(mode="json", exclude_none=True)
    text: str = yaml.dump(data, Dumper=Dumper, sort_keys=False, allow_unicode=True)
    return text


def _now() -> datetime:
    """Wall time, for names and stamps only; a mission's time is the vehicle's."""
    return datetime.now(UTC).astimezone()


def _stamp(precision: str) -> str:
    return _now().isoformat(timespec=precision)


def _new_folder(root: Path, mission_name: str) -> Path:
    slug = re.sub(r"[^A-Za-z0-9]+", "-", mission_name).strip("-").lower()[:40] or "mission"
    stem = f"{_now():%Y%m%d-%H%M%S}-{slug}"
    root.mkdir(parents=True, exist_ok=True)
    for number in itertools.count(1):
        path = root / (stem if number == 1 else f"{stem}-{number}")
        with contextlib.suppress(FileExistsError):
            path.mkdir()
            break
    return path


def _chosen_folder(out: Path) -> Path:
    out.mkdir(parents=True, exist_ok=True)
    found = [name for name in RUN_FILES if (out / name).exists()]
    if found:
        raise RecordError(
            f"{out} already holds a run ({', '.join(found)});"
            " choose another folder with --out, or move that run away"
        )
    return out


def _check_space(path: Path, needed_bytes: int) -> None:
    free_bytes = shutil.disk_usage(path).free
    if free_bytes < needed_bytes:
        raise RecordError(
            f"{free_bytes / 1e6:.0f} MB are free at {path}, a flight needs"
            f" {needed_bytes / 1e6:.0f} MB; free some space or choose another disk with --out"
        )


def _fingerprint(path: Path) -> dict[str, object]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
    return {"bytes": path.stat().st_size, "sha256": digest.hexdigest()}


def _read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Read a file of JSON lines; a last line damaged by a crash is left out."""
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            try:
                record = json.loads(line)
            except ValueError as exc:
                if not file.read(1):
                    return
                raise RecordError(f"{path}, line {number} is damaged: {exc}") from exc
            if line.endswith(b"\n"):
                yield record
