"""Lessons come in rounds, exactly as many as count, and a step learns from several of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from dronemon.env import Setup
from dronemon.planner.settings import SearchSettings
from dronemon.policy import NetworkConfig, PolicyNetwork, read_tensors
from dronemon.training.imitation import Expert, ExpertConfig, _judgement
from dronemon.training.lessons import Lesson, teach
from dronemon.training.peers import Peers

CPU = torch.device("cpu")
CONFIG = ExpertConfig(
    decisions=6, symmetries=False, precision="float32", history=(8, 8), max_gradient=1e9
)


def make_expert(
    folder: Path, config: ExpertConfig = CONFIG, peers: Peers | None = None, num_workers: int = 1
) -> Expert:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PolicyNetwork(NetworkConfig(width=16, num_heads=2, feed_forward=24))
    return Expert(
        network,
        config,
        peers if peers is not None else Peers(device=CPU),
        0,
        folder=folder,
        num_workers=num_workers,
    )


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


@pytest.fixture(scope="module")
def lessons(tmp_path_factory: pytest.TempPathFactory) -> list[Lesson]:
    expert = make_expert(tmp_path_factory.mktemp("lessons"))
    return [make_lesson(expert, 10_000 + i, 20 + 5 * i) for i in range(2)]


def gradients(expert: Expert) -> list[Tensor]:
    return [p.grad.clone() for p in expert.network.parameters() if p.grad is not None]


@pytest.mark.lengthy
def test_a_minibatch_is_the_mean_over_episodes_of_different_lessons(
    lessons: list[Lesson], tmp_path: Path
) -> None:
    config = replace(CONFIG, history=(1, 1))  # one phase alone: nothing is drawn
    alone, losses = [], []
    for lesson in lessons:
        expert = make_expert(tmp_path, config)
        losses.append(expert._update([(lesson, 0)], np.random.default_rng(0))["imitation_loss"])
        alone.append(gradients(expert))
    expert = make_expert(tmp_path, config)
    metrics = expert._update([(lesson, 0) for lesson in lessons], np.random.default_rng(0))
    assert float(metrics["imitation_loss"]) == pytest.approx(float(sum(losses)) / 2.0)
    for both, first, second in zip(gradients(expert), *alone, strict=True):
        torch.testing.assert_close(both, (first + second) / 2.0, rtol=1e-4, atol=1e-6)
    assert {int(s["step"]) for s in expert._optimizer.state.values()} == {1}


def test_the_teacher_flies_less_from_round_to_round() -> None:
    shares = [ExpertConfig().taught_share(number) for number in (0, 2, 3, 8, 9, 500)]
    assert shares == [1.0, 1.0, 0.5, 0.5, 0.15, 0.15]


def test_regret_is_a_share_of_the_largest_gain(lessons: list[Lesson]) -> None:
    lesson = lessons[0]
    logits = torch.full_like(lesson.rollout.logits, -torch.inf)
    logits[..., 1] = 0.0
    gains = torch.tensor([200.0, 150.0, -torch.inf]).expand(1, CONFIG.decisions, 3)
    lesson = replace(lesson, gains=gains, rollout=replace(lesson.rollout, logits=logits[..., :3]))
    assert _judgement([lesson]) == {"regret": 0.25, "agreement": 0.0}


def give_round(folder: Path, *, workers: int) -> Expert:
    config = replace(
        CONFIG,
        round_episodes=3,
        lesson_episodes=1,
        num_nodes=(20, 30),
        num_targets=(2, 3),
        teacher_drawn=20,
        teacher_refined=10,
    )
    expert = make_expert(folder, config, num_workers=workers)
    expert._take_lessons()
    return expert


@pytest.mark.slow
def test_lessons_do_not_depend_on_who_gives_them(tmp_path: Path) -> None:
    expert = give_round(tmp_path / "two", workers=2)
    give_round(tmp_path / "one", workers=1)
    for name in expert._files[0]:
        first, second = (read_tensors(tmp_path / f / name)["gains"] for f in ("one", "two"))
        assert torch.equal(first, second)


@pytest.mark.lengthy
def test_only_lessons_that_count_are_taken_up_again(tmp_path: Path) -> None:
    expert = give_round(tmp_path, workers=1)
    state = expert.state()
    stale = tmp_path / "round-0000-07.pt"
    stale.write_bytes((tmp_path / "round-0000-00.pt").read_bytes())
    again = make_expert(tmp_path)
    again.restore(state)
    assert len(again._lessons) == 3
    shares = []
    for rank in range(2):  # whoever goes on
        again = make_expert(tmp_path, peers=Peers(device=CPU, rank=rank, size=2))
        again.restore(state)
        shares.append(len(again._lessons))
    assert shares == [2, 1]
