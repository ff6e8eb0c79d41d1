"""What an evaluation covers, and the episodes that this makes."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from pathlib import Path

from dronemon import __version__
from dronemon.card import find_checkpoint
from dronemon.errors import OptionError
from dronemon.evaluation.episode import Conditions
from dronemon.planner import create_planner, files_outside, has_weights, planner_names
from dronemon.problem import MAX_HISTORY, MAX_TARGETS, MOTIONS, Prior, is_tracks
from dronemon.sensor import PERFECT, Sensor
from dronemon.world.motions import motion_flaw

PRIORS: tuple[Prior, ...] = ("full", "number", "none")
DEFAULT_NODES = 200


@dataclass(frozen=True, slots=True, order=True, kw_only=True)
class Cell:
    """One field of a table: what is known at first, the roadmap, how targets move and are seen."""

    prior: Prior
    num_targets: int
    speed_ratio: Fraction
    num_nodes: int = DEFAULT_NODES
    motion: str = "tsp"
    sensor: Sensor = PERFECT


Key = tuple[str, Cell, int, str]
"""What tells an episode from all others, also in a later run: method, cell, seed, settings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """Values of what a table or a figure goes through; cells are all their combinations."""

    targets: tuple[int, ...] = (4,)
    speed_ratios: tuple[Fraction, ...] = (Fraction(1, 10),)
    priors: tuple[Prior, ...] = ("full",)
    nodes: tuple[int, ...] = (DEFAULT_NODES,)
    motions: tuple[str, ...] = ("tsp",)
    sensors: tuple[Sensor, ...] = (PERFECT,)

    @property
    def cells(self) -> list[Cell]:
        """All combinations, in the order in which values were named."""
        return [
            Cell(
                prior=prior,
                num_targets=count,
                speed_ratio=speed,
                num_nodes=nodes,
                motion=motion,
                sensor=sensor,
            )
            for motion in self.motions
            for sensor in self.sensors
            for prior in self.priors
            for count in self.targets
            for speed in self.speed_ratios
            for nodes in self.nodes
        ]


TABLE1 = Sweep(
    targets=(2, 4, 6, 8),
    speed_ratios=(Fraction(1, 30), Fraction(1, 20), Fraction(1, 10), Fraction(1, 7)),
)
TABLE2 = Sweep(nodes=(50, 100, 150, 200, 300, 400))
FIGURE4 = Sweep(targets=(4, 6), speed_ratios=(Fraction(1, 20),))
FIGURE5 = Sweep(targets=(4, 6), speed_ratios=(Fraction(1, 20),), priors=PRIORS)
CONDITIONS = Sweep(
    priors=PRIORS,
    motions=MOTIONS,
    sensors=(PERFECT, Sensor(miss=0.1), Sensor(miss=0.1, false_alarms=0.05)),
)
"""Beside the paper's world, others; of these it is asked how much of the way a planner covers."""
PAPER_INSTANCES = 100
TABLE2_PLANNERS = {
    "stamp:paper@1": "1",
    "stamp:paper@25": "25",
    "stamp:paper@50": "50",
    "stamp:paper@100": "100",
    "stamp:paper@200": "200",
    "stamp:paper-no-predictions@200": "200 without prediction",
    "stamp:paper-lstm": "LSTM",
}
"""What Table II compares -> its row in the paper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerSpec:
    """A planner to evaluate: a registered name, and for a learned one its checkpoint and history.

    history: T, the decisions that it looks back, as many as it is used to for None
    """

    kind: str
    checkpoint: str | None = None
    history: int | None = None

    @classmethod
    def parse(cls, text: str) -> PlannerSpec:
        """Read `kind`, `kind:checkpoint`, either with `@history`, or `package.module:Class`."""
        match = re.fullmatch(r"([^:@]+)(?::(.+?))?(?:@(\d+))?", text.strip())
        if match is None or match[1] not in planner_names():
            return cls(kind=text.strip())
        history = int(match[3]) if match[3] else None
        return cls(kind=match[1], checkpoint=match[2], history=history)

    @property
    def text(self) -> str:
        """What `parse` reads."""
        return self._named(self.checkpoint)

    @property
    def method(self) -> str:
        """What tables call it."""
        return self._named(self.checkpoint and Path(self.checkpoint).stem)

    def _named(self, checkpoint: str | None) -> str:
        history = "" if self.history is None else f"@{self.history}"
        return self.kind + (f":{checkpoint}" if checkpoint else "") + history

    @property
    def files_digest(self) -> str | None:
        """Digest of weights and of others' code, so that others are another planner."""
        if has_weights(self.kind):
            return _file_digest(find_checkpoint(self.checkpoint))
        return _digest_outside(self.kind)


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSpec:
    """One episode to fly.

    settings: digest of all else that its outcome depends on
    folder:   where its arrays are kept, if they are
    """

    planner: PlannerSpec
    cell: Cell
    seed: int
    conditions: Conditions
    settings: str
    folder: Path | None

    @property
    def key(self) -> Key:
        """What tells this episode from all others."""
        return self.planner.method, self.cell, self.seed, self.settings

    def __str__(self) -> str:
        cell = self.cell
        told = f"N = {cell.num_targets}, speed {cell.speed_ratio}, {cell.num_nodes} nodes"
        return f"{self.planner.text} on seed {self.seed} ({told}, {cell.motion}, {cell.prior})"

    @property
    def path(self) -> Path | None:
        """The file of this episode's arrays, if they are kept."""
        if self.folder is None:
            return None
        cell = self.cell
        name = (
            f"{self.planner.method}_N{cell.num_targets}_{cell.speed_ratio}_{cell.prior}"
            f"_V{cell.num_nodes}_{Path(cell.motion).stem[:40]}_{cell.sensor}_seed{self.seed}_{self.settings}.npz"
        )
        return self.folder / name.replace(":", "-").replace("/", "-")


@dataclass(frozen=True, kw_only=True)
class Options:
    """An evaluation: every planner in every cell, on the same instances.

    horizon_au:    length of an episode
    save_episodes: keep the arrays of each episode
    workers:       processes

    Raises OptionError where a value cannot be used.
    """

    planners: tuple[PlannerSpec, ...]
    out: Path
    sweep: Sweep = TABLE1
    instances: int = PAPER_INSTANCES
    first_seed: int = 0
    horizon_au: float = 30.0
    save_episodes: bool = False
    workers: int = 1

    def __post_init__(self) -> None:
        methods = tuple(planner.method for planner in self.planners)
        over = self.sweep
        lists = {"planner": methods, "targets": over.targets, "speed": over.speed_ratios}
        lists |= {"prior": over.priors, "nodes": over.nodes, "motion": over.motions}
        lists |= {"sensor": over.sensors}
        for name, values in lists.items():
            _require(len(values) > 0, f"--{name} is empty; name at least one")
            _require(
                len(set(values)) == len(values),
                f"--{name} {','.join(map(str, values))} names one twice",
            )
        for count in over.targets:
            _require(1 <= count <= MAX_TARGETS, f"--targets {count} is not 1 to {MAX_TARGETS}")
        for speed in over.speed_ratios:
            _require(0 <= speed < 1, f"--speed {speed} is not from 0 to below 1, the agent's")
        for prior in over.priors:
            _require(prior in PRIORS, f"--prior {prior} is none of {', '.join(PRIORS)}")
        for motion in over.motions:
            _require(not (flaw := motion_flaw(motion, max(over.targets))), f"--motion {flaw}")
        _require(self.instances >= 1, f"--instances {self.instances} is less than 1")
        _require(self.first_seed >= 0, f"--first-seed {self.first_seed} is less than 0")
        _require(self.workers >= 1, f"--workers {self.workers} is less than 1")
        for nodes in over.nodes:
            _require(10 <= nodes <= 2000, f"--nodes {nodes} is not 10 to 2000")
        _require(
            math.isfinite(self.horizon_au) and 0.1 <= self.horizon_au <= 1000.0,
            f"--horizon {self.horizon_au:g} is not 0.1 to 1000 au",
        )
        for planner in self.planners:
            history = planner.history
            _require(
                history is None or 1 <= history <= MAX_HISTORY,
                f"--planner {planner.text}: a history of {history} is not 1 to {MAX_HISTORY}",
            )
            create_planner(planner.kind, checkpoint=planner.checkpoint, history=history)

    @property
    def command(self) -> str:
        """Command line that makes the same figures."""
        over = self.sweep
        return (
            f"dronemon evaluate --planner {_listed(planner.text for planner in self.planners)}"
            f" --targets {_listed(over.targets)} --speed {_listed(over.speed_ratios)}"
            f" --prior {_listed(over.priors)} --instances {self.instances}"
            f" --first-seed {self.first_seed} --horizon {self.horizon_au:g}"
            f" --nodes {_listed(over.nodes)} --motion {_listed(over.motions)}"
            f" --sensor {_listed(over.sensors)}"
        )

    @cached_property
    def _settings(self) -> dict[tuple[PlannerSpec, str], str]:
        """Digest, per planner and motion, of what decides an outcome besides the rest of a key."""
        return {
            (planner, motion): settings_digest(planner, motion, self.horizon_au)
            for planner in self.planners
            for motion in self.sweep.motions
        }

    def episodes(self) -> Iterator[EpisodeSpec]:
        """All episodes; seed by seed, so that an unfinished run covers all cells alike."""
        for seed in range(self.first_seed, self.first_seed + self.instances):
            for cell in self.sweep.cells:
                for planner in self.planners:
                    yield self.episode(planner, cell, seed)

    def episode(self, planner: PlannerSpec, cell: Cell, seed: int) -> EpisodeSpec:
        """One of the episodes."""
        conditions = Conditions(
            speed_ratio=float(cell.speed_ratio),
            prior=cell.prior,
            horizon_au=self.horizon_au,
            num_nodes=cell.num_nodes,
            sensor=cell.sensor,
        )
        return EpisodeSpec(
            planner=planner,
            cell=cell,
            seed=seed,
            conditions=conditions,
            settings=self._settings[planner, cell.motion],
            folder=self.out / "episodes" if self.save_episodes else None,
        )


def settings_digest(planner: PlannerSpec, motion: str, horizon_au: float) -> str:
    """Digest of what decides an outcome besides the rest of a key: files, horizon and version."""
    tracks = {"tracks": _file_digest(Path(motion))} if is_tracks(motion) else {}
    facts = {"version": __version__, "horizon": horizon_au, **tracks}
    return _digest({**facts, "weights": planner.files_digest})  # its name of old: results have it


def _listed(values: Iterable[object]) -> str:
    return ",".join(map(str, values))


def _digest(facts: dict[str, object]) -> str:
    """Short digest of facts. -> 12 hexadecimal digits."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:12]


@cache
def _digest_outside(kind: str) -> str | None:
    """Digest of a planner of others when this process first looked, which is how it is loaded."""
    files = files_outside(kind)
    return _digest({"files": [_file_digest(path) for path in files]}) if files else None


def _file_digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError) as exc:
        raise OptionError(f"{path}, which decides an outcome, cannot be read: {exc}") from exc


def _require(is_met: bool, otherwise: str) -> None:
    if not is_met:
        raise OptionError(otherwise)
