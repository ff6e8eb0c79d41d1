"""Pictures of a flight that was flown before, each with its time, place and attitude.

All is read and judged before the first is looked at: a table of theirs (`pose_table.py`), or else
what each picture says of itself (`pose_tags.py`).
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Self

from dronemon.camera import pose_table
from dronemon.camera.pictures import picture_files, read_picture
from dronemon.camera.pose_tags import has_tags, opened, read_tags
from dronemon.camera.source import check_size_px
from dronemon.camera.taken import Taken, refuse
from dronemon.errors import CameraError, did_you_mean
from dronemon.frames import GeoPoint, geo_to_ned
from dronemon.mission.camera import Camera
from dronemon.types import CameraModel, Picture, Pose, Vector3

_LONGEST_GAP, _LEAST_GAP_S = 10.0, 30.0
"""A gap is longer than so many usual intervals, and than a patrol goes on without pictures."""
_FASTEST_M_S, _LONGEST_S = 100.0, 86_400.0
"""No drone is faster, and no flight longer: a place, or a time, is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PosedPicture:
    """One picture, and where it was taken from.

    time_s:       since the first one
    place:        of the camera; its altitude is above the ground of the start
    attitude_rad: as `Pose.attitude_rad`
    """

    name: str
    file: Path
    time_s: float
    place: GeoPoint
    attitude_rad: Vector3


@dataclass(frozen=True, slots=True, kw_only=True)
class PosedPictures:
    """A flight's pictures, one at least, in the order of their times.

    began: when the first was taken
    """

    folder: Path
    pictures: tuple[PosedPicture, ...]
    began: datetime

    @property
    def start(self) -> GeoPoint:
        """The ground below the first."""
        return replace(self.pictures[0].place, altitude_m=0.0)

    def every(self, number: int) -> PosedPictures:
        """Only every n-th, from the first."""
        return replace(self, pictures=self.pictures[::number])

    def poses(self, home: GeoPoint) -> list[Pose]:
        """Pose at each picture, in the local frame of home. The speed is that since the last one.

        The ground is at down 0, flat, as in flight.
        """
        poses: list[Pose] = []
        for picture in self.pictures:
            flat = replace(picture.place, altitude_m=home.altitude_m)
            north_m, east_m, _ = map(float, geo_to_ned(flat, home))
            pose = Pose(
                time_s=picture.time_s,
                position_ned_m=(north_m, east_m, -picture.place.altitude_m),
                velocity_ned_m_s=(0.0, 0.0, 0.0),
                attitude_rad=picture.attitude_rad,
            )
            poses.append(_moved(poses[-1], pose) if poses else pose)
        return poses


def _moved(last: Pose, pose: Pose) -> Pose:
    """The same pose, as fast as it takes from the last one."""
    passed_s = pose.time_s - last.time_s
    north, east, down = (
        (b - a) / passed_s for a, b in zip(last.position_ned_m, pose.position_ned_m, strict=True)
    )
    return replace(pose, velocity_ned_m_s=(north, east, down))


class PosedCamera:
    """Gives the pictures one after the other; a `FrameSource`."""

    def __init__(self, pictures: PosedPictures) -> None:
        self._left = iter(pictures.pictures)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        pass

    async def capture(self) -> Picture:
        """The next picture. Raises CameraError: it cannot be read, or there is none."""
        picture = next(self._left, None)
        if picture is None:
            raise CameraError("there are no more pictures")
        image = await asyncio.to_thread(read_picture, picture.file)
        return Picture(time_s=picture.time_s, image=image)


def has_poses(folder: Path) -> bool:
    """Whether the pictures of a folder seem to have poses, in a table or in themselves."""
    with contextlib.suppress(CameraError):
        if tables := _tables(folder):
            return len(tables) == 1 and pose_table.has_poses(tables[0])
        with opened(picture_files(folder)[0]) as image:
            return has_tags(image)
    return False


def read_posed(folder: Path, table: Path | None, camera: Camera) -> PosedPictures:
    """Read the pictures of a folder, and where each was taken.

    table:  the one CSV file beside the pictures if None; without that, the pictures' own words
    camera: that they are of

    Raises CameraError with all that is wrong: each file, and each line of the table.
    """
    files = picture_files(folder)
    if table is None and len(tables := _tables(folder)) > 1:
        names = ", ".join(path.name for path in tables)
        raise CameraError(f"{folder}: has several tables, {names}; name one with --poses")
    table = table or next(iter(_tables(folder)), None)
    if table is None:
        taken = sorted(_tags(files, camera.model), key=lambda of: (_instant_s(of), of.name))
    else:
        taken = pose_table.read_table(table)
        refuse(list(_strangers(table, taken, {file.name for file in files})))
        refuse(list(_misfits(files, camera.model)))
    if taken[0].has_gimbal and any(camera.mount_deg):
        raise CameraError(
            f"{taken[0].told_by}: tells the attitude of the camera itself, on its gimbal, so the "
            f"mission's camera.mount_deg, {list(camera.mount_deg)}, must be [0, 0, 0]"
        )
    times_s = [_instant_s(of) - _instant_s(taken[0]) for of in taken]
    refuse(list(_flaws(taken, times_s)))
    return PosedPictures(
        folder=folder,
        pictures=tuple(
            PosedPicture(
                name=of.name,
                file=folder / of.name,
                time_s=time_s,
                place=of.place,
                attitude_rad=of.attitude_rad,
            )
            for of, time_s in zip(taken, times_s, strict=True)
        ),
        began=_began(taken[0].time, times_s[-1]),
    )


def _tables(folder: Path) -> list[Path]:
    return sorted(f for f in folder.glob("*.[cC][sS][vV]") if f.name[0] != ".")


def _strangers(table: Path, taken: Sequence[Taken], names: set[str]) -> Iterator[str]:
    """Lines without a picture, pictures without a line, and names that come twice."""
    told: set[str] = set()
    for of in taken:
        if of.name not in names:
            hint = did_you_mean(of.name, names)
            yield f"{of.told_by}: no picture {of.name!r:.80} is there; {hint}else leave it out"
        elif of.name in told:
            yield f"{of.told_by}: {of.name} comes again"
        told.add(of.name)
    for name in sorted(names - told):
        yield f"{table}: says nothing of {name}; add its line, or take the picture away"


def _misfits(files: Sequence[Path], model: CameraModel) -> Iterator[str]:
    """Pictures that cannot be read, or are not as large as the camera's."""
    for file in files:
        try:
            with opened(file) as image:
                check_size_px(*image.size, model)
        except CameraError as exc:
            yield f"{file}: {exc}"


def _tags(files: Sequence[Path], model: CameraModel) -> list[Taken]:
    """What each picture says of itself. Raises CameraError with all that is wrong."""
    refuse(list(_misfits(files, model)))
    taken, problems = list[Taken](), list[str]()
    for file in files:
        try:
            with opened(file) as image:
                taken.append(read_tags(image, file))
        except CameraError as exc:
            problems.append(f"{file}: {exc}")
    refuse(problems)
    return taken


def _instant_s(of: Taken) -> float:
    return of.time.timestamp() if isinstance(of.time, datetime) else of.time


def _began(first: float | datetime, duration_s: float) -> datetime:
    """When the first picture was taken; where no date is told, as if the last were of now."""
    if isinstance(first, datetime):
        return first.astimezone(UTC)
    return datetime.now(UTC) - timedelta(seconds=duration_s)


def _kind(time: float | datetime) -> str:
    if isinstance(time, float):
        return "seconds"
    return "a date with a zone" if time.tzinfo else "a date without a zone"


def _flaws(taken: Sequence[Taken], times_s: Sequence[float]) -> Iterator[str]:
    """What cannot be of pictures of one flight, in the order in which they were taken."""
    first = taken[0]
    for of, time_s in zip(taken, times_s, strict=True):
        if (kind := _kind(of.time)) != _kind(first.time):
            yield f"{of.told_by}: gives {kind}, and {first.told_by} {_kind(first.time)}; give one"
            return
        if abs(time_s) > _LONGEST_S:
            yield (
                f"{of.told_by}: {of.name} is {time_s:g} s later than {first.name}; no flight is "
                "so long: are these milliseconds?"
            )
            return
    passed_s = [after - before for before, after in pairwise(times_s)]
    usual_s = median(passed_s) if passed_s else 0.0
    for (before, after), interval_s in zip(pairwise(taken), passed_s, strict=True):
        if what := _flaw(before, after, interval_s, usual_s):
            yield f"{after.told_by}: {after.name} is {what}"


def _flaw(before: Taken, after: Taken, interval_s: float, usual_s: float) -> str | None:
    if interval_s <= 0.0:
        return (
            f"not later than {before.name}, which comes before ({interval_s:g} s); give parts of "
            "seconds, in the order in which they were taken"
        )
    if interval_s > max(_LONGEST_GAP * usual_s, _LEAST_GAP_S):
        return (
            f"{interval_s:.0f} s later than {before.name}, others {usual_s:.1f} s: make two "
            "folders of what are two flights"
        )
    away_m = math.hypot(*geo_to_ned(after.place, before.place)[:2])
    if away_m > _FASTEST_M_S * interval_s:
        return (
            f"{away_m:.0f} m from {before.name}, {interval_s:g} s later; are latitude and "
            "longitude swapped in one of them?"
        )
    return None
