"""How goals are flown to in the search, compiled: straight, around corners, or over a roadmap.

Also the arena's compiled twin: what `dronemon.arena` says of places and of ways.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dronemon.arena import Arena, Region
from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.roadmap import Roadmap
from dronemon.types import FloatArray, IntArray

_ARRIVED_AU = 0.05
NEAREST_CELLS = 64
"""Cells along each axis of the table of nearest nodes."""
_WALL_CELLS = 96
_SIGHT_CELLS = 48
_OUTSIDE, _ACROSS, _INSIDE = range(3)
_FAR = 1e9
"""Longer than any way, in au; fast arithmetic does not know infinity."""
_DRAWS = 64
"""Most places drawn to find one that is inside."""


class Walls(NamedTuple):
    """Where one may be: a box, or a polygon in it.

    bounds: (2, 2)  au the box's low and high corner
    edges:  (E, 4)  au start and end of each edge; none where all of the box is inside
    cells:  (C, C)  uint8 whether a cell of the box is inside, outside, or across an edge; no cells
                    without edges
    """

    bounds: FloatArray
    edges: FloatArray
    cells: NDArray[np.uint8]

    @classmethod
    def of(cls, arena: Arena, region: Region) -> Walls:
        """Those of a region of an arena: `field`, `free` or a part of one."""
        if arena.is_rectangle:
            return cls(arena.bounds, np.empty((0, 4)), np.empty((0, 0), dtype=np.uint8))
        half_au = arena.extent_au / (2 * _WALL_CELLS)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half_au
        is_in, is_out = region.holds(arena.cells(_WALL_CELLS, _WALL_CELLS)[:, None] + corners)
        cells = np.where(is_in, _INSIDE, np.where(is_out, _OUTSIDE, _ACROSS)).astype(np.uint8)
        return cls(arena.bounds, region.edges, cells.reshape(_WALL_CELLS, _WALL_CELLS))


class Turns(NamedTuple):
    """Where ways turn in free flight; all empty in a rectangle, where none does.

    edges:       (E, 4)    au what nothing may be flown across
    corners:     (M, 2)    au, as `Ways.corners_au`
    apart:       (M, M)    au shortest ways between them
    next_corner: (M, M)    int64, as `Ways.next_corner`
    sight:       (C, C, M) bool whether a corner may be seen from a cell of the box
    """

    edges: FloatArray
    corners: FloatArray
    apart: FloatArray
    next_corner: IntArray
    sight: NDArray[np.bool_]

    @classmethod
    def of(cls, arena: Arena) -> Turns:
        """Those of an arena; a corner is seen from a cell if from its centre or one beside."""
        if arena.is_rectangle:
            none = np.empty((0, 0))
            sight = np.empty((0, 0, 0), dtype=np.bool_)
            return cls(np.empty((0, 4)), np.empty((0, 2)), none, none.astype(np.int64), sight)
        ways, size = arena.ways, _SIGHT_CELLS
        cells_au = arena.free.clip(arena.cells(size, size))
        seen = arena.free.is_free(cells_au[:, None], ways.corners_au).reshape(size, size, -1)
        around = np.pad(seen, ((1, 1), (1, 1), (0, 0)))
        beside = [around[i : i + size, j : j + size] for i in range(3) for j in range(3)]
        return cls(
            edges=arena.free.edges,
            corners=ways.corners_au,
            apart=ways.distance_au,
            next_corner=ways.next_corner,
            sight=np.any(beside, axis=0),
        )


class Ground(NamedTuple):
    """How goals are flown to: over a roadmap, or freely if it has no nodes.

    nodes:    (V, 2) au
    next_hop: (V, V) int64 as `Roadmap.next_hop`
    nearest:  (C, C) int64 node nearest to each cell of the arena's box
    walls:    where goals may be
    turns:    how free flight goes around what is in the way
    """

    nodes: FloatArray
    next_hop: IntArray
    nearest: IntArray
    walls: Walls
    turns: Turns

    @classmethod
    def of(cls, arena: Arena, roadmap: Roadmap | None = None) -> Ground:
        """Free flight in an arena, or over a roadmap."""
        walls = Walls.of(arena, arena.goals)
        turns = Turns.of(arena)
        if roadmap is None:
            none = np.empty((0, 0), dtype=np.int64)
            return cls(np.empty((0, 2)), none, none, walls, turns)
        offset_au = arena.cells(NEAREST_CELLS, NEAREST_CELLS)[:, None] - roadmap.nodes_au
        nearest = np.linalg.norm(offset_au, axis=-1).argmin(axis=-1)
        return cls(
            nodes=np.ascontiguousarray(roadmap.nodes_au),
            next_hop=roadmap.next_hop,
            nearest=nearest.reshape(NEAREST_CELLS, NEAREST_CELLS),
            walls=walls,
            turns=turns,
        )


@njit(cache=True, fastmath=True, nogil=True, forceinline=True)
def is_inside(walls, x, y):  # type: ignore[no-untyped-def]
    """Whether a place is within walls."""
    bounds = walls.bounds
    if not (bounds[0, 0] <= x <= bounds[1, 0] and bounds[0, 1] <= y <= bounds[1, 1]):
        return False
    return walls.edges.shape[0] == 0 or _is_within_edges(walls, x, y)


@njit(cache=True, fastmath=True, nogil=True)
def _is_within_edges(walls, x, y):  # type: ignore[no-untyped-def]
    """Whether a place in the box of walls is within them, where these are not the box itself."""
    column, row = cell(walls.bounds, x, y, _WALL_CELLS, _WALL_CELLS)
    if walls.cells[column, row] != _ACROSS:
        return walls.cells[column, row] == _INSIDE
    inside = False
    for e in range(walls.edges.shape[0]):
        from_x, from_y, to_x, to_y = walls.edges[e]
        is_beside = (from_y > y) != (to_y > y)
        if is_beside and x < from_x + (y - from_y) / (to_y - from_y) * (to_x - from_x):
            inside = not inside
    return inside


@njit(cache=True, fastmath=True, nogil=True)
def clipped(walls, x, y):  # type: ignore[no-untyped-def]
    """Nearest place within walls. -> x, y."""
    bounds = walls.bounds
    if walls.edges.shape[0] > 0:
        return (x, y) if is_inside(walls, x, y) else _nearest_on(walls.edges, x, y)
    return min(max(x, bounds[0, 0]), bounds[1, 0]), min(max(y, bounds[0, 1]), bounds[1, 1])


@njit(cache=True, fastmath=True, nogil=True)
def _nearest_on(edges, x, y):  # type: ignore[no-untyped-def]
    """Nearest place on any edge. -> x, y."""
    nearest, at_x, at_y = 1e18, x, y
    for e in range(edges.shape[0]):
        from_x, from_y = edges[e, 0], edges[e, 1]
        dx, dy = edges[e, 2] - from_x, edges[e, 3] - from_y
        share = ((x - from_x) * dx + (y - from_y) * dy) / (dx * dx + dy * dy)
        share = min(max(share, 0.0), 1.0)
        on_x, on_y = from_x + share * dx, from_y + share * dy
        squared = (x - on_x) ** 2 + (y - on_y) ** 2
        if squared < nearest:
            nearest, at_x, at_y = squared, on_x, on_y
    return at_x, at_y


@njit(cache=True, fastmath=True, nogil=True)
def drawn(walls, rng):  # type: ignore[no-untyped-def]
    """Draw a place within walls. -> x, y."""
    bounds = walls.bounds
    x = bounds[0, 0] + (bounds[1, 0] - bounds[0, 0]) * rng.random()
    y = bounds[0, 1] + (bounds[1, 1] - bounds[0, 1]) * rng.random()
    if walls.edges.shape[0] > 0:
        for _ in range(_DRAWS):
            if is_inside(walls, x, y):
                break
            x = bounds[0, 0] + (bounds[1, 0] - bounds[0, 0]) * rng.random()
            y = bounds[0, 1] + (bounds[1, 1] - bounds[0, 1]) * rng.random()
        x, y = clipped(walls, x, y)
    return x, y


@njit(cache=True, fastmath=True, nogil=True)
def cell(bounds, x, y, columns, rows):  # type: ignore[no-untyped-def]
    """Which of columns * rows equal cells a place of the box lies in. -> column, row."""
    column = int((x - bounds[0, 0]) / (bounds[1, 0] - bounds[0, 0]) * columns)
    row = int((y - bounds[0, 1]) / (bounds[1, 1] - bounds[0, 1]) * rows)
    return min(column, columns - 1), min(row, rows - 1)


@njit(cache=True, fastmath=True, nogil=True)
def nearest_node(ground, x, y):  # type: ignore[no-untyped-def]
    """Node at a place of the arena, or -1 in free flight."""
    if ground.nodes.shape[0] == 0:
        return -1
    column, row = cell(ground.walls.bounds, x, y, NEAREST_CELLS, NEAREST_CELLS)
    return ground.nearest[column, row]


@njit(cache=True, fastmath=True, nogil=True)
def is_clear(edges, x, y, to_x, to_y):  # type: ignore[no-untyped-def]
    """Whether a straight way crosses no edge; one that it only touches is not crossed."""
    dx, dy = to_x - x, to_y - y
    for e in range(edges.shape[0]):
        a_x, a_y, b_x, b_y = edges[e, 0] - x, edges[e, 1] - y, edges[e, 2] - x, edges[e, 3] - y
        if (dx * a_y - dy * a_x) * (dx * b_y - dy * b_x) < 0.0:
            along_x, along_y = b_x - a_x, b_y - a_y
            here = along_y * a_x - along_x * a_y
            there = here + along_x * dy - along_y * dx
            if here * there < 0.0:
                return False
    return True


@njit(cache=True, fastmath=True, nogil=True)
def first_and_last_turn(turns, x, y, goal_x, goal_y, bounds):  # type: ignore[no-untyped-def]
    """Between which two corners the shortest way to a goal goes; -1, -1 where none is found."""
    count = turns.corners.shape[0]
    column, row = cell(bounds, goal_x, goal_y, _SIGHT_CELLS, _SIGHT_CELLS)
    back = np.full(count, _FAR)
    for w in range(count):
        at_x, at_y = turns.corners[w, 0], turns.corners[w, 1]
        if turns.sight[column, row, w] and is_clear(turns.edges, at_x, at_y, goal_x, goal_y):
            back[w] = math.sqrt((at_x - goal_x) ** 2 + (at_y - goal_y) ** 2)
    column, row = cell(bounds, x, y, _SIGHT_CELLS, _SIGHT_CELLS)
    shortest, first, last = _FAR, -1, -1
    for v in range(count):
        at_x, at_y = turns.corners[v, 0], turns.corners[v, 1]
        out = math.sqrt((at_x - x) ** 2 + (at_y - y) ** 2)
        if not turns.sight[column, row, v] or not is_clear(turns.edges, x, y, at_x, at_y):
            continue
        for w in range(count):
            length = out + turns.apart[v, w] + back[w]
            if length < shortest:
                shortest, first, last = length, v, w
    return first, last


@njit(cache=True, fastmath=True, nogil=True)
def _fly(path, k, x, y, due, to_x, to_y):  # type: ignore[no-untyped-def]
    """Fly straight to a place, and write where measurements fall. -> k, x, y, due."""
    left = math.sqrt((to_x - x) ** 2 + (to_y - y) ** 2)
    while due <= left and k < path.shape[0]:
        x += (to_x - x) * due / left
        y += (to_y - y) * due / left
        left -= due
        due = MEASUREMENT_INTERVAL_AU
        path[k, 0], path[k, 1] = x, y
        k += 1
    return k, to_x, to_y, due - left


@njit(cache=True, fastmath=True, nogil=True)
def _fly_around(goal_x, goal_y, ground, path, k, x, y, due):  # type: ignore[no-untyped-def]
    """Fly to a goal the shortest way around corners; stay where none is found. -> k, x, y, due."""
    turns = ground.turns
    if not is_clear(turns.edges, x, y, goal_x, goal_y):
        turn, last = first_and_last_turn(turns, x, y, goal_x, goal_y, ground.walls.bounds)
        if turn < 0:
            return k, x, y, due
        k, x, y, due = _fly(path, k, x, y, due, turns.corners[turn, 0], turns.corners[turn, 1])
        while turn != last and k < path.shape[0]:
            turn = turns.next_corner[turn, last]
            k, x, y, due = _fly(path, k, x, y, due, turns.corners[turn, 0], turns.corners[turn, 1])
    return _fly(path, k, x, y, due, goal_x, goal_y)


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
    if goal_node < 0 and ground.turns.edges.shape[0] > 0:
        k, x, y, due = _fly_around(goal_x, goal_y, ground, path, k, x, y, due)
        return k, x, y, node, due, hop
    if goal_node < 0:
        while k < horizon:
            dx, dy = goal_x - x, goal_y - y
            distance = math.sqrt(dx * dx + dy * dy)
            if distance < _ARRIVED_AU:
                break
            x, y = step_inside(ground.walls.bounds, x, y, due * dx / distance, due * dy / distance)
            due = MEASUREMENT_INTERVAL_AU
            path[k, 0], path[k, 1] = x, y
            k += 1
        return k, x, y, node, due, hop
    while node != goal_node and k < horizon:
        node = ground.next_hop[node, goal_node]
        if hop < 0:
            hop = node
        k, x, y, due = _fly(path, k, x, y, due, ground.nodes[node, 0], ground.nodes[node, 1])
    return k, x, y, node, due, hop
