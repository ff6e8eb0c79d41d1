"""`dronemon replay`: what another planner would have chosen at each decision of a flight."""

from __future__ import annotations

import csv
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.figure import Figure

from dronemon.arena import Arena
from dronemon.errors import PlannerError, blaming, writing
from dronemon.explain.decisions import begin_anew, read_decisions
from dronemon.feasibility import make_planner
from dronemon.flight_options import RunArgument
from dronemon.mission import Mission, mission_arena
from dronemon.mission.schema import Planner as PlannerSection
from dronemon.planner import Planner, Snapshot
from dronemon.planner.motion import waypoint_flaw
from dronemon.recorder import RunFolder
from dronemon.terminal import console, facts_table
from dronemon.types import FloatArray

SAME_AU = 1e-6
"""Waypoints nearer than this are one."""
PlannerOption = Annotated[
    str, typer.Option(help="Who decides again; see `dronemon planners`.", show_default=False)
]
CheckpointOption = Annotated[
    str | None, typer.Option(help="Weights of a learned planner: a path or a shipped name.")
]
ToOption = Annotated[
    Path, typer.Option("--to", help="Folder for replay.png and replay.csv.", show_default=False)
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Choices:
    """Both choices at each of D decisions.

    times_au:       (D,)   when; places_au: (D, 2) where
    flown_to_au:    (D, 2) the waypoint chosen in flight
    otherwise_au:   (D, 2) the other planner's
    decision_ms:    (D,)   how long it took
    """

    times_au: FloatArray
    places_au: FloatArray
    flown_to_au: FloatArray
    otherwise_au: FloatArray
    decision_ms: FloatArray

    @property
    def apart_au(self) -> FloatArray:
        """(D,) between the two waypoints."""
        apart: FloatArray = np.hypot(*(self.flown_to_au - self.otherwise_au).T)
        return apart


def replay_command(
    run: RunArgument, planner: PlannerOption, to: ToOption, checkpoint: CheckpointOption = None
) -> None:
    """Ask another planner at each decision of a flight: on the same sightings, in the same place.

    It is asked where the drone was, not where it would have been: what its choices would have
    come to is for `dronemon evaluate`.
    """
    folder = RunFolder.open(run)
    mission = folder.mission()
    section = PlannerSection(kind=planner, checkpoint=checkpoint)
    choices = decide_otherwise(folder, make_planner(section))
    with writing("--to", to / "replay.csv"):
        _write(choices, to / "replay.csv")
        _draw(choices, mission, planner).savefig(to / "replay.png", dpi=110)
    console.print(
        facts_table(f"{run}: {mission.planner.kind}, and {planner}", _facts(choices, mission))
    )
    console.print(f"{to / 'replay.png'} and .csv", soft_wrap=True, markup=False)


def decide_otherwise(folder: RunFolder, planner: Planner) -> Choices:
    """Ask a planner at each decision of a run. Raises RecordError, PlannerError."""
    decisions = read_decisions(folder)
    made = decisions.made
    arena = mission_arena(decisions.mission)
    asked = begin_anew(planner, decisions, made)
    answers = [_ask(planner, snapshot, arena) for _, snapshot in asked]
    waypoints_au, took_ms = zip(*answers, strict=True)
    return Choices(
        times_au=np.array([decision.time_au for decision in made]),
        places_au=np.array([decision.position_au for decision in made]),
        flown_to_au=np.array([decision.waypoint_au for decision in made]),
        otherwise_au=np.array(waypoints_au),
        decision_ms=np.array(took_ms),
    )


def _ask(planner: Planner, snapshot: Snapshot, arena: Arena) -> tuple[FloatArray, float]:
    """The planner's waypoint in au, and the milliseconds that it took. Raises PlannerError."""
    who = f"planner '{planner.name}'"
    began_s = time.perf_counter()
    with blaming(who, PlannerError):
        waypoint = planner.next_waypoint(snapshot)
        took_ms = 1e3 * (time.perf_counter() - began_s)
        flaw = waypoint_flaw(waypoint, snapshot.position_au, arena)
    if flaw:
        raise PlannerError(f"{who} gave at {snapshot.time_au:.3f} au {flaw}")
    return waypoint.position_au, took_ms


def _facts(choices: Choices, mission: Mission) -> Mapping[str, str]:
    apart_au = choices.apart_au
    same = apart_au < SAME_AU
    facts = {
        "decisions": str(len(apart_au)),
        "the same waypoint": f"{same.mean():.0%}",
        "time of a decision": f"{np.percentile(choices.decision_ms, 50):.1f} ms, "
        f"p99 {np.percentile(choices.decision_ms, 99):.1f} ms",
    }
    if not same.all():
        apart_m = float(np.median(apart_au[~same])) * mission.area.side_m
        facts["else apart by"] = f"{apart_m:.1f} m (median)"
    return facts


def _write(choices: Choices, path: Path) -> None:
    head = (
        "decision",
        "time_au",
        *(f"{what}_{axis}_au" for what in ("place", "flown", "otherwise") for axis in "xy"),
        "decision_ms",
    )
    rows: Sequence[Sequence[Any]] = np.column_stack(
        [
            choices.times_au,
            choices.places_au,
            choices.flown_to_au,
            choices.otherwise_au,
            choices.decision_ms,
        ]
    ).tolist()
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows((number, *row) for number, row in enumerate(rows, start=1))


def _draw(choices: Choices, mission: Mission, name: str) -> Figure:
    """Every leg flown, and beside it the leg that the other would have flown from there."""
    figure = Figure(figsize=(7.0, 7.4), layout="constrained")
    panel = figure.add_subplot()
    panel.plot(*mission_arena(mission).outline_au.T, color="0.3", linewidth=1.0)
    legs = zip(
        choices.places_au, choices.flown_to_au, choices.otherwise_au, choices.apart_au, strict=True
    )
    for place_au, flown_au, other_au, apart_au in legs:
        panel.plot(*np.stack([place_au, flown_au]).T, color="0.65", linewidth=1.0)
        if apart_au >= SAME_AU:
            panel.annotate(
                "",
                other_au,
                place_au,
                arrowprops={"arrowstyle": "->", "color": "tab:blue", "linewidth": 0.7},
            )
    panel.plot([], [], color="0.65", label=f"where {mission.planner.kind} flew")
    panel.plot([], [], color="tab:blue", label=f"where {name} would have gone from there")
    panel.set_title(f"{mission.name}: each decision of a flight, made again", fontsize=10)
    panel.set_aspect("equal")
    panel.set_axis_off()
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, frameon=False)
    return figure
