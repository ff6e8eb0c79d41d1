"""The binary sensor: a circular field of view, read at even distances along the agent's path.

Source: paper, section III-B and equation 1. That the residual is carried over waypoints is the
authors' release.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from dronemon.arena import Arena
from dronemon.problem import MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU, Prior
from dronemon.sensor import Sensor
from dronemon.types import BoolArray, FloatArray, Measurement

if TYPE_CHECKING:
    from torch import Tensor


Lengths = TypeVar("Lengths", FloatArray, "Tensor")
"""Lengths of one leg or of many, in numpy or torch."""


def num_due(residual_au: Lengths, length_au: Lengths) -> Lengths:
    """How many measurements fall on legs that begin `residual_au` after the last one.

    One falls every 0.1 au flown, also across waypoints. A measurement due within 1e-9 intervals of
    the leg's end belongs to the leg, so that legs of exactly 0.1 au have one each.

    residual_au, length_au: (...) au
    -> (...) whole numbers
    """
    return ((residual_au + length_au) / MEASUREMENT_INTERVAL_AU + 1e-9) // 1.0


def share_at(number: Lengths, residual_au: Lengths, length_au: Lengths) -> Lengths:
    """Share of a leg flown at its first, second, ... measurement. All (...) -> (...) in [0, 1]."""
    return ((MEASUREMENT_INTERVAL_AU * number - residual_au) / length_au).clip(0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """Where measurements fall on one straight leg, flown at unit speed.

    offsets_au:   (M,)   au distance of each from the leg's start, which is the time to it
    positions_au: (M, 2) au
    residual_au:  au flown since the last measurement at the leg's end
    """

    offsets_au: FloatArray
    positions_au: FloatArray
    residual_au: float


def sample_leg(start_au: FloatArray, end_au: FloatArray, residual_au: float) -> Leg:
    """Find where measurements fall on a leg: see `num_due`. start_au, end_au: (2,) au."""
    length = np.array([math.hypot(end_au[0] - start_au[0], end_au[1] - start_au[1])])
    residual = np.array([residual_au])
    count = int(num_due(residual, length)[0])
    share = share_at(np.arange(1.0, count + 1.0), residual, length)
    return Leg(
        offsets_au=share * length,
        positions_au=start_au + share[:, None] * (end_au - start_au),
        residual_au=max(0.0, residual_au + float(length[0]) - count * MEASUREMENT_INTERVAL_AU),
    )


def sense(agent_au: FloatArray, targets_au: FloatArray) -> BoolArray:
    """Tell which targets are in view: those strictly nearer than 0.1 au.

    agent_au: (..., 2); targets_au: (..., N, 2) -> (..., N) bool
    """
    offsets = targets_au - agent_au[..., None, :]
    seen: BoolArray = np.sqrt(offsets[..., 0] ** 2 + offsets[..., 1] ** 2) < SENSOR_RADIUS_AU
    return seen


class Roster:
    """Which of the true targets are known of: all, or each from its first sighting on.

    known:     indices of those known, in the order in which they became so
    priors_au: (K, 2) places of those known at time 0, NaN where unknown
    """

    def __init__(self, prior: Prior, first_au: FloatArray) -> None:
        """first_au: (N, 2) where targets truly are at time 0."""
        self.known: list[int] = [] if prior == "none" else list(range(len(first_au)))
        places_au = first_au if prior == "full" else np.full_like(first_au, np.nan)
        self.priors_au: FloatArray = places_au[self.known]

    def tell(self, truth: Measurement) -> Measurement:
        """What the sensor says of those known, whom the ones seen now for the first time join."""
        seen = np.flatnonzero(truth.seen).tolist()
        self.known += [target for target in seen if target not in self.known]
        known = self.known
        return replace(truth, seen=truth.seen[known], target_au=truth.target_au[known])


def measure(time_au: float, agent_au: FloatArray, targets_au: FloatArray) -> Measurement:
    """Read the sensor at one instant. agent_au: (2,); targets_au: (N, 2) true positions."""
    seen = sense(agent_au, targets_au)
    return Measurement(
        time_au=time_au,
        agent_au=agent_au,
        seen=seen,
        target_au=np.where(seen[:, None], targets_au, np.nan),
    )


def misread(
    truth: Measurement, sensor: Sensor, arena: Arena, rng: np.random.Generator
) -> Measurement:
    """What an eye that errs makes of what a perfect one would see: see `Sensor`.

    Of a target that is told at two places one holds. False alarms are of targets that are not
    seen, anywhere in view.
    """
    if sensor.is_perfect:
        return truth
    count = len(truth.seen)
    told_au = np.full((count, 2), np.nan)
    for target in np.flatnonzero(truth.seen & (rng.random(count) >= sensor.miss)).tolist():
        taken_for = target
        if count > 1 and rng.random() < sensor.confusion:
            taken_for = (target + int(rng.integers(1, count))) % count
        told_au[taken_for] = truth.target_au[target] + rng.normal(0.0, sensor.position_au, 2)
    for _ in range(rng.poisson(sensor.false_alarms)):
        if len(unseen := np.flatnonzero(np.isnan(told_au[:, 0]))):
            reach, bearing = SENSOR_RADIUS_AU * math.sqrt(rng.random()), rng.uniform(0.0, math.tau)
            offset_au = reach * np.array([math.cos(bearing), math.sin(bearing)])
            told_au[rng.choice(unseen)] = truth.agent_au + offset_au
    return replace(truth, seen=~np.isnan(told_au[:, 0]), target_au=arena.clip(told_au))
