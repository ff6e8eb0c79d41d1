"""How goals are flown to in the search, compiled: straight or along a roadmap's shortest paths.

Also the arena's compiled twin: what `dronemon.arena` says of places, by its bounds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.types import FloatArray, IntArray

_ARRIVED_AU = 0.05
NEAREST_CELLS = 64
"""Cells along each axis of the table of nearest nodes."""


class Ground(NamedTuple):
    """How goals are flown to: over a roadmap, or straight if it has no nodes.

    nodes:    (V, 2) au
    next_hop: (V, V) int64 as `Roadmap.next_hop`
    nearest:  (C, C) int64 node nearest to each cell of the arena
    bounds:   (2, 2) au the arena's
    """

    nodes: FloatArray
    next_hop: IntArray
    nearest: IntArray
    bounds: FloatArray


@njit(cache=True, fastmath=True, nogil=True)
def is_inside(bounds, x, y):  # type: ignore[no-untyped-def]
    """Whether a place is in the arena."""
    return bounds[0, 0] <= x <= bounds[1, 0] and bounds[0, 1] <= y <= bounds[1, 1]


@njit(cache=True, fastmath=True, nogil=True)
def clipped(bounds, x, y):  # type: ignore[no-untyped-def]
    """Nearest place in the arena. -> x, y."""
    return min(max(x, bounds[0, 0]), bounds[1, 0]), min(max(y, bounds[0, 1]), bounds[1, 1])


@njit(cache=True, fastmath=True, nogil=True)
def drawn(bounds, rng):  # type: ignore[no-untyped-def]
    """Draw a place of the arena. -> x, y."""
    x = bounds[0, 0] + (bounds[1, 0] - bounds[0, 0]) * rng.random()
    y = bounds[0, 1] + (bounds[1, 1] - bounds[0, 1]) * rng.random()
    return x, y


@njit(cache=True, fastmath=True, nogil=True)
def cell(bounds, x, y, size):  # type: ignore[no-untyped-def]
    """Which of size * size equal cells a place of the arena lies in. -> column, row."""
    column = int((x - bounds[0, 0]) / (bounds[1, 0] - bounds[0, 0]) * size)
    row = int((y - bounds[0, 1]) / (bounds[1, 1] - bounds[0, 1]) * size)
    return min(column, size - 1), min(row, size - 1)


@njit(cache=True, fastmath=True, nogil=True)
def nearest_node(ground, x, y):  # type: ignore[no-untyped-def]
    """Node at a place of the arena, or -1 in free flight."""
    if ground.nodes.shape[0] == 0:
        return -1
    column, row = cell(ground.bounds, x, y, NEAREST_CELLS)
    return ground.nearest[column, row]


@njit(cache=True, fastmath=True, nogil=True)
def step_inside(bounds, x, y, dx, dy):  # type: ignore[no-untyped-def]
    """Step (dx, dy) from inside the arena; along the border, as far, if it would lead out."""
    low_x, low_y, high_x, high_y = bounds[0, 0], bounds[0, 1], bounds[1, 0], bounds[1, 1]
    to_x, to_y = x + dx, y + dy
    if to_x < low_x or to_x > high_x:
        to_x = min(max(to_x, low_x), high_x)
        to_y = y + math.copysign(math.sqrt(dx * dx + dy * dy - (to_x - x) ** 2), dy)
        if to_y < low_y or to_y > high_y:
            to_y = 2.0 * y - to_y
    elif to_y < low_y or to_y > high_y:
        to_y = min(max(to_y, low_y), high_y)
        to_x = x + math.copysign(math.sqrt(dx * dx + dy * dy - (to_y - y) ** 2), dx)
        if to_x < low_x or to_x > high_x:
            to_x = 2.0 * x - to_x
    return to_x, to_y


# The compiled twin of `world.sensing.sample_leg`, to which a test holds it: 0.12 us a leg, over 20
# legs of a roadmap, where `python -m timeit -s "import numpy as np; from dronemon.world import
# sample_leg; a, b = np.random.default_rng(0).random((2, 2))" "sample_leg(a, b, 0.05)"` gives 94 us.
@njit(cache=True, fastmath=True, nogil=True)
def follow(goal_x, goal_y, goal_node, ground, path, k, x, y, node, due):  # type: ignore[no-untyped-def]
    """Fly to a goal, by its node if it has one, and write where measurements fall.

    -> k, x, y, node, due, first hop
    """
    horizon = path.shape[0]
    hop = -1
    if goal_node < 0:
        while k < horizon:
            dx, dy = goal_x - x, goal_y - y
            distance = math.sqrt(dx * dx + dy * dy)
            if distance < _ARRIVED_AU:
                break
            x, y = step_inside(ground.bounds, x, y, due * dx / distance, due * dy / distance)
            due = MEASUREMENT_INTERVAL_AU
            path[k, 0], path[k, 1] = x, y
            k += 1
        return k, x, y, node, due, hop
    while node != goal_node and k < horizon:
        node = ground.next_hop[node, goal_node]
        if hop < 0:
            hop = node
        to_x, to_y = ground.nodes[node, 0], ground.nodes[node, 1]
        left = math.sqrt((to_x - x) ** 2 + (to_y - y) ** 2)
        while due <= left and k < horizon:
            x += (to_x - x) * due / left
            y += (to_y - y) * due / left
            left -= due
            due = MEASUREMENT_INTERVAL_AU
            path[k, 0], path[k, 1] = x, y
            k += 1
        due -= left
        x, y = to_x, to_y
    return k, x, y, node, due, hop
