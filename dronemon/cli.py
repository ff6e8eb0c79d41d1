"""The command line: parse, call, map errors to exit codes.

0 done   1 internal error   2 bad input   3 vehicle   4 camera   5 belief or planner
6 run folder   7 view   130 interrupted (and landed)
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import dronemon
from dronemon.assembly import assemble_and_fly, check_flight, make_planner
from dronemon.errors import DronemonError, VehicleError
from dronemon.evaluation.command import evaluate_command
from dronemon.mission import Mission, find_mission, load_mission, shipped_missions
from dronemon.mission.load import outbound_min, usable_min
from dronemon.planner.registry import planner_names
from dronemon.runner.summary import facts
from dronemon.terminal import console, facts_table, print_error
from dronemon.training.command import train_command

INTERRUPTED = 130

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="One drone keeps watch over several moving targets.",
)

MissionOption = Annotated[
    str, typer.Option("--mission", "-m", help="Mission file, or name of a shipped mission.")
]

FollowOption = Annotated[
    str | None,
    typer.Option(
        help="Second MAVLink URL of that vehicle: simulated animals and camera follow it there."
    ),
]


def main() -> None:
    """Run the command line; a DronemonError becomes one message and its exit code."""
    try:
        app()
    except DronemonError as exc:
        print_error(str(exc))
        sys.exit(exc.exit_code)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        console.print(dronemon.__version__)
        raise typer.Exit


@app.command("fly")
def fly_command(
    mission: MissionOption = "animals",
    vehicle: Annotated[
        str | None,
        typer.Option(help="MAVLink URL of a vehicle, such as udpin://127.0.0.1:14540, or `mock`."),
    ] = None,
    follow: FollowOption = None,
    planner: Annotated[str | None, typer.Option(help="What chooses the waypoints.")] = None,
    horizon_au: Annotated[float | None, typer.Option(help="Patrol length in sides.")] = None,
    speed_up: Annotated[float | None, typer.Option(help="Speed of the mock, 1 to 20.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of world, roadmap and planner.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder; a new one under runs/ if absent.")
    ] = None,
    view: Annotated[
        bool | None, typer.Option("--view/--no-view", help="Serve the live view on loopback.")
    ] = None,
) -> None:
    """Fly a mission: take off, patrol, come home, land. Ctrl-C returns; twice lands now."""
    given: dict[tuple[str, str], tuple[str, object]] = {
        ("vehicle", "url"): ("--vehicle", vehicle),
        ("vehicle", "speed_up"): ("--speed-up", speed_up),
        ("flight", "horizon_au"): ("--horizon-au", horizon_au),
        ("planner", "kind"): ("--planner", planner),
        ("simulation", "seed"): ("--seed", seed),
        ("view", "live"): ("--view", view),
    }
    overrides = {key: option for key, option in given.items() if option[1] is not None}
    file = load_mission(find_mission(mission), overrides)
    check_flight(file, follow)
    chosen = make_planner(file)
    result, summary = asyncio.run(assemble_and_fly(file, chosen, follow, out))
    console.print(facts_table(file.mission.name, facts(result.outcome, summary)))
    if result.error is not None:
        raise result.error
    if not result.is_landed:
        raise VehicleError("the drone is still armed, and the pilot's")
    raise typer.Exit(INTERRUPTED if result.outcome == "interrupted" else 0)


@app.command()
def check(mission: MissionOption = "animals", follow: FollowOption = None) -> None:
    """Validate a mission and print what would be flown, without flying."""
    file = load_mission(find_mission(mission))
    check_flight(file, follow)
    make_planner(file)
    m = file.mission
    # Mean distance to one of the k nearest of V random places.
    leg_au = 2.0 / 3.0 * np.sqrt(m.roadmap.num_neighbours / (np.pi * m.roadmap.num_nodes))
    console.print(
        facts_table(
            f"{file.path}: can be flown",
            {
                "targets": ", ".join(f"{t.name} ({t.appearance})" for t in m.targets),
                "area": f"{m.area.side_m:g} m side, heading {m.area.heading_deg:g} degrees",
                "altitude": f"{m.flight.altitude_m:g} m; the sensor radius of "
                f"{m.sensor_radius_m:g} m needs {m.needed_altitude_m:.1f} m",
                "patrol": f"{m.horizon_au:g} au = {m.horizon_au * m.area.side_m:.0f} m at "
                f"{m.flight.cruise_speed_m_s:g} m/s = {m.patrol_duration_s / 60:.1f} min",
                "pictures": f"{m.horizon_au / 0.1:.0f}, one every {0.1 * m.area.side_m:g} m",
                "roadmap": f"{m.roadmap.num_nodes} nodes; about "
                f"{m.horizon_au / leg_au:.0f} decisions of a planner that keeps to it",
                "battery": f"{outbound_min(m):.1f} min until the return, of {usable_min(m):.1f} "
                f"min usable ({m.flight.endurance_min:g} min, return at "
                f"{m.flight.return_battery:.0%})",
                "planner": m.planner.kind,
                "vehicle": m.vehicle.url,
            },
        )
    )


@app.command()
def missions() -> None:
    """List the shipped missions."""
    for name, path in shipped_missions().items():
        console.print(f"{name}: {path}", soft_wrap=True, markup=False)


@app.command()
def planners() -> None:
    """List the planners that a mission may name."""
    for name in planner_names():
        console.print(name, markup=False)


@app.command()
def schema() -> None:
    """Print the JSON schema of mission files, for editors."""
    sys.stdout.write(json.dumps(Mission.model_json_schema(), indent=2) + "\n")


app.command("evaluate")(evaluate_command)
app.command("train")(train_command)

if __name__ == "__main__":
    main()
