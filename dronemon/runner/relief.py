"""The ground that a flight looks at, flat or with hills."""

from __future__ import annotations

import numpy as np

from dronemon.errors import MissionFileError
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.mission import Mission
from dronemon.preflight import Relief
from dronemon.types import FloatArray
from dronemon.vision.heights import read_heights
from dronemon.vision.surface import Plane, Surface
from dronemon.vision.terrain import Terrain
from dronemon.vision.view import needed_altitude_m, needed_px_per_m

_MOST_LOOKS = 500
"""Along each side of the area, for its highest ground."""


def surface_of(mission: Mission, frame: AreaFrame, home: GeoPoint, origin: GeoPoint) -> Surface:
    """The ground of a flight. Raises MissionFileError for a terrain that does not cover it.

    origin: of the frame
    """
    if mission.area.terrain is None:
        return Plane(frame.ground_down_m)
    terrain, _ = _surveyed(mission.area.terrain, frame, home, origin)
    return terrain


def relief_of(
    mission: Mission, frame: AreaFrame, home: GeoPoint, origin: GeoPoint
) -> Relief | None:
    """How high the ground is where a flight goes; None where the mission takes it for flat.

    As `surface_of`.
    """
    if mission.area.terrain is None:
        return None
    _, downs_m = _surveyed(mission.area.terrain, frame, home, origin)
    px = needed_px_per_m(mission)
    return Relief(
        highest_m=frame.ground_down_m - float(downs_m.min()),
        lowest_m=frame.ground_down_m - float(downs_m.max()),
        px_m=mission.camera.model.focal_px,
        needed_m=needed_altitude_m(mission),
        needed_px_per_m=px if px is not None else 0.0,
    )


def _surveyed(
    path: str, frame: AreaFrame, home: GeoPoint, origin: GeoPoint
) -> tuple[Terrain, FloatArray]:
    """A file's ground, and how far down it is all over the area's box and on the way from home.

    Raises MissionFileError where that is not known.
    """
    grid, home_ned_m = read_heights(path), geo_to_ned(home, origin)[:2]
    terrain = Terrain(grid, origin, home_ned_m, frame.ground_down_m)
    across_m = float(np.max(frame.side_m * frame.arena.extent_au))
    num_looks = int(min(across_m / grid.cell_m + 2, _MOST_LOOKS))
    places_m = frame.au_to_ned(frame.arena.grid(num_looks))
    nearest_m = places_m[np.linalg.norm(places_m - home_ned_m, axis=1).argmin()]
    way_m = np.linspace(home_ned_m, nearest_m, num_looks)
    downs_m = terrain.down_m(np.concatenate([places_m, way_m]))
    if np.isnan(downs_m).any():
        raise MissionFileError(
            f"{path}: has no heights of all the area and of the take-off place, {home}; name a "
            "larger grid"
        )
    return terrain, downs_m
