"""Small moves that planners share, and what a waypoint must be."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from dronemon.arena import Arena
from dronemon.planner.planner import Waypoint
from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.types import FloatArray

ARRIVED_AU = 1e-6
"""Distance at which a point counts as reached; no waypoint may be nearer: see `waypoint_flaw`."""
ORBIT_RADIUS_AU = 0.05
ORBIT_STEP_RAD = math.pi / 3.0


def waypoint_flaw(waypoint: object, here_au: FloatArray, arena: Arena) -> str | None:
    """Why a planner's answer cannot be flown to; None if it can. here_au: (2,) au."""
    if not isinstance(waypoint, Waypoint):
        return f"{waypoint!r:.80}, which is no Waypoint"
    waypoint_au = np.asarray(waypoint.position_au)
    if waypoint_au.shape != (2,) or waypoint_au.dtype.kind not in "fiu":
        return f"waypoint {waypoint.position_au!r:.80}, which is not two numbers"
    if not isinstance(waypoint.node, int | np.integer | None):
        return f"node {waypoint.node!r:.80}, which is no number of a node"
    if not np.isfinite(waypoint_au).all():
        return f"waypoint {waypoint_au}, which is no place"
    if not arena.segment_is_free(here_au, waypoint_au):
        return f"waypoint {waypoint_au}, which is not in the arena"
    if math.dist(waypoint_au, here_au) <= ARRIVED_AU:
        return (
            f"waypoint {waypoint_au}, which is where the agent is; it cannot stop, so give one"
            f" farther than {ARRIVED_AU:g} au"
        )
    return None


def until_measurement_au(flown_au: float) -> float:
    """Distance from here to the next measurement; a whole interval where one was just taken."""
    since = math.fmod(flown_au, MEASUREMENT_INTERVAL_AU)
    left = MEASUREMENT_INTERVAL_AU - since
    return left if left > ARRIVED_AU else MEASUREMENT_INTERVAL_AU


def step_towards(position_au: FloatArray, goal_au: FloatArray, step_au: float) -> FloatArray:
    """Point at most `step_au` from here on the straight line to the goal. (2,), (2,) -> (2,)."""
    offset = goal_au - position_au
    distance = math.hypot(offset[0], offset[1])
    return goal_au if distance <= step_au else position_au + offset * (step_au / distance)


def way_length_au(here_au: FloatArray, way_au: FloatArray) -> float:
    """Length of a way from here. here_au: (2,); way_au: (K, 2) places one after the other."""
    return sum(
        float(np.linalg.norm(to_au - at_au)) for at_au, to_au in pairwise([here_au, *way_au])
    )


def orbit(position_au: FloatArray, centre_au: FloatArray, arena: Arena) -> FloatArray:
    """Next corner of a small hexagon around a place, for an agent that cannot stop. -> (2,).

    It is moved to where there is room for it. Where there is none nearby, its corners are moved,
    and one that is too near then is left out.
    """
    centre = arena.clip_free(centre_au, ORBIT_RADIUS_AU)
    if math.dist(centre, centre_au) > 2.0 * ORBIT_RADIUS_AU:
        centre = centre_au
    offset = position_au - centre
    bearings = [math.atan2(offset[1], offset[0]) + ORBIT_STEP_RAD * step for step in range(1, 7)]
    around = ORBIT_RADIUS_AU * np.array([[math.cos(b), math.sin(b)] for b in bearings])
    corners = arena.clip_free(centre + around)
    away = np.linalg.norm(corners - position_au, axis=-1)
    is_far = away > min(ORBIT_RADIUS_AU / 2.0, 0.99 * away.max())
    corner: FloatArray = corners[np.argmax(is_far)]
    return corner
