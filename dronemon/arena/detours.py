"""Ways that keep out of discs as well: for a while, about what moves."""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

import numpy as np
from shapely import Polygon

from dronemon.arena.arena import Arena
from dronemon.arena.region import ROUNDING_AU, Region
from dronemon.arena.ways import turning_points
from dronemon.types import BoolArray, FloatArray

_NUM_SIDES = 12
"""Of the polygon about a disc, whose corners are so 3.5 % of the radius outside of it."""
_ANGLES = 2.0 * np.pi * np.arange(_NUM_SIDES) / _NUM_SIDES
_CORNERS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1) / math.cos(np.pi / _NUM_SIDES)


def detour(
    arena: Arena, start_au: FloatArray, goal_au: FloatArray, discs_au: FloatArray
) -> FloatArray:
    """Shortest way for the agent that goes into no disc: places to fly to straight.

    Out of discs that it begins in it leads by the nearest way first. It ends at the goal, or as
    near to that as a way leads.

    start_au, goal_au: (2,)
    discs_au:          (D, 3) x, y and radius
    -> (K, 2) au, none where there is no way out
    """
    apart_au = np.linalg.norm(discs_au[:, None, :2] - discs_au[:, :2], axis=-1)
    are_joined = apart_au < np.add.outer(discs_au[:, 2], discs_au[:, 2])
    is_near = np.zeros(len(discs_au), dtype=np.bool_)
    while True:
        # Few discs are near a way, and around the others none is to be sought.
        way_au = _way(arena, start_au, goal_au, discs_au[is_near])
        entered = into(np.concatenate([start_au[None], way_au]), discs_au) & ~is_near
        if not entered.any():
            return way_au
        is_near |= are_joined[entered].any(axis=0)


def into(path_au: FloatArray, discs_au: FloatArray) -> BoolArray:
    """Which discs a path goes through or begins in. (K, 2), (D, 3) -> (D,)."""
    centres_au, radii_au = discs_au[:, :2], discs_au[:, 2]
    nearest_au = np.linalg.norm(centres_au - path_au[0], axis=-1)
    for a_au, b_au in pairwise(path_au):
        along = b_au - a_au
        share = (centres_au - a_au) @ along / max(float(along @ along), 1e-30)
        foot_au = a_au + np.clip(share, 0.0, 1.0)[:, None] * along
        nearest_au = np.minimum(nearest_au, np.linalg.norm(centres_au - foot_au, axis=-1))
    inside: BoolArray = nearest_au < radii_au - ROUNDING_AU
    return inside


def _way(
    arena: Arena, start_au: FloatArray, goal_au: FloatArray, discs_au: FloatArray
) -> FloatArray:
    """The same, out of all of these discs."""
    if not len(discs_au):
        return arena.way(start_au, arena.clip_free(goal_au))
    polygons = [Polygon(x_y + radius * _CORNERS) for *x_y, radius in discs_au]
    parts = arena.free.parts(0.0, polygons)
    begin_au, part = start_au, next((p for p in parts if p.contains(start_au)), None)
    if part is None:
        inside = [shape for shape in polygons if Region(shape).contains(start_au)]
        others = [shape for shape in polygons if shape not in inside]
        begin_au, part = _exit(start_au, parts, arena.free.parts(0.0, others))
    if part is None:
        return np.empty((0, 2))
    way_au = _shortest(part, begin_au, part.clip(goal_au))
    return way_au if begin_au is start_au else np.concatenate([begin_au[None], way_au])


def _exit(
    start_au: FloatArray, parts: list[Region], about: list[Region]
) -> tuple[FloatArray, Region | None]:
    """The nearest place to come out at, and the part that it is of; none where there is none.

    parts: what is free; about: the same, and what is left of the discs that it begins in
    """
    here = next((region for region in about if region.contains(start_au)), None)
    found: tuple[FloatArray, Region | None] = start_au, None
    least_au = math.inf
    for part in parts:
        places_au = np.concatenate([part.clip(start_au)[None], *part.rings])
        if here is not None:  # else it is outside of the arena, too
            places_au = places_au[here.is_free(start_au, places_au)]
        away_au = np.linalg.norm(places_au - start_au, axis=-1)
        if len(away_au) and away_au.min() < least_au:
            least_au = float(away_au.min())
            found = places_au[away_au.argmin()], part
    return found


def _shortest(region: Region, start_au: FloatArray, end_au: FloatArray) -> FloatArray:
    """Shortest way inside a region that has both, along its corners: places, the end last.

    One way alone is sought, unlike in `Ways`, so that only what is seen from places on the way to
    the end is asked for. Source: Hart, Nilsson and Raphael (1968), A*.
    """
    corners_au = np.concatenate([turning_points(ring) for ring in region.rings])
    places_au = np.concatenate([end_au[None], corners_au[region.contains(corners_au)]])
    left_au = np.linalg.norm(places_au - end_au, axis=-1)
    before = dict[int, int]()
    ways: list[tuple[float, float, int, int]] = [(0.0, 0.0, -1, -1)]  # most, so far, at, from
    while ways:
        _, length_au, at, came_from = heapq.heappop(ways)
        if at in before:
            continue
        before[at] = came_from
        if at == 0:
            turns = [0]
            while (turn := before[turns[-1]]) >= 0:
                turns.append(turn)
            return places_au[turns[::-1]]
        here_au = places_au[at] if at >= 0 else start_au
        rest = np.array([place for place in range(len(places_au)) if place not in before])
        for to in rest[region.is_free(here_au, places_au[rest])].tolist():
            so_far_au = length_au + math.dist(here_au, places_au[to])
            heapq.heappush(ways, (so_far_au + left_au[to], so_far_au, to, at))
    return np.empty((0, 2))
