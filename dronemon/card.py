"""The card in a checkpoint: where its weights come from and what they were trained for.

A checkpoint is a zip archive of torch's with the card beside it, as JSON: whoever only asks what
weights are for need not import torch.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from dronemon.errors import CheckpointMismatch
from dronemon.problem import Prior

FORMAT = "dronemon policy 3"
CARD_FILE = "archive/card.json"
"""Its name in the archive; torch reads no archive with files outside its own folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """Missions that a network was trained on; ranges are inclusive."""

    num_targets: tuple[int, int]
    num_nodes: tuple[int, int]
    speed_ratio: tuple[float, float]
    priors: tuple[Prior, ...] = ("full",)

    def outside(
        self, *, num_targets: int, num_nodes: int, speed_ratio: float | None, unplaced: list[str]
    ) -> list[str]:
        """A sentence for each number of a mission that training never met.

        speed_ratio: the targets' speed over the drone's, None where nobody knows it
        unplaced:    names of the targets whose first position is unknown
        """
        numbers = (
            (num_targets, "targets", self.num_targets),
            (num_nodes, "nodes of the roadmap", self.num_nodes),
            (speed_ratio, "times the drone's speed for the targets", self.speed_ratio),
        )
        sentences = [
            f"{value:g} {what}: the network was trained for {low:g} to {high:g}"
            for value, what, (low, high) in numbers
            if value is not None and not low <= value <= high
        ]
        if ("number" if unplaced else "full") not in self.priors:
            what = f"is unknown of {', '.join(unplaced)}" if unplaced else "is known of all targets"
            how = "known" if unplaced else "unknown"
            sentences.append(f"the first position {what}: the network was trained with it {how}")
        return sentences

    def __str__(self) -> str:
        ranges = self.num_targets, self.num_nodes, self.speed_ratio
        targets, nodes, speed = (f"{low:g} to {high:g}" for low, high in ranges)
        known = " or ".join(self.priors)
        return f"{targets} targets, {nodes} nodes, {speed} times the agent's speed, prior {known}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Card:
    """Where weights come from.

    command:  what trained them
    commit:   of the code
    seeds:    used in training and for choosing
    settings: of the recipe
    curve:    rows of training, one mapping each
    scores:   on development seeds, of the weights kept
    scope:    what they were trained for, if anybody knows
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

    def as_json(self) -> str:
        """What `read_card` reads."""
        return json.dumps({"format": FORMAT, **dataclasses.asdict(self)}, indent=1)

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Card:
        """The card as its JSON holds it. Raises TypeError for other content."""
        ranges = content["scope"]
        scope = ranges and Scope(**{name: tuple(ends) for name, ends in ranges.items()})
        return cls(**{**content, "curve": tuple(content["curve"]), "scope": scope})

    def markdown(self, name: str, network: Mapping[str, object]) -> str:
        """The card as a page to lie beside the file. network: its settings."""
        shape = ", ".join(f"{k} {v}" for k, v in network.items())
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


def read_card(path: Path) -> Card:
    """The card of a checkpoint, whose bytes are whole.

    Raises CheckpointMismatch if the file is missing, damaged, or no checkpoint of this format.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if (damaged := archive.testzip()) is not None:
                raise CheckpointMismatch(f"{path}: damaged, in {damaged}")
            is_told = CARD_FILE in archive.namelist()
            content: dict[str, Any] = json.loads(archive.read(CARD_FILE)) if is_told else {}
        if (found := content.pop("format", "something else")) != FORMAT:
            raise CheckpointMismatch(
                f"{path}: holds {found!r}, not {FORMAT!r};"
                " train one with `dronemon train` or name another file"
            )
        return Card.of(content)
    except FileNotFoundError as exc:
        raise CheckpointMismatch(f"{path}: no such file") from exc
    except CheckpointMismatch:
        raise
    except (AttributeError, KeyError, TypeError) as exc:
        raise CheckpointMismatch(f"{path}: incomplete or from another version: {exc}") from exc
    except Exception as exc:  # an archive of others may be broken in any way
        raise CheckpointMismatch(f"{path}: not a readable checkpoint: {exc}") from exc


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


def _shipped_folder() -> Path:
    packaged = Path(str(resources.files("dronemon"))) / "data" / "models"
    return packaged if packaged.is_dir() else packaged.parents[2] / "models"


def _table(rows: tuple[Mapping[str, float], ...]) -> list[str]:
    """A Markdown table of rows with the same keys."""
    if not rows:
        return []
    body = ["| " + " | ".join(f"{value:.4g}" for value in row.values()) + " |" for row in rows]
    return ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0]), *body]
