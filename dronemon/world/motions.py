"""How targets move, beside the paper's tours: worlds that a planner was not measured on.

    tsp         the paper's: a short tour through random points, there and back
    waypoints   straight to one random place after another (random waypoint model)
    correlated  wanders on, turning a little all the while (correlated random walk)
    brownian    turns anywhere at every step
    grazing     wanders with many turns, and stands half of the time
    loop        patrols a circle, always the same way round
    herd        all drift together, each to and fro about the common centre
    road        along the streets of a small town, turning anywhere but back
    FILE        as in a file of tracks, see `dronemon.world.tracks`

A path is drawn for LENGTH_AU of walking, about; a target that has walked so far walks it back. None
leaves the arena's field; no-fly zones are nothing to a target.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from dronemon.arena import ARENA, Arena, Region
from dronemon.errors import OptionError
from dronemon.problem import is_tracks, motion_name_flaw
from dronemon.types import FloatArray, IntArray
from dronemon.world.targets import TargetPaths, inside
from dronemon.world.tracks import draw_tracks

LENGTH_AU = 40.0
"""As far as targets at a seventh of the agent's speed walk while it flies 280 au."""
_STEP_AU = 0.02
_TURN_RAD = {"correlated": 0.3, "brownian": np.pi, "grazing": 0.6}
"""Standard deviation of the turn at each step."""
_BOUT_AU = 0.15
"""Mean way between two rests of a grazing target, and mean rest in the way that it would walk."""
_AHEAD, _WAYS_BACK = 20, 24
"""Steps looked ahead, and directions to choose from where one would leave a polygon."""
_RADIUS_AU, _TRIES = (0.08, 0.25), 50
"""Radii of loops, less in a field less than 1 au across, and how often a place is sought for one
before it is made smaller by half."""
_HERD_AU, _HERD_PERIOD_AU, _HERD_ROOM = 0.08, (1.0, 3.0), 1.0 / 3.0
"""How far members of a herd go from its centre along each axis, and in how much walking; and the
share of a polygon that this leaves its centre at least, or they keep closer."""
_STREETS_PER_AU, _JITTER, _OPEN = 5.0, 0.25, 0.6
"""Junctions along an au, how far they are off a grid in its cells, and share of the streets that
are there though every junction can be reached without them."""

_Draw = Callable[[int, np.random.Generator, Arena], TargetPaths]


def motion_flaw(motion: str, num_targets: int, arena: Arena = ARENA) -> str | None:
    """Why a motion cannot be drawn for so many targets; None if it can."""
    if not is_tracks(motion):
        return motion_name_flaw(motion)
    try:
        draw_tracks(Path(motion), num_targets, arena)
    except OptionError as exc:
        return str(exc)
    return None


def draw_paths(
    motion: str, num_targets: int, rng: np.random.Generator, arena: Arena
) -> TargetPaths:
    """Draw the ways of all targets; the first of a larger draw are those of a smaller one.

    motion: one of `MOTIONS`, or a file of tracks, whose first targets are taken

    Raises OptionError, see `motion_flaw`.
    """
    if flaw := motion_flaw(motion, num_targets, arena):
        raise OptionError(flaw)
    if is_tracks(motion):
        return draw_tracks(Path(motion), num_targets, arena)
    return _MOTIONS[motion](num_targets, rng, arena)


def _breadth(arena: Arena) -> float:
    """By how much what is laid out for the square is to be made smaller, so that it fits. <= 1."""
    return min(1.0, float(arena.extent_au.min()))


def _waypoints(num_targets: int, rng: np.random.Generator, arena: Arena) -> TargetPaths:
    # Legs are half as long as the field, in the mean.
    count = max(round(2.0 * LENGTH_AU / float(arena.extent_au.mean())), 2)
    return TargetPaths.along(inside(arena.sample(count, rng), arena) for _ in range(num_targets))


def _walk(motion: str) -> _Draw:
    def draw(num_targets: int, rng: np.random.Generator, arena: Arena) -> TargetPaths:
        return TargetPaths.along(_wander(motion, rng, arena) for _ in range(num_targets))

    return draw


def _wander(motion: str, rng: np.random.Generator, arena: Arena) -> FloatArray:
    """A walk that the arena's border throws back. -> (P, 2) au."""
    count, start_au = round(LENGTH_AU / _STEP_AU), arena.sample(1, rng)
    turns = rng.normal(0.0, _TURN_RAD[motion], count)
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(turns)
    steps = _STEP_AU * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    if not arena.is_rectangle:
        return _turned_back(start_au, steps, rng, arena.field)
    walk_au = start_au + np.cumsum(np.concatenate([np.zeros((1, 2)), steps]), axis=0)
    return _folded(walk_au, arena)


def _folded(places_au: FloatArray, arena: Arena, margin_au: float = 0.0) -> FloatArray:
    """Mirror at a rectangle's border, as often as it takes, what goes beyond it. (..., 2) au."""
    low, high = arena.bounds[0] + margin_au, arena.bounds[1] - margin_au
    phase = np.mod((places_au - low) / (high - low), 2.0)
    folded: FloatArray = low + (high - low) * np.minimum(phase, 2.0 - phase)
    return folded


def _turned_back(
    start_au: FloatArray, steps_au: FloatArray, rng: np.random.Generator, field: Region
) -> FloatArray:
    """A walk that turns anywhere, with all that follows, where a step would leave the field.

    start_au: (1, 2), steps_au: (P - 1, 2) -> (P, 2) au.
    """
    angle = 2.0 * np.pi * np.arange(_WAYS_BACK) / _WAYS_BACK
    rows = np.stack([np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)], axis=-1)
    turns = rows.reshape(-1, 2, 2)
    walk_au = start_au
    while len(steps_au):
        here = walk_au[-1:]
        ahead_au = here + np.cumsum(steps_au[:_AHEAD], axis=0)
        is_free = field.is_free(np.concatenate([here, ahead_au[:-1]]), ahead_au)
        num_free = len(ahead_au) if is_free.all() else int(is_free.argmin())
        walk_au, steps_au = np.concatenate([walk_au, ahead_au[:num_free]]), steps_au[num_free:]
        if num_free < len(ahead_au):
            here = walk_au[-1]
            back = turns[field.is_free(here, here + steps_au[0] @ turns)]
            if len(back):
                steps_au = steps_au @ back[rng.integers(len(back))]
            else:  # in a corner as narrow as that
                steps_au = np.concatenate([steps_au[:1] / 2.0, steps_au[1:]])
    return walk_au


def _grazing(num_targets: int, rng: np.random.Generator, arena: Arena) -> TargetPaths:
    points, marks = [], []
    for _ in range(num_targets):
        way = _wander("grazing", rng, arena)
        steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
        rests = rng.random(len(steps)) < _STEP_AU / _BOUT_AU
        pauses = np.where(rests, rng.exponential(_BOUT_AU, len(steps)), 0.0)
        arrived = np.cumsum(np.concatenate([[0.0], steps + pauses]))
        left = arrived[:-1] + pauses  # it rests before the step
        points.append(np.repeat(way, 2, axis=0)[:-1])
        marks.append([*np.stack([arrived[:-1], left], axis=-1).ravel().tolist(), arrived[-1]])
    return TargetPaths(points_au=np.stack(points), marks_au=np.array(marks))


def _loop(num_targets: int, rng: np.random.Generator, arena: Arena) -> TargetPaths:
    return TargetPaths.along((_circle(rng, arena) for _ in range(num_targets)), is_closed=True)


def _circle(rng: np.random.Generator, arena: Arena) -> FloatArray:
    """Once round a circle inside the field. -> (73, 2) au."""
    radius_au = _breadth(arena) * rng.uniform(*_RADIUS_AU)
    low, high = arena.bounds
    while True:
        for _ in range(_TRIES):
            centre_au = (
                rng.uniform(low + radius_au, high - radius_au)
                if arena.is_rectangle
                else arena.sample(1, rng)[0]
            )
            begin, sense = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
            angle = begin + sense * np.linspace(0.0, 2.0 * np.pi, 73)
            around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            circle_au: FloatArray = centre_au + radius_au * around
            if arena.is_rectangle or arena.field.is_free(circle_au[:-1], circle_au[1:]).all():
                return circle_au
        radius_au /= 2.0


def _herd(num_targets: int, rng: np.random.Generator, arena: Arena) -> TargetPaths:
    centre_au, reach_au = _herd_centre(rng, arena)
    walked_au = _STEP_AU * np.arange(len(centre_au))
    members = []
    for _ in range(num_targets):
        period_au, phase = rng.uniform(*_HERD_PERIOD_AU, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
        sway = np.sin(2.0 * np.pi * walked_au[:, None] / period_au + phase)
        members.append(centre_au + reach_au * sway)
    # All are where the herd is then, however long their own ways are.
    marks_au = np.tile(walked_au, (num_targets, 1))
    return TargetPaths(points_au=np.stack(members), marks_au=marks_au)


def _herd_centre(rng: np.random.Generator, arena: Arena) -> tuple[FloatArray, float]:
    """Way of a herd's centre (P, 2) au, and how far its members may go from it along each axis."""
    reach_au = _HERD_AU * _breadth(arena)
    if arena.is_rectangle:
        return _folded(_wander("correlated", rng, arena), arena, reach_au), reach_au
    room_au2 = _HERD_ROOM * arena.field.area_au2
    while (inner := arena.field.shrunk(2.0**0.5 * reach_au)) is None or inner.area_au2 < room_au2:
        reach_au /= 2.0
    return _wander("correlated", rng, Arena.polygon(inner.rings[0])), reach_au


def _road(num_targets: int, rng: np.random.Generator, arena: Arena) -> TargetPaths:
    junctions_au, streets = _town(rng, arena)
    count = round(LENGTH_AU * _STREETS_PER_AU)  # a street is as long as a cell, about
    ways = []
    for _ in range(num_targets):
        way = [int(rng.integers(len(junctions_au)))]
        before = -1
        while len(way) < count:
            here = way[-1]
            onward = [there for there in streets[here] if there != before] or [before]
            before = here
            way.append(int(rng.choice(onward)))
        ways.append(inside(junctions_au[way], arena))
    return TargetPaths.along(ways)


def _town(rng: np.random.Generator, arena: Arena) -> tuple[FloatArray, list[list[int]]]:
    """Junctions (J, 2) au, and of each those at the other ends of its streets.

    Streets that would leave the field are not there. Its parts that none then joins are joined by
    the shortest way between their nearest junctions.
    """
    junctions_au, pairs = _junctions(rng, arena)
    streets: list[list[int]] = [[] for _ in junctions_au]
    part = np.arange(len(junctions_au))  # junctions of one part can reach each other

    def join(one: int, other: int) -> None:
        part[part == part[other]] = part[one]
        streets[one].append(other)
        streets[other].append(one)

    for one, other in rng.permutation(pairs).tolist():
        if part[one] != part[other] or rng.random() < _OPEN:
            join(one, other)
    while (is_apart := part != part[0]).any():
        near, far = np.flatnonzero(~is_apart), np.flatnonzero(is_apart)
        offset_au = junctions_au[near][:, None] - junctions_au[far]
        apart_au = np.hypot(offset_au[..., 0], offset_au[..., 1])
        one, other = np.unravel_index(apart_au.argmin(), apart_au.shape)
        join(int(near[one]), int(far[other]))
    return junctions_au, streets


def _junctions(rng: np.random.Generator, arena: Arena) -> tuple[FloatArray, IntArray]:
    """Junctions in the field (J, 2) au, two or more, and pairs that a straight street may join."""
    per_au, is_in = _STREETS_PER_AU, np.zeros(0, dtype=bool)
    while is_in.sum() < 2:
        sizes = np.maximum(np.rint(per_au * arena.extent_au), 1.0).astype(int)
        shares = np.meshgrid(*((np.arange(size) + 0.5) / size for size in sizes), indexing="ij")
        cells_au = arena.bounds[0] + arena.extent_au * np.stack(shares, axis=-1).reshape(-1, 2)
        width_au = arena.extent_au / sizes
        junctions_au = cells_au + _JITTER * width_au * rng.uniform(-1.0, 1.0, cells_au.shape)
        is_in = arena.contains(junctions_au)
        per_au *= 2.0
    numbers = np.arange(len(is_in)).reshape(sizes)
    along_x, along_y = (numbers[:-1], numbers[1:]), (numbers[:, :-1], numbers[:, 1:])
    pairs = np.concatenate(
        [np.stack([a.ravel(), b.ravel()], axis=-1) for a, b in (along_x, along_y)]
    )
    pairs = pairs[is_in[pairs].all(axis=-1)]
    pairs = pairs[arena.field.is_free(junctions_au[pairs[:, 0]], junctions_au[pairs[:, 1]])]
    return junctions_au[is_in], (np.cumsum(is_in) - 1)[pairs]


_MOTIONS: Mapping[str, _Draw] = {
    "tsp": TargetPaths.random,
    "waypoints": _waypoints,
    "correlated": _walk("correlated"),
    "brownian": _walk("brownian"),
    "grazing": _grazing,
    "loop": _loop,
    "herd": _herd,
    "road": _road,
}
