"""Times and poses of pictures in a CSV file.

    picture       name of the file
    time_s        seconds from any start, or ISO 8601; without a zone, by this machine's
    latitude, longitude    degrees on WGS-84, where the camera was
    altitude_m    above the ground where the drone took off
    roll_deg, pitch_deg, yaw_deg    of the vehicle, ZYX, yaw clockwise from north: its camera looks
                  straight down from it, or as camera.mount_deg says
    gimbal_roll_deg, gimbal_pitch_deg, gimbal_yaw_deg    instead, of the camera itself: a pitch of
                  -90 looks straight down, the picture's top to the yaw; they count where both are

Columns may come in any order, and others among them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from dronemon.camera.taken import (
    Taken,
    checked_attitude,
    checked_place,
    checked_time,
    number,
    refuse,
)
from dronemon.errors import CameraError

_MOST_BYTES = 100_000_000
_PLACE = ("latitude", "longitude", "altitude_m")
_BODY = ("roll_deg", "pitch_deg", "yaw_deg")
_GIMBAL = tuple(f"gimbal_{name}" for name in _BODY)


def read_table(path: Path) -> list[Taken]:
    """Every line of a table, in its order. Raises CameraError with what is wrong, a line each."""
    rows = _rows(path)
    head, has_gimbal = _head(path, rows)
    taken, problems = list[Taken](), list[str]()
    for line, cells in rows[1:]:
        told_by = f"{path}:{line}"
        if len(cells) != len(head):
            problems.append(f"{told_by}: has {len(cells)} values, its head {len(head)} columns")
            continue
        try:
            row = dict(zip(head, cells, strict=True))
            taken.append(_taken(row, told_by, has_gimbal=has_gimbal))
        except ValueError as exc:
            problems.append(f"{told_by}: {exc}")
    refuse(problems)
    return taken


def has_poses(path: Path) -> bool:
    """Whether a file seems to be such a table. Raises CameraError if it cannot be read."""
    rows = _rows(path)
    return {"picture", "latitude"} <= {cell.strip() for cell in rows[0][1]} if rows else False


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Lines that are not empty, by their numbers."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise CameraError(f"{path}: larger than {_MOST_BYTES} bytes; is it a table of poses?")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as exc:
        raise CameraError(f"{path}: cannot be read: {exc}") from exc
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        return [(reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as exc:
        raise CameraError(f"{path}:{reader.line_num}: {exc}") from exc


def _head(path: Path, rows: Sequence[tuple[int, list[str]]]) -> tuple[list[str], bool]:
    """The columns, and whether they have a gimbal's angles."""
    head = [cell.strip() for cell in rows[0][1]] if rows else []
    has_gimbal = not set(head).isdisjoint(_GIMBAL)
    wanted = ("picture", "time_s", *_PLACE, *(_GIMBAL if has_gimbal else _BODY))
    if missing := [name for name in wanted if name not in head]:
        raise CameraError(
            f"{path}:1: has no column {', '.join(missing)}; its first line names the columns, "
            f"with commas between: {', '.join(wanted)}"
        )
    if twice := [name for name in wanted if head.count(name) > 1]:
        raise CameraError(f"{path}:1: has the column {twice[0]} twice")
    return head, has_gimbal


def _taken(row: Mapping[str, str], told_by: str, *, has_gimbal: bool) -> Taken:
    """What a line says. Raises ValueError with all that is wrong."""
    numbers, problems = dict[str, float](), list[str]()
    for name in (*_PLACE, *(_GIMBAL if has_gimbal else _BODY)):
        try:
            numbers[name] = number(row[name])
        except ValueError as exc:
            problems.append(f"{name} {exc}")
    if problems:
        raise ValueError("; ".join(problems))
    latitude_deg, longitude_deg, altitude_m, *angles_deg = numbers.values()
    return Taken(
        told_by=told_by,
        name=row["picture"].strip(),
        time=_time(row["time_s"].strip()),
        place=checked_place(latitude_deg, longitude_deg, altitude_m),
        attitude_rad=checked_attitude(angles_deg, has_gimbal=has_gimbal),
        has_gimbal=has_gimbal,
    )


def _time(text: str) -> float | datetime:
    try:
        return number(text)
    except ValueError:
        pass
    try:
        return checked_time(datetime.fromisoformat(text))
    except ValueError as exc:
        what = f"time_s {text!a:.40} is neither seconds nor an ISO 8601 time: {exc}"
        raise ValueError(what) from None
