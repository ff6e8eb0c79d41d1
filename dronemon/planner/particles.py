"""Where each target may be: particles that walk as targets do, corrected by every measurement.

A target walks at a constant speed, in one of a few ways (see `dronemon.planner.walking`). A
sighting puts its particles at one place, a miss removes those that would have been seen; both less
surely where the eye errs. Which way of moving foresaw the sightings, and how fast targets are, is
learned for all together.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.planner import walking
from dronemon.planner.kinds import KindBelief
from dronemon.planner.moving import Walls
from dronemon.planner.settings import MotionSettings
from dronemon.planner.speeds import SpeedBelief
from dronemon.planner.walking import CURVATURE, HEADING, KIND, RESTING, SPEED, Stops, X, Y
from dronemon.problem import SENSOR_AREA_AU2, SENSOR_RADIUS_AU
from dronemon.sensor import PERFECT, Sensor
from dronemon.sightings import Sight, Sightings
from dronemon.types import FloatArray, IntArray, Measurement

_NUM_SIGHTS = 6
"""Sights of a target that tell its speed and heading."""
_MOST_MISSES = 64
"""Misses since the last sight up to which particles are walked anew from there."""
_APART_AU = 0.35
"""Time between two sights from which they are of two visits."""
_ASTRAY = 0.05
"""Density per au^2 of a target where no particle is."""
_FEW = 0.15
"""Share of surviving particles below which lost ones are walked anew instead of copied."""


class _Miss(NamedTuple):
    """When and where the agent did not see a target, and what about it was looked at.

    view_au, hidden_au: as a `Measurement` has them
    """

    time_au: float
    x_au: float
    y_au: float
    view_au: float
    hidden_au: FloatArray | None

    @classmethod
    def of(cls, look: Measurement) -> _Miss:
        x_au, y_au = look.agent_au.tolist()
        return cls(look.time_au, x_au, y_au, look.view_au, look.hidden_au)


@dataclass(slots=True, kw_only=True)
class TargetParticles:
    """What is believed of one target.

    walkers: (M, NUM_ROWS) float64 its particles, rows as `dronemon.planner.walking` has them
    deck:    (M, NUM_ROWS) float64 what it may have been at the last sight
    sights:  the last that are believed
    trail:   places it was seen at, a little apart
    """

    walkers: FloatArray
    deck: FloatArray
    sights: deque[Sight] = field(default_factory=lambda: deque(maxlen=_NUM_SIGHTS))
    trail: deque[Sight] = field(default_factory=lambda: deque(maxlen=128))

    def remember(self, sight: Sight) -> None:
        """Keep a sight, and lengthen the trail if the target has come away from its end."""
        self.sights.append(sight)
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
        sensor: Sensor = PERFECT,
    ) -> None:
        """Begin at the priors.

        priors_au:    (N, 2) float64 au positions at time 0, NaN where unknown
        num_imagined: targets, kept last, that stand for those not known of yet
        sensor:       how the eye errs

        `undetected` is the chance that one of those would not have been seen so far: where their
        number is Poisson, that share of it is left, whatever was found meanwhile.
        """
        self._motion = motion
        self._arena = arena
        self._walls = Walls.of(arena, arena.field)
        self._sensor = sensor
        self._rng = rng
        self._num_imagined = num_imagined
        self.undetected = 1.0
        self._num_learned = 0
        self.time_au = 0.0
        self.speed = SpeedBelief(motion, sensor, len(priors_au) + num_imagined)
        self.kinds = KindBelief(motion, sensor, self._walls, rng)
        imagined_au = np.full((num_imagined, 2), np.nan)
        priors_au = np.concatenate([priors_au, imagined_au])
        self.targets = [self._begin(i, prior_au) for i, prior_au in enumerate(priors_au)]

    def _begin(self, index: int, prior_au: FloatArray) -> TargetParticles:
        count = self._motion.num_particles
        walkers = np.zeros((count, walking.NUM_ROWS))
        walkers[:, :2] = self._arena.places(self._rng.random((count, 2)))
        walkers[:, HEADING] = 2.0 * math.pi * self._rng.random(count)
        walkers[:, SPEED] = self.speed.draw(index, count, self._rng)
        self.kinds.draw(walkers, walkers[:0])
        target = TargetParticles(walkers=walkers, deck=walkers)
        if not np.isnan(prior_au).any():
            walkers[:, :2] = prior_au
            target.remember(Sight(0.0, *prior_au.tolist()))
        target.deck = walkers.copy()
        return target

    @property
    def last_seen_au(self) -> FloatArray:
        """(N,) au when each target was last believed to be seen, a prior counted; -inf if never."""
        return np.array([t.sights[-1].time_au if t.sights else -math.inf for t in self.targets])

    def place(self, places_au: FloatArray, velocities: FloatArray) -> None:
        """Take the truth for now. places_au: (N, 2); velocities: (N, 2) over the agent's speed."""
        for target, place_au, (east, north) in zip(
            self.targets, places_au, velocities, strict=True
        ):
            target.walkers[:, :2] = place_au
            speed = math.hypot(east, north)
            target.walkers[:, SPEED], target.walkers[:, RESTING] = speed, speed == 0.0
            if speed > 0.0:
                target.walkers[:, HEADING] = math.atan2(north, east)

    def advance(self, time_au: float) -> None:
        """Walk all particles on to a time; never back."""
        duration = time_au - self.time_au
        if duration <= 0.0:
            return
        self.time_au = time_au
        for target in self.targets:
            walking.walk(target.walkers, duration, self.kinds.table, self._walls, self._rng)

    def futures(
        self, num_particles: int, num_steps: int, interval_au: float
    ) -> tuple[FloatArray, FloatArray]:
        """Give some particles of each target, now and walked on. -> (N, m, 2), (H, N, m, 2)."""
        # Always the first ones: plans made against the same particles keep their worth.
        count = min(num_particles, self._motion.num_particles)
        walkers = np.concatenate([target.walkers[:count] for target in self.targets])
        shape = (len(self.targets), count, 2)
        now = walkers[:, :2].reshape(shape).copy()
        later = np.empty((num_steps, len(walkers), 2))
        walking.walk_ahead(walkers, interval_au, self.kinds.table, self._walls, self._rng, later)
        return now, later.reshape(num_steps, *shape)

    def learn(self, sightings: Sightings) -> None:
        """Take in what the log holds since the last time, target by target that joined, too."""
        for measurement in sightings.since(self._num_learned):
            self._num_learned += 1
            while len(measurement.seen) > len(self.targets) - self._num_imagined:
                # May be where the last one, unseen too, may be.
                self.speed.join()
                last = self.targets[-1]
                self.targets.append(
                    TargetParticles(walkers=last.walkers.copy(), deck=last.deck.copy())
                )
            self._update(measurement, sightings)

    def _update(self, measurement: Measurement, sightings: Sightings) -> None:
        time_au = measurement.time_au
        self.advance(time_au)
        seen = np.flatnonzero(measurement.seen).tolist()
        now = {i: Sight(time_au, *measurement.target_au[i].tolist()) for i in seen}
        trust = {i: self._trust(i, sight, measurement.agent_au) for i, sight in now.items()}
        believed = {i: sight for i, sight in now.items() if trust[i] >= 0.5}
        for i, sight in believed.items():
            self._learn_speed(i, sight)
        for i, sight in believed.items():
            self._learn_kind(i, sight, sightings)
        if believed:
            for i, target in enumerate(self.targets):
                target.walkers[:, SPEED] = self.speed.draw(i, len(target.walkers), self._rng)
        for i, target in enumerate(self.targets):
            foreseen = target.walkers.copy() if i in now else None
            if trust.get(i, 0.0) < 1.0:
                self._miss(i, measurement, sightings)
            if foreseen is not None:
                self._sight(i, now[i], trust[i], foreseen)

    def _trust(self, index: int, sight: Sight, agent_au: FloatArray) -> float:
        """Chance that a target truly is where it is said to be seen."""
        sensor, target = self._sensor, self.targets[index]
        false = sensor.false_sights
        if false == 0.0:
            return 1.0
        places = target.walkers[:, :2]
        in_view = np.linalg.norm(places - agent_au, axis=1) < SENSOR_RADIUS_AU
        false *= (
            (1.0 - (1.0 - sensor.untold) * in_view.mean()) / len(self.targets) / SENSOR_AREA_AU2
        )
        since = sight.time_au - target.sights[-1].time_au if target.sights else 0.0
        width = 0.02 + 2.0 * sensor.position_au + 0.1 * self.speed.mean_of(index) * since
        squared = ((places - sight[1:]) ** 2).sum(axis=1)
        near = np.exp(-0.5 * squared / width**2).mean() / (2.0 * math.pi * width**2)
        true = (1.0 - sensor.untold) * (near + _ASTRAY)
        return float(true / (true + false))

    def _miss(self, index: int, look: Measurement, sightings: Sightings) -> None:
        """Remove what would have been seen, as surely as the eye would have seen it."""
        target = self.targets[index]
        looked, miss = _stops(_Miss.of(look)), self._sensor.untold
        lost: IntArray = walking.refuted(target.walkers, looked, miss, self._rng)
        if index >= len(self.targets) - self._num_imagined:
            self.undetected *= 1.0 - len(lost) / self._motion.num_particles
        if len(lost) > (1.0 - _FEW) * self._motion.num_particles and target.sights:
            misses = self._misses_since(target.sights[-1], sightings)
            lost = lost[self._walk_anew(index, lost, target.sights[-1], misses) :]
        if len(lost):
            self._copy_survivors(index, lost)
        self._doubt_trail(target)

    def _doubt_trail(self, target: TargetParticles) -> None:
        """Replace particles near the target's own trail, as surely as their kind keeps off it.

        Each by one of its own kind: that a place is unlikely for a kind tells nothing against it.
        """
        walkers, trail_au = target.walkers, self._old_trail(target)
        doubts = walking.doubts(walkers, trail_au, self._motion.trail_radius_au, self.kinds.table)
        is_lost = self._rng.random(len(doubts)) < doubts
        if not is_lost.any():
            return
        for kind in np.unique(walkers[is_lost, KIND]):
            is_own = walkers[:, KIND] == kind
            left, lost = np.flatnonzero(is_own & ~is_lost), np.flatnonzero(is_own & is_lost)
            if len(left):
                walkers[lost] = walkers[self._rng.choice(left, len(lost))]

    def _learn_speed(self, index: int, now: Sight) -> None:
        for then in list(self.targets[index].sights)[-3:]:
            if 1e-6 < now.time_au - then.time_au <= 1.2:
                duration_au = now.time_au - then.time_au
                self.speed.observe(index, math.dist(then[1:], now[1:]), duration_au)

    def _dealt(self, index: int) -> FloatArray:
        """Particles as the target was last seen, as fast and of such kinds as is believed now."""
        deck = self.targets[index].deck.copy()
        deck[:, SPEED] = self.speed.draw(index, len(deck), self._rng)
        self.kinds.draw(deck, self.targets[index].deck)
        return deck

    def _learn_kind(self, index: int, now: Sight, sightings: Sightings) -> None:
        """Weigh the ways of moving by the walks from the last sight to the new one."""
        target = self.targets[index]
        misses = self._misses_since(target.sights[-1], sightings) if target.sights else None
        if misses is not None:
            self.kinds.observe(
                self._dealt(index),
                _stops(target.sights[-1], *misses[:-1], now),
                self._old_trail(target),
                self.speed.mean_of(index) * (now.time_au - target.sights[-1].time_au),
            )

    def _sight(self, index: int, now: Sight, trust: float, foreseen: FloatArray) -> None:
        """Put particles where a target is seen: all, or as many as trust that it is there.

        foreseen: (M, NUM_ROWS) the particles before the picture
        """
        target, count = self.targets[index], self._motion.num_particles
        walkers, is_heading_known = self._put(index, now, foreseen)
        if trust >= 0.5:
            target.deck = walkers.copy()
            is_lost = self._rng.random(count) >= (0.65 if is_heading_known else 0.0)
            target.deck[is_lost, HEADING] = math.tau * self._rng.random(int(is_lost.sum()))
            target.remember(now)
        is_elsewhere = self._rng.random(count) >= trust
        walkers[is_elsewhere] = target.walkers[is_elsewhere]
        target.walkers = walkers

    def _put(self, index: int, now: Sight, foreseen: FloatArray) -> tuple[FloatArray, bool]:
        """Make particles at a place, and say whether sights tell their heading.

        If not, it comes from the particles that foresaw the place best.
        """
        target, count = self.targets[index], self._motion.num_particles
        speed, blur_au = self.speed.mean_of(index), self._sensor.position_au
        base = _heading_base(target.sights, now, 4.0 * blur_au)
        walkers = foreseen.copy()
        if base is not None:
            came = math.dist(now[1:], base[1:])
            self.kinds.draw(walkers, foreseen)
            walkers[:, HEADING] = math.atan2(now.y_au - base.y_au, now.x_au - base.x_au)
            walkers[:, HEADING] += 0.5 * came * walkers[:, CURVATURE]
            if came < 0.93 * speed * (now.time_au - base.time_au):  # it turned on the way
                is_loose = self._rng.random(count) < 0.7
                walkers[:, HEADING] += np.where(is_loose, self._rng.normal(0.0, 0.6, count), 0.0)
        else:
            error = (walkers[:, X] - now.x_au) ** 2 + (walkers[:, Y] - now.y_au) ** 2
            best = foreseen[np.argpartition(error, count // 12)[: count // 12]]
            walkers = best[self._rng.integers(len(best), size=count)]
            self.kinds.draw(walkers, best)
            walkers[:, HEADING] += self._rng.normal(0.0, 0.2, count)
        then = target.sights[-1] if target.sights else None
        if then is not None and now.time_au - then.time_au < _APART_AU:
            stays = math.dist(now[1:], then[1:]) < 0.3 * speed * (now.time_au - then.time_au)
            walkers[:, RESTING] = stays
        off_au = blur_au * self._rng.normal(size=(count, 2))
        walkers[:, :2] = self._arena.clip(np.array(now[1:]) + off_au)
        return walkers, base is not None

    def _old_trail(self, target: TargetParticles) -> FloatArray:
        """Where the target was seen, less what it walked last. -> (P, 2) au"""
        speed = self.speed.mean
        latest_au = self.time_au - 0.3 / speed
        first_au = self.time_au - self._motion.trail_au / speed
        old = [sight[1:] for sight in target.trail if first_au < sight.time_au < latest_au]
        return np.array(old, dtype=np.float64).reshape(-1, 2)

    def _misses_since(self, sight: Sight, sightings: Sightings) -> list[_Miss] | None:
        """When and where the agent has missed a target since a sight; None if too often to tell."""
        first = max(0, self._num_learned - _MOST_MISSES)
        recent = sightings.since(first)[: self._num_learned - first]
        misses = [_Miss.of(look) for look in recent if look.time_au > sight.time_au + 1e-9]
        return misses if len(misses) < _MOST_MISSES else None

    def _walk_anew(
        self, index: int, lost: IntArray, sight: Sight, misses: list[_Miss] | None
    ) -> int:
        """Walk particles anew from the last sight if all misses since are known. -> how many."""
        if misses is None:
            return 0
        return int(
            walking.walk_anew(
                self.targets[index].walkers,
                lost,
                self._dealt(index),
                _stops(sight, *misses),
                self.kinds.table,
                self._walls,
                self._sensor.untold,
                self._rng,
            )
        )

    def _copy_survivors(self, index: int, lost: IntArray) -> None:
        """Replace particles by survivors, or by anything in the arena if there are none."""
        target = self.targets[index]
        is_left = np.ones(self._motion.num_particles, dtype=np.bool_)
        is_left[lost] = False
        survivors = np.flatnonzero(is_left)
        if len(survivors):
            target.walkers[lost] = target.walkers[self._rng.choice(survivors, len(lost))]
        else:
            target.walkers[lost] = self._begin(index, np.full(2, np.nan)).walkers[lost]


def _stops(*stops: Sight | _Miss) -> Stops:
    """As walks take them."""
    looks = np.array([(*stop, 0.0)[:4] for stop in stops], dtype=np.float64)
    told = {
        row: stop.hidden_au
        for row, stop in enumerate(stops)
        if isinstance(stop, _Miss) and stop.hidden_au is not None
    }
    hidden = np.full((len(stops), max(map(len, told.values()), default=0), 2), SENSOR_RADIUS_AU)
    hidden[..., 0] = looks[:, 3:]
    for row, hidden_au in told.items():
        hidden[row] = hidden_au
    return Stops(looks, hidden)


def _heading_base(before: Iterable[Sight], now: Sight, blur_au: float) -> Sight | None:
    """The recent sight from which the present heading is told: far enough, not too old."""
    base = None
    for sight in reversed(list(before)):
        if now.time_au - sight.time_au > 0.65:
            break
        base = sight
        if math.dist(now[1:], sight[1:]) > max(0.01, blur_au):
            break
    if base is not None and math.dist(now[1:], base[1:]) < 1e-4:
        return None
    return base
