"""One episode of one planner in the simulated world, flown exactly as the paper evaluates.

The agent flies straight at unit speed from waypoint to waypoint and measures every 0.1 au flown;
targets move on all the while. Source: paper, section V-A.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from dronemon.arena import Arena
from dronemon.belief import Belief, EpisodeMetrics, episode_metrics
from dronemon.errors import PlannerError, blaming
from dronemon.planner import Briefing, Clairvoyant, Planner, Snapshot, TargetsAt
from dronemon.planner.motion import waypoint_flaw
from dronemon.problem import MEASUREMENT_INTERVAL_AU, Prior
from dronemon.roadmap import Roadmap
from dronemon.sensor import PERFECT, Sensor
from dronemon.sightings import Sightings
from dronemon.types import FloatArray
from dronemon.world import Instance, Roster, measure, misread, sample_leg


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """What an episode is flown under, besides its instance.

    speed_ratio: targets' speed over the agent's; prior: what is known at the start; horizon_au:
    distance flown; num_nodes, num_neighbours: the roadmap's; sensor: how the eye errs
    """

    speed_ratio: float
    prior: Prior = "full"
    horizon_au: float = 30.0
    num_nodes: int = 200
    num_neighbours: int = 10
    sensor: Sensor = PERFECT

    @property
    def times_au(self) -> FloatArray:
        """(S+1,) time of the start and of each measurement within the horizon."""
        count = math.floor(self.horizon_au / MEASUREMENT_INTERVAL_AU + 1e-9)
        return np.arange(count + 1, dtype=np.float64) * MEASUREMENT_INTERVAL_AU


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """What happened, at the start and at each of S measurements.

    agent_au: (S+1, 2); targets_au: (S+1, N, 2) true positions; told_au: (S+1, N, 2) where each
    target was said to be seen, NaN where it was not, and at the start; decisions_s: (D,) wall-clock
    time of each of the planner's decisions
    """

    conditions: Conditions
    arena: Arena
    agent_au: FloatArray
    targets_au: FloatArray
    told_au: FloatArray
    decisions_s: FloatArray

    def metrics(self) -> EpisodeMetrics:
        """Score the belief of all true targets at every measurement."""
        return episode_metrics(
            self.conditions.times_au,
            self.agent_au,
            self.targets_au,
            self.told_au,
            prior=self.conditions.prior,
            arena=self.arena,
            sensor=self.conditions.sensor,
        )


def fly_episode(planner: Planner, instance: Instance, conditions: Conditions) -> Episode:
    """Fly one episode.

    A clairvoyant planner is told of all targets, whatever the prior; its belief is scored under
    the prior all the same.

    Raises PlannerError if the planner gives a waypoint that cannot be flown to.
    """

    def targets_at(times_au: FloatArray) -> FloatArray:
        return instance.paths.positions_au(conditions.speed_ratio * times_au)

    roadmap = Roadmap.random(
        conditions.num_nodes,
        conditions.num_neighbours,
        instance.stream("roadmap"),
        instance.start_au,
        instance.arena,
    )
    told: Prior = conditions.prior
    if isinstance(planner, Clairvoyant):
        planner.foresee(targets_at)
        told = "full"
    agent = _Agent(instance, targets_at, conditions, told)
    who = f"planner {planner.name}, seed {instance.seed},"
    with blaming(who, PlannerError):
        planner.reset(agent.brief(instance.stream("planner")), roadmap)
    decisions_s = []
    while not agent.is_done:
        snapshot = agent.snapshot(roadmap)
        began_s = time.perf_counter()
        with blaming(who, PlannerError):
            waypoint = planner.next_waypoint(snapshot)
            decisions_s.append(time.perf_counter() - began_s)
            flaw = waypoint_flaw(waypoint, agent.position_au, instance.arena)
        if flaw:
            raise PlannerError(f"{who} gave at {snapshot.time_au:.3f} au {flaw}")
        agent.fly_to(np.array(waypoint.position_au, dtype=np.float64), waypoint.node)
    return agent.episode(np.array(decisions_s))


class _Agent:
    """The agent in its world: where it is, what it has measured, what it knows."""

    def __init__(
        self, instance: Instance, targets_at: TargetsAt, conditions: Conditions, told: Prior
    ) -> None:
        self._conditions, self._arena = conditions, instance.arena
        self._rng = instance.stream("sensor")
        self._times_au = conditions.times_au
        self._targets_au = targets_at(self._times_au)
        self._agent_au = [instance.start_au]
        self.position_au = instance.start_au
        self._residual_au = 0.0
        self._node: int | None = 0  # the roadmap's first node is the start
        self._told_au = [np.full_like(self._targets_au[0], np.nan)]
        self._roster = Roster(told, self._targets_au[0])
        self._sightings = Sightings(self._roster.priors_au, conditions.sensor)
        self._belief = Belief(self._sightings)

    def brief(self, rng: np.random.Generator) -> Briefing:
        """Tell what is known at the start."""
        return Briefing(
            num_targets=self._sightings.num_targets,
            priors_au=self._sightings.priors_au.copy(),
            start_au=self._agent_au[0].copy(),
            horizon_au=self._conditions.horizon_au,
            rng=rng,
            arena=self._arena,
            sensor=self._conditions.sensor,
        )

    @property
    def is_done(self) -> bool:
        """Whether all measurements have been taken."""
        return len(self._agent_au) == len(self._times_au)

    def snapshot(self, roadmap: Roadmap) -> Snapshot:
        """Give what is known now. At unit speed the distance flown is the time."""
        time_au = float(self._times_au[len(self._agent_au) - 1]) + self._residual_au
        return Snapshot(
            time_au=time_au,
            flown_au=time_au,
            position_au=self.position_au.copy(),
            node=self._node,
            sightings=self._sightings,
            belief=self._belief,
            roadmap=roadmap,
            remaining_au=max(0.0, self._conditions.horizon_au - time_au),
        )

    def fly_to(self, waypoint_au: FloatArray, node: int | None) -> None:
        """Fly to a place of the arena, measuring on the way."""
        leg = sample_leg(self.position_au, waypoint_au, self._residual_au)
        for position_au in leg.positions_au:
            if self.is_done:
                break
            index = len(self._agent_au)
            truth = measure(float(self._times_au[index]), position_au, self._targets_au[index])
            self._agent_au.append(position_au)
            told = misread(truth, self._conditions.sensor, self._arena, self._rng)
            self._told_au.append(told.target_au)
            self._sightings.add(self._roster.tell(told))
        self.position_au, self._residual_au, self._node = waypoint_au, leg.residual_au, node

    def episode(self, decisions_s: FloatArray) -> Episode:
        """Give the record of a finished episode."""
        return Episode(
            conditions=self._conditions,
            arena=self._arena,
            agent_au=np.stack(self._agent_au),
            targets_au=self._targets_au,
            told_au=np.stack(self._told_au),
            decisions_s=decisions_s,
        )
