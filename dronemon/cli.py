"""The command line: parse, call, map errors to exit codes.

0 done   1 internal error   2 bad input   3 vehicle   4 camera   5 belief or planner
6 run folder   7 view   130 interrupted (and landed)
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
import yaml
from rich.console import Console

import dronemon
from dronemon.camera import FrameSource, SimulatedCamera, VideoCamera
from dronemon.errors import DronemonError, OptionError, PolicyError, VehicleError
from dronemon.evaluation.command import evaluate_command
from dronemon.mission import Mission, MissionFile, find_mission, load_mission, shipped_missions
from dronemon.mission.load import outbound_min, usable_min
from dronemon.planner import Clairvoyant, Planner
from dronemon.planner.registry import create_planner, planner_names
from dronemon.recorder import RunRecorder
from dronemon.runner import FlightResult, Interrupts, fly, mission_kernel, rehearse
from dronemon.runner.summary import facts, summarise
from dronemon.simulator import Simulator, read_truth, simulator
from dronemon.terminal import FlightDisplay, facts_table
from dronemon.training.command import train_command
from dronemon.types import FloatArray
from dronemon.vehicle.mavsdk_link import MavsdkLink
from dronemon.viz import FlightView

INTERRUPTED = 130
_WORKER_THREADS = 16  # MAVSDK's calls wait in threads

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="One drone keeps watch over several moving targets.",
)
console = Console()
errors = Console(stderr=True)

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
        errors.print(f"error: {exc}", style="bold red", soft_wrap=True, markup=False)
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
    _check_flight(file, follow)
    chosen = _create_planner(file)
    raise typer.Exit(asyncio.run(_fly(file, chosen, follow, out)))


def _check_flight(file: MissionFile, follow: str | None) -> None:
    """What is wrong with vehicle, camera and priors taken together. Raises MissionFileError."""
    mission = file.mission
    if mission.vehicle.is_mock and follow is not None:
        raise OptionError("--follow goes with --vehicle URL; the mock has its own animals")
    has_simulator = mission.vehicle.is_mock or follow is not None
    if mission.camera.is_simulated and not has_simulator:
        raise file.error(
            ("camera", "url"),
            "is `simulated`, but a vehicle at a URL has no simulator beside it; name its camera, "
            "or let simulated animals follow it with --follow URL",
        )
    for index, target in enumerate(mission.targets):
        if target.prior_au == "simulated" and not has_simulator:
            raise file.error(
                ("targets", index, "prior_au"),
                "is `simulated`, but there is no simulator; give [x, y] or leave it out",
            )


def _create_planner(file: MissionFile) -> Planner:
    """The planner of a mission. Raises MissionFileError naming the line."""
    kind, checkpoint = file.mission.planner.kind, file.mission.planner.checkpoint
    try:
        planner = create_planner(kind, checkpoint=checkpoint)
    except OptionError as exc:
        raise file.error(("planner", "kind"), str(exc)) from exc
    except PolicyError as exc:
        raise file.error(("planner", "checkpoint"), str(exc)) from exc
    if isinstance(planner, Clairvoyant):
        raise file.error(
            ("planner", "kind"),
            f"{kind!r} must be told the future: it is a bound for `dronemon evaluate`, not a "
            "planner to fly",
        )
    return planner


async def _fly(file: MissionFile, planner: Planner, follow: str | None, out: Path | None) -> int:
    mission = file.mission
    loop = asyncio.get_running_loop()
    loop.set_default_executor(ThreadPoolExecutor(_WORKER_THREADS))
    interrupts = Interrupts()
    for signal_number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(signal_number, interrupts.request)
    names = tuple(target.name for target in mission.targets)
    recorder = RunRecorder.create(
        mission_text=_as_flown(mission), mission_name=mission.name, target_names=names, out=out
    )
    console.print(f"run folder: {recorder.folder.path}", soft_wrap=True, markup=False)
    console.print("getting ready (the first time code is compiled, for about 15 s)")
    with recorder:
        try:
            result, truth, priors_au = await _with_everything(
                file, planner, follow, recorder, interrupts
            )
        except BaseException as exc:
            recorder.finish("failed", {"error": str(exc) or repr(exc)})
            raise
        summary = summarise(
            result,
            truth=truth,
            priors_au=priors_au,
            side_m=mission.area.side_m,
            target_names=names,
            kernel=mission_kernel(mission),
        )
        recorder.finish(result.outcome, summary)
    console.print(facts_table(mission.name, facts(result.outcome, summary)))
    if result.error is not None:
        errors.print(f"error: {result.error}", style="bold red", soft_wrap=True, markup=False)
        return result.error.exit_code
    if not result.is_landed:
        errors.print("error: the drone is still armed, and the pilot's", style="bold red")
        return VehicleError.exit_code
    return INTERRUPTED if result.outcome == "interrupted" else 0


async def _with_everything(
    file: MissionFile,
    planner: Planner,
    follow: str | None,
    recorder: RunRecorder,
    interrupts: Interrupts,
) -> tuple[FlightResult, dict[float, FloatArray], FloatArray]:
    """Open simulator, view, link and camera, fly, and close them. -> result, truth, priors."""
    folder, mission = recorder.folder, file.mission
    async with contextlib.AsyncExitStack() as stack:
        sim: Simulator | None = None
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(rehearse(mission, planner, interrupts), name="rehearsal")
                if mission.vehicle.is_mock or follow:
                    sim = await stack.enter_async_context(
                        simulator(
                            folder.path / "mission.yaml",
                            truth=folder.path / "truth.jsonl",
                            log=folder.path / "simulator.log",
                            follow=follow,
                        )
                    )
        except BaseExceptionGroup as group_error:
            # The first failure cancelled the other.
            raise group_error.exceptions[0] from None
        priors_au = _priors(mission, sim)
        view = stack.enter_context(
            FlightView(
                folder.rrd_path,
                title=mission.name,
                targets={target.name: target.appearance for target in mission.targets},
                camera=mission.camera.model,
                side_m=mission.area.side_m,
                live=mission.view.live,
                port=mission.view.port,
            )
        )
        if view.url:
            console.print(f"live view: {view.url}", soft_wrap=True, markup=False)
        display = stack.enter_context(FlightDisplay(console))
        link = await stack.enter_async_context(_link(mission, sim))
        result = await fly(
            file,
            link=link,
            camera=_camera(mission, sim, link),
            planner=planner,
            priors_au=priors_au,
            recorder=recorder,
            view=view,
            interrupts=interrupts,
            audience=display,
        )
        truth = read_truth(sim.truth) if sim else {}
        for time_s, targets_au in truth.items():
            view.truth(time_s, targets_au)
    return result, truth, priors_au


def _priors(mission: Mission, sim: Simulator | None) -> FloatArray:
    """Known positions of the targets. -> (N, 2) au, NaN where unknown."""
    priors_au = np.full((len(mission.targets), 2), np.nan)
    for index, target in enumerate(mission.targets):
        if target.prior_au == "simulated":
            assert sim is not None  # _check_flight
            priors_au[index] = sim.targets_au[index]
        elif target.prior_au is not None:
            priors_au[index] = target.prior_au
    return priors_au


def _link(mission: Mission, sim: Simulator | None) -> MavsdkLink:
    vehicle = mission.vehicle
    url = sim.vehicle_url if sim and sim.vehicle_url else vehicle.url
    return MavsdkLink(
        url,
        connect_timeout_s=vehicle.connect_timeout_s,
        command_timeout_s=vehicle.command_timeout_s,
        link_loss_timeout_s=vehicle.link_loss_timeout_s,
    )


def _camera(mission: Mission, sim: Simulator | None, link: MavsdkLink) -> FrameSource:
    camera = mission.camera
    if camera.is_simulated:
        assert sim is not None  # _check_flight
        return SimulatedCamera(sim.camera_url, timeout_s=camera.timeout_s)
    source = int(camera.url) if camera.url.isdigit() else camera.url
    return VideoCamera(source, timeout_s=camera.timeout_s, latency_s=camera.latency_s, clock=link)


def _as_flown(mission: Mission) -> str:
    """The mission with every default and override, as a file that can be flown again."""
    return yaml.safe_dump(
        mission.model_dump(mode="json", exclude_none=True), sort_keys=False, allow_unicode=True
    )


@app.command()
def check(mission: MissionOption = "animals", follow: FollowOption = None) -> None:
    """Validate a mission and print what would be flown, without flying."""
    file = load_mission(find_mission(mission))
    _check_flight(file, follow)
    _create_planner(file)
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
