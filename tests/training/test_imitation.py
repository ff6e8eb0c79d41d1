"""A step of imitation is a step on the mean of its episodes, whatever lessons they are of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from dronemon.env import Setup
from dronemon.planner.search import SearchSettings
from dronemon.policy import NetworkConfig, PolicyNetwork
from dronemon.training.imitation import Expert, ExpertConfig
from dronemon.training.lessons import Lesson, teach
from dronemon.training.peers import Peers

CONFIG = ExpertConfig(
    decisions=6, symmetries=False, precision="float32", history=(8, 8), max_gradient=1e9
)


def make_expert(folder: Path, config: ExpertConfig = CONFIG) -> Expert:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PolicyNetwork(NetworkConfig(width=16, num_heads=2, feed_forward=24))
    return Expert(network, config, seed=0, device=torch.device("cpu"), peers=Peers(), folder=folder)


def make_lesson(expert: Expert, seed: int, num_nodes: int) -> Lesson:
    return teach(
        expert.network,
        [Setup(seed=seed, num_targets=2, num_nodes=num_nodes, speed_ratio=0.1)],
        is_taught=[True],
        is_greedy=[True],
        history=8,
        num_decisions=CONFIG.decisions,
        settings=SearchSettings(num_drawn=20, num_refined=10, num_planned=10),
        rng=torch.Generator().manual_seed(0),
    )


def gradients(expert: Expert) -> list[Tensor]:
    return [p.grad.clone() for p in expert.network.parameters() if p.grad is not None]


def test_a_minibatch_is_the_mean_over_episodes_of_different_lessons(tmp_path: Path) -> None:
    lessons = [make_lesson(make_expert(tmp_path), 10_000 + i, 20 + 5 * i) for i in range(2)]
    alone, losses = [], []
    for lesson in lessons:
        expert = make_expert(tmp_path)
        losses.append(expert._update([(lesson, 0)], np.random.default_rng(0))["imitation_loss"])
        alone.append(gradients(expert))
    expert = make_expert(tmp_path)
    metrics = expert._update([(lesson, 0) for lesson in lessons], np.random.default_rng(0))
    assert float(metrics["imitation_loss"]) == pytest.approx(float(sum(losses)) / 2.0)
    for both, first, second in zip(gradients(expert), *alone, strict=True):
        torch.testing.assert_close(both, (first + second) / 2.0, rtol=1e-4, atol=1e-6)
    assert {int(s["step"]) for s in expert._optimizer.state.values()} == {1}
