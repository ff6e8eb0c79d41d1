"""The learned planner flies what was learned: it decides as in the environment."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from dronemon.belief import Belief
from dronemon.env import Env, Setup
from dronemon.errors import CheckpointMismatch
from dronemon.planner import Briefing, Snapshot
from dronemon.planner.learned import LearnedPlanner
from dronemon.policy import Card, Checkpoint, History, NetworkConfig, PolicyNetwork
from dronemon.problem import Prior
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.types import Measurement
from dronemon.world import Instance, measure, sample_leg

CARD = Card(recipe="none", command="", commit="", date="", seeds="")
NUM_NODES, SPEED = 30, 0.1


def make_planner() -> tuple[LearnedPlanner, PolicyNetwork]:
    with torch.random.fork_rng():
        torch.manual_seed(1)
        network = PolicyNetwork(
            NetworkConfig(
                width=16, feed_forward=24, newest=True, ways=True, geometry=True, tracks=True
            )
        ).eval()
    checkpoint = Checkpoint(network=network, card=CARD)
    return LearnedPlanner(checkpoint, history=10), network


class Mission:
    """One instance flown by hand, measuring as the runner does."""

    def __init__(self, seed: int, num_targets: int, *, is_known: bool = True) -> None:
        self.instance = Instance.draw(seed, num_targets)
        self.roadmap = Roadmap.random(
            NUM_NODES, 10, self.instance.stream("roadmap"), self.instance.start_au
        )
        priors_au = self.instance.paths.positions_au(0.0)
        self.sightings = Sightings(priors_au if is_known else np.empty((0, 2)))
        self.belief = Belief(self.sightings)
        self.is_known = is_known
        self.time_au, self.residual_au, self.node = 0.0, 0.0, 0
        self.order: list[int] = []

    def briefing(self) -> Briefing:
        return Briefing(
            num_targets=self.sightings.num_targets,
            priors_au=self.sightings.priors_au,
            start_au=self.instance.start_au,
            horizon_au=30.0,
            rng=np.random.default_rng(0),
        )

    def snapshot(self) -> Snapshot:
        return Snapshot(
            time_au=self.time_au,
            flown_au=self.time_au,
            position_au=self.roadmap.nodes_au[self.node],
            node=self.node,
            sightings=self.sightings,
            belief=self.belief,
            roadmap=self.roadmap,
            remaining_au=30.0 - self.time_au,
        )

    def fly_to(self, node: int) -> None:
        start_au, end_au = self.roadmap.nodes_au[self.node], self.roadmap.nodes_au[node]
        leg = sample_leg(start_au, end_au, self.residual_au)
        for offset_au, position_au in zip(leg.offsets_au, leg.positions_au, strict=True):
            now_au = self.time_au + float(offset_au)
            targets_au = self.instance.paths.positions_au(SPEED * now_au)
            self._take(measure(now_au, position_au, targets_au))
        self.residual_au = leg.residual_au
        self.time_au += float(np.hypot(*(end_au - start_au)))
        self.node = node

    def _take(self, measurement: Measurement) -> None:
        if not self.is_known:
            for index in np.flatnonzero(measurement.seen):
                if int(index) not in self.order:
                    self.order.append(int(index))
            measurement = Measurement(
                time_au=measurement.time_au,
                agent_au=measurement.agent_au,
                seen=measurement.seen[self.order],
                target_au=measurement.target_au[self.order],
            )
        self.sightings.add(measurement)


@pytest.mark.parametrize("prior", ["full", "none"])
def test_it_decides_as_in_the_environment_it_was_trained_in(prior: Prior) -> None:
    planner, network = make_planner()
    mission = Mission(10_000, 3, is_known=prior == "full")
    env = Env()
    setup = Setup(seed=10_000, num_targets=3, num_nodes=NUM_NODES, speed_ratio=SPEED, prior=prior)
    observation = env.reset([setup])
    memory = History(network, env.graphs, 10)
    for _ in range(2):  # the second mission starts anew
        planner.reset(mission.briefing(), mission.roadmap)
    for _ in range(40):
        waypoint = planner.next_waypoint(mission.snapshot())
        verdict = memory.decide(
            observation.frames,
            observation.target_mask,
            observation.length_au,
            observation.node,
            observation.tracks,
        )
        logits = verdict.logits[0, 0][observation.neighbour_mask[0]]
        np.testing.assert_allclose(waypoint.details["logits"], logits.numpy(), atol=1e-4)
        assert waypoint.node is not None
        np.testing.assert_array_equal(waypoint.position_au, mission.roadmap.nodes_au[waypoint.node])
        mission.fly_to(waypoint.node)
        observation = env.step(torch.tensor([waypoint.node])).observation
    assert mission.sightings.num_targets > 0


def test_its_thoughts_can_be_recorded() -> None:
    planner, _ = make_planner()
    mission = Mission(10_001, 2)
    planner.reset(mission.briefing(), mission.roadmap)
    details = planner.next_waypoint(mission.snapshot()).details
    again = json.loads(json.dumps(details))
    assert len(again["logits"]) == len(again["neighbours"]) > 0


def test_it_starts_without_any_target_and_takes_in_those_it_meets() -> None:
    planner, _ = make_planner()
    mission = Mission(10_002, 4, is_known=False)
    planner.reset(mission.briefing(), mission.roadmap)
    rng = np.random.default_rng(0)
    for _ in range(60):
        waypoint = planner.next_waypoint(mission.snapshot())
        assert np.isfinite(waypoint.details["logits"]).all()
        moves = mission.roadmap.neighbours[mission.node][mission.roadmap.is_move[mission.node]]
        mission.fly_to(int(rng.choice(moves)))
    assert mission.belief.num_targets > 0


def test_away_from_every_node_it_decides_at_the_nearest() -> None:
    planner, _ = make_planner()
    mission = Mission(10_003, 2)
    planner.reset(mission.briefing(), mission.roadmap)
    at_node = mission.snapshot()
    away = replace(at_node, position_au=at_node.position_au + 1e-3, node=None)
    chosen = planner.next_waypoint(away).node
    assert chosen in mission.roadmap.neighbours[0]


def test_a_missing_checkpoint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointMismatch, match="no such checkpoint"):
        LearnedPlanner.load(str(tmp_path / "none.pt"))
