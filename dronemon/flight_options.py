"""Options of `fly`, `preflight` and `check`, and their help."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from dronemon.errors import OptionError

DEFAULT_MISSION = "animals"
MOST_CELL_M = 1e6
"""Places are told at least so exactly."""

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
StayOpen = Annotated[
    bool, typer.Option("--stay", help="Show the whole flight afterwards, until Ctrl-C.")
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
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Its run folder.")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON, for scripts.")]
CotUrl = Annotated[
    str | None,
    typer.Option(
        "--cot", metavar="udp://HOST:PORT", help="Send sightings there as Cursor-on-Target events."
    ),
]
StationUrl = Annotated[
    str | None,
    typer.Option(
        "--station",
        metavar="udp://HOST:PORT",
        help="Tell a ground station there, such as QGroundControl at port 14550, who is found.",
    ),
]
Markers = Annotated[
    bool, typer.Option("--markers", help="And mark every sighting on the ground station's map.")
]
Redact = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=MOST_CELL_M,
        metavar="METRES",
        help="To how many metres --cot and --station say where; 0: exactly.",
        show_default="1000",
    ),
]


RedactOption = Annotated[
    float | None,
    typer.Option(
        "--redact",
        min=1.0,
        max=MOST_CELL_M,
        metavar="METRES",
        help="Give places only to this many metres, and no pictures: who hunts reads maps, too.",
        show_default="exact",
    ),
]


def confirmed_settings(texts: Iterable[str], is_unasked: bool) -> dict[str, float]:
    """Parameters to set, by name, each confirmed by a person. Raises OptionError."""
    from dronemon.mission.scalars import number  # slow, and not needed for help

    settings: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            settings[name] = number(value)
        except ValueError:
            settings[name] = math.nan
        if not re.fullmatch("[A-Z][A-Z0-9_]{0,15}", name) or not math.isfinite(settings[name]):
            example = "NAME=VALUE with a plain number, such as COM_OBL_RC_ACT=3"
            raise OptionError(f"--set {text}: give {example}")
        if is_unasked:
            continue
        if not sys.stdin.isatty():
            raise OptionError(f"--set {text}: there is nobody to ask; add --yes")
        if not typer.confirm(f"Set {text} on the vehicle, and put it back afterwards?"):
            raise OptionError(f"--set {text}: not confirmed; nothing was done")
    return settings
