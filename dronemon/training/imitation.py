"""Learning from the search planner, then by oneself: what two cores can afford.

Each round the student flies (at first the teacher does), the teacher scores every neighbour of
every node reached, and the student learns from all lessons so far (dataset aggregation). The
teacher's best choice is chance where neighbours tie, so the student learns the softmax of its
scores. The last part of the budget can be PPO from there.

Source: Ross, Gordon & Bagnell (2011), algorithm 3.1.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from dronemon.env import Setup
from dronemon.planner.settings import SearchSettings
from dronemon.policy import (
    Card,
    PolicyNetwork,
    load_checkpoint,
    read_tensors,
    save_checkpoint,
    write_atomically,
)
from dronemon.problem import FIRST_TRAINING_SEED
from dronemon.training.lessons import Lesson, teach
from dronemon.training.peers import Peers
from dronemon.training.ppo import (
    Count,
    Counts,
    Positive,
    Ppo,
    PpoConfig,
    Precision,
    Priors,
    Share,
    Speeds,
    entropy,
    in_precision,
    mean_over,
    progress_of,
    rollout_advantages,
)
from dronemon.workers import share_out

T = TypeVar("T")

# Differs from STAMP: what is rewarded, and targets as many and as fast as Table I has them.
FINISH = PpoConfig(
    objective="unc",
    reward_scale=0.5,  # returns of order one, so that the value does not drown the imitation
    decision_cost=0.0,
    episodes_per_iteration=16,
    learning_rate=3e-5,
    curriculum_episodes=0,
    max_speed_ratio=0.15,
    num_targets=(2, 8),
)
"""How PPO goes on from what was imitated."""
_NO_CARD = Card(recipe="expert", command="", commit="", date="", seeds="")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpertConfig:
    """Settings of the recipe; ranges are inclusive, episodes count over all processes.

    num_nodes:       drawn evenly by its logarithm, since large roadmaps take most of the time
    round_episodes:  taught each round
    lesson_episodes: of them with the same V, N and T
    taught_shares:   of episodes that the teacher flies, each from a round on
    greedy_share:    of episodes in which the student flies as it would in a mission
    updates:         of the network each round
    minibatch_episodes: in an update, which learns from every stride-th decision of each
    temperature:     of the soft targets, as a share of a decision's largest gain
    imitation_share: of the budget, before PPO
    symmetries:      learn each episode in the eight ways of seeing the square
    teacher_drawn:   effort of each of the teacher's planners
    teacher_refined: the same
    """

    round_episodes: Count = 16
    lesson_episodes: Count = 4
    taught_shares: tuple[tuple[int, Share], ...] = ((0, 1.0), (3, 0.5), (9, 0.15))
    greedy_share: Share = 0.5
    decisions: Annotated[int, Field(ge=2)] = 256
    updates: Count = 128
    minibatch_episodes: Count = 8
    learning_rate: Positive = 2e-3
    final_learning_rate: Positive = 2e-5
    warmup_updates: Count = 100
    max_gradient: Positive = 1.0
    temperature: Positive = 0.01
    imitation_share: Share = 1.0
    symmetries: bool = True
    precision: Precision = "auto"
    teacher_drawn: Count = 100
    teacher_refined: Count = 75
    speed_ratio: Speeds = (0.025, 0.15)
    num_nodes: Counts = (150, 200)
    history: Counts = (50, 100)
    num_targets: Counts = (2, 8)
    priors: Priors = ("full",)
    finish: PpoConfig = FINISH

    @property
    def value_weight(self) -> float:
        """Of the value's loss beside the policy's; without PPO nobody needs the value."""
        return 0.05 if self.imitation_share < 1.0 else 0.01

    def taught_share(self, number: int) -> float:
        """Share of a round's episodes that the teacher flies."""
        return max((first, share) for first, share in self.taught_shares if first <= number)[1]


class Expert:
    """Imitation of the search planner, then PPO."""

    def __init__(
        self,
        network: PolicyNetwork,
        config: ExpertConfig,
        peers: Peers,
        seed: int,
        *,
        folder: Path,
        num_workers: int,
        cluster: Executor | None = None,
    ) -> None:
        self.network = network
        self.config = config
        self._peers = peers
        self._seed = seed
        self._folder = folder
        self._num_workers = num_workers
        self._cluster = cluster
        self._lessons: list[Lesson] = []
        self._files: list[list[str]] = []  # of each round, over all processes
        self._num_updates = 0
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        self._finish = Ppo(network, config.finish, peers, seed)
        self.average = self._finish.average

    def state(self) -> dict[str, Any]:
        """All that the next iteration depends on, besides the weights and the lessons on disk."""
        return {
            "files": self._files,
            "updates": self._num_updates,
            "optimizer": self._optimizer.state_dict(),
            "finish": self._finish.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where `state` was taken; lessons of later rounds are given again."""
        self._files, self._num_updates = state["files"], state["updates"]
        self._optimizer.load_state_dict(state["optimizer"])
        self._finish.restore(state["finish"])
        for files in self._files:
            self._lessons += [self._read(name) for name in self._own(files)]

    def iterate(self, progress: float) -> dict[str, float]:
        """A round of lessons and the updates after it, or an iteration of PPO."""
        if progress >= self.config.imitation_share:
            return self._finish.iterate(progress)
        began = time.perf_counter()
        taken = self._take_lessons()
        self._lessons += taken
        played = time.perf_counter()
        metrics = self._learn(progress / self.config.imitation_share)
        metrics["episodes"] = float(sum(len(lesson.gains) for lesson in self._lessons))
        rollouts = [lesson.rollout for lesson in taken]
        common = progress_of(rollouts, self._peers, began, played)
        return metrics | _judgement(taken) | common

    def _take_lessons(self) -> list[Lesson]:
        """Own share of a round, given by worker processes; each lesson is a file."""
        config, number, size = self.config, len(self._files), self._peers.size
        self._folder.mkdir(parents=True, exist_ok=True)
        # A name of its own: who shares the folder over a network may remember the last one's file.
        student = self._folder / f"student-{number:04d}-{self._peers.rank}.pt"
        save_checkpoint(student, self.network, _NO_CARD)
        count = size * math.ceil(config.round_episodes / config.lesson_episodes / size)
        files = [f"round-{number:04d}-{part:02d}.pt" for part in range(count)]
        give = partial(_give, config, student, config.taught_share(number))
        own = self._own(range(count))
        jobs = [((self._seed, number, part), self._folder / files[part]) for part in own]
        try:
            for _ in share_out(give, jobs, max(1, self._num_workers // size), self._cluster):
                pass
        finally:
            student.unlink(missing_ok=True)
        self._files.append(files)
        return [self._read(name) for name in self._own(files)]

    def _own(self, parts: Sequence[T]) -> Sequence[T]:
        """The share of this process in the parts of a round."""
        return parts[self._peers.rank :: self._peers.size]

    def _read(self, name: str) -> Lesson:
        return Lesson.from_parts(read_tensors(self._folder / name))

    def _learn(self, progress: float) -> dict[str, float]:
        """Updates on random episodes of all lessons. progress: of the imitation, 0 to 1."""
        config = self.config
        rng = np.random.default_rng([self._seed, len(self._files), self._peers.rank, 99])
        episodes = [(lesson, i) for lesson in self._lessons for i in range(len(lesson.gains))]
        size = min(max(1, config.minibatch_episodes // self._peers.size), len(episodes))
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))
        rate = config.final_learning_rate + cosine * (
            config.learning_rate - config.final_learning_rate
        )
        updates = []
        for _ in range(config.updates):
            warm = min(1.0, (self._num_updates + 1) / config.warmup_updates)
            for group in self._optimizer.param_groups:
                group["lr"] = rate * warm
            chosen = rng.choice(len(episodes), size=size, replace=False)
            updates.append(self._update([episodes[i] for i in chosen], rng))
            self._num_updates += 1
        return {**mean_over(updates), "learning_rate": rate}

    def _update(
        self, chosen: Sequence[tuple[Lesson, int]], rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """One step on a few episodes, each of any lesson."""
        self._optimizer.zero_grad()
        # One after another: a pass over two at once leaves the caches and takes twice as long.
        rows = [self._add_gradient(lesson, index, len(chosen), rng) for lesson, index in chosen]
        self._peers.average_gradients(self.network)
        gradient = nn.utils.clip_grad_norm_(self.network.parameters(), self.config.max_gradient)
        self._optimizer.step()
        self.average.update_parameters(self.network)
        means = {name: torch.stack([row[name] for row in rows]).mean() for name in rows[0]}
        return {**means, "gradient": gradient}

    def _add_gradient(
        self, lesson: Lesson, index: int, count: int, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """Add the gradient of one of `count` episodes whose mean loss a step reduces."""
        config, device = self.config, self._peers.device
        episode, rollout = torch.tensor([index]), lesson.rollout
        segment = rollout.segment.select(episode).to(device)
        if config.symmetries:
            segment = segment.mirrored(torch.as_tensor(rng.integers(8, size=1)).to(device))
        history = int(rng.integers(config.history[0], config.history[1] + 1))
        stride = self.network.config.stride_for(history)
        phase = int(rng.integers(stride))  # neighbouring decisions teach much the same
        with in_precision(config.precision, device):
            verdict = self.network(segment, history, phase)
        gains = lesson.gains[episode, phase::stride].to(device)
        targets = (gains / (config.temperature * _largest(gains))).softmax(-1)
        log_chances = verdict.logits.log_softmax(-1).masked_fill(gains.isinf(), 0.0)
        loss = -(targets * log_chances).sum(-1).mean()
        returns = rollout_advantages(rollout, config.finish, 1.0) + rollout.values[:, :-1]
        returns = returns[episode, phase::stride].to(device)
        value_loss = (verdict.value - returns).square().mean()
        torch.autograd.backward((loss + config.value_weight * value_loss) / count)
        return {
            "imitation_loss": loss.detach(),
            "value_loss": value_loss.detach(),
            "entropy": entropy(verdict.logits).mean().detach(),
        }


def _largest(gains: Tensor) -> Tensor:
    """Size of each decision's largest gain, by which others are judged. (..., k) -> (..., 1)."""
    return gains.amax(-1, keepdim=True).abs().clamp(min=1e-3)


def _judgement(lessons: Sequence[Lesson]) -> dict[str, float]:
    """How the teacher sees what the student would have chosen, before it learned from them."""
    regret, is_best = [], []
    for lesson in lessons:
        gains, choice = lesson.gains, lesson.rollout.logits.argmax(-1, keepdim=True)
        lost = gains.amax(-1, keepdim=True) - gains.gather(-1, choice)
        regret.append((lost / _largest(gains)).flatten())
        is_best.append((lost == 0.0).float().flatten())
    return {
        "regret": float(torch.cat(regret).mean()),
        "agreement": float(torch.cat(is_best).mean()),
    }


def _give(
    config: ExpertConfig, student: Path, taught_share: float, job: tuple[tuple[int, ...], Path]
) -> None:
    """Give the lesson that follows from a seed and write it to a file."""
    (seed, path), count = job, config.lesson_episodes
    rng = np.random.default_rng(seed)
    num_nodes = round(math.exp(rng.uniform(*np.log(config.num_nodes))))
    history, num_targets = (
        int(rng.integers(low, high + 1)) for low, high in (config.history, config.num_targets)
    )
    setups = [
        Setup(
            seed=FIRST_TRAINING_SEED + int(rng.integers(2**40)),
            num_targets=num_targets,
            num_nodes=num_nodes,
            speed_ratio=float(rng.uniform(*config.speed_ratio)),
            prior=config.priors[int(rng.integers(len(config.priors)))],
        )
        for _ in range(count)
    ]
    lesson = teach(
        load_checkpoint(student).network,
        setups,
        is_taught=(rng.random(count) < taught_share).tolist(),
        is_greedy=(rng.random(count) < config.greedy_share).tolist(),
        history=history,
        num_decisions=config.decisions,
        settings=SearchSettings(num_drawn=config.teacher_drawn, num_refined=config.teacher_refined),
        rng=torch.Generator().manual_seed(int(rng.integers(2**60))),
    )
    write_atomically(path, asdict(lesson))
