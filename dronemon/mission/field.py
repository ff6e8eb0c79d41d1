"""Where a mission's area is, in metres: one `Field`, however the file gives it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dronemon.arena import ARENA
from dronemon.errors import MissionFileError
from dronemon.frames import AreaFrame, GeoPoint, degrees_to_ned, ned_to_geo
from dronemon.mission.area import Area
from dronemon.mission.document import Problem
from dronemon.mission.schema import Mission
from dronemon.outline import Field, LaidZone, Outline, Ring, away_m, read_outline
from dronemon.types import FloatArray

_FARTHEST_M = 50_000.0
"""From what an area's metres count from: no drone patrols farther from home."""


def lay_field(area: Area, frame: AreaFrame, origin: GeoPoint) -> Field:
    """Where the drone may fly.

    frame:  of the area, whose centre metres count from
    origin: of the local frame

    Raises MissionFileError if the file is none, is far from there, or nothing is left to fly in.
    """
    centre = ned_to_geo([*frame.centre_ned_m, 0.0], origin)
    outline = _outline(area)
    if outline is not None:
        _refuse_far(area, "the field", outline.border_deg, centre)
        field = outline.laid(origin)
    elif area.polygon_m is not None:
        field = Field(border_ned_m=_from_centre(area.polygon_m, frame), no_fly=())
    else:
        field = Field(border_ned_m=frame.au_to_ned(ARENA.outline_au[:-1]), no_fly=())
    zones = list(field.no_fly)
    for zone in area.no_fly:
        if zone.polygon_deg is not None:
            _refuse_far(area, f"no-fly {zone.name!r}", zone.polygon_deg, centre)
            corners_m = degrees_to_ned(np.array(zone.polygon_deg), origin)[:, :2]
        else:
            assert zone.polygon_m is not None  # one of them is given
            corners_m = _from_centre(zone.polygon_m, frame)
        zones.append(LaidZone(name=zone.name, corners_ned_m=corners_m))
    field = replace(field, no_fly=tuple(zones))
    if flaw := field.flaw():
        raise MissionFileError(flaw)
    return field


def field_problems(mission: Mission) -> Iterator[Problem]:
    """What is wrong with a field, as far as that can be told before home is known."""
    area = mission.area
    try:
        outline = _outline(area)
    except MissionFileError as exc:
        yield ("area", "file"), str(exc)
        return
    is_in_metres = {outline is None, *(zone.polygon_deg is None for zone in area.no_fly)}
    if area.latitude_deg is not None and area.longitude_deg is not None:
        origin = GeoPoint(latitude_deg=area.latitude_deg, longitude_deg=area.longitude_deg)
    elif len(is_in_metres) > 1:  # how they lie to each other is known once home is
        return
    else:
        origin = GeoPoint.at((0.0, 0.0) if outline is None else outline.border_deg[0])
    frame = AreaFrame(
        centre_ned_m=(0.0, 0.0),
        ground_down_m=0.0,
        side_m=area.side_m,
        heading_rad=math.radians(area.heading_deg),
        cruise_speed_m_s=mission.flight.cruise_speed_m_s,
    )
    try:
        lay_field(area, frame, origin)
    except MissionFileError as exc:
        yield ("area", area.border_key or "no_fly"), str(exc)


def _outline(area: Area) -> Outline | None:
    """What is given in degrees, by a file or by the mission."""
    if area.file is not None:
        return read_outline(area.file)
    if area.polygon_deg is not None:
        return Outline(border_deg=area.polygon_deg, no_fly=())
    return None


def _from_centre(polygon_m: Sequence[tuple[float, float]], frame: AreaFrame) -> FloatArray:
    """North and east of corners that are east and north of the area's centre."""
    corners_m: FloatArray = np.asarray(frame.centre_ned_m) + np.array(polygon_m)[:, ::-1]
    return corners_m


def _refuse_far(area: Area, what: str, ring: Ring, centre: GeoPoint) -> None:
    if (off_m := away_m(ring, centre)) > _FARTHEST_M:
        whence = "home" if area.latitude_deg is None else "area.latitude_deg and longitude_deg"
        raise MissionFileError(
            f"{what} is {off_m / 1000.0:.0f} km from {whence}; are its latitude and longitude "
            "swapped, or is it another place's?"
        )
