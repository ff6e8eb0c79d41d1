"""Episodes with a teacher at the side: the student or the teacher flies, the teacher scores.

The teacher is the search planner on the roadmap, or rather the mean of a few: their particles and
paths differ, and what they agree on is not chance. At every decision, whoever flies, it says what
the best path by way of each neighbour would gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dronemon.belief import Belief
from dronemon.env import Env, Observation, Setup
from dronemon.planner import Briefing, Snapshot
from dronemon.planner.search import RoadmapSearchPlanner
from dronemon.planner.settings import SearchSettings
from dronemon.policy import Graphs, PolicyNetwork, Segment, Verdict
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.training.rollout import Rollout, play
from dronemon.world import Instance, Roster, measure, sample_leg

NUM_NEIGHBOURS = 10
NUM_PLANNERS = 2
"""Whose gains are averaged.

Two of half the effort each repeat their own best choice in 69 % of decisions, one of all of it in
56 %. Forgetting the plans from decision to decision makes them worse.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lesson:
    """A rollout and what the teacher thought of it.

    rollout: the episodes, with frames in float16 to save room
    gains:   (B, L, k) float32 by way of each neighbour, -inf where there is none
    """

    rollout: Rollout
    gains: Tensor

    @classmethod
    def from_parts(cls, parts: dict[str, Any]) -> Lesson:
        """What `asdict` took apart for a file."""
        rollout, segment = parts["rollout"], parts["rollout"]["segment"]
        whole = Segment(**segment | {"graphs": Graphs(**segment["graphs"])})
        return cls(rollout=Rollout(**rollout | {"segment": whole}), gains=parts["gains"])


class Teacher:
    """Flies along with one episode of the environment and scores the neighbours of each node."""

    def __init__(self, setup: Setup, settings: SearchSettings) -> None:
        instance = Instance.draw(setup.seed, setup.num_targets)
        self._targets, self._speed_ratio = instance.paths, setup.speed_ratio
        self._roadmap = Roadmap.random(
            setup.num_nodes, NUM_NEIGHBOURS, instance.stream("roadmap"), instance.start_au
        )
        self._roster = Roster(setup.prior, self._targets.positions_au(0.0))
        priors_au = self._roster.priors_au
        self._sightings = Sightings(priors_au)
        self._belief = Belief(self._sightings)
        self._planners = [RoadmapSearchPlanner(settings) for _ in range(NUM_PLANNERS)]
        for index, planner in enumerate(self._planners):
            planner.reset(
                Briefing(
                    num_targets=len(priors_au),
                    priors_au=priors_au,
                    start_au=instance.start_au,
                    horizon_au=np.inf,
                    rng=instance.stream(f"teacher {index}"),
                ),
                self._roadmap,
            )
        self._time_au, self._residual_au, self._node = 0.0, 0.0, 0

    def score(self, node: int, time_au: float, num_columns: int) -> Tensor:
        """What each neighbour of the node just reached would gain.

        -> (num_columns,), -inf where there is no neighbour
        """
        nodes_au = self._roadmap.nodes_au
        leg = sample_leg(nodes_au[self._node], nodes_au[node], self._residual_au)
        for offset_au, agent_au in zip(leg.offsets_au, leg.positions_au, strict=True):
            at_au = self._time_au + float(offset_au)
            targets_au = self._targets.positions_au(self._speed_ratio * at_au)
            self._sightings.add(self._roster.tell(measure(at_au, agent_au, targets_au)))
        self._residual_au, self._time_au, self._node = leg.residual_au, time_au, node
        snapshot = Snapshot(
            time_au=time_au,
            flown_au=time_au,
            position_au=nodes_au[node],
            node=node,
            sightings=self._sightings,
            belief=self._belief,
            roadmap=self._roadmap,
            remaining_au=np.inf,
        )
        found = [
            torch.tensor(p.next_waypoint(snapshot).details["neighbour_gains"])
            for p in self._planners
        ]
        gains = torch.full((num_columns,), -torch.inf)
        columns = torch.as_tensor(self._roadmap.is_move[node]).nonzero()[:, 0]
        gains[columns] = torch.stack(found).mean(0)
        return gains


def teach(
    network: PolicyNetwork,
    setups: Sequence[Setup],
    *,
    is_taught: Sequence[bool],
    is_greedy: Sequence[bool],
    history: int,
    num_decisions: int,
    settings: SearchSettings,
    rng: torch.Generator,
) -> Lesson:
    """Play one episode per setup and have each scored.

    is_taught: the teacher flies, not the student
    is_greedy: the student flies as it would in a mission, not by its policy's probabilities
    """
    teachers = [Teacher(setup, settings) for setup in setups]
    taught, greedy = torch.tensor(is_taught), torch.tensor(is_greedy)
    gains: list[Tensor] = []

    def choose(verdict: Verdict, observation: Observation) -> Tensor:
        logits = verdict.logits[:, 0]
        places = zip(
            teachers, observation.node.tolist(), observation.length_au.tolist(), strict=True
        )
        scored = [t.score(node, time_au, logits.shape[1]) for t, node, time_au in places]
        gains.append(torch.stack(scored))
        sampled = torch.multinomial(logits.softmax(-1), 1, generator=rng)[:, 0]
        own = torch.where(greedy, logits.argmax(-1), sampled)
        return torch.where(taught, gains[-1].argmax(-1), own)

    env = Env(num_neighbours=NUM_NEIGHBOURS)
    rollout = play(
        network, env, setups, history=history, num_decisions=num_decisions, choose=choose
    )
    segment = replace(rollout.segment, frames=rollout.segment.frames.half())
    return Lesson(rollout=replace(rollout, segment=segment), gains=torch.stack(gains, dim=1))
