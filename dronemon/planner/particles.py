"""Where each target may be: particles that walk as targets do, corrected by every measurement.

A target walks straight at a constant speed, unknown and the same for all targets, and turns now
and then. A sighting puts all its particles at one place, a miss removes those that would have been
seen.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from dronemon.arena import ARENA, Arena
from dronemon.planner.moving import is_inside
from dronemon.planner.settings import MotionSettings
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.sightings import Sight, Sightings
from dronemon.types import FloatArray, IntArray, Measurement

TURN_QUANTILES_RAD = np.radians(
    [0.0, 11.5, 23.0, 34.7, 46.3, 58.2, 71.2, 85.2, 100.5, 118.8, 165.0]
)
"""Size of a turn at evenly spaced probabilities 0 to 1, on development paths (10000 to 10059)."""
_TRIES = 8
_REGENERATIONS = 1500
"""Most walks tried anew for one target and measurement; bounds the time of a decision."""
_NUM_SIGHTS = 6
"""Sights of a target that tell its speed and heading."""
_MOST_MISSES = 64
"""Misses since the last sight up to which particles are walked anew from there."""
_FEW = 0.15
"""Share of surviving particles below which lost ones are walked anew instead of copied."""


@njit(cache=True, fastmath=True, nogil=True)
def _turned(heading, rng):  # type: ignore[no-untyped-def]
    """A new heading after a random turn to either side."""
    quantiles = TURN_QUANTILES_RAD
    place = rng.random() * (quantiles.shape[0] - 1)
    low = int(place)
    size = quantiles[low] + (quantiles[low + 1] - quantiles[low]) * (place - low)
    return heading + size if rng.random() < 0.5 else heading - size


@njit(cache=True, fastmath=True, nogil=True)
def _step(x, y, heading, distance, turns_per_au, bounds, rng):  # type: ignore[no-untyped-def]
    """Walk one target a short distance inside the arena. -> x, y, heading."""
    if rng.random() < 1.0 - math.exp(-turns_per_au * distance):
        heading = _turned(heading, rng)
    for _ in range(_TRIES):
        next_x = x + distance * math.cos(heading)
        next_y = y + distance * math.sin(heading)
        if is_inside(bounds, next_x, next_y):
            return next_x, next_y, heading
        heading = _turned(heading, rng)
    return x, y, heading


@njit(cache=True, fastmath=True, nogil=True)
def walk(walkers, speeds, duration, turns_per_au, bounds, rng):  # type: ignore[no-untyped-def]
    """Walk particles on, in place. walkers: (3, M) x, y, heading; speeds: (M,); duration: au."""
    for j in range(walkers.shape[1]):
        x, y, heading = walkers[0, j], walkers[1, j], walkers[2, j]
        distance = speeds[j] * duration
        x, y, heading = _step(x, y, heading, distance, turns_per_au, bounds, rng)
        walkers[0, j], walkers[1, j], walkers[2, j] = x, y, heading


@njit(cache=True, fastmath=True, nogil=True)
def refuted(walkers, agent, old_trail, trail_radius, trail_doubt, rng):  # type: ignore[no-untyped-def]
    """Particles that a miss removes: in view, or (perhaps) on the target's own trail. -> (K,)."""
    out = np.empty(walkers.shape[1], np.int64)
    count = 0
    for j in range(walkers.shape[1]):
        x, y = walkers[0, j], walkers[1, j]
        gone = (x - agent[0]) ** 2 + (y - agent[1]) ** 2 < SENSOR_RADIUS_AU**2
        for m in range(0 if gone else old_trail.shape[0]):
            if (x - old_trail[m, 0]) ** 2 + (y - old_trail[m, 1]) ** 2 < trail_radius**2:
                gone = rng.random() < trail_doubt
                break
        if gone:
            out[count] = j
            count += 1
    return out[:count]


@njit(cache=True, fastmath=True, nogil=True)
def walk_anew(walkers, speeds, lost, origin, misses, turns_per_au, bounds, rng):  # type: ignore[no-untyped-def]
    """Replace particles by walks from the last sighting that no miss since refutes. -> how many.

    lost:   (K,)   int64 their indices
    origin: (5,)   time, x, y, heading, chance that the heading is right
    misses: (S, 3) time, x, y since
    """
    done = 0
    for _ in range(_REGENERATIONS):
        if done == lost.shape[0]:
            break
        j = lost[done]
        time, x, y, heading = origin[0], origin[1], origin[2], origin[3]
        if rng.random() >= origin[4]:
            heading = rng.random() * 2.0 * math.pi
        kept = True
        for m in range(misses.shape[0]):
            distance = speeds[j] * (misses[m, 0] - time)
            time = misses[m, 0]
            x, y, heading = _step(x, y, heading, distance, turns_per_au, bounds, rng)
            if (x - misses[m, 1]) ** 2 + (y - misses[m, 2]) ** 2 < SENSOR_RADIUS_AU**2:
                kept = False
                break
        if kept:
            walkers[0, j], walkers[1, j], walkers[2, j] = x, y, heading
            done += 1
    return done


class SpeedBelief:
    """Posterior of the targets' common speed, from displacements between sightings."""

    def __init__(self, motion: MotionSettings) -> None:
        self._motion = motion
        self._grid = np.geomspace(motion.slowest, motion.fastest, 80)
        self._log_likelihood = np.zeros_like(self._grid)

    @property
    def _weights(self) -> FloatArray:
        weights = np.exp(self._log_likelihood - self._log_likelihood.max())
        normalised: FloatArray = weights / weights.sum()
        return normalised

    @property
    def mean(self) -> float:
        """Expected speed over the agent's."""
        return float(self._weights @ self._grid)

    def observe(self, displacement_au: float, duration_au: float) -> None:
        """Take two sightings of one target: it walked straight, or turned and came less far."""
        walked = self._grid * duration_au
        spread = self._motion.noise_au + 0.01 * walked
        turned = 1.0 - np.exp(-self._motion.turns_per_au * walked)
        straight = np.exp(-0.5 * ((displacement_au - walked) / spread) ** 2) / spread
        bent = np.where(displacement_au < walked + spread, 0.7 / (walked + spread), 1e-3)
        # Displacements of one sighting to the next few share their ends: each counts half.
        self._log_likelihood += 0.5 * np.log((1.0 - turned) * straight + turned * bent + 1e-6)
        self._log_likelihood -= self._log_likelihood.max()
        np.maximum(self._log_likelihood, -40.0, out=self._log_likelihood)

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Speeds that spread as the posterior does. -> (count,)."""
        ranks = (rng.permutation(count) + 0.5) / count
        index = np.searchsorted(np.cumsum(self._weights), ranks).clip(0, len(self._grid) - 1)
        speeds: FloatArray = self._grid[index] * np.exp(rng.uniform(-0.025, 0.025, count))
        return speeds


@dataclass(slots=True, kw_only=True)
class TargetParticles:
    """What is believed of one target.

    walkers:       (3, M) float64 x, y, heading of its particles
    trail:         places it was seen at, a little apart
    heading_rad:   at the last sight
    heading_trust: chance that it is right
    """

    walkers: FloatArray
    trail: deque[Sight] = field(default_factory=lambda: deque(maxlen=128))
    heading_rad: float = 0.0
    heading_trust: float = 0.0

    def remember(self, sight: Sight) -> None:
        """Lengthen the trail if the target has come away from its end."""
        x_au, y_au = sight[1:]
        if not self.trail or math.dist(self.trail[-1][1:], (x_au, y_au)) > 0.025:
            self.trail.append(sight)


class ParticleBelief:
    """Particles of all targets, folded over the mission's log of sightings."""

    def __init__(
        self,
        priors_au: FloatArray,
        motion: MotionSettings,
        rng: np.random.Generator,
        *,
        num_imagined: int = 0,
        arena: Arena = ARENA,
    ) -> None:
        """Begin at the priors.

        priors_au:    (N, 2) float64 au positions at time 0, NaN where unknown
        num_imagined: targets, kept last, that stand for those not known of yet

        `undetected` is the chance that one of those would not have been seen so far: where their
        number is Poisson, that share of it is left, whatever was found meanwhile.
        """
        self._motion = motion
        self._arena, self._bounds = arena, arena.bounds
        self._rng = rng
        self._num_imagined = num_imagined
        self.undetected = 1.0
        self._num_learned = 0
        self.time_au = 0.0
        self.speed = SpeedBelief(motion)
        self._speeds = self.speed.draw(motion.num_particles, rng)
        imagined_au = np.full((num_imagined, 2), np.nan)
        self.targets = [self._begin(prior) for prior in np.concatenate([priors_au, imagined_au])]

    def _begin(self, prior_au: FloatArray) -> TargetParticles:
        walkers = self._rng.random((3, self._motion.num_particles))
        walkers[:2] = self._arena.places(walkers[:2].T).T
        walkers[2] *= 2.0 * math.pi
        target = TargetParticles(walkers=walkers)
        if not np.isnan(prior_au).any():
            walkers[:2] = prior_au[:, None]
            target.remember(Sight(0.0, *prior_au.tolist()))
        return target

    def advance(self, time_au: float) -> None:
        """Walk all particles on to a time; never back."""
        duration = time_au - self.time_au
        if duration <= 0.0:
            return
        self.time_au = time_au
        for target in self.targets:
            self._walk(target.walkers, self._speeds, duration)

    def _walk(self, walkers: FloatArray, speeds: FloatArray, duration_au: float) -> None:
        turns_per_au = self._motion.turns_per_au
        walk(walkers, speeds, duration_au, turns_per_au, self._bounds, self._rng)

    def futures(
        self, num_particles: int, num_steps: int, interval_au: float
    ) -> tuple[FloatArray, FloatArray]:
        """Give some particles of each target, now and walked on. -> (N, m, 2), (H, N, m, 2)."""
        # Always the first ones: plans made against the same particles keep their worth.
        chosen = np.arange(min(num_particles, self._motion.num_particles))
        speeds = np.tile(self._speeds[chosen], len(self.targets))
        walkers = np.concatenate([target.walkers[:, chosen] for target in self.targets], axis=1)
        shape = (len(self.targets), len(chosen), 2)
        now = walkers[:2].T.reshape(shape).copy()
        later = np.empty((num_steps, *shape))
        for step in range(num_steps):
            self._walk(walkers, speeds, interval_au)
            later[step] = walkers[:2].T.reshape(shape)
        return now, later

    def learn(self, sightings: Sightings) -> None:
        """Take in what the log holds since the last time, target by target that joined, too."""
        for measurement in sightings.since(self._num_learned):
            self._num_learned += 1
            while len(measurement.seen) > len(self.targets) - self._num_imagined:
                # May be where the last one, unseen too, may be.
                self.targets.append(TargetParticles(walkers=self.targets[-1].walkers.copy()))
            self._update(measurement, sightings)

    def _update(self, measurement: Measurement, sightings: Sightings) -> None:
        time_au = measurement.time_au
        self.advance(time_au)
        before = [sightings.sights(i, time_au, _NUM_SIGHTS) for i in range(len(self.targets))]
        seen = np.flatnonzero(measurement.seen).tolist()
        now = {i: Sight(time_au, *measurement.target_au[i].tolist()) for i in seen}
        for i, sight in now.items():
            self._learn_speed(before[i], sight)
        if seen:
            self._speeds = self.speed.draw(self._motion.num_particles, self._rng)
        for i, target in enumerate(self.targets):
            if i in now:
                self._sight(target, before[i], now[i])
            else:
                lost = self._refuted(target, measurement.agent_au)
                if i >= len(self.targets) - self._num_imagined:
                    self.undetected *= 1.0 - len(lost) / self._motion.num_particles
                if len(lost) > (1.0 - _FEW) * self._motion.num_particles and before[i]:
                    misses = self._misses_since(before[i][-1], sightings)
                    lost = lost[self._walk_anew(target, lost, before[i][-1], misses) :]
                if len(lost):
                    self._copy_survivors(target, lost)

    def _learn_speed(self, before: list[Sight], now: Sight) -> None:
        for then in before[-3:]:
            if 1e-6 < now.time_au - then.time_au <= 1.2:
                self.speed.observe(math.dist(then[1:], now[1:]), now.time_au - then.time_au)

    def _sight(self, target: TargetParticles, before: list[Sight], now: Sight) -> None:
        """Put all particles where the target is seen.

        Headings come from the last sights, or from the particles that foresaw the place best.
        """
        walkers, count = target.walkers, self._motion.num_particles
        base = _heading_base(before, now)
        if base is not None:
            target.heading_rad = math.atan2(now.y_au - base.y_au, now.x_au - base.x_au)
            target.heading_trust = 0.65
            walkers[2] = target.heading_rad
            walked = self.speed.mean * (now.time_au - base.time_au)
            if math.dist(now[1:], base[1:]) < 0.93 * walked:  # it turned on the way
                is_loose = self._rng.random(count) < 0.7
                walkers[2] += np.where(is_loose, self._rng.normal(0.0, 0.6, count), 0.0)
        else:
            target.heading_trust = 0.0
            error = (walkers[0] - now.x_au) ** 2 + (walkers[1] - now.y_au) ** 2
            best = np.argpartition(error, count // 12)[: count // 12]
            walkers[2] = walkers[2, self._rng.choice(best, count)]
            walkers[2] += self._rng.normal(0.0, 0.2, count)
        walkers[:2] = self._arena.clip(np.array(now[1:]))[:, None]
        target.remember(now)

    def _refuted(self, target: TargetParticles, agent_au: FloatArray) -> IntArray:
        """Particles that a miss refutes. -> (K,) their indices."""
        motion = self._motion
        latest_au = self.time_au - 0.3 / self.speed.mean
        first_au = self.time_au - motion.trail_au / self.speed.mean
        old = [sight[1:] for sight in target.trail if first_au < sight.time_au < latest_au]
        lost: IntArray = refuted(
            target.walkers,
            agent_au,
            np.array(old, dtype=np.float64).reshape(-1, 2),
            motion.trail_radius_au,
            motion.trail_doubt,
            self._rng,
        )
        return lost

    def _misses_since(self, sight: Sight, sightings: Sightings) -> list[Sight] | None:
        """When and where the agent has missed a target since a sight; None if too often to tell."""
        first = max(0, self._num_learned - _MOST_MISSES)
        recent = sightings.since(first)[: self._num_learned - first]
        misses = [
            Sight(m.time_au, *m.agent_au.tolist())
            for m in recent
            if m.time_au > sight.time_au + 1e-9
        ]
        return misses if len(misses) < _MOST_MISSES else None

    def _walk_anew(
        self, target: TargetParticles, lost: IntArray, sight: Sight, misses: list[Sight] | None
    ) -> int:
        """Walk particles anew from the last sight if all misses since are known. -> how many."""
        if misses is None:
            return 0
        return int(
            walk_anew(
                target.walkers,
                self._speeds,
                lost,
                np.array([*sight, target.heading_rad, target.heading_trust]),
                np.array(misses, dtype=np.float64).reshape(-1, 3),
                self._motion.turns_per_au,
                self._bounds,
                self._rng,
            )
        )

    def _copy_survivors(self, target: TargetParticles, lost: IntArray) -> None:
        """Replace particles by survivors, or by anything in the arena if there are none."""
        survivors = np.setdiff1d(np.arange(self._motion.num_particles), lost)
        if len(survivors):
            target.walkers[:, lost] = target.walkers[:, self._rng.choice(survivors, len(lost))]
        else:
            target.walkers[:, lost] = self._begin(np.full(2, np.nan)).walkers[:, lost]


def _heading_base(before: list[Sight], now: Sight) -> Sight | None:
    """The recent sight from which the present heading is told: far enough, not too old."""
    base = None
    for sight in reversed(before):
        if now.time_au - sight.time_au > 0.65:
            break
        base = sight
        if math.dist(now[1:], sight[1:]) > 0.01:
            break
    if base is not None and math.dist(now[1:], base[1:]) < 1e-4:
        return None
    return base
