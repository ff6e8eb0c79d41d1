"""The ground that a flight looks at, flat or with hills, and how it flies over it."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial import ConvexHull

from dronemon.errors import MissionFileError
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned, ned_to_degrees
from dronemon.mission import Mission, field_centre, lay_frame, mission_obstacles
from dronemon.preflight import Relief
from dronemon.runner.profile import Profile
from dronemon.types import FloatArray
from dronemon.vision.built_up import BuiltUp
from dronemon.vision.envelope import Envelope
from dronemon.vision.heights import HeightGrid, read_heights
from dronemon.vision.surface import Plane, Surface
from dronemon.vision.terrain import Terrain
from dronemon.vision.view import needed_altitude_m, needed_px_per_m

_MOST_LOOKS = 500
"""Along each side of the area, for its highest ground."""


def surface_of(mission: Mission, frame: AreaFrame, home: GeoPoint, origin: GeoPoint) -> Surface:
    """The ground of a flight, and what stands on it. Raises as `ground_of`."""
    ground, obstacles = ground_of(mission, frame, home, origin), mission_obstacles(mission)
    return BuiltUp(ground, frame, obstacles) if obstacles else ground


def ground_of(
    mission: Mission, frame: AreaFrame, home: GeoPoint, origin: GeoPoint
) -> Plane | Terrain:
    """The same without it. Raises MissionFileError for a terrain that does not cover the flight.

    origin: of the frame
    """
    if mission.area.terrain is None:
        return Plane(frame.ground_down_m)
    terrain, _ = _surveyed(mission, mission.area.terrain, frame, home, origin)
    return terrain


def profile_over(
    ground: Plane | Terrain, mission: Mission, frame: AreaFrame, origin: GeoPoint
) -> Profile:
    """How high the patrol is over each place of a ground from `ground_of`; origin: as there."""
    path, flight = mission.area.terrain, mission.flight
    if not (flight.follow_terrain and path and isinstance(ground, Terrain)):
        return Profile(Plane(frame.ground_down_m), flight.altitude_m)
    grid = _enveloped(path, flight.steepest)
    return Profile(Envelope(grid, origin, ground.level_down_m), flight.altitude_m)


@cache
def _enveloped(path: str, steepest: float) -> HeightGrid:
    return read_heights(path).enveloped(steepest)


def relief_of(
    mission: Mission, frame: AreaFrame, home: GeoPoint, origin: GeoPoint
) -> Relief | None:
    """How high the ground is where a flight goes; None where the mission takes it for flat.

    As `surface_of`.
    """
    if mission.area.terrain is None:
        return None
    terrain, places_m = _surveyed(mission, mission.area.terrain, frame, home, origin)
    downs_m = terrain.down_m(places_m)
    profile, px = profile_over(terrain, mission, frame, origin), needed_px_per_m(mission)
    over_m = profile.heights_m(places_m, downs_m)
    return Relief(
        highest_m=frame.ground_down_m - float(downs_m.min()),
        lowest_m=frame.ground_down_m - float(downs_m.max()),
        least_m=float(over_m.min()),
        most_m=float(over_m.max()),
        top_m=float(profile.heights_m(places_m, frame.ground_down_m).max()),
        px_m=mission.camera.model.focal_px,
        needed_m=needed_altitude_m(mission),
        needed_px_per_m=px if px is not None else 0.0,
    )


def describe_relief(mission: Mission) -> str:
    """The same in words, before it is known where home is; the mission has a terrain.

    Raises as `surface_of`, and MissionFileError for a file that is none.
    """
    assert mission.area.terrain is not None
    read_heights(mission.area.terrain)
    if (centre := field_centre(mission.area)) is None:
        return f"as in {mission.area.terrain}; preflight compares it, once home is known"
    relief = relief_of(mission, lay_frame(mission, (0.0, 0.0), 0.0), centre, centre)
    assert relief is not None  # it has a terrain
    least_m, most_m = relief.least_m, relief.most_m
    pixels = ""
    if least_m > 0.0:
        pixels = f", {relief.px_m / most_m:.1f} to {relief.px_m / least_m:.1f} pixels a metre"
    return (
        f"{relief.lowest_m:+.0f} to {relief.highest_m:+.0f} m from the area's middle; taken off "
        f"there, {least_m:.0f} to {most_m:.0f} m below the flight{pixels}"
    )


def _surveyed(
    mission: Mission, path: str, frame: AreaFrame, home: GeoPoint, origin: GeoPoint
) -> tuple[Terrain, FloatArray]:
    """A file's ground, and the places where it was looked at. -> (..., 2) north, east

    Those are all over the area's box and on the way from home; for a flight that follows the
    ground, over all ways between home and the area: it is no higher on these.

    Raises MissionFileError where that is not known.
    """
    grid, home_ned_m = read_heights(path), geo_to_ned(home, origin)[:2]
    terrain = Terrain(grid, origin, home_ned_m, frame.ground_down_m)
    across_m = float(np.max(frame.side_m * frame.arena.extent_au))
    num_looks = int(min(across_m / grid.cell_m + 2, _MOST_LOOKS))
    places_m = frame.au_to_ned(frame.arena.grid(num_looks))
    nearest_m = places_m[np.linalg.norm(places_m - home_ned_m, axis=1).argmin()]
    ways_m = [np.linspace(home_ned_m, nearest_m, num_looks)]
    if mission.flight.follow_terrain:
        ways_m.append(_between(places_m, home_ned_m, num_looks))
    places_m = np.concatenate([places_m, *ways_m])
    if (is_unknown := np.isnan(terrain.down_m(places_m))).any():
        latitude, longitude = ned_to_degrees(places_m[is_unknown][0], origin).tolist()
        south, west, north, east = grid.bounds_deg
        raise MissionFileError(
            f"{path}: has no height at {latitude:.5f}, {longitude:.5f}, and so it has no heights "
            f"of all the area and of the ways from the take-off; it reaches from {south:.5f}, "
            f"{west:.5f} to {north:.5f}, {east:.5f}; name a larger grid, or one without gaps, or "
            "see whether the area lies where it should"
        )
    return terrain, places_m


def _between(places_m: FloatArray, home_m: FloatArray, num_looks: int) -> FloatArray:
    """Places in the hull of others and home, so many along each side. places_m: (n, 2)."""
    hull = ConvexHull(np.concatenate([places_m, home_m[None]]))
    bounds = zip(hull.min_bound, hull.max_bound, strict=True)
    sides = [np.linspace(low, high, num_looks) for low, high in bounds]
    box_m = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    is_in = (box_m @ hull.equations[:, :2].T + hull.equations[:, 2] <= 0.0).all(axis=1)
    inside_m: FloatArray = box_m[is_in]
    return inside_m
