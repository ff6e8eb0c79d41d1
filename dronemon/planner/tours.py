"""Short tours of places, by the distances between them."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np

from dronemon.types import FloatArray, IntArray

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


def short_path(distances_au: FloatArray) -> IntArray:
    """Order of a short open path from the first point to the second: nearest neighbour and 2-opt.

    Only correctly rounded elementwise operations decide, so the order is the same on any machine.

    distances_au: (P, P) -> (P,) indices, 0 first and 1 last
    """
    order = _nearest_neighbour_order(distances_au)
    num_legs = len(order) - 1
    is_pair = np.triu(np.ones((num_legs, num_legs), dtype=bool), k=2)
    while True:
        along = distances_au[np.ix_(order, order)]
        legs = along[np.arange(num_legs), np.arange(1, num_legs + 1)]
        # Cutting legs i and j and walking what lies between them backwards.
        change = along[:-1, :-1] + along[1:, 1:] - legs[:, None] - legs[None]
        change[~is_pair] = 0.0
        first, second = divmod(int(np.argmin(change)), num_legs)
        if not change[first, second] < -1e-9:  # nor where it is no number, for no way leads there
            return order
        order[first + 1 : second + 1] = order[first + 1 : second + 1][::-1]


def _nearest_neighbour_order(distances_au: FloatArray) -> IntArray:
    """Order from point 0, always to the nearest point left, point 1 last. (P, P) -> (P,)."""
    count = len(distances_au)
    is_left = np.ones(count, dtype=bool)
    is_left[:2] = False
    order = np.zeros(count, dtype=np.int64)
    order[-1] = 1
    for position in range(1, count - 1):
        nearest = int(np.argmin(np.where(is_left, distances_au[order[position - 1]], np.inf)))
        order[position] = nearest
        is_left[nearest] = False
    return order
