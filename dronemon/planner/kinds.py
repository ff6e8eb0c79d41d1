"""In which way targets move, learned for all together from how each way foresaw their sightings."""

from __future__ import annotations

import numpy as np

from dronemon.planner import walking
from dronemon.planner.moving import Walls
from dronemon.planner.settings import MotionSettings
from dronemon.planner.walking import CURVATURE, KIND, Stops, X, Y
from dronemon.sensor import Sensor
from dronemon.types import FloatArray, IntArray

_NUM_WALKS = 200
"""Walks of each kind from one sight to the next, by which it is weighed."""


class KindBelief:
    """Posterior of the way in which all targets move.

    table: (K, 4) float64 the ways, as `walking.table_of` gives them
    """

    def __init__(
        self, motion: MotionSettings, sensor: Sensor, walls: Walls, rng: np.random.Generator
    ) -> None:
        """walls: within which targets stay."""
        self._motion, self._sensor = motion, sensor
        self._walls, self._rng = walls, rng
        self.table = walking.table_of(motion.kinds)
        self._log_weights = np.zeros(len(motion.kinds))

    @property
    def shares(self) -> FloatArray:
        """Of each kind, none of them ever below a floor. -> (K,)"""
        weights = np.exp(self._log_weights - self._log_weights.max())
        floor = self._motion.least_share
        shares: FloatArray = floor + (1.0 - floor * len(weights)) * weights / weights.sum()
        return shares

    def draw(self, walkers: FloatArray, known: FloatArray) -> None:
        """Let particles move in ways as likely as they are, in place.

        walkers: (M, NUM_ROWS); known: (L, NUM_ROWS) particles whose curves are kept
        """
        ranks = (self._rng.permutation(len(walkers)) + self._rng.random()) / len(walkers)
        kinds = np.searchsorted(np.cumsum(self.shares), ranks).clip(0, len(self.table) - 1)
        self._become(walkers, kinds, known)

    def _become(self, walkers: FloatArray, kinds: IntArray, known: FloatArray) -> None:
        """Make particles of these kinds, with what each needs. kinds: (M,)"""
        walkers[:, KIND], walkers[:, CURVATURE] = kinds, 0.0
        for k, kind in enumerate(self._motion.kinds):
            number = int((kinds == k).sum())
            if kind.curvature[1] == 0.0 or number == 0:
                continue
            own = known[known[:, KIND] == k, CURVATURE]
            if len(own):
                curvature = self._rng.choice(own, number)
                curvature *= np.exp(self._rng.normal(0.0, 0.1, number))
            else:
                low, high = np.log(kind.curvature)
                curvature = np.exp(self._rng.uniform(low, high, number))
                curvature *= self._rng.choice([-1.0, 1.0], number)
            walkers[kinds == k, CURVATURE] = curvature

    def observe(
        self, deck: FloatArray, stops: Stops, trail_au: FloatArray, walked_au: float
    ) -> None:
        """Take two sights of a target in a row: how many walks from one come to the other?

        deck:      (M, NUM_ROWS) its particles at the first sight
        stops:     that sight, every miss since, and the new sight
        trail_au:  (P, 2)        where it was seen of old
        walked_au: way that it went meanwhile
        """
        count = len(self.table)
        walkers = deck[self._rng.integers(len(deck), size=count * _NUM_WALKS)]
        self._become(walkers, np.repeat(np.arange(count), _NUM_WALKS), deck)
        lives = walking.outlived(
            walkers, stops, self.table, self._walls, self._sensor.untold, self._rng
        )
        width = self._motion.closeness_au + 2.0 * self._sensor.position_au
        width += self._motion.closeness_share * walked_au
        now_au = stops.looks[-1, 1:3]
        squared = (walkers[:, X] - now_au[0]) ** 2 + (walkers[:, Y] - now_au[1]) ** 2
        closeness = np.exp(-0.5 * squared / width**2)
        radius_au = self._motion.trail_radius_au
        weights = lives * (1.0 - walking.doubts(walkers, trail_au, radius_au, self.table))
        lives, weights, closeness = (v.reshape(count, -1) for v in (lives, weights, closeness))
        near = (weights * closeness).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-9)
        likelihoods = lives.mean(axis=1) * near
        # A tenth for what none of them is: no single sighting decides.
        self._log_weights += np.log(likelihoods + 0.1 * likelihoods.mean() + 1e-12)
        self._log_weights -= self._log_weights.max()
        np.maximum(self._log_weights, -self._motion.most_certain, out=self._log_weights)
