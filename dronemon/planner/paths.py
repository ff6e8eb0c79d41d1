"""Candidate paths and the search among them: the compiled inside of the search.

A path is a list of goals, flown to one after the other, straight, around corners or along a
roadmap's shortest paths; what counts are the places where it measures.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from dronemon.planner.moving import clipped, drawn, follow, nearest_node
from dronemon.planner.scoring import score
from dronemon.planner.settings import SearchSettings
from dronemon.problem import MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU
from dronemon.types import FloatArray

MAX_GOALS = 24
NOTHING = -1e30
"""Gain of no path at all; fast arithmetic does not know infinity."""


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

    @classmethod
    def of(cls, settings: SearchSettings) -> Effort:
        """Give what the search needs of its settings."""
        return cls(*(getattr(settings, name) for name in cls._fields))


class Found(NamedTuple):
    """The best path found.

    gain:         float, NOTHING where there is no path
    path_au:      (H, 2) au where it measures
    goals_au:     (MAX_GOALS, 2) au the goals it is flown by, the first `num_goals` of them
    num_goals:    int
    hop:          int first roadmap node on the way, -1 in free flight
    option_gains: (K,) gain of the best path by way of each option
    """

    gain: float
    path_au: FloatArray
    goals_au: FloatArray
    num_goals: int
    hop: int
    option_gains: FloatArray


@njit(cache=True, fastmath=True, nogil=True)
def draw_goal(forecast, walls, k, x, y, age, forget_steps, power, is_guided, scatter, goal, rng):  # type: ignore[no-untyped-def]
    """Draw where to fly next: mostly where a particle will be when it is reached. -> its target.

    age: (N,) steps since each target was seen, less k
    """
    if rng.random() < 0.06:
        goal[0], goal[1] = drawn(walls, rng)
        return -1
    num_targets = age.shape[0]
    weight = np.ones(num_targets)
    if is_guided:
        for i in range(num_targets):
            p = forecast.first[i] + int(rng.random() * (forecast.first[i + 1] - forecast.first[i]))
            distance = math.sqrt((forecast.x[k, p] - x) ** 2 + (forecast.y[k, p] - y) ** 2)
            urge = 1.0 - math.exp(-(age[i] + k + 1) / forget_steps)
            weight[i] = (urge / (distance + 0.15)) ** power
    place = rng.random() * weight.sum()
    target = 0
    while target < num_targets - 1 and place >= weight[target]:
        place -= weight[target]
        target += 1
    p = forecast.first[target] + int(
        rng.random() * (forecast.first[target + 1] - forecast.first[target])
    )
    distance = math.sqrt((forecast.x[k, p] - x) ** 2 + (forecast.y[k, p] - y) ** 2)
    arrival = min(forecast.x.shape[0] - 1, k + int(distance / MEASUREMENT_INTERVAL_AU + 0.5))
    off = scatter * math.sqrt(rng.random())
    bearing = 2.0 * math.pi * rng.random()
    x = forecast.x[arrival, p] + off * math.cos(bearing)
    y = forecast.y[arrival, p] + off * math.sin(bearing)
    goal[0], goal[1] = clipped(walls, x, y)
    return target


@njit(cache=True, nogil=True)
def _copy(to, row, source, source_row):  # type: ignore[no-untyped-def]
    """Copy a row (2,); assigning slices takes a second of compiling for each."""
    to[row, 0], to[row, 1] = source[source_row, 0], source[source_row, 1]


@njit(cache=True, fastmath=True, nogil=True)
def refine(goals, count, forecast, walls, size, rng):  # type: ignore[no-untyped-def]
    """Change a goal a little: move, drop, insert, swap, or cut the list there. -> its length."""
    g = int(rng.random() * min(count, 6))
    kind = rng.random()
    if kind < 0.6:
        reach = size * 2.0 ** (2.0 - 4.0 * rng.random())
        x, y = goals[g, 0] + reach * rng.normal(), goals[g, 1] + reach * rng.normal()
        goals[g, 0], goals[g, 1] = clipped(walls, x, y)
        return count
    if kind < 0.7:
        for c in range(g, count - 1):
            _copy(goals, c, goals, c + 1)
        return count - 1
    if kind < 0.85 and count < goals.shape[0]:
        for c in range(count, g, -1):
            _copy(goals, c, goals, c - 1)
        if rng.random() < 0.5:
            k, p = int(rng.random() * forecast.x.shape[0]), int(rng.random() * forecast.x.shape[1])
            x, y = forecast.x[k, p], forecast.y[k, p]
        else:
            x, y = goals[g, 0] + 2.0 * size * rng.normal(), goals[g, 1] + 2.0 * size * rng.normal()
        goals[g, 0], goals[g, 1] = clipped(walls, x, y)
        return count + 1
    if kind < 0.93:
        other = int(rng.random() * count)
        for c in range(2):
            goals[g, c], goals[other, c] = goals[other, c], goals[g, c]
        return count
    return g


@njit(cache=True, fastmath=True, nogil=True)
def search(start, ground, options, forecast, tables, effort, last_goals, num_last, rng):  # type: ignore[no-untyped-def]
    """Find the path of the greatest gain.

    options:    (K,) int64 neighbours of the start's node, empty in free flight
    last_goals: (MAX_GOALS, 2) au of the last best path, the first num_last of them
    -> a Found
    """
    num_targets, horizon = forecast.first.shape[0] - 1, forecast.x.shape[0]
    probe, sight = np.empty_like(forecast.probe_age), np.empty_like(forecast.sight_age)
    squared = np.empty(forecast.x.shape[1], np.float32)
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
            count = refine(goals, best_count, forecast, ground.walls, effort.refine_au, rng)
        elif options.shape[0] > 0 and c % 2 == 0:
            count = 1
            option = options[(c // 2) % options.shape[0]]
            _copy(goals, 0, ground.nodes, option)
        for i in range(num_targets):
            age[i] = forecast.sight_age[forecast.first[i]]
        power = 1.0 + (effort.greed - 1.0) * rng.random()
        is_guided = rng.random() < effort.guided_share
        x, y, node, due, hop = start.x, start.y, start.node, start.due_au, -1
        k, g = np.int64(0), 0  # a literal 0 would have callees compiled for it apart
        while k < horizon and g < MAX_GOALS:
            target = -1
            if g >= count:
                target = draw_goal(
                    forecast,
                    ground.walls,
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
            k, x, y, node, due, first = follow(
                goals[g, 0], goals[g, 1], goal_node, ground, path, k, x, y, node, due
            )
            hop = first if hop < 0 else hop
            g += 1
            if target >= 0:
                age[target] = -k
            elif g <= count:
                for m in range(before, k):
                    for i in range(num_targets):
                        p = forecast.first[i] + (7 * m) % (
                            forecast.first[i + 1] - forecast.first[i]
                        )
                        if (forecast.x[m, p] - path[m, 0]) ** 2 + (
                            forecast.y[m, p] - path[m, 1]
                        ) ** 2 < SENSOR_RADIUS_AU**2:
                            age[i] = -m
        if k == 0:
            continue
        path[k:, 0], path[k:, 1] = x, y
        gain = score(path, forecast, tables, probe, sight, squared)
        for o in range(options.shape[0]):
            if options[o] == hop:
                option_gain[o] = max(option_gain[o], gain)
        if gain > best:
            best, best_count, best_hop = gain, g, hop
            for m in range(g):
                _copy(best_goals, m, goals, m)
            for m in range(horizon):
                _copy(best_path, m, path, m)
    return Found(best, best_path, best_goals, best_count, best_hop, option_gain)
