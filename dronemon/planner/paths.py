"""Candidate paths and what they are worth: the compiled inside of the search.

A path is a list of goals, flown to one after the other, straight or along a roadmap's shortest
paths; what counts are the places where it measures. Its worth is the uncertainty that it takes away
from the targets' surroundings, as the metric Unc counts it:

  * Around every particle lie four probes. The state of a probe is the age of the sighting in its
    very place that would leave it as uncertain (its *equivalent age*), in quarters of an interval.
    Age grows as time passes; a measurement near the probe makes it younger.
  * `worth[age]` is the certainty that a probe of that age will still enjoy, summed over the future;
    a measurement gains the difference.
  * A sighting also gains by what it tells of the place. A miss sets the belief's mean to 0 where it
    is taken: that gains where the mean is false, as on the trail of old sightings behind a target,
    and costs near the target, where it bends the peak (the metric JSD). With mean mu there, and
    p the presence that the target's distance would give, squared error falls by mu (mu - 2 p).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dronemon.problem import (
    LENGTH_SCALE_AU,
    MEASUREMENT_INTERVAL_AU,
    PRESENCE_STD_AU,
    SENSOR_RADIUS_AU,
    TIME_SCALE_AU,
)
from dronemon.types import FloatArray, IntArray

Float32Array = NDArray[np.float32]
Int32Array = NDArray[np.int32]

AGES_PER_STEP = 4
NUM_AGES = 256
OLDEST = 127
"""Greatest age, in steps, of a sighting."""
MAX_GOALS = 24
_REACH_AU = 0.25
"""A measurement farther from a probe tells nothing about it."""
_REACH_BINS = 512
_NEAR = 0.05
"""Squared distance, particle to agent, beyond which its probes are left alone."""
_ARRIVED_AU = 0.05
NEAREST_CELLS = 64
"""Cells along each axis of the table of nearest nodes."""
MEAN_CELLS = 48
"""Cells along each axis of the fields of posterior means."""
_MEAN_REACH_AU = 0.7
"""Data farther from a cell, age counted, do not show in its mean: the kernel is below 1e-4."""
_MEAN_BINS = 8192
_MEAN_JITTER = 1e-6
NOTHING = -1e30
"""Gain of no path at all; fast arithmetic does not know infinity."""


def _matern(distance: FloatArray) -> FloatArray:
    scaled = math.sqrt(3.0) * distance
    kernel: FloatArray = (1.0 + scaled) * np.exp(-scaled)
    return kernel


_MATERN_AT = _matern(
    np.sqrt((np.arange(_MEAN_BINS) + 0.5) / _MEAN_BINS) * _MEAN_REACH_AU / LENGTH_SCALE_AU
)
"""The kernel by squared distance, in bins to `_MEAN_REACH_AU`."""


class Tables(NamedTuple):
    """Look-up tables of the score; all follow from the kernel, the settings and the speed.

    age_at: (B,) equivalent age of a probe measured at a squared distance (B bins to 0.25 au);
    seen_age: of the probes of a target just seen; worth: (NUM_AGES,); known: (OLDEST + 1,) gain of
    a sighting by the age of the last; shape_worth: of squared error of the mean; discount: (H,)
    """

    age_at: Int32Array
    seen_age: int
    worth: Float32Array
    known: Float32Array
    shape_worth: float
    discount: Float32Array
    probe_au: float


class Scene(NamedTuple):
    """What a path is scored in. P particles, those of a target beside each other.

    x, y: (H, P) at each of the next measurements; weight: (P,); probe_age: (P, 4) and
    sight_age: (P,) now; first: (N + 1,) each target's first particle; mean: (N, C, C) posterior
    mean now of each target's presence, in the cells of the square
    """

    x: Float32Array
    y: Float32Array
    weight: Float32Array
    probe_age: Int32Array
    sight_age: Int32Array
    first: IntArray
    mean: Float32Array


class Ground(NamedTuple):
    """How goals are flown to: over a roadmap, or straight if it has no nodes.

    nodes: (V, 2); next_hop: (V, V); nearest: (C, C) node nearest to each cell of the square
    """

    nodes: FloatArray
    next_hop: IntArray
    nearest: IntArray


class Start(NamedTuple):
    """Where paths begin: place, node (-1 in free flight) and distance to the next measurement."""

    x: float
    y: float
    node: int
    due_au: float


class Effort(NamedTuple):
    """How candidates are drawn; see `SearchSettings`."""

    num_drawn: int
    num_refined: int
    guided_share: float
    greed: float
    forget_steps: float
    refine_au: float
    scatter_au: float


def make_tables(
    *,
    speed: float,
    num_steps: int,
    discount: float,
    fading: float,
    drift: float,
    probe_au: float,
    sight_gain: float,
    forget_steps: float,
    shape_worth: float,
) -> Tables:
    """Build the tables for a believed speed of the targets; names as in `SearchSettings`."""
    age_au = np.arange(NUM_AGES) / AGES_PER_STEP * MEASUREMENT_INTERVAL_AU
    correlation = _matern(
        np.hypot(drift * speed * age_au / LENGTH_SCALE_AU, age_au / TIME_SCALE_AU)
    )
    certainty = 1.0 - np.sqrt(1.0 - correlation**2)
    certainty[-AGES_PER_STEP:] = 0.0
    worth = certainty.copy()
    for age in range(NUM_AGES - AGES_PER_STEP - 1, -1, -1):
        worth[age] += fading * worth[age + AGES_PER_STEP]
    distance_au = np.sqrt((np.arange(_REACH_BINS) + 0.5) / _REACH_BINS) * _REACH_AU
    nearest_age = np.searchsorted(-correlation, -_matern(distance_au / LENGTH_SCALE_AU))
    age_at: Int32Array = np.minimum(nearest_age, NUM_AGES - 1).astype(np.int32)
    return Tables(
        age_at=age_at,
        seen_age=int(age_at[int((probe_au / _REACH_AU) ** 2 * _REACH_BINS)]),
        worth=worth.astype(np.float32),
        known=(
            sight_gain * forget_steps * (1.0 - np.exp(-np.arange(OLDEST + 1) / forget_steps))
        ).astype(np.float32),
        # A fast target soon leaves the shape behind.
        shape_worth=shape_worth * 2.0 / (1.0 + speed * TIME_SCALE_AU / LENGTH_SCALE_AU),
        discount=(discount ** np.arange(num_steps)).astype(np.float32),
        probe_au=probe_au,
    )


@njit(cache=True, fastmath=True, nogil=True)
def probe_ages(particles, first, points, counts, time_au, tables, out):  # type: ignore[no-untyped-def]
    """Equivalent age now of every probe, from what was measured in the belief's window.

    particles: (P, 2); points: (N, n, 3) x, y, time of each target's data, the first `counts` of
    them -> out (P, 4)
    """
    rho = tables.probe_au
    scale = _REACH_BINS / _REACH_AU**2
    squared_speed = (LENGTH_SCALE_AU / TIME_SCALE_AU) ** 2
    for i in range(counts.shape[0]):
        for p in range(first[i], first[i + 1]):
            for q in range(4):
                x = particles[p, 0] + (rho if q == 0 else (-rho if q == 1 else 0.0))
                y = particles[p, 1] + (rho if q == 2 else (-rho if q == 3 else 0.0))
                nearest = 1e9
                for m in range(counts[i]):
                    dt = time_au - points[i, m, 2]
                    distance = (
                        (x - points[i, m, 0]) ** 2
                        + (y - points[i, m, 1]) ** 2
                        + dt * dt * squared_speed
                    )
                    nearest = min(nearest, distance)
                bin_ = int(nearest * scale)
                out[p, q] = tables.age_at[bin_] if bin_ < _REACH_BINS else NUM_AGES - 1


@njit(cache=True, fastmath=True, nogil=True)
def _solve(matrix, vector):  # type: ignore[no-untyped-def]
    """Solve for a vector in place, by Cholesky; compiled much sooner than numpy's solver."""
    n = vector.shape[0]
    for a in range(n):
        for b in range(a + 1):
            rest = matrix[a, b]
            for k in range(b):
                rest -= matrix[a, k] * matrix[b, k]
            matrix[a, b] = math.sqrt(rest) if a == b else rest / matrix[b, b]
        for k in range(a):
            vector[a] -= matrix[a, k] * vector[k]
        vector[a] /= matrix[a, a]
    for a in range(n - 1, -1, -1):
        for k in range(a + 1, n):
            vector[a] -= matrix[k, a] * vector[k]
        vector[a] /= matrix[a, a]


@njit(cache=True, fastmath=True, nogil=True)
def mean_fields(points, values, counts, time_au, out):  # type: ignore[no-untyped-def]
    """Posterior mean now of each target's presence, cell by cell.

    points: (N, n, 3) x, y, time of each target's data, the first `counts` of them; values: (N, n)
    -> out (N, C, C)
    """
    size = out.shape[1]
    squared_speed = (LENGTH_SCALE_AU / TIME_SCALE_AU) ** 2
    scale = _MEAN_BINS / _MEAN_REACH_AU**2
    for i in range(counts.shape[0]):
        out[i] = 0.0
        n = counts[i]
        covariance = np.empty((n, n))
        for a in range(n):
            for b in range(a):
                dt = points[i, a, 2] - points[i, b, 2]
                distance = math.sqrt(
                    (points[i, a, 0] - points[i, b, 0]) ** 2
                    + (points[i, a, 1] - points[i, b, 1]) ** 2
                    + dt * dt * squared_speed
                )
                scaled = math.sqrt(3.0) * distance / LENGTH_SCALE_AU
                covariance[a, b] = covariance[b, a] = (1.0 + scaled) * math.exp(-scaled)
            covariance[a, a] = 1.0 + _MEAN_JITTER
        weight = values[i, :n].copy()
        _solve(covariance, weight)
        for a in range(n):
            dt = time_au - points[i, a, 2]
            for c in range(size):
                dx = (c + 0.5) / size - points[i, a, 0]
                across = dx * dx + dt * dt * squared_speed
                for d in range(size):
                    dy = (d + 0.5) / size - points[i, a, 1]
                    distance = across + dy * dy
                    if distance < _MEAN_REACH_AU**2:
                        bin_ = min(int(distance * scale), _MEAN_BINS - 1)
                        out[i, c, d] += weight[a] * _MATERN_AT[bin_]


@njit(cache=True, fastmath=True, nogil=True)
def score(path, scene, tables, probe, sight, squared):  # type: ignore[no-untyped-def]
    """What a path gains. path: (H, 2); the last three arrays are scratch, as scene's of their size.

    Ages are kept less the time that has passed, so that they need not grow.
    """
    for p in range(sight.shape[0]):
        sight[p] = scene.sight_age[p]
        for q in range(4):
            probe[p, q] = scene.probe_age[p, q]
    rho = np.float32(tables.probe_au)
    scale = np.float32(_REACH_BINS / _REACH_AU**2)
    shape_worth = np.float32(tables.shape_worth)
    size = scene.mean.shape[1]
    total = 0.0
    for k in range(path.shape[0]):
        passed = k + 1
        ax, ay = np.float32(path[k, 0]), np.float32(path[k, 1])
        for p in range(squared.shape[0]):
            dx, dy = scene.x[k, p] - ax, scene.y[k, p] - ay
            squared[p] = dx * dx + dy * dy
        gained = np.float32(0.0)
        cx, cy = min(int(ax * size), size - 1), min(int(ay * size), size - 1)
        for i in range(scene.mean.shape[0]):
            mean = max(scene.mean[i, cx, cy], np.float32(0.0))  # as the metric JSD counts it
            cleared = shape_worth * mean * mean
            for p in range(scene.first[i], scene.first[i + 1]):
                gain = cleared
                if squared[p] < SENSOR_RADIUS_AU**2:
                    age = tables.seen_age
                    for q in range(4):
                        old = min(probe[p, q] + AGES_PER_STEP * passed, NUM_AGES - 1)
                        if age < old:
                            gain += tables.worth[age] - tables.worth[old]
                            probe[p, q] = age - AGES_PER_STEP * passed
                    gain += tables.known[min(sight[p] + passed, OLDEST)] - cleared
                    sight[p] = -passed
                elif squared[p] < _NEAR:
                    presence = math.exp(np.float32(-0.5 / PRESENCE_STD_AU**2) * squared[p])
                    gain -= np.float32(2.0) * shape_worth * mean * presence
                    dx, dy = scene.x[k, p] - ax, scene.y[k, p] - ay
                    for q in range(4):
                        qx = dx + (rho if q == 0 else (-rho if q == 1 else np.float32(0.0)))
                        qy = dy + (rho if q == 2 else (-rho if q == 3 else np.float32(0.0)))
                        bin_ = int((qx * qx + qy * qy) * scale)
                        if bin_ < _REACH_BINS:
                            age = tables.age_at[bin_]
                            old = min(probe[p, q] + AGES_PER_STEP * passed, NUM_AGES - 1)
                            if age < old:
                                gain += tables.worth[age] - tables.worth[old]
                                probe[p, q] = age - AGES_PER_STEP * passed
                gained += gain * scene.weight[p]
        total += tables.discount[k] * gained
    return total


@njit(cache=True, fastmath=True, nogil=True)
def nearest_node(ground, x, y):  # type: ignore[no-untyped-def]
    """Node at a place of the square, or -1 in free flight."""
    if ground.nodes.shape[0] == 0:
        return -1
    last = NEAREST_CELLS - 1
    return ground.nearest[min(int(x * NEAREST_CELLS), last), min(int(y * NEAREST_CELLS), last)]


@njit(cache=True, fastmath=True, nogil=True)
def advance(x, y, dx, dy):  # type: ignore[no-untyped-def]
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
def fly(goal_x, goal_y, goal_node, ground, path, k, x, y, node, due):  # type: ignore[no-untyped-def]
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
            x, y = advance(x, y, due * dx / distance, due * dy / distance)
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


@njit(cache=True, fastmath=True, nogil=True)
def draw_goal(scene, k, x, y, age, forget_steps, power, is_guided, scatter, goal, rng):  # type: ignore[no-untyped-def]
    """Draw where to fly next: mostly where a particle will be when it is reached. -> its target.

    age: (N,) steps since each target was seen, less k
    """
    if rng.random() < 0.06:
        goal[0], goal[1] = rng.random(), rng.random()
        return -1
    num_targets = age.shape[0]
    weight = np.ones(num_targets)
    if is_guided:
        for i in range(num_targets):
            p = scene.first[i] + int(rng.random() * (scene.first[i + 1] - scene.first[i]))
            distance = math.sqrt((scene.x[k, p] - x) ** 2 + (scene.y[k, p] - y) ** 2)
            urge = 1.0 - math.exp(-(age[i] + k + 1) / forget_steps)
            weight[i] = (urge / (distance + 0.15)) ** power
    place = rng.random() * weight.sum()
    target = 0
    while target < num_targets - 1 and place >= weight[target]:
        place -= weight[target]
        target += 1
    p = scene.first[target] + int(rng.random() * (scene.first[target + 1] - scene.first[target]))
    distance = math.sqrt((scene.x[k, p] - x) ** 2 + (scene.y[k, p] - y) ** 2)
    arrival = min(scene.x.shape[0] - 1, k + int(distance / MEASUREMENT_INTERVAL_AU + 0.5))
    off = scatter * math.sqrt(rng.random())
    bearing = 2.0 * math.pi * rng.random()
    goal[0] = min(max(scene.x[arrival, p] + off * math.cos(bearing), 0.0), 1.0)
    goal[1] = min(max(scene.y[arrival, p] + off * math.sin(bearing), 0.0), 1.0)
    return target


@njit(cache=True, nogil=True)
def _copy(to, row, source, source_row):  # type: ignore[no-untyped-def]
    """Copy a row (2,); assigning slices takes a second of compiling for each."""
    to[row, 0], to[row, 1] = source[source_row, 0], source[source_row, 1]


@njit(cache=True, fastmath=True, nogil=True)
def refine(goals, count, scene, size, rng):  # type: ignore[no-untyped-def]
    """Change a goal a little: move, drop, insert, swap, or cut the list there. -> its length."""
    g = int(rng.random() * min(count, 6))
    kind = rng.random()
    if kind < 0.6:
        reach = size * 2.0 ** (2.0 - 4.0 * rng.random())
        goals[g, 0] = min(max(goals[g, 0] + reach * rng.normal(), 0.0), 1.0)
        goals[g, 1] = min(max(goals[g, 1] + reach * rng.normal(), 0.0), 1.0)
        return count
    if kind < 0.7:
        for c in range(g, count - 1):
            _copy(goals, c, goals, c + 1)
        return count - 1
    if kind < 0.85 and count < goals.shape[0]:
        for c in range(count, g, -1):
            _copy(goals, c, goals, c - 1)
        if rng.random() < 0.5:
            k, p = int(rng.random() * scene.x.shape[0]), int(rng.random() * scene.x.shape[1])
            goals[g, 0], goals[g, 1] = scene.x[k, p], scene.y[k, p]
        else:
            goals[g, 0] = min(max(goals[g, 0] + 2.0 * size * rng.normal(), 0.0), 1.0)
            goals[g, 1] = min(max(goals[g, 1] + 2.0 * size * rng.normal(), 0.0), 1.0)
        return count + 1
    if kind < 0.93:
        other = int(rng.random() * count)
        for c in range(2):
            goals[g, c], goals[other, c] = goals[other, c], goals[g, c]
        return count
    return g


@njit(cache=True, fastmath=True, nogil=True)
def search(start, ground, options, scene, tables, effort, last_goals, num_last, rng):  # type: ignore[no-untyped-def]
    """Find the path of the greatest gain.

    options: (K,) neighbours of the start's node, empty in free flight; last_goals: (MAX_GOALS, 2)
    of the last best path, the first num_last of them -> gain, path (H, 2), goals (MAX_GOALS, 2),
    their number, first hop, gain of the best path by way of each option (K,); NOTHING without one
    """
    num_targets, horizon = scene.first.shape[0] - 1, scene.x.shape[0]
    probe, sight = np.empty_like(scene.probe_age), np.empty_like(scene.sight_age)
    squared = np.empty(scene.x.shape[1], np.float32)
    goals, path = np.zeros((MAX_GOALS, 2)), np.zeros((horizon, 2))
    best_goals, best_path = last_goals.copy(), np.zeros((horizon, 2))
    best, best_count, best_hop = NOTHING, num_last, -1
    option_gain = np.full(options.shape[0], NOTHING)
    age = np.empty(num_targets)
    for c in range(effort.num_drawn + effort.num_refined):
        count, option = 0, -1
        if c == 0:
            count = num_last
            for m in range(count):
                _copy(goals, m, last_goals, m)
        elif c >= effort.num_drawn and best_count > 0:
            for m in range(best_count):
                _copy(goals, m, best_goals, m)
            count = refine(goals, best_count, scene, effort.refine_au, rng)
        elif options.shape[0] > 0 and c % 2 == 0:
            count = 1
            option = options[(c // 2) % options.shape[0]]
            _copy(goals, 0, ground.nodes, option)
        for i in range(num_targets):
            age[i] = scene.sight_age[scene.first[i]]
        power = 1.0 + (effort.greed - 1.0) * rng.random()
        is_guided = rng.random() < effort.guided_share
        x, y, node, due, hop = start.x, start.y, start.node, start.due_au, -1
        k, g = np.int64(0), 0  # a literal 0 would have callees compiled for it apart
        while k < horizon and g < MAX_GOALS:
            target = -1
            if g >= count:
                target = draw_goal(
                    scene,
                    k,
                    x,
                    y,
                    age,
                    effort.forget_steps,
                    power,
                    is_guided,
                    effort.scatter_au,
                    goals[g],
                    rng,
                )
            before = k
            goal_node = nearest_node(ground, goals[g, 0], goals[g, 1])
            if g == 0 and option >= 0:
                goal_node = option
            k, x, y, node, due, first = fly(
                goals[g, 0], goals[g, 1], goal_node, ground, path, k, x, y, node, due
            )
            hop = first if hop < 0 else hop
            g += 1
            if target >= 0:
                age[target] = -k
            elif g <= count:
                for m in range(before, k):
                    for i in range(num_targets):
                        p = scene.first[i] + (7 * m) % (scene.first[i + 1] - scene.first[i])
                        if (scene.x[m, p] - path[m, 0]) ** 2 + (
                            scene.y[m, p] - path[m, 1]
                        ) ** 2 < SENSOR_RADIUS_AU**2:
                            age[i] = -m
        if k == 0:
            continue
        path[k:, 0], path[k:, 1] = x, y
        gain = score(path, scene, tables, probe, sight, squared)
        for o in range(options.shape[0]):
            if options[o] == hop:
                option_gain[o] = max(option_gain[o], gain)
        if gain > best:
            best, best_count, best_hop = gain, g, hop
            for m in range(g):
                _copy(best_goals, m, goals, m)
            for m in range(horizon):
                _copy(best_path, m, path, m)
    return best, best_path, best_goals, best_count, best_hop, option_gain
