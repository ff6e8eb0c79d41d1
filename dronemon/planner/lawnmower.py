"""Boustrophedon coverage: parallel lanes flown back and forth, blind to what is seen.

Source: paper, section V-A, after Choset (2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.planner.motion import ARRIVED_AU
from dronemon.planner.planner import Briefing, Snapshot, Waypoint
from dronemon.types import FloatArray

if TYPE_CHECKING:
    from dronemon.roadmap import Roadmap

NUM_LANES = 4
"""Even, so that a sweep closes; chosen among 2 to 10 on development seeds, see `sweep_track`."""


def sweep_track(arena: Arena = ARENA) -> FloatArray:
    """Corners of a closed sweep of the arena, flown round and round. -> (2 NUM_LANES, 2) au.

    Lanes lie 1/n apart and half of that inside the border. All but the first and the last stop
    short of one side, where the way back runs: a closed sweep returns to every place after the
    same time, which one that retraces its lanes does not.

    Four lanes gave mean Unc 0.794 on development seeds (10000 to 10009, N = 4, r_v = 1/30 and
    1/10). Two to ten lanes, other distances from the border, and sweeps that fly back to their
    start, retrace their lanes or cross the last ones at right angles gave 0.795 to 0.86.
    """
    spacing = 1.0 / NUM_LANES
    near, far = spacing / 2.0, 1.0 - spacing / 2.0
    corners: list[tuple[float, float]] = []
    for lane in range(NUM_LANES):
        y = spacing * (lane + 0.5)
        inner = near if lane in (0, NUM_LANES - 1) else near + spacing
        ends = ((inner, y), (far, y))
        corners += ends if lane % 2 == 0 else ends[::-1]
    low_au, _ = arena.bounds
    track_au: FloatArray = low_au + arena.extent_au * np.array(corners)
    return track_au


def sweep_length_au(track_au: FloatArray) -> float:
    """Length of one closed sweep, after which every lane was flown once. track_au: (C, 2) au."""
    return float(np.linalg.norm(track_au - np.roll(track_au, 1, axis=0), axis=-1).sum())


@dataclass(slots=True, kw_only=True)
class Sweep:
    """Progress along a closed track that is entered at its nearest corner.

    track_au: (C, 2) corners
    """

    track_au: FloatArray
    corner: int | None = None

    def next_corner(self, position_au: FloatArray) -> FloatArray:
        """Corner to fly to from here: the same one until it is reached, then the next. -> (2,)."""
        distances = np.linalg.norm(self.track_au - position_au, axis=-1)
        if self.corner is None:
            self.corner = int(np.argmin(distances))
        if distances[self.corner] <= ARRIVED_AU:
            self.corner = (self.corner + 1) % len(self.track_au)
        corner_au: FloatArray = self.track_au[self.corner]
        return corner_au


class Lawnmower:
    """Flies the closed sweep from its nearest corner on."""

    name = "lawnmower"

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Begin at the corner nearest to wherever the mission starts."""
        self._sweep = Sweep(track_au=sweep_track(briefing.arena))

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """Give the next corner."""
        return Waypoint(position_au=self._sweep.next_corner(snapshot.position_au))
