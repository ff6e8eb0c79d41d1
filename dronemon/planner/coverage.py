"""Coverage of a field of any form: parallel lanes through it, joined to a short closed track.

A lane is cut by whatever is in its way, and every piece of it is flown once. Choset (2000) flies
them cell by cell; here the order of the pieces is a short tour of all, which goes to and fro in
what he would call a cell by itself.

Source: Choset (2000), "Coverage of known spaces: the boustrophedon cellular decomposition"; for the
tour Bähnemann et al. (2019), "Revisiting boustrophedon coverage path planning as a generalized
traveling salesman problem".
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from dronemon.arena import Arena, Region
from dronemon.planner.motion import ARRIVED_AU
from dronemon.types import FloatArray
from dronemon.world.targets import short_path

_BONDED_AU = -1e3
"""Taken for the distance between a lane's ends, so that no tour leaves out its flight."""


@lru_cache(maxsize=8)
def covering_track(arena: Arena, spacing_au: float) -> FloatArray:
    """Corners of a closed track near to every place where the agent may be. -> (C, 2) au.

    Its legs are free. Lanes lie `spacing_au` apart, or less, and end half of that inside; no place
    is farther than three quarters of it from the track.
    """
    lanes_au = _fewest_lanes(arena.free, spacing_au)
    while True:
        track_au = _joined(arena, lanes_au)
        legs_au = np.stack([track_au, np.roll(track_au, -1, axis=0)], axis=1)
        missed_au = arena.free.missed(legs_au, 0.75 * spacing_au)
        if not len(missed_au):
            track_au.setflags(write=False)  # all that ask share it
            return track_au
        lanes_au = np.concatenate([lanes_au, np.stack([missed_au, missed_au], axis=1)])


def _fewest_lanes(free: Region, spacing_au: float) -> FloatArray:
    """Lanes along that edge which fewest are along. -> (L, 2, 2) au."""
    along = free.edges[:, 2:] - free.edges[:, :2]
    degrees = np.unique(np.rint(np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 180.0) % 180.0)
    return min((_lanes(free, math.radians(d), spacing_au) for d in degrees), key=len)


def _lanes(free: Region, bearing_rad: float, spacing_au: float) -> FloatArray:
    """Pieces of lanes of one direction. -> (L, 2, 2) au start and end of each."""
    ahead = np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    axes = np.stack([ahead, [-ahead[1], ahead[0]]])
    corners = free.edges[:, :2] @ axes.T
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    count = math.ceil((top - bottom) / spacing_au - 1e-9)
    across = bottom + (np.arange(count) + 0.5) * (top - bottom) / count
    lines = np.stack(
        [np.stack([np.full(count, x), across], axis=-1) for x in (left, right)], axis=1
    )
    chords = free.chords(lines @ axes)
    lengths = np.linalg.norm(chords[:, 1] - chords[:, 0], axis=-1)
    cut = np.minimum(0.5 * spacing_au / lengths, 0.4)[:, None]
    start, end = chords[:, 0], chords[:, 1]
    return np.stack([start + cut * (end - start), end + cut * (start - end)], axis=1)


def _joined(arena: Arena, lanes_au: FloatArray) -> FloatArray:
    """Fly lanes in the order of a short tour, by free ways. (L, 2, 2) -> (C, 2) au, closed."""
    ends_au = lanes_au.reshape(-1, 2)
    distances_au = arena.distances(ends_au, ends_au)
    starts = np.arange(0, len(ends_au), 2)
    distances_au[starts, starts + 1] = distances_au[starts + 1, starts] = _BONDED_AU
    order = short_path(distances_au)  # from one end of the first lane to the other, and along it
    legs = zip(order, np.roll(order, -1), strict=True)
    track_au = np.concatenate([arena.way(ends_au[a], ends_au[b]) for a, b in legs])
    apart_au = np.linalg.norm(track_au - np.roll(track_au, 1, axis=0), axis=-1)
    distinct_au: FloatArray = track_au[apart_au > ARRIVED_AU]
    return distinct_au
