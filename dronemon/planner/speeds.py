"""How fast targets move, learned from displacements between their sightings."""

from __future__ import annotations

import math

import numpy as np

from dronemon.planner.settings import MotionSettings
from dronemon.sensor import Sensor
from dronemon.types import FloatArray

SPREADS = (0.025, 0.15, 0.5)
"""How far apart targets' speeds may be: standard deviations of their logarithms, equally likely."""
_GRID_SIZE = 80


class SpeedBelief:
    """Posterior of each target's speed over the agent's.

    What all have in common is believed of each: a mean speed, and how far theirs lie about it.
    """

    def __init__(self, motion: MotionSettings, sensor: Sensor, num_targets: int) -> None:
        self._noise_au = math.hypot(motion.noise_au, math.sqrt(2.0) * sensor.position_au)
        self._turns_per_au = max(kind.turns_per_au for kind in motion.kinds)
        self._grid = np.geomspace(motion.slowest, motion.fastest, _GRID_SIZE)
        self._own = np.zeros((num_targets, _GRID_SIZE))  # log-likelihoods
        steps = np.subtract.outer(np.log(self._grid), np.log(self._grid))
        about = [np.exp(-0.5 * (steps / spread) ** 2) for spread in SPREADS]
        self._about = np.stack([of / of.sum(axis=1, keepdims=True) for of in about])  # (S, G, G)
        self._weights: FloatArray | None = None

    def join(self) -> None:
        """One more target, of which nothing is known."""
        self._own = np.concatenate([self._own, np.zeros((1, _GRID_SIZE))])
        self._weights = None

    @property
    def weights(self) -> FloatArray:
        """Posterior of each target over the grid. -> (N, G)"""
        if self._weights is None:
            own = np.exp(self._own)
            told = np.log(np.einsum("smg,ng->nsm", self._about, own) + 1e-300)
            others = told.sum(axis=0) - told  # (N, S, G) of means and spreads, but for its own word
            others = np.exp(others - others.max(axis=(1, 2), keepdims=True))
            weights = own * np.einsum("nsm,smg->ng", others, self._about)
            self._weights = weights / weights.sum(axis=1, keepdims=True)
        return self._weights

    def mean_of(self, target: int) -> float:
        """Expected speed of a target."""
        return float(self.weights[target] @ self._grid)

    @property
    def mean(self) -> float:
        """Expected speed of any target."""
        return float((self.weights @ self._grid).mean())

    def observe(self, target: int, displacement_au: float, duration_au: float) -> None:
        """Take two sightings of a target: it walked straight, or turned and came less far."""
        walked = self._grid * duration_au
        spread = self._noise_au + 0.01 * walked
        turned = 1.0 - np.exp(-self._turns_per_au * walked)
        straight = np.exp(-0.5 * ((displacement_au - walked) / spread) ** 2) / spread
        bent = np.where(displacement_au < walked + spread, 0.7 / (walked + spread), 1e-3)
        # Displacements of one sighting to the next few share their ends: each counts half.
        own = self._own[target]
        own += 0.5 * np.log((1.0 - turned) * straight + turned * bent + 1e-6)
        own -= own.max()
        np.maximum(own, -40.0, out=own)
        self._weights = None

    def draw(self, target: int, count: int, rng: np.random.Generator) -> FloatArray:
        """Speeds of a target that spread as its posterior does. -> (count,)."""
        ranks = (rng.permutation(count) + 0.5) / count
        index = np.searchsorted(np.cumsum(self.weights[target]), ranks).clip(0, _GRID_SIZE - 1)
        speeds: FloatArray = self._grid[index] * np.exp(rng.uniform(-0.025, 0.025, count))
        return speeds
