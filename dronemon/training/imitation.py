"""Learning from the search planner, then by oneself: what two cores can afford.

Each round the student flies (at first the teacher does), the teacher scores every neighbour of
every node reached, and the student learns from all lessons so far (dataset aggregation). The
teacher's best choice is chance where neighbours tie, so the student learns the softmax of its
scores. The last part of the time budget is PPO from there.

Source: Ross, Gordon & Bagnell (2011), algorithm 3.1.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from dronemon.env import Setup
from dronemon.errors import PolicyError
from dronemon.planner.search import SearchSettings
from dronemon.policy import (
    Card,
    PolicyNetwork,
    load_checkpoint,
    read_tensors,
    save_checkpoint,
    write_atomically,
)
from dronemon.training.gae import advantages
from dronemon.training.lessons import Lesson, teach
from dronemon.training.peers import Peers
from dronemon.training.ppo import (
    FIRST_SEED,
    Ppo,
    PpoConfig,
    Precision,
    entropy,
    in_precision,
    scaled_rewards,
)

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
    """Settings of the recipe; ranges are inclusive.

    round_episodes: taught each round, over all workers (0 workers: one per core); first_episodes:
    of the first round, which the teacher flies; taught_share: of later episodes, that it flies;
    updates: of the network each round, each from minibatch_episodes (over all processes);
    temperature: in the teacher's score, of the soft targets;
    imitation_share: of the time budget, before PPO; symmetries: learn each episode in the eight
    ways of seeing the square.
    """

    round_episodes: int = 16
    first_episodes: int = 32
    taught_share: float = 0.2
    greedy_share: float = 0.5
    decisions: int = 256
    updates: int = 128
    minibatch_episodes: int = 2
    learning_rate: float = 7e-4
    final_learning_rate: float = 2e-5
    warmup_updates: int = 50
    max_gradient: float = 1.0
    value_weight: float = 0.05
    temperature: float = 2.0
    imitation_share: float = 0.75
    symmetries: bool = True
    precision: Precision = "bfloat16"
    workers: int = 0
    teacher_drawn: int = 200
    teacher_refined: int = 150
    max_speed_ratio: float = 0.15
    num_nodes: tuple[int, int] = (100, 200)
    history: tuple[int, int] = (50, 100)
    num_targets: tuple[int, int] = (2, 8)
    finish: PpoConfig = FINISH


class Expert:
    """The recipe `expert`: imitation of the search planner, then PPO."""

    def __init__(
        self,
        network: PolicyNetwork,
        config: ExpertConfig,
        *,
        seed: int,
        device: torch.device,
        peers: Peers,
        folder: Path,
    ) -> None:
        self.network = network
        self.config = config
        self._seed = seed
        self._device = device
        self._peers = peers
        self._folder = folder / f"process-{peers.rank}"
        self._lessons: list[Lesson] = []
        self._num_rounds = 0
        self._num_updates = 0
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        self._finish = Ppo(network, config.finish, seed=seed, device=device, peers=peers)

    @property
    def settings(self) -> dict[str, object]:
        """What a card says about the recipe."""
        return asdict(self.config)

    def state(self) -> dict[str, Any]:
        """All that the next iteration depends on, besides the weights and the lessons on disk."""
        return {
            "rounds": self._num_rounds,
            "updates": self._num_updates,
            "optimizer": self._optimizer.state_dict(),
            "finish": self._finish.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where `state` was taken; lessons of later rounds are given again."""
        self._num_rounds, self._num_updates = state["rounds"], state["updates"]
        self._optimizer.load_state_dict(state["optimizer"])
        self._finish.restore(state["finish"])
        for number in range(self._num_rounds):
            for path in sorted(self._folder.glob(f"round-{number:04d}-*.pt")):
                self._lessons.append(Lesson.from_parts(read_tensors(path)))

    def iterate(self, progress: float) -> dict[str, float]:
        """A round of lessons and the updates after it, or an iteration of PPO."""
        if progress >= self.config.imitation_share:
            return self._finish.iterate(progress)
        began = time.perf_counter()
        taken = self._take_lessons()
        self._lessons += taken
        played = time.perf_counter()
        metrics = self._learn(progress / self.config.imitation_share)
        self._num_rounds += 1
        learned = time.perf_counter()
        count = sum(lesson.gains[..., 0].numel() for lesson in taken) * self._peers.size
        return {
            **metrics,
            "unc": float(torch.cat([lesson.rollout.unc for lesson in taken]).mean()),
            "reward": float(torch.cat([lesson.rollout.rewards for lesson in taken]).mean()),
            "episodes": float(sum(len(lesson.gains) for lesson in self._lessons)),
            "decisions": float(count),
            "play_s": played - began,
            "learn_s": learned - played,
            "decisions_per_s": count / (learned - began),
        }

    def _take_lessons(self) -> list[Lesson]:
        """One round, shared among worker processes; each writes a file."""
        config, number = self.config, self._num_rounds
        self._folder.mkdir(parents=True, exist_ok=True)
        student = self._folder / "student.pt"
        save_checkpoint(student, self.network, _NO_CARD)
        workers = config.workers or os.cpu_count() or 1
        count = config.round_episodes if number else config.first_episodes
        count = max(1, count // self._peers.size)
        shares = [len(part) for part in np.array_split(range(count), min(workers, count))]
        paths = [self._folder / f"round-{number:04d}-{i:02d}.pt" for i in range(len(shares))]
        jobs = [
            _Job(
                config=config,
                student=student,
                path=path,
                seed=(self._seed, number, self._peers.rank, index),
                episodes=share,
                is_first=number == 0,
            )
            for index, (path, share) in enumerate(zip(paths, shares, strict=True))
        ]
        _do_all(jobs)
        return [Lesson.from_parts(read_tensors(path)) for path in paths]

    def _learn(self, progress: float) -> dict[str, float]:
        """Updates on random episodes of all lessons. progress: of the imitation, 0 to 1."""
        config = self.config
        rng = np.random.default_rng([self._seed, self._num_rounds, self._peers.rank, 99])
        episodes = [(lesson, i) for lesson in self._lessons for i in range(len(lesson.gains))]
        size = min(max(1, config.minibatch_episodes // self._peers.size), len(episodes))
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))
        rate = config.final_learning_rate + cosine * (
            config.learning_rate - config.final_learning_rate
        )
        sums: dict[str, Tensor] = {}
        for _ in range(config.updates):
            warm = min(1.0, (self._num_updates + 1) / config.warmup_updates)
            for group in self._optimizer.param_groups:
                group["lr"] = rate * warm
            chosen = rng.choice(len(episodes), size=size, replace=False)
            for name, value in self._update([episodes[i] for i in chosen], rng).items():
                sums[name] = sums.get(name, torch.zeros_like(value)) + value
            self._num_updates += 1
        means = {name: float(value) / config.updates for name, value in sums.items()}
        return {**means, "learning_rate": rate}

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
        means = {name: torch.stack([row[name] for row in rows]).mean() for name in rows[0]}
        return {**means, "gradient": gradient}

    def _add_gradient(
        self, lesson: Lesson, index: int, count: int, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """Add the gradient of one of `count` episodes whose mean loss a step reduces."""
        config = self.config
        episode, rollout = torch.tensor([index]), lesson.rollout
        segment = rollout.segment.select(episode).to(self._device)
        if config.symmetries:
            segment = segment.mirrored(torch.as_tensor(rng.integers(8, size=1)).to(self._device))
        gains = lesson.gains[episode].to(self._device)
        history = int(rng.integers(config.history[0], config.history[1] + 1))
        with in_precision(config.precision, self._device):
            verdict = self.network(segment, history)
        targets = (gains / config.temperature).softmax(-1)
        log_chances = verdict.logits.log_softmax(-1).masked_fill(gains.isinf(), 0.0)
        loss = -(targets * log_chances).sum(-1).mean()
        rewards = scaled_rewards(rollout, config.finish)
        never = torch.zeros_like(rewards, dtype=torch.bool)
        discount = config.finish.discount
        returns = advantages(rewards, rollout.values, never, discount, 1.0) + rollout.values[:, :-1]
        value_loss = (verdict.value - returns[episode].to(self._device)).square().mean()
        torch.autograd.backward((loss + config.value_weight * value_loss) / count)
        choice, best = verdict.logits.argmax(-1, keepdim=True), gains.amax(-1, keepdim=True)
        return {
            "imitation_loss": loss.detach(),
            "value_loss": value_loss.detach(),
            "entropy": entropy(verdict.logits).mean().detach(),
            "regret": ((best - gains.gather(-1, choice)) / config.temperature).mean(),
            "agreement": (gains.gather(-1, choice) == best).float().mean(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Job:
    """A worker's share of a round; everything follows from its seed."""

    config: ExpertConfig
    student: Path
    path: Path
    seed: tuple[int, ...]
    episodes: int
    is_first: bool

    def do(self) -> None:
        """Give the lessons and write them down."""
        config = self.config
        rng = np.random.default_rng(self.seed)
        num_nodes, history, num_targets = (
            int(rng.integers(low, high + 1))
            for low, high in (config.num_nodes, config.history, config.num_targets)
        )
        setups = [
            Setup(
                seed=FIRST_SEED + int(rng.integers(2**40)),
                num_targets=num_targets,
                num_nodes=num_nodes,
                speed_ratio=float(rng.uniform(0.0, config.max_speed_ratio)),
            )
            for _ in range(self.episodes)
        ]
        lesson = teach(
            load_checkpoint(self.student).network,
            setups,
            is_taught=(rng.random(self.episodes) < (self.is_first or config.taught_share)).tolist(),
            is_greedy=(rng.random(self.episodes) < config.greedy_share).tolist(),
            history=history,
            num_decisions=config.decisions,
            settings=SearchSettings(
                num_drawn=config.teacher_drawn, num_refined=config.teacher_refined
            ),
            rng=torch.Generator().manual_seed(int(rng.integers(2**60))),
        )
        write_atomically(self.path, lesson.to_parts())


def _do_all(jobs: Sequence[_Job]) -> None:
    """Do jobs side by side, one process each; here, if there is only one.

    Processes end with their job, so none is left over when this one is killed.
    """
    if len(jobs) == 1:
        jobs[0].do()
        return
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_do, args=(job,), daemon=True) for job in jobs]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    failed = [process.exitcode for process in processes if process.exitcode]
    if failed:
        raise PolicyError(f"{len(failed)} of {len(jobs)} teaching processes failed: see above")


def _do(job: _Job) -> None:
    torch.set_num_threads(1)
    job.do()
