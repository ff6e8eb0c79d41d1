"""Where a mission's area is, in metres: one `Field`, however the file gives it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.errors import MissionFileError
from dronemon.frames import AreaFrame, GeoPoint, degrees_to_ned, ned_to_geo
from dronemon.mission.area import Area
from dronemon.mission.document import Problem
from dronemon.mission.schema import Mission
from dronemon.outline import Field, LaidZone, Outline, Ring, away_m, read_outline, unwound
from dronemon.types import FloatArray, Obstacle

_MOST_CUT_OFF = 0.05
"""Share of what is free that may be cut off from the rest."""
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
        _refuse_far(area, _called(area), outline.border_deg, centre)
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
        zones.append(
            LaidZone(
                name=zone.name,
                corners_ned_m=corners_m,
                below_m=zone.below_m,
                height_m=zone.height_m,
            )
        )
    field = replace(field, no_fly=tuple(zones))
    if flaw := field.flaw():
        raise MissionFileError(flaw)
    return field


def field_centre(area: Area) -> GeoPoint | None:
    """What an area lies around: (0.5, 0.5) au; None where that is home. Raises MissionFileError."""
    if area.latitude_deg is not None and area.longitude_deg is not None:
        return GeoPoint(latitude_deg=area.latitude_deg, longitude_deg=area.longitude_deg)
    if (outline := _outline(area)) is None:
        return None
    border_deg = np.array(outline.border_deg)
    return GeoPoint.at((border_deg.min(axis=0) + border_deg.max(axis=0)) / 2.0)


def check_near(area: Area, home: GeoPoint) -> None:
    """Refuse a field that is far from home. Raises MissionFileError."""
    outline = _outline(area)
    if outline is not None and area.latitude_deg is None:
        _refuse_far(area, _called(area), outline.border_deg, home)


def mission_arena(mission: Mission) -> Arena:
    """The mission's area in au, the same wherever home is. Raises MissionFileError."""
    area, flight = mission.area, mission.flight
    if area.is_square:
        return ARENA
    frame, _, field = _laid(mission)
    zones_au = [frame.ned_to_au(zone.corners_ned_m) for zone in field.no_fly]
    try:
        arena = Arena.polygon(
            frame.ned_to_au(field.border_ned_m),
            zones_au,
            margin_au=flight.clearance_m / area.side_m,
        )
    except ValueError as exc:
        names = ", ".join(zone.name for zone in field.no_fly[:5])
        raise MissionFileError(
            f"nothing of {_called(area)} is left to fly in: the drone keeps"
            f" {flight.clearance_m:.0f} m from the border and from no-fly zones"
            f"{f' ({names})' if names else ''}, since it cuts corners at cruise speed; fly slower,"
            " or higher where a zone has below_m, or enlarge the field"
        ) from exc
    if arena.cut_off > _MOST_CUT_OFF:
        raise MissionFileError(
            f"{arena.cut_off:.0%} of where it may fly cannot be reached from the rest by a drone"
            f" that keeps {flight.clearance_m:.0f} m from the border and from no-fly zones; fly"
            " slower, widen the way there, or make it a field of its own"
        )
    return arena


def flown_over(mission: Mission) -> list[str]:
    """Names of no-fly zones that do not reach up to the patrol. Raises MissionFileError."""
    if mission.area.is_square:
        return []
    _, whole, field = _laid(mission)
    return [zone.name for zone in whole.no_fly if zone not in field.no_fly]


def mission_obstacles(mission: Mission) -> tuple[Obstacle, ...]:
    """What stands in and about the area, the same wherever home is. Raises MissionFileError."""
    if mission.area.is_square:
        return ()
    frame, whole, _ = _laid(mission)
    return tuple(
        Obstacle(corners_au=frame.ned_to_au(zone.corners_ned_m), height_m=zone.height_m)
        for zone in whole.no_fly
        if zone.height_m is not None
    )


def _laid(mission: Mission) -> tuple[AreaFrame, Field, Field]:
    """The mission's frame around (0, 0); its field with all zones, and as it is at the patrol."""
    frame = _frame(mission, (0.0, 0.0), 0.0)
    origin = field_centre(mission.area) or GeoPoint.at((0.0, 0.0))
    whole = lay_field(mission.area, frame, origin)
    at_patrol = whole.at(mission.flight.altitude_m - mission.flight.stand_off_m)
    if mission.area.terrain is not None:
        # A top is above the ground there, the flight above its own, or the take-off's.
        binding = (z for z in whole.no_fly if z.height_m is not None or z in at_patrol.no_fly)
        at_patrol = replace(whole, no_fly=tuple(binding))
    return frame, whole, at_patrol


def lay_frame(
    mission: Mission, centre_ned_m: tuple[float, float], ground_down_m: float
) -> AreaFrame:
    """Lay the area over the ground: see `AreaFrame`. Raises MissionFileError."""
    return replace(_frame(mission, centre_ned_m, ground_down_m), arena=mission_arena(mission))


def _frame(mission: Mission, centre_ned_m: tuple[float, float], ground_down_m: float) -> AreaFrame:
    return AreaFrame(
        centre_ned_m=centre_ned_m,
        ground_down_m=ground_down_m,
        side_m=mission.area.side_m,
        heading_rad=math.radians(mission.area.heading_deg),
        cruise_speed_m_s=mission.flight.cruise_speed_m_s,
    )


def reach_m(mission: Mission) -> float:
    """Distance of the area's farthest corner from (0.5, 0.5) au. Raises MissionFileError."""
    away_au = np.linalg.norm(mission_arena(mission).outline_au - 0.5, axis=-1)
    return mission.area.side_m * float(away_au.max())


def field_problems(mission: Mission) -> Iterator[Problem]:
    """What is wrong with a field."""
    area = mission.area
    try:
        is_in_degrees = _outline(area) is not None
    except MissionFileError as exc:
        yield ("area", "file"), str(exc)
        return
    if area.latitude_deg is None:
        for number, zone in enumerate(area.no_fly):
            if (zone.polygon_deg is not None) != is_in_degrees:
                yield (
                    ("area", "no_fly", number),
                    "in metres of home, or in degrees, but the field is not: give both alike, or "
                    "area.latitude_deg and longitude_deg, from which metres then count",
                )
                return
    try:
        mission_arena(mission)
    except MissionFileError as exc:
        yield ("area", _key_at_fault(mission)), str(exc)


def _key_at_fault(mission: Mission) -> str:
    """Of a field that cannot be flown in: its border's, unless that alone can."""
    area = mission.area
    if area.border_key is None:
        return "no_fly"
    bare = area.model_copy(update={"no_fly": ()})
    try:
        mission_arena(mission.model_copy(update={"area": bare}))
    except MissionFileError:
        return area.border_key
    return "no_fly"


def place_problems(mission: Mission) -> Iterator[Problem]:
    """Which of the places that the mission names are not in its area, which has no flaw."""
    arena, start_au = mission_arena(mission), mission.flight.start_au
    low, high = arena.bounds.round(3).tolist()
    if start_au is not None and not arena.segment_is_free(*[np.array(start_au)] * 2):
        yield (
            ("flight", "start_au"),
            f"{list(start_au)} is not where the drone may be, in an area from {low} to {high} au",
        )
    for target in mission.targets:
        place_au = target.prior_au
        if isinstance(place_au, tuple) and not arena.contains(np.array(place_au)):
            yield (
                ("targets", target.entry, "prior_au"),
                f"{list(place_au)} is not in the area, which is from {low} to {high} au",
            )


def _outline(area: Area) -> Outline | None:
    """What is given in degrees, by a file or by the mission."""
    if area.file is not None:
        return read_outline(area.file)
    if area.polygon_deg is not None:
        return Outline(border_deg=unwound(area.polygon_deg, 0.0), no_fly=())
    return None


def _from_centre(polygon_m: Sequence[tuple[float, float]], frame: AreaFrame) -> FloatArray:
    """North and east of corners that are east and north of the area's centre."""
    corners_m: FloatArray = np.asarray(frame.centre_ned_m) + np.array(polygon_m)[:, ::-1]
    return corners_m


def _called(area: Area) -> str:
    return "the field" if area.file is None else f"{area.file}: the field"


def _refuse_far(area: Area, what: str, ring: Ring, centre: GeoPoint) -> None:
    if (off_m := away_m(ring, centre)) > _FARTHEST_M:
        whence = "home" if area.latitude_deg is None else "area.latitude_deg and longitude_deg"
        raise MissionFileError(
            f"{what} is {off_m / 1000.0:.0f} km from {whence}; are its latitude and longitude "
            "swapped, or is it another place's?"
        )
