"""Boustrophedon coverage: parallel lanes flown back and forth, blind to what is seen.

Source: paper, section V-A, after Choset (2000).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.planner.coverage import covering_track
from dronemon.planner.motion import ARRIVED_AU
from dronemon.planner.planner import Briefing, Snapshot, Waypoint
from dronemon.types import FloatArray

if TYPE_CHECKING:
    from dronemon.roadmap import Roadmap

LANE_SPACING_AU = 0.25
"""Chosen on development seeds, see `sweep_track`."""


def sweep_track(arena: Arena = ARENA) -> FloatArray:
    """Corners of a closed sweep of the arena, flown round and round. -> (C, 2) au.

    Four lanes gave mean Unc 0.794 in the square on development seeds (10000 to 10009, N = 4,
    r_v = 1/30 and 1/10). Two to ten lanes, other distances from the border, and sweeps that fly
    back to their start, retrace their lanes or cross the last ones at right angles gave 0.795 to
    0.86. Lanes lie as far apart in any other field.
    """
    if not arena.is_rectangle:
        return covering_track(arena, LANE_SPACING_AU)
    track_au: FloatArray = arena.bounds[0] + arena.extent_au * _closed_sweep(*arena.extent_au)
    return track_au


def _closed_sweep(width_au: float, height_au: float) -> FloatArray:
    """Corners of a sweep of a rectangle, in shares of its sides. -> (2 n, 2), n even to close it.

    Lanes lie 1/n apart and half of that inside the border. All but the first and the last stop
    short of one side, where the way back runs: a closed sweep returns to every place after the
    same time, which one that retraces its lanes does not.
    """
    num_lanes = 2 * max(1, round(height_au / (2.0 * LANE_SPACING_AU)))
    spacing, way_back = 1.0 / num_lanes, min(LANE_SPACING_AU / width_au, 0.25)
    near, far = way_back / 2.0, 1.0 - way_back / 2.0
    corners: list[tuple[float, float]] = []
    for lane in range(num_lanes):
        y = spacing * (lane + 0.5)
        inner = near if lane in (0, num_lanes - 1) else near + way_back
        ends = ((inner, y), (far, y))
        corners += ends if lane % 2 == 0 else ends[::-1]
    return np.array(corners)


def sweep_length_au(track_au: FloatArray) -> float:
    """Length of one closed sweep, after which every lane was flown once. track_au: (C, 2) au."""
    return float(np.linalg.norm(track_au - np.roll(track_au, 1, axis=0), axis=-1).sum())


class Sweep:
    """Progress along an arena's sweep, which is entered at its nearest corner.

    track_au: (C, 2) its corners
    """

    def __init__(self, arena: Arena = ARENA) -> None:
        self._arena = arena
        self.track_au = sweep_track(arena)
        self._corner: int | None = None

    def next_place(self, position_au: FloatArray) -> FloatArray:
        """Where to fly from here: towards the same corner until it is reached, then the next.

        -> (2,) au the corner, or the first turn of the way there
        """
        if self._corner is None:
            distances_au = self._arena.distances(position_au[None], self.track_au)
            self._corner = int(distances_au[0].argmin())
        if np.linalg.norm(self.track_au[self._corner] - position_au) <= ARRIVED_AU:
            self._corner = (self._corner + 1) % len(self.track_au)
        place_au: FloatArray = self._arena.way(position_au, self.track_au[self._corner])[0]
        return place_au


class Lawnmower:
    """Flies the closed sweep from its nearest corner on."""

    name = "lawnmower"

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Begin at the corner nearest to wherever the mission starts."""
        self._sweep = Sweep(briefing.arena)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """Give the next corner, or a turn on the way there."""
        return Waypoint(position_au=self._sweep.next_place(snapshot.position_au))
