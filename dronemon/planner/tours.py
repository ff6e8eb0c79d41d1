"""Short tours of places, by the distances between them."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np

from dronemon.types import FloatArray, IntArray
from dronemon.world.targets import short_path

EXACT_POINTS = 8
"""Most points whose shortest loop is sought among all."""


@cache
def _all_loops(count: int) -> IntArray:
    """Every order that begins with 0. -> ((count - 1)!, count)."""
    return np.array([(0, *rest) for rest in permutations(range(1, count))], dtype=np.int64)


def shortest_loop(distances_au: FloatArray) -> IntArray:
    """Order of a shortest closed tour that begins with point 0. (N, N) -> (N,) indices.

    Exact for up to eight points; for more, nearest neighbour and 2-opt on the open path from
    point 0 back to itself.
    """
    count = len(distances_au)
    if count > EXACT_POINTS:
        again = np.maximum(np.arange(count + 1) - 1, 0)
        order = short_path(distances_au[np.ix_(again, again)])
        loop: IntArray = again[order[:-1]]
        return loop
    loops = _all_loops(count)
    lengths = distances_au[loops, np.roll(loops, -1, axis=1)].sum(axis=1)
    shortest: IntArray = loops[np.argmin(lengths)]
    return shortest
