"""The run folder: what a flight leaves behind, append-only, readable whenever the program stops.

    mission.yaml         the mission as flown
    observations.jsonl   one line per measurement
    decisions.jsonl      one line per waypoint chosen
    events.jsonl         one line per event: armed, mode changes, warnings, failures
    poses.jsonl          one line per second: where the vehicle was
    flight.rrd           pictures, beliefs and time series for the Rerun viewer (written by `viz`);
                         flight-2.rrd and so on: after a resume
    summary.json         `"outcome": "in flight"` from the start, replaced as a whole at the end

Lines have the vehicle's time and the wall clock's, and once the area is laid a place on the globe:
the vehicle's, of an observation also those of the targets seen, of a decision the waypoint's.

Each line is one write and one fsync (0.2 ms median on a solid-state disk, half a second on one that
is busy), each in a thread of its own: no setpoint waits for the disk, and no write for an fsync. A
line that cannot be written whole is taken back. While a program flies a run it holds a lock on
mission.yaml.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import yaml

from dronemon.clock import machine_time
from dronemon.durable import LineWriter, replace_text, write_new
from dronemon.errors import RecordError
from dronemon.events import AreaLaid, Decided, Event, Measured, Moved, Noted
from dronemon.frames import GeoPoint, ned_to_geo
from dronemon.json_values import json_line, json_text
from dronemon.mission import Mission
from dronemon.mission.scalars import Dumper
from dronemon.recorder.folder import (
    DECISIONS_FILE,
    EVENTS_FILE,
    IN_FLIGHT,
    LINE_FILES,
    MISSION_FILE,
    NEEDED_BYTES,
    OBSERVATIONS_FILE,
    OTHER_FILES,
    POSES_FILE,
    REWATCHED,
    RUN_FILES,
    SUMMARY_FILE,
    Earlier,
    RunFolder,
    fingerprint,
)
from dronemon.types import FloatArray, Pose
from dronemon.version import code_version

POSE_INTERVAL_S = 1.0
"""Vehicle time between two lines that say where it was."""


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
        earlier: Earlier | None = None,
    ) -> None:
        """is_new: whether the folder was made for it; before: summary of a run that goes on.

        earlier: what is looked at, where nothing is flown: its wall time counts
        """
        self.folder = folder
        self._is_new, self._before, self._earlier = is_new, before, earlier
        self._laid: AreaLaid | None = None
        self._pose: Pose | None = None
        self._posed_s = -math.inf
        self._names = tuple(names)
        self._head: dict[str, object] = {
            "started": self._stamp(0.0, "seconds"),
            "code": code_version(),
            "targets": self._names,
        }
        if earlier is not None:
            self._head[REWATCHED] = str(earlier.pictures.absolute())
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
        earlier: Earlier | None = None,
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
            recorder = cls(RunFolder(path=path), names, is_new=is_new, earlier=earlier)
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
            case AreaLaid():
                self._laid = event
            case Moved():
                self._move(event.pose)
            case Measured():
                self._append(OBSERVATIONS_FILE, self._observation(event))
            case Decided():
                said = asdict(event) | {"wall": self._wall(event.time_s)}
                self._append(DECISIONS_FILE, said | self._ground(event.waypoint_au))
            case Noted():
                self._append(EVENTS_FILE, self._event(event))
        with self._naming_the_disk():
            self._lines.check()

    def _move(self, pose: Pose) -> None:
        """Remember where the vehicle is, and say so now and then."""
        self._pose = pose
        if self._laid is None or 0.0 <= pose.time_s - self._posed_s < POSE_INTERVAL_S:
            return
        self._posed_s = pose.time_s
        said = asdict(pose) | {"wall": self._stamp(pose.time_s)}
        self._append(POSES_FILE, said | self._place(pose.position_ned_m))

    def _observation(self, event: Measured) -> dict[str, object]:
        measurement, names = event.measurement, self._names
        said = {
            "number": event.number,
            "time_s": event.time_s,
            "wall": self._wall(event.time_s),
            "time_au": measurement.time_au,
            "agent_au": measurement.agent_au,
            "view_au": measurement.view_au,
            **({} if measurement.hidden_au is None else {"hidden_au": measurement.hidden_au}),
            "battery": event.battery,
            "battery_needed": event.battery_needed,
            "stretch": asdict(event.stretch),
            "targets": {name: self._target(event, number) for number, name in enumerate(names)},
        }
        return said | self._place(event.pose.position_ned_m)

    def _target(self, event: Measured, number: int) -> dict[str, object]:
        """What a measurement says of one target."""
        if not event.measurement.seen[number]:
            return {"seen": False, "position_au": None, "score": None}
        position_au = event.measurement.target_au[number]
        said = {"seen": True, "position_au": position_au, "score": event.score[number]}
        error = {"error_m": event.error_m[number], "covariance_m2": event.covariance_m2[number]}
        return said | self._ground(position_au) | error

    def _event(self, event: Noted) -> dict[str, object]:
        boot, up_s = machine_time()
        said = {"time_s": event.time_s, "wall": self._stamp(event.time_s)}
        said |= {"boot": boot, "up_s": round(up_s, 3), "kind": event.kind, "text": event.text}
        where = self._place(self._pose.position_ned_m) if self._pose else {}
        return said | where | dict(event.fields)

    def ground_place(self, position_au: FloatArray) -> GeoPoint | None:
        """A place of the area on the globe; None before the area is laid."""
        laid = self._laid
        return None if laid is None else laid.area.au_to_geo(position_au, laid.origin)

    def _ground(self, position_au: FloatArray) -> dict[str, object]:
        return _told(self.ground_place(position_au))

    def _place(self, position_ned_m: Sequence[float]) -> dict[str, object]:
        laid = self._laid
        return _told(None if laid is None else ned_to_geo(position_ned_m, laid.origin))

    def _wall(self, time_s: float) -> str:
        """Wall time of a vehicle time that has just passed."""
        passed_s = self._pose.time_s - time_s if self._pose else 0.0
        return self._stamp(time_s, ago_s=passed_s)

    def _stamp(
        self, time_s: float | None, precision: str = "milliseconds", ago_s: float = 0.0
    ) -> str:
        """Wall time: now, or so long ago; of an earlier flight that of its time."""
        if self._earlier is None or time_s is None:
            return _stamp(precision, ago_s)
        then = self._earlier.began.astimezone() + timedelta(seconds=time_s)
        return then.isoformat(timespec=precision)

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
                name: fingerprint(self.folder.path / name)
                for name in dict.fromkeys((*RUN_FILES, *self.folder.recordings()))
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


def _as_flown(mission: Mission) -> str:
    """The mission with every default and override, as a file that can be flown again."""
    data = mission.model_dump(mode="json", exclude_none=True)
    text: str = yaml.dump(data, Dumper=Dumper, sort_keys=False, allow_unicode=True)
    return text


def _told(place: GeoPoint | None) -> dict[str, object]:
    """A place to the centimetre, where it is known."""
    if place is None:
        return {}
    latitude_deg, longitude_deg = round(place.latitude_deg, 7), round(place.longitude_deg, 7)
    altitude_m = round(place.altitude_m, 2)
    rounded = GeoPoint(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m
    )
    return {"place": asdict(rounded)}


def _now() -> datetime:
    """Wall time, for names and stamps only; a mission's time is the vehicle's."""
    return datetime.now(UTC).astimezone()


def _stamp(precision: str, ago_s: float = 0.0) -> str:
    return (_now() - timedelta(seconds=ago_s)).isoformat(timespec=precision)


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
