"""Trained weights and the card that says where they come from, in one file that is safe to open.

Only tensors, numbers and text are read (`weights_only`), and a digest guards the weights.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dronemon.errors import CheckpointMismatch, PolicyError
from dronemon.policy.layers import NetworkConfig
from dronemon.policy.network import PolicyNetwork
from dronemon.policy.scope import Scope

FORMAT = "dronemon policy 2"
DEFAULT_HISTORY = 100
"""T, the frames a policy remembers in flight and evaluation. Source: paper, section V-A."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Card:
    """Where weights come from.

    command:  what trained them
    commit:   of the code
    seeds:    used in training and for choosing
    settings: of the recipe
    curve:    rows of training, one mapping each
    scores:   on development seeds, of the weights kept
    scope:    what they were trained for; None where a file of before does not say
    """

    recipe: str
    command: str
    commit: str
    date: str
    seeds: str
    settings: Mapping[str, object] = field(default_factory=dict)
    curve: tuple[Mapping[str, float], ...] = ()
    scores: Mapping[str, float] = field(default_factory=dict)
    scope: Scope | None = None

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Card:
        """The card as a checkpoint holds it. Raises TypeError for other content."""
        scope = content.get("scope")
        rest = {"curve": tuple(content["curve"]), "scope": scope and Scope(**scope)}
        return cls(**{**content, **rest})

    def markdown(self, name: str, config: NetworkConfig) -> str:
        """The card as a page to lie beside the file."""
        shape = ", ".join(f"{k} {v}" for k, v in dataclasses.asdict(config).items())
        settings = ", ".join(f"{k} {v}" for k, v in self.settings.items())
        scores = ", ".join(f"{k} {v:.4g}" for k, v in self.scores.items())
        lines = [
            f"# {name}",
            "",
            "A network for `planner: stamp`: from beliefs at roadmap nodes to the next node.",
            "",
            f"- Network: {shape}",
            f"- Recipe: {self.recipe}; {settings}",
            f"- Command: `{self.command}`",
            f"- Commit: {self.commit}, {self.date}",
            f"- Trained for: {self.scope}",
            f"- Seeds: {self.seeds}",
            f"- Scores: {scores}",
            "",
            *_table(self.curve),
        ]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A network that is ready to judge, and its card."""

    network: PolicyNetwork
    card: Card


def save_checkpoint(path: Path, network: PolicyNetwork, card: Card) -> None:
    """Write weights and card, whole or not at all."""
    weights = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    write_atomically(
        path,
        {
            "format": FORMAT,
            "config": dataclasses.asdict(network.config),
            "weights": weights,
            "digest": digest(weights),
            "card": dataclasses.asdict(card),
        },
    )


def load_checkpoint(path: Path, expected: NetworkConfig | None = None) -> Checkpoint:
    """Read a checkpoint; the network is in evaluation mode.

    Raises CheckpointMismatch if the file is missing, damaged, or not a network of this kind (or not
    the `expected` one).
    """
    content = read_tensors(path)
    if content.get("format") != FORMAT:
        raise CheckpointMismatch(
            f"{path}: holds {content.get('format', 'something else')!r}, not {FORMAT!r};"
            " train one with `dronemon train` or name another file"
        )
    try:
        config = NetworkConfig(**content["config"])
        card = Card.of(content["card"])
        weights, expected_digest = content["weights"], content["digest"]
    except (KeyError, TypeError, PolicyError) as exc:
        raise CheckpointMismatch(f"{path}: incomplete or from another version: {exc}") from exc
    if expected is not None and config != expected:
        raise CheckpointMismatch(f"{path}: {_difference(config, expected)}")
    if digest(weights) != expected_digest:
        raise CheckpointMismatch(f"{path}: damaged, its weights are not those it was written with")
    network = PolicyNetwork(config)
    try:
        network.load_state_dict(weights)
    except RuntimeError as exc:
        raise CheckpointMismatch(f"{path}: weights do not fit its own shape: {exc}") from exc
    return Checkpoint(network=network.eval(), card=card)


def find_checkpoint(name: str | None) -> Path:
    """The checkpoint of a path, or of the name of a shipped one; the shipped default for None.

    Raises CheckpointMismatch if there is none.
    """
    shipped = _shipped_folder()
    wanted = name if name is not None else "stamp"
    own = [Path(name)] if name is not None else []  # no file here stands in for the default
    for path in (*own, shipped / wanted, shipped / f"{wanted}.pt"):
        if path.is_file():
            return path
    raise CheckpointMismatch(
        f"{wanted}: no such checkpoint, neither as a path nor in {shipped.name}/; shipped are:"
        f" {', '.join(sorted(p.stem for p in shipped.glob('*.pt'))) or 'none'}"
    )


def write_atomically(path: Path, content: Mapping[str, Any]) -> None:
    """Write tensors, numbers and text to a file, whole or not at all, even if power fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with partial.open("wb") as file:
            torch.save(dict(content), file)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def read_tensors(path: Path) -> dict[str, Any]:
    """Read what `write_atomically` wrote. Raises CheckpointMismatch if that cannot be."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as exc:
        raise CheckpointMismatch(f"{path}: no such file") from exc
    except (OSError, EOFError, ValueError, RuntimeError, KeyError) as exc:
        raise CheckpointMismatch(f"{path}: not a readable checkpoint: {_first_line(exc)}") from exc
    except (pickle.UnpicklingError, zipfile.BadZipFile) as exc:
        raise CheckpointMismatch(f"{path}: damaged or unsafe: {_first_line(exc)}") from exc
    if not isinstance(content, dict):
        raise CheckpointMismatch(f"{path}: holds a {type(content).__name__}, not a checkpoint")
    return content


def digest(weights: Mapping[str, Tensor]) -> str:
    """SHA-256 of all weights with their names and shapes."""
    total = hashlib.sha256()
    for name in sorted(weights):
        value = weights[name].detach().cpu().contiguous()
        total.update(f"{name} {tuple(value.shape)} {value.dtype}\n".encode())
        total.update(value.numpy().tobytes())
    return total.hexdigest()


def _shipped_folder() -> Path:
    packaged = Path(str(resources.files("dronemon"))) / "data" / "models"
    return packaged if packaged.is_dir() else packaged.parents[2] / "models"


def _difference(found: NetworkConfig, expected: NetworkConfig) -> str:
    """The first setting in which two networks differ."""
    pairs = zip(
        dataclasses.asdict(found).items(), dataclasses.asdict(expected).values(), strict=True
    )
    (name, has), wants = next((item, want) for item, want in pairs if item[1] != want)
    return f"its {name} is {has!r}, not {wants!r} as asked for"


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]


def _table(rows: tuple[Mapping[str, float], ...]) -> list[str]:
    """A Markdown table of rows with the same keys."""
    if not rows:
        return []
    body = ["| " + " | ".join(f"{value:.4g}" for value in row.values()) + " |" for row in rows]
    return ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0]), *body]
