"""Finished episodes on disk: one line of JSON each, so that a killed run goes on where it was."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from dronemon.belief import Scores
from dronemon.errors import OptionError, RecordError
from dronemon.evaluation.options import DEFAULT_NODES, Cell, Key
from dronemon.sensor import Sensor

_DAMAGE = ValueError, KeyError, TypeError, AttributeError, ArithmeticError, OptionError
"""What a line that nobody wrote so may raise."""
UNKNOWN_CODE = "unknown"
"""Code of episodes from before results named it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """One finished episode.

    method:          the planner
    unc_over_time:   (S,) mean over targets at each measurement
    found_over_time: (S,) share of targets that were seen by then
    decisions:       how often the planner was asked
    decision_s:      its mean answering time
    code:            version that flew it
    """

    method: str
    cell: Cell
    seed: int
    settings: str
    scores: Scores
    unc_over_time: tuple[float, ...]
    found_over_time: tuple[float, ...]
    decisions: int
    decision_s: float
    code: str

    @property
    def key(self) -> Key:
        """The key of the task that this is the result of."""
        return self.method, self.cell, self.seed, self.settings

    def as_json(self) -> str:
        """One line, without its end."""
        record = asdict(self)
        cell, scores = record.pop("cell"), record.pop("scores")
        record |= {
            "targets": cell["num_targets"],
            "speed_ratio": str(cell["speed_ratio"]),
            "prior": cell["prior"],
            "nodes": cell["num_nodes"],
            "motion": cell["motion"],
            "sensor": str(self.cell.sensor),
            "scores": {n: None if math.isnan(value) else value for n, value in scores.items()},
        }
        return json.dumps(record, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Result:
        """Read a line that `as_json` wrote.

        Raises Value-, Key-, Type-, Arithmetic-, Attribute- or OptionError otherwise.
        """
        before = {"code": UNKNOWN_CODE, "nodes": DEFAULT_NODES, "motion": "tsp"}
        before |= {"sensor": "perfect"}
        record: dict[str, Any] = {**before, "found_over_time": (), **json.loads(line)}
        scores: dict[str, Any] = {
            name: math.nan if value is None else value for name, value in record["scores"].items()
        }
        record |= {
            "cell": Cell(
                prior=record.pop("prior"),
                num_targets=record.pop("targets"),
                speed_ratio=Fraction(record.pop("speed_ratio")),
                num_nodes=record.pop("nodes"),
                motion=record.pop("motion"),
                sensor=Sensor.parse(record.pop("sensor")),
            ),
            "scores": Scores(**scores),
            "unc_over_time": tuple(map(float, record["unc_over_time"])),
            "found_over_time": tuple(map(float, record["found_over_time"])),
        }
        if not record["unc_over_time"] or not all(
            isinstance(s, int | float) for s in scores.values()
        ):
            raise ValueError("there is no curve, or a score is no number")
        return cls(**record)


def load_results(path: Path) -> dict[Key, Result]:
    """Read all finished episodes of a file; a last line that was cut off is removed from it.

    Raises RecordError if it, or a line before the last one, cannot be read.
    """
    try:
        content = path.read_bytes() if path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            with path.open("r+b") as file:
                file.truncate(len(whole))
    except OSError as exc:
        raise RecordError(f"{path}: {exc.strerror}; choose another --out") from exc
    results = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            result = Result.from_json(line.decode())
        except _DAMAGE as exc:
            raise RecordError(
                f"{path}:{number} is no finished episode ({exc!r}); remove the line, and "
                "the episode is flown again"
            ) from exc
        results[result.key] = result
    return results


def append_result(path: Path, result: Result) -> None:
    """Add a finished episode to a file and hand it to the operating system."""
    with path.open("a", encoding="utf-8") as file:
        file.write(result.as_json() + "\n")
