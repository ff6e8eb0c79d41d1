"""The shortest closed tour through a few points: exact for up to eight of them."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np

from dronemon.types import FloatArray, IntArray
from dronemon.world.targets import short_path_order

EXACT_POINTS = 8


@cache
def _all_loops(count: int) -> IntArray:
    """Every order that begins with 0. -> ((count - 1)!, count)."""
    return np.array([(0, *rest) for rest in permutations(range(1, count))], dtype=np.int64)


def shortest_loop(points_au: FloatArray) -> IntArray:
    """Order of a shortest closed tour that begins with point 0. points_au: (N, 2) -> (N,) indices.

    Exact for up to eight points; for more, nearest neighbour and 2-opt on the open path from
    point 0 back to itself.
    """
    count = len(points_au)
    if count > EXACT_POINTS:
        order = short_path_order(np.concatenate([points_au[:1], points_au]))
        loop: IntArray = np.maximum(order[:-1] - 1, 0)
        return loop
    distances = np.linalg.norm(points_au[:, None] - points_au[None], axis=-1)
    loops = _all_loops(count)
    lengths = distances[loops, np.roll(loops, -1, axis=1)].sum(axis=1)
    shortest: IntArray = loops[np.argmin(lengths)]
    return shortest
