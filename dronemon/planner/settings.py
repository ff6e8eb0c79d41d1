"""What the search assumes of targets, how it looks ahead, and what it values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from dronemon.planner.walking import KINDS, Kind
from dronemon.problem import MEASUREMENT_INTERVAL_AU


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSettings:
    """What is assumed of targets, and how closely they are followed; speeds over the agent's."""

    num_particles: int = 240
    """Of each target."""
    slowest: float = 0.005
    fastest: float = 0.3
    kinds: tuple[Kind, ...] = KINDS
    """Ways in which they may move, all as likely before anything is seen."""
    least_share: float = 0.01
    """Particles that move in a way which fits the sightings badly."""
    most_certain: float = 5.0
    """Greatest log of the odds of one way against another."""
    closeness_au: float = 0.005
    """How near to a sighting particles must come to have foreseen it,"""
    closeness_share: float = 0.15
    """and how much of what was walked since the last one is added to that."""
    noise_au: float = 0.0015
    """Of a displacement between two sightings."""
    trail_radius_au: float = 0.1
    """Nearer than this to its own trail a target is seldom, if it is of such a kind,"""
    trail_au: float = 5.0
    """as far as it walked it in this length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSettings:
    """How the search looks ahead and what it values.

    Compared by `benchmarks/tune_search.py` on development seeds; ablations: docs/experiments.md.
    """

    num_steps: int = 26
    """Longest horizon, in measurements."""
    walk_au: float = 0.18
    """Walk of a target after which its place is a guess; the horizon ends there at the latest."""
    num_drawn: int = 200
    """Paths drawn at every decision."""
    num_refined: int = 150
    """Small changes of the best path tried after that."""
    num_planned: int = 80
    """Most particles of each target that paths are scored against."""
    num_places: int = 26 * 240
    """Most places of particles, of all targets at all measurements of the horizon; bounds the time
    of a decision."""
    discount: float = 0.985
    """Worth of a gain one measurement later."""
    fading: float = 0.985
    """Worth of certainty that lasts one measurement longer."""
    drift: float = 0.7
    """Share of a target's speed at which it leaves the place of a measurement behind."""
    probe_au: float = 0.065
    """Distance of the four probes around a target; the mean over its area is about that at it."""
    sight_gain: float = 2.0
    """Worth of having seen a target, for each measurement that the knowledge lasts."""
    forget_steps: float = 25.0
    """Measurements in which that knowledge fades to 1/e."""
    shape_worth: float = 1.0
    """Worth of a belief's mean nearer to its target's presence, per squared error at r_v = 1/30."""
    guided_share: float = 0.7
    """Paths whose goals are drawn by urgency and nearness, rather than at random."""
    greed: float = 6.0
    """Greatest power of that preference."""
    scatter_au: float = 0.05
    """How far from a particle a goal may be."""
    refine_au: float = 0.05
    """Typical change of a goal in refinement."""
    unfound_weight: float = 10.0
    """Weight of a target that was never seen: once found, it can be followed.

    While more targets may exist than are known, an imagined one stands for all of them.
    """
    beyond_worth: float = 1.0
    """Worth of what might be gained after the horizon, in a field that it does not reach across."""
    num_unknown: float = 4.0
    """Targets expected at first where their number is unknown."""
    motion: MotionSettings = field(default_factory=MotionSettings)

    def horizon(self, speed: float) -> int:
        """Measurements to look ahead over, for targets of a speed."""
        return min(self.num_steps, math.ceil(self.walk_au / speed / MEASUREMENT_INTERVAL_AU))
