"""Options of `fly`, `preflight` and `check`, and their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DEFAULT_MISSION = "animals"

MissionArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[MISSION]",
        help="Mission file, or name of a shipped mission.",
        show_default=DEFAULT_MISSION,
    ),
]
NamedMission = Annotated[str | None, typer.Option("--mission", "-m", help="The same, by name.")]
VehicleUrl = Annotated[
    str | None,
    typer.Option(help="MAVLink URL of a vehicle, such as udpin://127.0.0.1:14540, or `mock`."),
]
FollowUrl = Annotated[
    str | None,
    typer.Option(
        help="Second MAVLink URL of that vehicle: simulated animals and camera follow it there."
    ),
]
PlannerKind = Annotated[
    str | None, typer.Option(help="What chooses the waypoints; see `dronemon planners`.")
]
HistoryLength = Annotated[
    int | None, typer.Option(help="How many decisions a learned planner looks back.")
]
HorizonAu = Annotated[float | None, typer.Option(help="Patrol length in sides.")]
SpeedUp = Annotated[float | None, typer.Option(help="Speed of the mock, 1 to 20.")]
Seed = Annotated[int | None, typer.Option(help="Seed of world, roadmap and planner.")]
LiveView = Annotated[
    bool | None, typer.Option("--view/--no-view", help="Serve the live view on loopback.")
]
RunFolder = Annotated[
    Path | None, typer.Option(help="Run folder; a new one under runs/ if absent.")
]
Resume = Annotated[
    Path | None,
    typer.Option(
        metavar="RUN",
        help="Go on with a run whose program ended: in the air, unless somebody flies the vehicle, "
        "or on the ground.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Set a parameter of the vehicle meanwhile, and put it back afterwards.",
    ),
]
Unasked = Annotated[bool, typer.Option("--yes", help="Set parameters without asking.")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON, for scripts.")]
