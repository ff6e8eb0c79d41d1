"""The binary sensor: a circular field of view, read at even distances along the agent's path.

Source: paper, section III-B and equation 1; PAPER-NOTES' measurement row ("residual carried over
waypoints").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dronemon.problem import MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU
from dronemon.types import BoolArray, FloatArray, Measurement


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """Where measurements fall on one straight leg.

    offsets_au: (M,) distance of each from the leg's start; positions_au: (M, 2); residual_au: flown
    since the last measurement at the leg's end
    """

    offsets_au: FloatArray
    positions_au: FloatArray
    residual_au: float


def sample_leg(start_au: FloatArray, end_au: FloatArray, residual_au: float) -> Leg:
    """Find where measurements fall on a leg that begins `residual_au` after the last one.

    One falls every 0.1 au flown, also across waypoints.
    A measurement due within 1e-9 intervals of the leg's end belongs to the leg, so that legs of
    exactly 0.1 au have one each.

    start_au, end_au: (2,) au
    """
    length = math.hypot(end_au[0] - start_au[0], end_au[1] - start_au[1])
    flown = residual_au + length
    count = math.floor(flown / MEASUREMENT_INTERVAL_AU + 1e-9)
    offsets = np.clip(MEASUREMENT_INTERVAL_AU * np.arange(1, count + 1) - residual_au, 0.0, length)
    share = offsets / length if length > 0.0 else offsets
    return Leg(
        offsets_au=offsets,
        positions_au=start_au + share[:, None] * (end_au - start_au),
        residual_au=max(0.0, flown - count * MEASUREMENT_INTERVAL_AU),
    )


def sense(agent_au: FloatArray, targets_au: FloatArray) -> BoolArray:
    """Tell which targets are in view: those strictly nearer than 0.1 au.

    agent_au: (..., 2); targets_au: (..., N, 2) -> (..., N) bool
    """
    offsets = targets_au - agent_au[..., None, :]
    seen: BoolArray = np.sqrt(offsets[..., 0] ** 2 + offsets[..., 1] ** 2) < SENSOR_RADIUS_AU
    return seen


def measure(time_au: float, agent_au: FloatArray, targets_au: FloatArray) -> Measurement:
    """Read the sensor at one instant. agent_au: (2,); targets_au: (N, 2) true positions."""
    seen = sense(agent_au, targets_au)
    return Measurement(
        time_au=time_au,
        agent_au=agent_au,
        seen=seen,
        target_au=np.where(seen[:, None], targets_au, np.nan),
    )
