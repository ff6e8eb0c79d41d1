"""Training from start to finish: iterations of a learner, validation, and a run that can be killed.

A run is a folder. `state.pt` holds everything the next iteration depends on and is replaced after
each, so a kill at any point costs at most the iteration under way; `recipe.yaml` is the recipe as
used; `metrics.csv` holds a line per iteration; `best.pt` and `best.md` are the averaged weights
with the lowest `val_unc` so far, and their card.
"""

from __future__ import annotations

import contextlib
import csv
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Thread
from typing import Any

import torch

from dronemon.durable import claim
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
from dronemon.training.peers import Peers
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
"""Every number that training logs, and what it means; docs/training.md has the same table."""
METRICS_FILE = "metrics.csv"
"""Of a run: a column for each of these, empty where an iteration has no such number."""
STATE_FORMAT = "dronemon training 3"
SPENT_FILE, NOTE_INTERVAL_S = "spent_s", 2.0
Listener = Callable[[float, Mapping[str, float]], None]
"""Hears of each iteration: the share of the budget that is spent, and its metrics."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What to train, for how long, and where.

    start:                path or name of a checkpoint whose weights to begin with
    minutes:              budget, over all resumptions
    iterations:           budget instead of it, which a busy machine does not make smaller
    num_workers:          processes that give lessons, over all that train
    validation_minutes:   between measurements; the last one is at the end
    validation_episodes:  how thoroughly to measure
    validation_decisions: in each of these episodes
    """

    out: Path
    recipe: Recipe = field(default_factory=Recipe)
    start: str | None = None
    minutes: float = 60.0
    iterations: int | None = None
    seed: int = 0
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
    curve: list[dict[str, float]] = field(default_factory=list)


def train(
    plan: Plan,
    peers: Peers,
    *,
    command: str,
    listen: Listener,
    cluster: Executor | None = None,
) -> Path:
    """Train, or go on with the run in `plan.out`. -> path of the best checkpoint.

    peers:   the processes that train together, of which each calls this
    cluster: gives lessons instead of processes of our own

    Raises CheckpointMismatch if `plan.out` holds a run of another plan, or the start is unusable;
    RecordError if `plan.out` cannot be written.
    """
    code_version()  # for the card: the files may change while it trains
    claim(plan.out)
    training = _Training(plan, command, peers, cluster)
    if peers.is_first:
        (plan.out / "recipe.yaml").write_text(plan.recipe.text, encoding="utf-8")
    while training.progress < 1.0:
        metrics = training.iterate()
        if peers.is_first:
            training.record(metrics)
            listen(training.progress, metrics)
    return training.best


class _Training:
    """A run in the folder of its plan."""

    def __init__(self, plan: Plan, command: str, peers: Peers, cluster: Executor | None) -> None:
        self._plan, self._command, self._peers = plan, command, peers
        self.best = plan.out / "best.pt"
        self._network = _first_weights(plan).to(peers.device)
        peers.share_weights(self._network)
        self._learner = _learner(plan, self._network, peers, cluster)
        self._run = self._resumed()
        spent_s = max(self._run.elapsed_s, _spent_s(plan))
        self._run.elapsed_s = peers.agree({"s": spent_s})["s"]  # one clock for all processes

    @property
    def progress(self) -> float:
        """Share of the budget that is spent."""
        if self._plan.iterations is not None:
            return self._run.iteration / self._plan.iterations
        return self._run.elapsed_s / (60.0 * self._plan.minutes)

    def iterate(self) -> dict[str, float]:
        """Play, learn, and validate where that is due. -> metrics, the mean over all processes."""
        run = self._run
        with self._counted():
            metrics = self._peers.agree(self._learner.iterate(self.progress))
        run.iteration += 1
        unvalidated_s = run.elapsed_s - run.validated_s
        if unvalidated_s >= 60.0 * self._plan.validation_minutes or self.progress >= 1.0:
            with self._counted():
                if self._peers.is_first:
                    metrics |= validate(
                        self._average,
                        episodes=self._plan.validation_episodes,
                        decisions=self._plan.validation_decisions,
                        device=self._peers.device,
                        priors=self._plan.recipe.settings.priors,
                    )
            run.validated_s = run.elapsed_s
        return {"iteration": run.iteration, "minutes": run.elapsed_s / 60.0, **metrics}

    @contextmanager
    def _counted(self) -> Iterator[None]:
        """Count the time spent; all processes agree on it, so that all stop together."""
        began_s = time.monotonic()
        with contextlib.ExitStack() as stack:
            if self._peers.is_first:
                stack.enter_context(_noting(self._plan.out, self._run.elapsed_s - began_s))
            yield
        spent = self._peers.agree({"s": time.monotonic() - began_s})
        self._run.elapsed_s += spent["s"]

    @property
    def _average(self) -> PolicyNetwork:
        """The network with averaged weights, which is validated and kept."""
        network = self._learner.average.module
        assert isinstance(network, PolicyNetwork)
        return network

    def record(self, metrics: dict[str, float]) -> None:
        """Write what an iteration led to; the state last, since it makes the rest count."""
        folder, run = self._plan.out, self._run
        if "val_unc" in metrics:
            names = ("iteration", "minutes", "val_unc", "val_reward", "val_lost")
            run.curve.append({name: metrics[name] for name in names})
            if metrics["val_unc"] < run.best_unc:
                run.best_unc = metrics["val_unc"]
                self._keep()
        with (folder / METRICS_FILE).open("a", encoding="utf-8", newline="") as file:
            log = csv.DictWriter(file, METRICS, lineterminator="\n")
            if file.tell() == 0:
                log.writeheader()
            log.writerow(metrics)
            file.flush()
            os.fsync(file.fileno())
        state = {
            "format": STATE_FORMAT,
            "identity": self._plan.identity,
            "weights": self._network.state_dict(),
            "learner": self._learner.state(),
            "run": asdict(run),
        }
        write_atomically(folder / "state.pt", state)

    def _keep(self) -> None:
        """Write the best weights so far, with their card."""
        plan, curve = self._plan, self._run.curve
        last = FIRST_DEVELOPMENT_SEED + plan.validation_episodes - 1
        card = Card(
            recipe=plan.recipe.learner,
            command=self._command,
            commit=code_version(),
            date=datetime.now(UTC).strftime("%Y-%m-%d"),
            seeds=f"root {plan.seed}; chosen on {FIRST_DEVELOPMENT_SEED} to {last}",
            settings=plan.recipe.facts["settings"],
            curve=tuple(curve),
            scores={name: value for name, value in curve[-1].items() if name.startswith("val_")},
            scope=plan.recipe.scope,
        )
        save_checkpoint(self.best, self._average, card)
        page = card.markdown("best", asdict(self._average.config))
        self.best.with_suffix(".md").write_text(page, encoding="utf-8")

    def _resumed(self) -> _Run:
        """Take up the run in the folder, if there is one."""
        path = self._plan.out / "state.pt"
        if not path.exists():
            return _Run()
        state = read_tensors(path)
        if state.get("format") != STATE_FORMAT:
            raise CheckpointMismatch(
                f"{path}: not the state of a training run; choose another --out"
            )
        before, now = state["identity"], self._plan.identity
        if before != now:
            name = next(n for n in {**before, **now} if before.get(n) != now.get(n))
            raise CheckpointMismatch(
                f"{path}: that run has {name} {before.get(name)}, not {now.get(name)}; repeat its"
                f" options and its recipe, {path.with_name('recipe.yaml')}, to go on with it, or"
                " choose another --out"
            )
        self._network.load_state_dict(state["weights"])
        self._learner.restore(state["learner"])
        run = _Run(**state["run"])
        _forget_lines(path.with_name(METRICS_FILE), 1 + run.iteration)
        return run


@contextmanager
def _noting(folder: Path, offset_s: float) -> Iterator[None]:
    """Keep in a file how long training has taken, so that a kill does not give time back.

    offset_s: that time less the clock
    """
    is_over = Event()

    def note() -> None:
        part = folder / f"{SPENT_FILE}.part"
        while True:
            part.write_text(f"{offset_s + time.monotonic():.1f}\n", encoding="utf-8")
            part.replace(folder / SPENT_FILE)
            if is_over.wait(NOTE_INTERVAL_S):
                return

    thread = Thread(target=note, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def _spent_s(plan: Plan) -> float:
    """How long a run has trained, the part of an iteration that was killed counted.

    Never all of a budget of minutes: the last iteration ends with a validation.
    """
    path = plan.out / SPENT_FILE
    noted_s = float(path.read_text(encoding="utf-8")) if path.exists() else 0.0
    return noted_s if plan.iterations is not None else min(noted_s, 60.0 * plan.minutes - 1.0)


def _first_weights(plan: Plan) -> PolicyNetwork:
    """New weights from the seed, or those of a checkpoint."""
    if plan.start is not None:
        path = find_checkpoint(plan.start)
        return load_checkpoint(path, expected=plan.recipe.network).network.train()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(plan.seed)
        return PolicyNetwork(plan.recipe.network)


def _learner(
    plan: Plan, network: PolicyNetwork, peers: Peers, cluster: Executor | None
) -> Ppo | Expert:
    settings = plan.recipe.settings
    if isinstance(settings, PpoConfig):
        return Ppo(network, settings, peers, plan.seed)
    folder = plan.out / "lessons"
    return Expert(
        network,
        settings,
        peers,
        plan.seed,
        folder=folder,
        num_workers=plan.num_workers,
        cluster=cluster,
    )


def _flat(facts: Mapping[str, Any], prefix: str = "") -> dict[str, object]:
    """Nested values by dotted names."""
    flat: dict[str, object] = {}
    for key, value in facts.items():
        nested = isinstance(value, Mapping)
        flat |= _flat(value, f"{prefix}{key}.") if nested else {prefix + key: value}
    return flat


def _forget_lines(path: Path, count: int) -> None:
    """Drop lines that were written after the state was; the iteration is done again."""
    if path.exists():
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        path.write_text("".join(lines[:count]), encoding="utf-8")
