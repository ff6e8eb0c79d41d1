"""Several runs side by side: what each came to, in a column each."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Column, Table
from rich.text import Text

from dronemon.flight_options import AsJson
from dronemon.recorder import RunFolder
from dronemon.runner.history import understanding
from dronemon.runner.watch import span
from dronemon.terminal import console

RunArguments = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Their run folders.")]
FIGURES: dict[str, Callable[[Any], str]] = {
    "planner": str,
    "outcome": str,
    "horizon_au": "{:g}".format,
    "pictures": str,
    "longest_unseen_s": span,
    "unc": "{:.3f}".format,
    "jsd": "{:.3f}".format,
    "min_ob": str,
    "mean_speed_m_s": "{:.2f}".format,
    "decision_p99_ms": "{:.1f}".format,
    "landing_battery": "{:.0%}".format,
}
"""What is told of each run, and how it is shown."""
HEADS = {
    "horizon_au": "way to fly (au)",
    "longest_unseen_s": "longest out of sight",
    "unc": "Unc",
    "jsd": "JSD",
    "min_ob": "MinOb",
    "mean_speed_m_s": "speed (m/s)",
    "decision_p99_ms": "decision p99 (ms)",
    "landing_battery": "battery left",
}
"""Of the figures that are not called by their key."""


def compare_command(runs: RunArguments, as_json: AsJson = False) -> None:
    """Show several flights side by side."""
    rows = compare([RunFolder.open(run) for run in runs])
    if as_json:
        sys.stdout.write(json.dumps(rows, indent=2, ensure_ascii=False) + "\n")
        return
    table = Table("", *(Column(Text(row["run"], overflow="fold")) for row in rows))
    for key, show in FIGURES.items():
        cells = ["-" if row[key] is None else " ".join(show(row[key]).split()) for row in rows]
        table.add_row(HEADS.get(key, key), *map(Text, cells))
    console.print(table)


def compare(folders: Sequence[RunFolder]) -> list[dict[str, Any]]:
    """The figures of each run, None for what it does not know. Raises RecordError."""
    return [_row(folder) for folder in folders]


def _row(folder: RunFolder) -> dict[str, Any]:
    summary = folder.summary()
    mission = folder.mission()
    with understanding(folder):
        unseen_s = [watched["longest_unseen_s"] for watched in summary.get("watched", {}).values()]
        known = summary | {
            "run": folder.path.name,
            "planner": mission.planner.kind,
            "horizon_au": mission.horizon_au,
            "longest_unseen_s": max(unseen_s, default=None),
        }
    return {key: known.get(key) for key in ("run", *FIGURES)}
