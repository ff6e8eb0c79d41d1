"""Training from start to finish: iterations of a learner, validation, and a run that can be killed.

A run is a folder. `state.pt` holds everything the next iteration depends on and is replaced after
each, so a kill at any point costs at most the iteration under way; `recipe.yaml` is the recipe as
used; `metrics.jsonl` holds a line per iteration; `best.pt` and `best.md` are the averaged weights
with the lowest `val_unc` so far, and their card.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import torch
from torch.optim.swa_utils import AveragedModel

from dronemon.errors import CheckpointMismatch
from dronemon.policy import (
    Card,
    PolicyNetwork,
    find_checkpoint,
    load_checkpoint,
    read_tensors,
    save_checkpoint,
    write_atomically,
)
from dronemon.problem import FIRST_DEVELOPMENT_SEED
from dronemon.training.imitation import Expert
from dronemon.training.peers import Peers, join_peers, own_device
from dronemon.training.ppo import Ppo, PpoConfig
from dronemon.training.recipe import Recipe
from dronemon.training.validation import validate
from dronemon.version import code_version
from dronemon.workers import num_cores

METRICS: dict[str, str] = {
    "iteration": "iterations of the recipe so far",
    "minutes": "time spent in training so far, over all its resumptions",
    "decisions": "decisions played in the iteration, over all processes",
    "decisions_per_s": "decisions over the time the iteration took to play and to learn",
    "play_s": "seconds spent playing episodes: environment, belief and network",
    "learn_s": "seconds spent improving the network",
    "unc": "mean of sigma_bar over targets and the way flown, in the episodes played",
    "reward": "paper's reward per decision in the episodes played, unscaled",
    "learning_rate": "of the optimizer",
    "policy_loss": "PPO's clipped objective, negated, mean over the updates",
    "value_loss": "squared error of the value against the returns",
    "entropy": "of the policy, in nats",
    "gradient": "norm of the gradient before it is clipped",
    "kl": "estimate of the divergence from the policy that played",
    "clipped": "share of decisions whose probability ratio left the clip range",
    "imitation_loss": "cross-entropy between the teacher's soft choice and the policy",
    "regret": "share of the teacher's largest gain that the student's choices would lose, in the"
    " round's new lessons before it learned from them",
    "agreement": "share of the same decisions in which student and teacher would choose alike",
    "episodes": "taught episodes in the dataset",
    "val_unc": "mean of sigma_bar, flying greedily on development seeds; chooses the best",
    "val_reward": "paper's reward per decision, the same episodes",
    "val_lost": "share of targets with sigma_bar > 0.9, the same episodes",
}
"""Every number that training logs, and what it means."""
STATE_FORMAT = "dronemon training 3"


class Learner(Protocol):
    """A way to train: `iterate` plays and learns once; the average is what is worth keeping."""

    average: AveragedModel

    def iterate(self, progress: float) -> dict[str, float]:
        """Play and learn. progress: share of the time budget that is spent -> metrics."""
        ...

    def state(self) -> dict[str, Any]:
        """All that the next iteration depends on, besides the weights."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where `state` was taken."""
        ...


class Listener(Protocol):
    """Hears about a run as it goes."""

    def __call__(self, progress: float, metrics: Mapping[str, float]) -> None:
        """Take in the metrics of an iteration. progress: share of the time budget spent."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What to train, for how long, and where.

    start:                path or name of a checkpoint whose weights to begin with
    num_workers:          processes that give lessons, over all that train
    validation_minutes:   between measurements; the last one is at the end
    validation_episodes:  how thoroughly to measure
    validation_decisions: in each of these episodes
    """

    out: Path
    recipe: Recipe = field(default_factory=Recipe)
    start: str | None = None
    minutes: float = 60.0
    seed: int = 0
    device: str = "auto"
    num_workers: int = field(default_factory=num_cores)
    validation_minutes: float = 14.0
    validation_episodes: int = 32
    validation_decisions: int = 300

    @property
    def identity(self) -> dict[str, object]:
        """What a resumed run must share with the run it goes on with, by dotted names."""
        return _flat({**self.recipe.facts, "start": self.start, "seed": self.seed})


@dataclass(slots=True)
class _Run:
    """What a run has come to."""

    iteration: int = 0
    elapsed_s: float = 0.0
    validated_s: float = 0.0
    best_unc: float = float("inf")
    curve: list[dict[str, float]] | None = None


def train(plan: Plan, *, command: str, listen: Listener) -> Path:
    """Train, or go on with the run in `plan.out`. -> path of the best checkpoint.

    Raises CheckpointMismatch if `plan.out` holds a run of another plan, or the start is unusable.
    """
    code_version()  # for the card: the files may change while it trains
    device = own_device(plan.device)
    with join_peers(device) as peers:
        network = _first_weights(plan).to(device)
        peers.share_weights(network)
        learner = _learner(plan, network, device, peers)
        run = _resume(plan, network, learner)
        if peers.is_first:
            plan.out.mkdir(parents=True, exist_ok=True)
            (plan.out / "recipe.yaml").write_text(plan.recipe.text, encoding="utf-8")
        best = plan.out / "best.pt"
        budget_s = 60.0 * plan.minutes
        while run.elapsed_s < budget_s:
            began = time.monotonic()
            metrics = peers.agree(learner.iterate(run.elapsed_s / budget_s), device)
            run.iteration += 1
            _spend(run, began, peers, device)
            is_due = run.elapsed_s - run.validated_s >= 60.0 * plan.validation_minutes
            if is_due or run.elapsed_s >= budget_s:
                began = time.monotonic()
                metrics |= _measure(plan, learner, device) if peers.is_first else {}
                _spend(run, began, peers, device)
                run.validated_s = run.elapsed_s
            row = {"iteration": run.iteration, "minutes": run.elapsed_s / 60.0, **metrics}
            if peers.is_first:
                _record(plan, network, learner, run, row, command)
                listen(run.elapsed_s / budget_s, row)
        return best


def _spend(run: _Run, began_s: float, peers: Peers, device: torch.device) -> None:
    """Count the time since `began_s`; all processes agree on it, so that all stop together."""
    spent = {"s": time.monotonic() - began_s}
    run.elapsed_s += peers.agree(spent, device)["s"]


def _first_weights(plan: Plan) -> PolicyNetwork:
    """New weights from the seed, or those of a checkpoint."""
    if plan.start is not None:
        return load_checkpoint(
            find_checkpoint(plan.start), expected=plan.recipe.network
        ).network.train()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(plan.seed)
        return PolicyNetwork(plan.recipe.network)


def _learner(plan: Plan, network: PolicyNetwork, device: torch.device, peers: Peers) -> Learner:
    settings = plan.recipe.settings
    if isinstance(settings, PpoConfig):
        return Ppo(network, settings, seed=plan.seed, device=device, peers=peers)
    return Expert(
        network,
        settings,
        seed=plan.seed,
        device=device,
        peers=peers,
        folder=plan.out / "lessons",
        num_workers=plan.num_workers,
    )


def _flat(facts: Mapping[str, Any], prefix: str = "") -> dict[str, object]:
    """Nested values by dotted names."""
    flat: dict[str, object] = {}
    for key, value in facts.items():
        nested = isinstance(value, Mapping)
        flat |= _flat(value, f"{prefix}{key}.") if nested else {prefix + key: value}
    return flat


def _resume(plan: Plan, network: PolicyNetwork, learner: Learner) -> _Run:
    """Take up the run in the folder, if there is one."""
    path = plan.out / "state.pt"
    if not path.exists():
        return _Run(curve=[])
    state = read_tensors(path)
    if state.get("format") != STATE_FORMAT:
        raise CheckpointMismatch(f"{path}: not the state of a training run; choose another --out")
    if state["identity"] != plan.identity:
        before, now = state["identity"], plan.identity
        name = next(n for n in {**before, **now} if before.get(n) != now.get(n))
        raise CheckpointMismatch(
            f"{path}: that run has {name} {before.get(name)}, not {now.get(name)}; repeat its"
            f" options and its recipe, {plan.out / 'recipe.yaml'}, to go on with it, or choose"
            " another --out"
        )
    network.load_state_dict(state["weights"])
    learner.restore(state["learner"])
    _forget_lines(plan.out / "metrics.jsonl", state["run"]["iteration"])
    return _Run(**state["run"])


def _average(learner: Learner) -> PolicyNetwork:
    """The network with averaged weights, which is validated and kept."""
    network = learner.average.module
    assert isinstance(network, PolicyNetwork)
    return network


def _measure(plan: Plan, learner: Learner, device: torch.device) -> dict[str, float]:
    return validate(
        _average(learner),
        episodes=plan.validation_episodes,
        decisions=plan.validation_decisions,
        device=device,
    )


def _record(
    plan: Plan,
    network: PolicyNetwork,
    learner: Learner,
    run: _Run,
    row: dict[str, float],
    command: str,
) -> None:
    """Write what an iteration led to; the state last, since it makes the rest count."""
    assert run.curve is not None
    if "val_unc" in row:
        names = ("iteration", "minutes", "val_unc", "val_reward", "val_lost")
        run.curve.append({name: row[name] for name in names})
        if row["val_unc"] < run.best_unc:
            run.best_unc = row["val_unc"]
            _keep(plan, learner, run, row, command)
    with (plan.out / "metrics.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")
        file.flush()
        os.fsync(file.fileno())
    write_atomically(
        plan.out / "state.pt",
        {
            "format": STATE_FORMAT,
            "identity": plan.identity,
            "weights": network.state_dict(),
            "learner": learner.state(),
            "run": asdict(run),
        },
    )


def _keep(
    plan: Plan,
    learner: Learner,
    run: _Run,
    row: dict[str, float],
    command: str,
) -> None:
    """Write the best weights so far, with their card."""
    network = _average(learner)
    card = Card(
        recipe=plan.recipe.learner,
        command=command,
        commit=code_version(),
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        seeds=(
            f"root {plan.seed}; chosen on {FIRST_DEVELOPMENT_SEED} to"
            f" {FIRST_DEVELOPMENT_SEED + plan.validation_episodes - 1}"
        ),
        settings=plan.recipe.facts["settings"],
        curve=tuple(run.curve or ()),
        scores={name: value for name, value in row.items() if name.startswith("val_")},
        scope=plan.recipe.scope,
    )
    save_checkpoint(plan.out / "best.pt", network, card)
    (plan.out / "best.md").write_text(
        card.markdown("best", asdict(network.config)), encoding="utf-8"
    )


def _forget_lines(path: Path, count: int) -> None:
    """Drop lines that were written after the state was; the iteration is done again."""
    if path.exists():
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        path.write_text("".join(lines[:count]), encoding="utf-8")
