"""How goals are flown to in the search: straight or along a roadmap's shortest paths, compiled."""

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

    nodes: (V, 2); next_hop: (V, V); nearest: (C, C) node nearest to each cell of the square
    """

    nodes: FloatArray
    next_hop: IntArray
    nearest: IntArray


@njit(cache=True, fastmath=True, nogil=True)
def nearest_node(ground, x, y):  # type: ignore[no-untyped-def]
    """Node at a place of the square, or -1 in free flight."""
    if ground.nodes.shape[0] == 0:
        return -1
    last = NEAREST_CELLS - 1
    return ground.nearest[min(int(x * NEAREST_CELLS), last), min(int(y * NEAREST_CELLS), last)]


@njit(cache=True, fastmath=True, nogil=True)
def step_inside(x, y, dx, dy):  # type: ignore[no-untyped-def]
    """Step (dx, dy) from inside the square; along the border, as far, if it would lead out."""
    to_x, to_y = x + dx, y + dy
    if to_x < 0.0 or to_x > 1.0:
        to_x = min(max(to_x, 0.0), 1.0)
        to_y = y + math.copysign(math.sqrt(dx * dx + dy * dy - (to_x - x) ** 2), dy)
        if to_y < 0.0 or to_y > 1.0:
            to_y = 2.0 * y - to_y
    elif to_y < 0.0 or to_y > 1.0:
        to_y = min(max(to_y, 0.0), 1.0)
        to_x = x + math.copysign(math.sqrt(dx * dx + dy * dy - (to_y - y) ** 2), dx)
        if to_x < 0.0 or to_x > 1.0:
            to_x = 2.0 * x - to_x
    return to_x, to_y


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
            x, y = step_inside(x, y, due * dx / distance, due * dy / distance)
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
