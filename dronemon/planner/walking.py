"""How a target may move, compiled: the kinds of motion that particles stand for, and their walk.

A particle is one whole hypothesis: where a target is, and in which of a few ways it moves. Which
ways fit is learned from the mission's own sightings, see `dronemon.planner.kinds`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from dronemon.planner.moving import is_inside
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import FloatArray

X, Y, HEADING, SPEED, KIND, CURVATURE, RESTING = range(7)
"""Rows of a particle: place and heading, speed over the agent's, index of its kind of motion, turn
per length walked in rad/au, and 1 while it stands."""
NUM_ROWS = 7

TURN_QUANTILES_RAD = np.radians(
    [0.0, 11.5, 23.0, 34.7, 46.3, 58.2, 71.2, 85.2, 100.5, 118.8, 165.0]
)
"""Size of a turn at evenly spaced probabilities 0 to 1, on development paths (10000 to 10059)."""
_TRIES = 8
_REGENERATIONS = 1500
"""Most walks tried anew for one target and measurement; bounds the time of a decision."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One way of moving.

    turns_per_au:  how often it turns, per length walked
    wander_rad:    standard deviation of its heading's drift over 1 au walked, which grows as the
                   root of the length
    curvature:     least and greatest turn per length walked, rad/au, to either side
    rests_per_au:  how often it stops per length walked; it rests as long as it walks, in the mean
    trail_doubt:   chance, at every miss, that a particle near its target's own trail is replaced by
                   another of its kind
    """

    name: str
    turns_per_au: float = 0.0
    wander_rad: float = 0.0
    curvature: tuple[float, float] = (0.0, 0.0)
    rests_per_au: float = 0.0
    trail_doubt: float = 0.0


KINDS = (
    # The paper's tours, on development seeds; who tours seldom comes near its own trail.
    Kind(name="tour", turns_per_au=8.5, trail_doubt=0.9),
    Kind(name="legs", turns_per_au=3.0),
    Kind(name="wander", wander_rad=2.5),
    Kind(name="jitter", wander_rad=12.0),
    Kind(name="circle", curvature=(2.5, 20.0), wander_rad=0.3),
    Kind(name="graze", wander_rad=4.0, rests_per_au=7.0),
)


class Stops(NamedTuple):
    """When a target was seen, and where the agent did not see it, one after the other.

    looks:  (L, 4)    time, x, y and view of each in au, no view of a sight
    hidden: (L, S, 2) as `Measurement.hidden_au`, of a sight anything; S is 0 where nothing stands
    """

    looks: FloatArray
    hidden: FloatArray


def table_of(kinds: tuple[Kind, ...]) -> FloatArray:
    """Kinds as compiled code has them. -> (K, 4) turns_per_au, wander_rad, rests_per_au, doubt."""
    return np.array([[k.turns_per_au, k.wander_rad, k.rests_per_au, k.trail_doubt] for k in kinds])


@njit(cache=True, fastmath=True, nogil=True)
def _turned(heading, rng):  # type: ignore[no-untyped-def]
    """A new heading after a random turn to either side."""
    quantiles = TURN_QUANTILES_RAD
    place = rng.random() * (quantiles.shape[0] - 1)
    low = int(place)
    size = quantiles[low] + (quantiles[low + 1] - quantiles[low]) * (place - low)
    return heading + size if rng.random() < 0.5 else heading - size


@njit(cache=True, fastmath=True, nogil=True, forceinline=True)
def _step(walker, duration, kinds, walls, rng):  # type: ignore[no-untyped-def]
    """Walk one particle on for a short while inside the arena, in place. walker: (NUM_ROWS,)"""
    turns_per_au, wander, rests_per_au, _ = kinds[int(walker[KIND])]
    distance = walker[SPEED] * duration
    if rests_per_au > 0.0:
        if rng.random() < 1.0 - math.exp(-rests_per_au * distance):
            walker[RESTING] = 1.0 - walker[RESTING]
        if walker[RESTING] > 0.0:
            return
    heading = walker[HEADING] + walker[CURVATURE] * distance
    if wander > 0.0:
        heading += wander * math.sqrt(distance) * rng.normal()
    if turns_per_au > 0.0 and rng.random() < 1.0 - math.exp(-turns_per_au * distance):
        heading = _turned(heading, rng)
    for _ in range(_TRIES):
        x = walker[X] + distance * math.cos(heading)
        y = walker[Y] + distance * math.sin(heading)
        if is_inside(walls, x, y):
            walker[X], walker[Y] = x, y
            break
        heading = _turned(heading, rng)
    walker[HEADING] = heading


@njit(cache=True, fastmath=True, nogil=True)
def walk(walkers, duration, kinds, walls, rng):  # type: ignore[no-untyped-def]
    """Walk particles on, in place. walkers: (M, NUM_ROWS); duration: au; kinds: as `table_of`."""
    for j in range(walkers.shape[0]):
        _step(walkers[j], duration, kinds, walls, rng)


@njit(cache=True, fastmath=True, nogil=True)
def walk_ahead(walkers, duration, kinds, walls, rng, places_au):  # type: ignore[no-untyped-def]
    """Walk particles on, in place, as often as there are rows to write their places to.

    walkers: (M, NUM_ROWS); duration: au, of each time; places_au: (H, M, 2) written
    """
    for step in range(places_au.shape[0]):
        for j in range(walkers.shape[0]):
            _step(walkers[j], duration, kinds, walls, rng)
            places_au[step, j, 0], places_au[step, j, 1] = walkers[j, X], walkers[j, Y]


@njit(cache=True, fastmath=True, nogil=True)
def doubts(walkers, old_trail_au, trail_radius_au, kinds):  # type: ignore[no-untyped-def]
    """Doubt of each particle for being near its target's own trail. -> (M,)

    walkers: (M, NUM_ROWS); old_trail_au: (P, 2); kinds: as `table_of`
    """
    out = np.zeros(walkers.shape[0])
    for j in range(walkers.shape[0]):
        doubt = kinds[int(walkers[j, KIND]), 3]
        for m in range(old_trail_au.shape[0] if doubt > 0.0 else 0):
            dx, dy = walkers[j, X] - old_trail_au[m, 0], walkers[j, Y] - old_trail_au[m, 1]
            if dx**2 + dy**2 < trail_radius_au**2:
                out[j] = doubt
                break
    return out


@njit(cache=True, fastmath=True, nogil=True, forceinline=True)
def is_in_view(x, y, agent_x, agent_y, view, hidden, m):  # type: ignore[no-untyped-def]
    """Whether look m showed a place: the compiled twin of `dronemon.sightings.is_in_view`."""
    squared = (x - agent_x) ** 2 + (y - agent_y) ** 2
    if hidden.shape[1] == 0:
        return squared < view**2
    return squared < SENSOR_RADIUS_AU**2 and _is_shown(x - agent_x, y - agent_y, hidden[m])


@njit(cache=True, fastmath=True, nogil=True)
def _is_shown(dx, dy, hidden):  # type: ignore[no-untyped-def]
    """Whether nothing hides what is so far off. hidden: (S, 2)"""
    share = math.atan2(dy, dx) / math.tau
    sector = math.floor(hidden.shape[0] * share) % hidden.shape[0]
    away = math.sqrt(dx * dx + dy * dy)
    return away < hidden[sector, 0] or away > hidden[sector, 1]


@njit(cache=True, fastmath=True, nogil=True)
def refuted(walkers, stops, miss, rng):  # type: ignore[no-untyped-def]
    """Particles that a miss removes: those in view. -> (L,) their indices.

    walkers: (M, NUM_ROWS)
    stops:   that miss alone
    miss:    chance that the eye misses what is in view
    """
    _, agent_x, agent_y, view = stops.looks[0]
    out = np.empty(walkers.shape[0], np.int64)
    count = 0
    for j in range(walkers.shape[0]):
        gone = is_in_view(walkers[j, X], walkers[j, Y], agent_x, agent_y, view, stops.hidden, 0)
        if gone and miss > 0.0:
            gone = rng.random() >= miss
        if gone:
            out[count] = j
            count += 1
    return out[:count]


@njit(cache=True, fastmath=True, nogil=True, forceinline=True)
def _outlives(walker, looks, hidden, count, kinds, walls, miss, rng):  # type: ignore[no-untyped-def]
    """Walk one particle on, in place, over looks; whether none of the first `count` refutes it."""
    for m in range(1, looks.shape[0]):
        _step(walker, looks[m, 0] - looks[m - 1, 0], kinds, walls, rng)
        if (
            m < count
            and is_in_view(walker[X], walker[Y], looks[m, 1], looks[m, 2], looks[m, 3], hidden, m)
            and not (miss > 0.0 and rng.random() < miss)
        ):
            return False
    return True


@njit(cache=True, fastmath=True, nogil=True)
def walk_anew(walkers, lost, deck, stops, kinds, walls, miss, rng):  # type: ignore[no-untyped-def]
    """Replace particles by walks from the last sighting that no miss since refutes. -> how many.

    lost:  (L,)          int64 their indices
    deck:  (M, NUM_ROWS) the particles as they were at the last sighting
    stops: that sighting and every miss since
    miss:  chance that the eye misses what is in view
    """
    done = 0
    looks = stops.looks
    walker = np.empty(NUM_ROWS)
    for _ in range(_REGENERATIONS):
        if done == lost.shape[0]:
            break
        card = int(rng.random() * deck.shape[0])
        for r in range(NUM_ROWS):
            walker[r] = deck[card, r]
        if _outlives(walker, looks, stops.hidden, looks.shape[0], kinds, walls, miss, rng):
            for r in range(NUM_ROWS):
                walkers[lost[done], r] = walker[r]
            done += 1
    return done


@njit(cache=True, fastmath=True, nogil=True)
def outlived(walkers, stops, kinds, walls, miss, rng):  # type: ignore[no-untyped-def]
    """Walk particles on, in place, from one sight to the next. -> which no miss refutes, (M,)

    walkers: (M, NUM_ROWS) as they were at the first
    stops:   the first sight, every miss since, and the second
    """
    looks = stops.looks
    out = np.empty(walkers.shape[0], np.bool_)
    for j in range(walkers.shape[0]):
        count = looks.shape[0] - 1
        out[j] = _outlives(walkers[j], looks, stops.hidden, count, kinds, walls, miss, rng)
    return out
