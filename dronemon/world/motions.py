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

A path is drawn for LENGTH_AU of walking; a target that has walked so far walks it back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from dronemon.arena import ARENA
from dronemon.errors import OptionError
from dronemon.problem import is_tracks, motion_name_flaw
from dronemon.types import FloatArray
from dronemon.world.targets import TargetPaths
from dronemon.world.tracks import draw_tracks

LENGTH_AU = 40.0
"""As far as targets at a seventh of the agent's speed walk while it flies 280 au."""
_STEP_AU = 0.02
_TURN_RAD = {"correlated": 0.3, "brownian": np.pi, "grazing": 0.6}
"""Standard deviation of the turn at each step."""
_BOUT_AU = 0.15
"""Mean way between two rests of a grazing target, and mean rest in the way that it would walk."""
_RADIUS_AU = (0.08, 0.25)
_HERD_AU, _HERD_PERIOD_AU = 0.08, (1.0, 3.0)
"""How far members of a herd go from its centre along each axis, and in how much walking."""
_STREETS, _JITTER, _OPEN = 5, 0.25, 0.6
"""Junctions along each side, how far they are off a grid in its cells, and share of the streets
that are there though every junction can be reached without them."""

_Draw = Callable[[int, np.random.Generator], TargetPaths]


def motion_flaw(motion: str, num_targets: int) -> str | None:
    """Why a motion cannot be drawn for so many targets; None if it can."""
    if not is_tracks(motion):
        return motion_name_flaw(motion)
    try:
        draw_tracks(Path(motion), num_targets)
    except OptionError as exc:
        return str(exc)
    return None


def draw_paths(motion: str, num_targets: int, rng: np.random.Generator) -> TargetPaths:
    """Draw the ways of all targets; the first of a larger draw are those of a smaller one.

    motion: one of `MOTIONS`, or a file of tracks, whose first targets are taken

    Raises OptionError, see `motion_flaw`.
    """
    if flaw := motion_flaw(motion, num_targets):
        raise OptionError(flaw)
    if is_tracks(motion):
        return draw_tracks(Path(motion), num_targets)
    return _MOTIONS[motion](num_targets, rng)


def _waypoints(num_targets: int, rng: np.random.Generator) -> TargetPaths:
    count = round(2.0 * LENGTH_AU)  # legs are half an au long, in the mean
    return TargetPaths.along(np.stack([ARENA.sample(count, rng) for _ in range(num_targets)]))


def _walk(motion: str) -> _Draw:
    def draw(num_targets: int, rng: np.random.Generator) -> TargetPaths:
        return TargetPaths.along(np.stack([_wander(motion, rng) for _ in range(num_targets)]))

    return draw


def _wander(motion: str, rng: np.random.Generator) -> FloatArray:
    """A walk that the arena's border throws back. -> (P, 2) au."""
    count, start_au = round(LENGTH_AU / _STEP_AU), ARENA.sample(1, rng)
    turns = rng.normal(0.0, _TURN_RAD[motion], count)
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(turns)
    steps = _STEP_AU * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return _folded(start_au + np.cumsum(np.concatenate([np.zeros((1, 2)), steps]), axis=0))


def _folded(places_au: FloatArray, margin_au: float = 0.0) -> FloatArray:
    """Mirror at the border, as often as it takes, what goes beyond it. (..., 2) au."""
    low, high = ARENA.bounds[0] + margin_au, ARENA.bounds[1] - margin_au
    phase = np.mod((places_au - low) / (high - low), 2.0)
    folded: FloatArray = low + (high - low) * np.minimum(phase, 2.0 - phase)
    return folded


def _grazing(num_targets: int, rng: np.random.Generator) -> TargetPaths:
    points, marks = [], []
    for _ in range(num_targets):
        way = _wander("grazing", rng)
        steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
        rests = rng.random(len(steps)) < _STEP_AU / _BOUT_AU
        pauses = np.where(rests, rng.exponential(_BOUT_AU, len(steps)), 0.0)
        arrived = np.cumsum(np.concatenate([[0.0], steps + pauses]))
        left = arrived[:-1] + pauses  # it rests before the step
        points.append(np.repeat(way, 2, axis=0)[:-1])
        marks.append([*np.stack([arrived[:-1], left], axis=-1).ravel().tolist(), arrived[-1]])
    return TargetPaths(points_au=np.stack(points), marks_au=np.array(marks))


def _loop(num_targets: int, rng: np.random.Generator) -> TargetPaths:
    circles = []
    for _ in range(num_targets):
        radius_au = rng.uniform(*_RADIUS_AU)
        low, high = ARENA.bounds
        centre_au = rng.uniform(low + radius_au, high - radius_au)
        begin, sense = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
        angle = begin + sense * np.linspace(0.0, 2.0 * np.pi, 73)
        circles.append(centre_au + radius_au * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return TargetPaths.along(np.stack(circles), is_closed=True)


def _herd(num_targets: int, rng: np.random.Generator) -> TargetPaths:
    centre_au = _folded(_wander("correlated", rng), _HERD_AU)
    walked_au = _STEP_AU * np.arange(len(centre_au))
    members = []
    for _ in range(num_targets):
        period_au, phase = rng.uniform(*_HERD_PERIOD_AU, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
        sway = np.sin(2.0 * np.pi * walked_au[:, None] / period_au + phase)
        members.append(centre_au + _HERD_AU * sway)
    # All are where the herd is then, however long their own ways are.
    marks_au = np.tile(walked_au, (num_targets, 1))
    return TargetPaths(points_au=np.stack(members), marks_au=marks_au)


def _road(num_targets: int, rng: np.random.Generator) -> TargetPaths:
    junctions_au, streets = _town(rng)
    count = round(LENGTH_AU * _STREETS)  # a street is as long as a cell, about
    ways = []
    for _ in range(num_targets):
        way = [int(rng.integers(len(junctions_au)))]
        before = -1
        while len(way) < count:
            here = way[-1]
            onward = [there for there in streets[here] if there != before] or [before]
            before = here
            way.append(int(rng.choice(onward)))
        ways.append(junctions_au[way])
    return TargetPaths.along(np.stack(ways))


def _town(rng: np.random.Generator) -> tuple[FloatArray, list[list[int]]]:
    """Junctions (J, 2) au, and of each those at the other ends of its streets."""
    cells_au = ARENA.cells(_STREETS)
    width_au = ARENA.extent_au / _STREETS
    junctions_au = cells_au + _JITTER * width_au * rng.uniform(-1.0, 1.0, cells_au.shape)
    numbers = np.arange(_STREETS**2).reshape(_STREETS, _STREETS)
    pairs = np.concatenate(
        [
            np.stack([numbers[:-1].ravel(), numbers[1:].ravel()], axis=-1),
            np.stack([numbers[:, :-1].ravel(), numbers[:, 1:].ravel()], axis=-1),
        ]
    )
    streets: list[list[int]] = [[] for _ in junctions_au]
    part = list(range(len(junctions_au)))  # junctions of one part can reach each other
    for one, other in rng.permutation(pairs).tolist():
        joins = part[one] != part[other]
        if joins:
            old, new = part[other], part[one]
            part = [new if p == old else p for p in part]
        if joins or rng.random() < _OPEN:
            streets[one].append(other)
            streets[other].append(one)
    return junctions_au, streets


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
