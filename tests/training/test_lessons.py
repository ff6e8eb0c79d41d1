"""The teacher sees what the environment's agent sees, and its scores survive a file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest
import torch

from dronemon.env import Setup
from dronemon.planner.settings import SearchSettings
from dronemon.policy import NetworkConfig, PolicyNetwork, read_tensors, write_atomically
from dronemon.training.lessons import Lesson, teach

SETTINGS = SearchSettings(num_drawn=40, num_refined=20, num_planned=10)
SETUPS = [
    Setup(seed=10_000, num_targets=2, num_nodes=25, speed_ratio=0.1),
    Setup(seed=10_001, num_targets=2, num_nodes=25, speed_ratio=0.05),
    Setup(seed=10_002, num_targets=2, num_nodes=25, speed_ratio=0.05, prior="none"),
]


def make_lesson() -> Lesson:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PolicyNetwork(NetworkConfig(width=16, feed_forward=24))
    return teach(
        network,
        SETUPS,
        is_taught=[True, False, True],
        is_greedy=[True, True, True],
        history=8,
        num_decisions=15,
        settings=SETTINGS,
        rng=torch.Generator().manual_seed(0),
    )


@pytest.mark.lengthy
def test_every_neighbour_is_scored_and_the_teacher_flies_to_the_best() -> None:
    lesson = make_lesson()
    segment = lesson.rollout.segment
    episodes = torch.arange(3)[:, None]
    mask = segment.graphs.neighbour_mask[episodes, segment.nodes]
    assert torch.equal(lesson.gains.isfinite(), mask)
    for taught in (0, 2):
        assert torch.equal(lesson.rollout.actions[taught], lesson.gains[taught].argmax(-1))
    assert torch.equal(lesson.rollout.actions[1], lesson.rollout.logits[1].argmax(-1))


@pytest.mark.lengthy
def test_a_lesson_comes_back_from_its_file(tmp_path: Path) -> None:
    lesson = make_lesson()
    write_atomically(tmp_path / "lesson.pt", asdict(lesson))
    again = Lesson.from_parts(read_tensors(tmp_path / "lesson.pt"))
    assert torch.equal(again.gains, lesson.gains)
    assert torch.equal(again.rollout.segment.frames, lesson.rollout.segment.frames)
    assert torch.equal(
        again.rollout.segment.graphs.distances, lesson.rollout.segment.graphs.distances
    )
    assert again.rollout.history == 8
