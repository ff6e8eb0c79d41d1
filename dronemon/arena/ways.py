"""Shortest ways inside a region: along its corners, by a visibility graph.

Source: Lozano-Perez and Wesley (1979).
"""

from __future__ import annotations

import numpy as np

from dronemon.arena.region import Region
from dronemon.types import FloatArray, IntArray

CLEAR_AU = 1e-4
"""How far ways stay off the corners that they turn at, so that rounding takes none across."""


class Ways:
    """The corners at which shortest ways turn, and how far they are apart.

    corners_au:  (M, 2)
    distance_au: (M, M) length of the shortest way between two
    next_corner: (M, M) int64 the first corner on it; the corner itself on the diagonal
    """

    def __init__(self, region: Region) -> None:
        from scipy.sparse.csgraph import shortest_path  # slow, and of fields alone

        self._region = region
        self.corners_au = np.concatenate([turning_points(ring) for ring in region.rings])
        self.corners_au = self.corners_au[region.contains(self.corners_au)]
        count = len(self.corners_au)
        straight = self._straight(self.corners_au, self.corners_au)
        self.distance_au, towards = shortest_path(straight, return_predecessors=True)
        # Undirected: what comes last on the way there comes first on the way back.
        self.next_corner: IntArray = np.ascontiguousarray(towards.T, dtype=np.int64)
        np.fill_diagonal(self.next_corner, np.arange(count))

    def distances(self, starts_au: FloatArray, ends_au: FloatArray) -> FloatArray:
        """Lengths of the shortest ways, infinite to and from outside. (n, 2), (m, 2) -> (n, m)."""
        out, back = (
            self._straight(places_au, self.corners_au) for places_au in (starts_au, ends_au)
        )
        lengths = self._straight(starts_au, ends_au)
        for row in np.flatnonzero(np.isinf(lengths).any(axis=1)):
            by_corner = (out[row, :, None] + self.distance_au).min(axis=0, initial=np.inf)
            around = (by_corner + back).min(axis=1, initial=np.inf)
            lengths[row] = np.minimum(lengths[row], around)
        return lengths

    def _straight(self, starts_au: FloatArray, ends_au: FloatArray) -> FloatArray:
        """Straight distances, infinite where they are not free. (n, 2), (m, 2) -> (n, m)."""
        lengths: FloatArray = np.linalg.norm(starts_au[:, None] - ends_au, axis=-1)
        lengths[~self._region.is_free(starts_au[:, None], ends_au)] = np.inf
        return lengths

    def way(self, start_au: FloatArray, end_au: FloatArray) -> FloatArray:
        """Places to fly to straight, one after the other, the end last. (2,), (2,) -> (K, 2) au.

        ValueError where no way leads there, since one of the two is outside.
        """
        if self._region.is_free(start_au, end_au):
            return np.asarray(end_au, dtype=np.float64)[None]
        out, back = (
            np.linalg.norm(self.corners_au - place, axis=-1) for place in (start_au, end_au)
        )
        out[~self._region.is_free(start_au, self.corners_au)] = np.inf
        out[out < CLEAR_AU / 2.0] = np.inf  # one is there, and sees whatever corner comes next
        back[~self._region.is_free(self.corners_au, end_au)] = np.inf
        length = out[:, None] + self.distance_au + back
        if not np.isfinite(length).any():
            raise ValueError(f"no way leads from {start_au} to {end_au} au")
        corner, last = np.unravel_index(length.argmin(), length.shape)
        turns = [corner]
        while turns[-1] != last:
            turns.append(self.next_corner[turns[-1], last])
        return np.concatenate([self.corners_au[turns], np.asarray(end_au)[None]])


def turning_points(ring: FloatArray) -> FloatArray:
    """Corners at which the inside is more than a half turn, a little off them. (n, 2) -> (m, 2)."""
    came = ring - np.roll(ring, 1, axis=0)
    came /= np.linalg.norm(came, axis=-1, keepdims=True)
    left = np.roll(came, -1, axis=0)
    turns_right = came[:, 0] * left[:, 1] - came[:, 1] * left[:, 0] < -1e-12
    off = (came - left)[turns_right]
    off *= CLEAR_AU / np.linalg.norm(off, axis=-1, keepdims=True)
    points: FloatArray = ring[turns_right] + off
    return points
