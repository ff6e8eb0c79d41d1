"""What a run says of places on the globe, read once for every format."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dronemon.camera import crop_path
from dronemon.errors import RecordError
from dronemon.frames import GeoPoint
from dronemon.mission import Mission
from dronemon.recorder import RunFolder
from dronemon.runner.history import Laid, understanding

_EARTH_DEGREE_M = 111_320.0
"""Length of a degree of latitude."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fix:
    """Where the vehicle was."""

    time: datetime
    place: GeoPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """A target seen in a picture.

    number:  of the target among the mission's
    error_m: radius about the place in which it truly is, in 95 of 100 or more
    score:   the detector's confidence, 0 to 1
    crop:    the part of the picture that shows it, None where it was not kept
    """

    number: int
    target: str
    appearance: str
    time: datetime
    place: GeoPoint
    error_m: float
    score: float | None
    crop: Path | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """A run on the globe; all times are UTC.

    title:   the mission's name, and what a reader must know of the rest
    corners: of the area, as a walk around it that ends where it began
    cell_m:  to which places are told; 0: exactly, with heights
    """

    name: str
    title: str
    started: datetime
    cell_m: float
    corners: tuple[GeoPoint, ...]
    track: tuple[Fix, ...]
    sightings: tuple[Sighting, ...]


def read_story(folder: RunFolder) -> Story:
    """Read a run, finished or not. Raises RecordError if it has no places."""
    mission = folder.mission()
    with understanding(folder):
        laid = [Laid.told_by(event) for event in folder.events() if event["kind"] == "ready"]
        if not laid:
            raise RecordError(
                f"{folder.path}: its area was never laid over the ground, so nothing of it can be"
                " put on a map"
            )
        return Story(
            name=mission.name,
            title=mission.name + (f" ({how})" if (how := _made(folder, mission)) else ""),
            started=_utc(folder.summary()["started"]),
            cell_m=0.0,
            corners=tuple(_corners(laid[-1])),
            track=tuple(
                Fix(time=_utc(pose["wall"]), place=GeoPoint(**pose["place"]))
                for pose in folder.poses()
            ),
            sightings=tuple(
                sighting
                for line in folder.observations()
                for sighting in _sightings(folder.path, line, mission)
            ),
        )


def _made(folder: RunFolder, mission: Mission) -> str:
    """What of a run was not flown for real, in words; empty for nothing."""
    if folder.rewatched() is not None:
        return "from pictures of an earlier flight"
    if mission.vehicle.is_mock:
        return f"simulated, at {mission.vehicle.speed_up:g} times real time"
    return "with simulated targets" if mission.camera.is_simulated else ""


def _corners(laid: Laid) -> list[GeoPoint]:
    return [
        laid.frame.au_to_geo(corner_au, laid.origin) for corner_au in laid.frame.arena.outline_au
    ]


def _sightings(run: Path, line: Mapping[str, Any], mission: Mission) -> list[Sighting]:
    found = []
    for number, target in enumerate(mission.targets):
        told = line["targets"][target.name]
        if not told["seen"]:
            continue
        crop = crop_path(run, line["number"], number, target.name)
        found.append(
            Sighting(
                number=number,
                target=target.name,
                appearance=target.appearance,
                time=_utc(line["wall"]),
                place=GeoPoint(**told["place"]),
                error_m=told["error_m"],
                score=told["score"],
                crop=crop if crop.is_file() else None,
            )
        )
    return found


def _utc(stamp: str) -> datetime:
    return datetime.fromisoformat(stamp).astimezone(UTC)


def coarse(place: GeoPoint, cell_m: float) -> GeoPoint:
    """The centre of the cell of this side in which a place is, without its height."""
    row_deg = cell_m / _EARTH_DEGREE_M
    latitude_deg = (math.floor(place.latitude_deg / row_deg) + 0.5) * row_deg
    # By the row's middle, so that all of a row have the same columns.
    shrunk = max(math.cos(math.radians(latitude_deg)), 1e-6)
    column_deg = min(row_deg / shrunk, 360.0)
    longitude_deg = (math.floor(place.longitude_deg / column_deg) + 0.5) * column_deg
    return GeoPoint(
        latitude_deg=max(-90.0, min(90.0, latitude_deg)),
        longitude_deg=(longitude_deg + 180.0) % 360.0 - 180.0,
    )


def coarse_sighting(sighting: Sighting, cell_m: float) -> Sighting:
    """The same, somewhere in a cell of this side, and without its picture."""
    away_m = cell_m / math.sqrt(2.0)  # from the cell's centre to its corner
    place, error_m = coarse(sighting.place, cell_m), away_m + sighting.error_m
    return replace(sighting, place=place, error_m=error_m, crop=None)


def redacted(story: Story, cell_m: float) -> Story:
    """The same story, coarse: what keeps endangered animals from those who would hunt them.

    Without the track: when it came into the next cell, the drone was at that cell's edge.
    """
    return replace(
        story,
        title=f"{story.title}, places to {cell_m:g} m",
        cell_m=cell_m,
        corners=(),
        track=(),
        sightings=tuple(coarse_sighting(sighting, cell_m) for sighting in story.sightings),
    )
