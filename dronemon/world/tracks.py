"""Real tracks as a world: fixes of collared animals or of vehicles, read from a CSV or GPX file.

    time,target,x,y                     x and y in au, all the way in the area
    time,target,latitude,longitude      laid into the area: the longer side of what the targets
                                        cover is the area's shorter side, of a polygon that of the
                                        square in its largest circle
    a .gpx file                         one target per track, as the last

Times are numbers in any unit, or ISO 8601. Columns may be named as Movebank has them. Of a file of
more targets than are wanted the first are taken. They walk from the first instant at which all
have a fix to the last, then back; how fast is the mission's or the evaluation's speed: that is
their mean one.
"""

from __future__ import annotations

import csv
import xml.sax
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from functools import cache
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.sax.handler import ContentHandler

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.errors import OptionError
from dronemon.frames import GeoPoint, geo_to_ned
from dronemon.types import FloatArray
from dronemon.world.targets import TargetPaths, stacked

_MOST_BYTES, _MOST_LETTERS, _MOST_TIME = 50_000_000, 100, 1e15
_LEAST_WAY_AU = 0.01
"""Way of all targets in the mean below which nothing moves."""
_LONGEST_GAP = 10.0
"""Longest time between two fixes of a target, over its median one."""
_COLUMNS = {
    "time": ("time", "timestamp", "t"),
    "target": ("target", "individual-local-identifier", "tag-local-identifier", "name", "id"),
    "x": ("x",),
    "y": ("y",),
    "latitude": ("latitude", "lat", "location-lat"),
    "longitude": ("longitude", "lon", "long", "lng", "location-long"),
}


class Fix(NamedTuple):
    """One line of a file: where a target was. place: x, y in au, or latitude, longitude in deg."""

    line: int
    time_s: float
    target: str
    place: tuple[float, float]


@cache
def draw_tracks(path: Path, num_targets: int, arena: Arena = ARENA) -> TargetPaths:
    """The first targets of a file, laid out and timed without regard to the others.

    Raises OptionError naming file and line.
    """
    is_geographic, every = _read(path)
    if len(every) < num_targets:
        raise OptionError(f"{path} has {len(every)} targets; {num_targets} are wanted")
    tracks = every[:num_targets]
    lay = _laid_out if is_geographic else _in_arena
    places = lay(tracks, arena, path)
    return _paths([[fix.time_s for fix in track] for track in tracks], places, path)


@cache
def _read(path: Path) -> tuple[bool, list[list[Fix]]]:
    """Whether places are on the globe, and the fixes of each target. Raises OptionError."""
    try:
        if not path.is_file():
            what = "is no file" if path.exists() else "cannot be read: No such file or directory"
            raise OptionError(f"{path}: {what}")
        if path.stat().st_size > _MOST_BYTES:
            raise OptionError(f"{path}: larger than {_MOST_BYTES // 10**6} MB; thin it out")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as exc:
        raise OptionError(f"{path}: cannot be read: {exc.strerror}") from exc
    except UnicodeDecodeError as exc:
        raise OptionError(f"{path}: is no text in UTF-8; save it as such") from exc
    is_geographic, fixes = _gpx(text, path) if path.suffix.lower() == ".gpx" else _csv(text, path)
    by_target: dict[str, list[Fix]] = {}
    for fix in fixes:
        by_target.setdefault(fix.target, []).append(fix)
    if not by_target:
        raise OptionError(f"{path}: has no fixes")
    for track in by_target.values():
        _check_track(track, path)
    return is_geographic, list(by_target.values())


def _csv(text: str, path: Path) -> tuple[bool, Iterable[Fix]]:
    rows = _rows(text, path)
    _, header = next(rows, (1, []))
    header = [name.strip().lower().replace("_", "-") for name in header]
    column = {
        name: next((header.index(also) for also in names if also in header), None)
        for name, names in _COLUMNS.items()
    }
    is_geographic = None not in (column["latitude"], column["longitude"])
    wanted = ["time", "target", *(("latitude", "longitude") if is_geographic else ("x", "y"))]
    if missing := [name for name in wanted if column[name] is None]:
        raise OptionError(
            f"{path}, line 1: no column {' and no '.join(missing)} in {', '.join(header)!r:.200}; "
            "the first line names the columns: time, target and x, y in au, or latitude, longitude"
        )
    return is_geographic, _csv_fixes(rows, [column[name] or 0 for name in wanted], path)


def _rows(text: str, path: Path) -> Iterator[tuple[int, list[str]]]:
    """Lines of a table that are not empty, and their numbers. Raises OptionError."""
    rows = csv.reader(StringIO(text))
    try:
        for row in rows:
            if any(cell.strip() for cell in row):
                yield rows.line_num, row
    except csv.Error as exc:
        raise OptionError(f"{path}, line {rows.line_num}: {exc}") from exc


def _csv_fixes(
    rows: Iterator[tuple[int, list[str]]], columns: list[int], path: Path
) -> Iterator[Fix]:
    for line, row in rows:
        if len(row) <= max(columns):
            raise OptionError(f"{path}, line {line}: has {len(row)} cells; the header has more")
        yield _fix(line, *(row[c].strip() for c in columns), path=path)


def _fix(line: int, time: str, target: str, first: str, second: str, *, path: Path) -> Fix:
    """Read one fix. Raises OptionError."""
    if not 0 < len(target) <= _MOST_LETTERS:
        raise OptionError(
            f"{path}, line {line}: the target's name has {len(target)} letters, not 1 to "
            f"{_MOST_LETTERS}"
        )
    place = _number(first, line, path), _number(second, line, path)
    return Fix(line, _seconds(time, line, path), target, place)


def _number(text: str, line: int, path: Path) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise OptionError(
            f"{path}, line {line}: {text!r:.40} is no number; leave out fixes without a place"
        )
    return value


def _seconds(text: str, line: int, path: Path) -> float:
    try:
        value = float(text)
    except ValueError:
        try:
            instant = datetime.fromisoformat(text)
        except ValueError as exc:
            raise OptionError(
                f"{path}, line {line}: {text!r:.40} is no time; give a number or ISO 8601, such as "
                "2026-05-01T12:00:00Z"
            ) from exc
        value = (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()
    if not abs(value) < _MOST_TIME:
        raise OptionError(f"{path}, line {line}: time {text!r:.40} is not less than {_MOST_TIME:g}")
    return value


_TEXTS = {("trk", "name"), ("trkpt", "time")}


class _GpxHandler(ContentHandler):
    """Collects the points of tracks, each with its line."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.fixes: list[Fix] = []
        self._path, self._open = path, [""]
        self._text: list[str] | None = None  # of what is wanted
        self._track, self._num_tracks, self._time = "", 0, ""
        self._names: set[str] = set()
        self._at, self._line = ("", ""), 0

    def startElement(self, name: str, attrs: xml.sax.xmlreader.AttributesImpl) -> None:
        self._open.append(name.split(":")[-1])
        self._text = [] if tuple(self._open[-2:]) in _TEXTS else None
        if self._open[-1] == "trk":
            self._num_tracks += 1
            self._track = f"track {self._num_tracks}"
        elif self._open[-1] == "trkpt":
            self._at, self._time = (attrs.get("lat", ""), attrs.get("lon", "")), ""
            self._line = self._locator.getLineNumber()  # type: ignore[attr-defined]

    def characters(self, content: str) -> None:
        if self._text is not None:
            self._text.append(content)

    def endElement(self, name: str) -> None:
        text, self._text = "".join(self._text or []).strip(), None
        match self._open.pop(), self._open[-1]:
            case "name", "trk":
                again = f" ({self._num_tracks})" if text in self._names else ""
                self._track = text + again if text else self._track
                self._names.add(text)
            case "time", "trkpt":
                self._time = text
            case "trkpt", _:
                self.fixes.append(
                    _fix(self._line, self._time, self._track, *self._at, path=self._path)
                )


def _gpx(text: str, path: Path) -> tuple[bool, Iterable[Fix]]:
    if "<!ENTITY" in text or "<!DOCTYPE" in text:
        raise OptionError(f"{path}: declares entities or a document type, which no GPX needs")
    handler = _GpxHandler(path)
    try:
        xml.sax.parseString(text.encode(), handler)
    except (xml.sax.SAXParseException, LookupError) as exc:
        line = f", line {exc.getLineNumber()}" if isinstance(exc, xml.sax.SAXException) else ""
        raise OptionError(f"{path}{line}: is no GPX: {exc}") from exc
    return True, handler.fixes


def _check_track(track: list[Fix], path: Path) -> None:
    """See that a target's fixes follow each other, without long gaps. Raises OptionError."""
    name = track[0].target
    if len(track) < 2:
        raise OptionError(f"{path}, line {track[0].line}: the only fix of {name}; give two or more")
    for before, fix in pairwise(track):
        if fix.time_s <= before.time_s:
            raise OptionError(
                f"{path}, line {fix.line}: not later than the fix of {name} in line {before.line}; "
                "sort each target's fixes by time and leave out doubles"
            )
    steps = np.diff([fix.time_s for fix in track])
    usual, longest = float(np.median(steps)), int(np.argmax(steps))
    if steps[longest] > _LONGEST_GAP * usual:
        raise OptionError(
            f"{path}, line {track[longest + 1].line}: no fix of {name} for {steps[longest]:g} since"
            f" line {track[longest].line}, where they come every {usual:g}; cut the file there, or "
            "fill the gap"
        )


def _in_arena(tracks: list[list[Fix]], arena: Arena, path: Path) -> list[FloatArray]:
    """Tracks in au as they are. -> (P, 2) au of each. Raises OptionError for one that leaves."""
    every = [np.array([fix.place for fix in track]) for track in tracks]
    for track, places_au in zip(tracks, every, strict=True):
        if not (is_in := arena.contains(places_au)).all():
            fix = track[int(is_in.argmin())]
            (left, bottom), (right, top) = arena.low_au, arena.high_au
            raise OptionError(
                f"{path}, line {fix.line}: {fix.target} at {fix.place[0]:g}, {fix.place[1]:g} is "
                f"not in the area, which lies within x {left:g} to {right:g}, y {bottom:g} to "
                f"{top:g} au; mind the unit, or give latitude and longitude"
            )
        if arena.is_rectangle:
            continue
        if not (is_in := arena.field.is_free(places_au[:-1], places_au[1:])).all():
            number = int(is_in.argmin())
            before, fix = track[number : number + 2]
            raise OptionError(
                f"{path}, line {fix.line}: the straight way of {fix.target} from its place in line "
                f"{before.line} leaves the area; add fixes between them"
            )
    return every


def _geo(fix: Fix) -> GeoPoint:
    return GeoPoint(latitude_deg=fix.place[0], longitude_deg=fix.place[1], altitude_m=0.0)


def _laid_out(tracks: list[list[Fix]], arena: Arena, path: Path) -> list[FloatArray]:
    """Tracks on the globe, fitted into the arena about its middle. -> (P, 2) au of each."""
    for track in tracks:
        for fix in track:
            if not (-90.0 <= fix.place[0] <= 90.0 and -180.0 <= fix.place[1] <= 360.0):
                raise OptionError(
                    f"{path}, line {fix.line}: {fix.place[0]:g}, {fix.place[1]:g} is no latitude "
                    "and longitude in degrees"
                )
    origin = _geo(tracks[0][0])
    ned = [[geo_to_ned(_geo(fix), origin) for fix in t] for t in tracks]
    east_north = [np.array(places)[:, [1, 0]] for places in ned]
    low, high = (of([of(p, axis=0) for p in east_north], axis=0) for of in (np.min, np.max))
    side_m = float((high - low).max())
    if side_m < 1.0:
        raise OptionError(f"{path}: its targets stay within a metre of each other")
    middle_au, side_au = arena.bounds.mean(axis=0), float(arena.extent_au.min())
    if not arena.is_rectangle:
        middle_au, radius_au = arena.field.largest_circle()
        side_au = 2.0**0.5 * radius_au
    scale = side_au / side_m
    return [arena.clip(middle_au + scale * (p - (low + high) / 2.0)) for p in east_north]


def _paths(times: list[list[float]], places: list[FloatArray], path: Path) -> TargetPaths:
    """Cut tracks to the time that they share. times: P each; places: (P, 2) au each."""
    begin, end = max(t[0] for t in times), min(t[-1] for t in times)
    if end <= begin:
        raise OptionError(
            f"{path}: there is no time at which all {len(times)} targets have a fix before and "
            "after; leave out those that were followed at another time"
        )
    instants = [np.unique([begin, *(t for t in each if begin < t < end), end]) for each in times]
    ways = [
        np.stack([np.interp(at, each, place[:, k]) for k in (0, 1)], axis=-1)
        for at, each, place in zip(instants, times, places, strict=True)
    ]
    walked = np.mean([np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in ways])
    if walked < _LEAST_WAY_AU:
        raise OptionError(
            f"{path}: its {len(times)} targets walk {walked:.2g} au while all have fixes, from "
            f"{begin:.10g} to {end:.10g}; too little to be played"
        )
    marks = [walked * (at - begin) / (end - begin) for at in instants]
    return TargetPaths(points_au=stacked(ways), marks_au=stacked(marks))
