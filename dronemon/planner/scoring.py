"""What a path is worth: the compiled score of the search, and what it is scored in.

A path's worth is the uncertainty that it takes away from the targets' surroundings, as the metric
Unc counts it:

  * Around every particle lie four probes. The state of a probe is the age of the sighting in its
    very place that would leave it as uncertain (its *equivalent age*), in quarters of an interval.
    Age grows as time passes; a measurement near the probe makes it younger.
  * `worth[age]` is the certainty that a probe of that age will still enjoy, summed over the future;
    a measurement gains the difference.
  * A sighting also gains by what it tells of the place. A miss sets the belief's mean to 0 where it
    is taken: that gains where the mean is false, as on the trail of old sightings behind a target,
    and costs near the target, where it bends the peak (the metric JSD). With mean mu there, and
    p the presence that the target's distance would give, squared error falls by mu (mu - 2 p).
  * In a field that the horizon does not reach across, where the path ends counts, too: what it
    would gain to fly on from there to each target, as far as its particles will be together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dronemon.arena import Arena
from dronemon.planner.moving import cell
from dronemon.planner.settings import SearchSettings
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
_REACH_AU = 0.25
"""A measurement farther from a probe tells nothing about it."""
_REACH_BINS = 512
_NEAR = 0.05
"""Squared distance, particle to agent, beyond which its probes are left alone."""
MEAN_CELLS_PER_AU, MOST_MEAN_CELLS = 48.0, 64**2
"""Of the fields of posterior means; cells of a large field are larger."""


def _matern(distance: FloatArray) -> FloatArray:
    scaled = math.sqrt(3.0) * distance
    kernel: FloatArray = (1.0 + scaled) * np.exp(-scaled)
    return kernel


class Tables(NamedTuple):
    """Look-up tables of the score; all follow from the kernel, the settings and the speed.

    age_at:      (B,) int32 equivalent age of a probe by squared distance, in B bins to 0.25 au
    seen_age:    that of the probes of a target just seen
    worth:       (NUM_AGES,) float32 certainty still to come, by age
    known:       (OLDEST + 1,) float32 gain of a sighting by the age of the last
    shape_worth: worth of squared error of the mean
    discount:    (H,) float32
    fading:      log of the discount of one step
    probe_au:    distance of the probes from a particle
    """

    age_at: Int32Array
    seen_age: int
    worth: Float32Array
    known: Float32Array
    shape_worth: float
    discount: Float32Array
    fading: float
    probe_au: float


class Forecast(NamedTuple):
    """What a path is scored in. P particles, those of a target beside each other.

    x, y:      (H, P)    float32 au at each of the next measurements
    weight:    (P,)      float32
    probe_age: (P, 4)    int32 now
    sight_age: (P,)      int32 now
    first:     (N + 1,)  int64 each target's first particle
    mean:      (N, C, R) float32 the beliefs' means now, in the cells of the arena
    bounds:    (2, 2)    float64 au the arena's
    together:  (N,)      float32 share of a target's particles that are in view from one of them at
               the end, on the average; empty where the horizon reaches across the arena
    """

    x: Float32Array
    y: Float32Array
    weight: Float32Array
    probe_age: Int32Array
    sight_age: Int32Array
    first: IntArray
    mean: Float32Array
    bounds: FloatArray
    together: Float32Array


def mean_cells(arena: Arena) -> tuple[int, int]:
    """Columns and rows of the fields of posterior means over an arena."""
    wanted = MEAN_CELLS_PER_AU * arena.extent_au
    columns, rows = np.rint(wanted * min(1.0, math.sqrt(MOST_MEAN_CELLS / wanted.prod())))
    return max(int(columns), 1), max(int(rows), 1)


def make_tables(settings: SearchSettings, speed: float) -> Tables:
    """Build the tables for a believed speed of the targets."""
    age_au = np.arange(NUM_AGES) / AGES_PER_STEP * MEASUREMENT_INTERVAL_AU
    correlation = _matern(
        np.hypot(settings.drift * speed * age_au / LENGTH_SCALE_AU, age_au / TIME_SCALE_AU)
    )
    certainty = 1.0 - np.sqrt(1.0 - correlation**2)
    certainty[-AGES_PER_STEP:] = 0.0
    worth = certainty.copy()
    for age in range(NUM_AGES - AGES_PER_STEP - 1, -1, -1):
        worth[age] += settings.fading * worth[age + AGES_PER_STEP]
    distance_au = np.sqrt((np.arange(_REACH_BINS) + 0.5) / _REACH_BINS) * _REACH_AU
    nearest_age = np.searchsorted(-correlation, -_matern(distance_au / LENGTH_SCALE_AU))
    age_at: Int32Array = np.minimum(nearest_age, NUM_AGES - 1).astype(np.int32)
    forget = settings.forget_steps
    known = settings.sight_gain * forget * (1.0 - np.exp(-np.arange(OLDEST + 1) / forget))
    return Tables(
        age_at=age_at,
        seen_age=int(age_at[int((settings.probe_au / _REACH_AU) ** 2 * _REACH_BINS)]),
        worth=worth.astype(np.float32),
        known=known.astype(np.float32),
        # A fast target soon leaves the shape behind.
        shape_worth=settings.shape_worth * 2.0 / (1.0 + speed * TIME_SCALE_AU / LENGTH_SCALE_AU),
        discount=(settings.discount ** np.arange(settings.horizon(speed))).astype(np.float32),
        fading=math.log(settings.discount),
        probe_au=settings.probe_au,
    )


@njit(cache=True, fastmath=True, nogil=True)
def probe_ages(particles, first, points, mask, time_au, tables, out):  # type: ignore[no-untyped-def]
    """Write the equivalent age now of every probe, from what was measured in the belief's window.

    particles: (P, 2)    au
    first:     (N + 1,)  each target's first particle
    points:    (N, n, 3) au x, y, time of each target's data
    mask:      (N, n)    bool whether there is such a datum
    out:       (P, 4)    int32
    """
    rho = tables.probe_au
    scale = _REACH_BINS / _REACH_AU**2
    squared_speed = (LENGTH_SCALE_AU / TIME_SCALE_AU) ** 2
    for i in range(mask.shape[0]):
        for p in range(first[i], first[i + 1]):
            for q in range(4):
                x = particles[p, 0] + (rho if q == 0 else (-rho if q == 1 else 0.0))
                y = particles[p, 1] + (rho if q == 2 else (-rho if q == 3 else 0.0))
                nearest = 1e9
                for m in range(mask.shape[1]):
                    if not mask[i, m]:
                        continue
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
def score(path, forecast, tables, probe, sight, squared):  # type: ignore[no-untyped-def]
    """What a path gains. Ages are kept less the time that has passed, so that they need not grow.

    path:    (H, 2) au
    probe:   (P, 4) int32 scratch
    sight:   (P,)   int32 scratch
    squared: (P,)   float32 scratch
    """
    for p in range(sight.shape[0]):
        sight[p] = forecast.sight_age[p]
        for q in range(4):
            probe[p, q] = forecast.probe_age[p, q]
    rho = np.float32(tables.probe_au)
    scale = np.float32(_REACH_BINS / _REACH_AU**2)
    shape_worth = np.float32(tables.shape_worth)
    columns, rows = forecast.mean.shape[1], forecast.mean.shape[2]
    total = 0.0
    for k in range(path.shape[0]):
        passed = k + 1
        ax, ay = np.float32(path[k, 0]), np.float32(path[k, 1])
        for p in range(squared.shape[0]):
            dx, dy = forecast.x[k, p] - ax, forecast.y[k, p] - ay
            squared[p] = dx * dx + dy * dy
        gained = np.float32(0.0)
        cx, cy = cell(forecast.bounds, ax, ay, columns, rows)
        for i in range(forecast.mean.shape[0]):
            mean = max(forecast.mean[i, cx, cy], np.float32(0.0))  # as the metric JSD counts it
            cleared = shape_worth * mean * mean
            for p in range(forecast.first[i], forecast.first[i + 1]):
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
                    if mean > 0.0:
                        presence = math.exp(np.float32(-0.5 / PRESENCE_STD_AU**2) * squared[p])
                        gain -= np.float32(2.0) * shape_worth * mean * presence
                    dx, dy = forecast.x[k, p] - ax, forecast.y[k, p] - ay
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
                gained += gain * forecast.weight[p]
        total += tables.discount[k] * gained
    if forecast.together.shape[0] > 0:
        total += _gain_beyond(path, forecast, tables, probe, sight)
    return total


@njit(cache=True, fastmath=True, nogil=True)
def _gain_beyond(path, forecast, tables, probe, sight):  # type: ignore[no-untyped-def]
    """What it would gain to fly on from the path's end to each target, as if to that one alone."""
    horizon = path.shape[0]
    total = 0.0
    for i in range(forecast.together.shape[0]):
        for p in range(forecast.first[i], forecast.first[i + 1]):
            dx = forecast.x[horizon - 1, p] - path[horizon - 1, 0]
            dy = forecast.y[horizon - 1, p] - path[horizon - 1, 1]
            steps = horizon + math.sqrt(dx * dx + dy * dy) / MEASUREMENT_INTERVAL_AU
            gain = tables.known[min(int(sight[p] + steps), OLDEST)]
            for q in range(4):
                old = min(int(probe[p, q] + AGES_PER_STEP * steps), NUM_AGES - 1)
                if tables.seen_age < old:
                    gain += tables.worth[tables.seen_age] - tables.worth[old]
            worth = forecast.together[i] * forecast.weight[p] * math.exp(tables.fading * steps)
            total += worth * gain
    return total
