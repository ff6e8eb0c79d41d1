"""The command line: parse, call, map errors to exit codes.

0 done   1 internal error   2 bad input   3 vehicle   4 camera   5 belief or planner
6 run folder   7 view   130 interrupted (and landed)
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import dronemon
from dronemon.errors import DronemonError, OptionError, VehicleError
from dronemon.flight_options import (
    DEFAULT_MISSION,
    AsJson,
    CotUrl,
    FollowUrl,
    HistoryLength,
    HorizonAu,
    LiveView,
    Markers,
    MissionArgument,
    NamedMission,
    PlannerKind,
    Redact,
    Resume,
    RunArgument,
    RunFolder,
    Seed,
    Settings,
    SpeedUp,
    StationUrl,
    StayOpen,
    Unasked,
    VehicleUrl,
    confirmed_settings,
)
from dronemon.terminal import (
    console,
    facts_table,
    forgive_outputs,
    print_error,
    print_facts,
    print_warning,
)

if TYPE_CHECKING:
    from dronemon.mission import MissionFile
    from dronemon.preflight import Finding
    from dronemon.runner.flight import FlightResult

# Nearly all is slow to import, and so imported by the command that needs it.

INTERRUPTED = 130
_VERDICT_STYLES = {"go": "green", "warning": "yellow", "no-go": "bold red"}

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="One drone keeps watch over several moving targets.",
)

_REST = {"allow_extra_args": True, "ignore_unknown_options": True}
"""Settings of a command whose options are read where it is defined."""

_OVERRIDES = {
    "vehicle": ("vehicle", "url"),
    "speed_up": ("vehicle", "speed_up"),
    "horizon_au": ("flight", "horizon_au"),
    "planner": ("planner", "kind"),
    "history": ("planner", "history"),
    "seed": ("simulation", "seed"),
    "view": ("view", "live"),
}
"""Parameters of `fly`, `check` and `preflight` -> the key of a mission that each stands for."""
_UNCHANGED = {
    "file": "the mission",
    "mission": "--mission",
    "planner": "--planner",
    "history": "--history",
    "horizon_au": "--horizon-au",
    "seed": "--seed",
    "out": "--out",
}
"""Parameters of `fly` that a flight which goes on does not take."""


def main() -> None:
    """Run the command line; a DronemonError becomes its message and its exit code."""
    forgive_outputs()
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
    context: typer.Context,
    file: MissionArgument = None,
    mission: NamedMission = None,
    vehicle: VehicleUrl = None,
    follow: FollowUrl = None,
    planner: PlannerKind = None,
    history: HistoryLength = None,
    horizon_au: HorizonAu = None,
    speed_up: SpeedUp = None,
    seed: Seed = None,
    view: LiveView = None,
    out: RunFolder = None,
    resume: Resume = None,
    settings: Settings = None,
    yes: Unasked = False,
    cot: CotUrl = None,
    station: StationUrl = None,
    markers: Markers = False,
    redact: Redact = None,
    stay: StayOpen = False,
) -> None:
    """Fly a mission: take off, patrol, come home, land. Ctrl-C returns; twice lands now."""
    checked = _resumed(context) if resume else _checked(context)
    confirmed = confirmed_settings(settings or (), yes)
    import asyncio

    from dronemon.assembly import Request, assemble_and_fly
    from dronemon.runner.summary import facts, figures

    if markers and station is None:
        raise OptionError("--markers: name the ground station, --station udp://HOST:PORT")
    request = Request(
        follow=follow,
        settings=confirmed,
        out=out,
        resume=resume,
        cot=cot,
        station=station,
        has_markers=markers,
        redact_m=redact,
    )
    result, summary, folder = asyncio.run(assemble_and_fly(checked, request))
    console.print(facts_table(checked.mission.name, facts(summary)))
    if told := figures(summary.as_json()):
        console.print(facts_table("for researchers", told))
    (console.print if result.is_landed else print_error)(result.last_word)
    code = _exit_code(result)
    if stay:
        from dronemon.viewing import show

        try:
            show(folder, checked.mission.view.port)
        except DronemonError as exc:
            print_error(str(exc))
            code = code or exc.exit_code
    raise typer.Exit(code)


def _exit_code(result: FlightResult) -> int:
    """What the shell is told of a flight."""
    if result.error is not None:  # told when it happened
        return result.error.exit_code
    if not result.is_landed:
        return VehicleError.exit_code
    return INTERRUPTED if result.outcome == "interrupted" else 0


@app.command("preflight")
def preflight_command(
    context: typer.Context,
    file: MissionArgument = None,
    mission: NamedMission = None,
    vehicle: VehicleUrl = None,
    follow: FollowUrl = None,
    planner: PlannerKind = None,
    history: HistoryLength = None,
    horizon_au: HorizonAu = None,
    speed_up: SpeedUp = None,
    seed: Seed = None,
    view: LiveView = None,
    out: RunFolder = None,
    settings: Settings = None,
    yes: Unasked = False,
) -> None:
    """Ask the vehicle all that is asked before a take-off, and say go or no-go."""
    checked = _checked(context)
    confirmed = confirmed_settings(settings or (), yes)
    import asyncio

    from dronemon.assembly import Request, assemble_and_inspect
    from dronemon.preflight import Verdict, against
    from dronemon.runner.inspection import refusal

    request = Request(follow=follow, settings=confirmed, out=out)
    findings = asyncio.run(assemble_and_inspect(checked, request, _tell_findings))
    if error := refusal(findings):
        raise error
    warnings = len(against(findings, Verdict.WARNING))
    told = {0: "", 1: ", with 1 warning"}.get(warnings, f", with {warnings} warnings")
    console.print(f"GO{told}")


def _tell_findings(findings: Iterable[Finding]) -> None:
    """Show what was found before a take-off, a line each, with the option that mends it."""
    from rich.text import Text

    from dronemon.preflight import mending_options

    for finding in findings:
        verdict = finding.judgement.verdict
        mend = mending_options([finding])
        text = f"{finding}; mended by {mend}" if mend else str(finding)
        line = Text.assemble((f"{verdict:<9}", _VERDICT_STYLES[verdict]), text)
        console.print(line, soft_wrap=not console.is_terminal)


@app.command()
def check(
    context: typer.Context,
    file: MissionArgument = None,
    mission: NamedMission = None,
    vehicle: VehicleUrl = None,
    follow: FollowUrl = None,
    planner: PlannerKind = None,
    history: HistoryLength = None,
    horizon_au: HorizonAu = None,
    speed_up: SpeedUp = None,
    seed: Seed = None,
    view: LiveView = None,
    as_json: AsJson = False,
) -> None:
    """Validate a mission and print what would be flown, without flying."""
    from dronemon.feasibility import flight_facts

    checked = _checked(context)
    print_facts(f"{checked.path}: can be flown", flight_facts(checked.mission), as_json)


@app.command("status")
def status_command(run: RunArgument, as_json: AsJson = False) -> None:
    """Tell how far a flight is, from any terminal."""
    from dronemon.recorder import RunFolder
    from dronemon.runner.status import status

    folder = RunFolder.open(run)
    mission = folder.mission()
    print_facts(f"{run}: {mission.name}", status(folder, mission), as_json)


@app.command("resume")
def resume_command(run: RunArgument) -> None:
    """Say that all are clear of a drone that waits with a fresh battery: it takes off."""
    from dronemon.recorder import RunFolder
    from dronemon.runner.status import ask_to_go_on

    ask_to_go_on(RunFolder.open(run))
    console.print("it goes on")


def _resumed(context: typer.Context) -> MissionFile:
    """The mission of a run that goes on: as it was flown, but for how the vehicle is reached."""
    from dronemon.recorder import MISSION_FILE

    given = context.params
    for name, shown in _UNCHANGED.items():
        if given[name] is not None:
            raise OptionError(f"--resume goes on as the run began: leave {shown} away")
    if not (given["resume"] / MISSION_FILE).is_file():
        raise OptionError(f"--resume {given['resume']}: no run folder: it has no {MISSION_FILE}")
    return _checked(context, str(given["resume"] / MISSION_FILE))


def _checked(context: typer.Context, mission: str | None = None) -> MissionFile:
    """The mission that a command was given, with its options; doubts are told on stderr."""
    from dronemon.feasibility import doubts, load_checked

    given = context.params
    names = [given[key] for key in ("file", "mission") if given[key] is not None]
    if len(names) > 1:
        raise OptionError(f"the mission is given twice: {names[0]} and --mission; leave one")
    names += [mission] if mission else []
    overrides = {
        key: (f"--{name.replace('_', '-')}", given[name])
        for name, key in _OVERRIDES.items()
        if given[name] is not None
    }
    checked = load_checked((*names, DEFAULT_MISSION)[0], overrides, given["follow"])
    for doubt in doubts(checked.mission, given["follow"]):
        print_warning(f"planner {checked.mission.planner.kind}: {doubt}")
    return checked


@app.command()
def init(
    file: Annotated[Path, typer.Argument(help="Where to write it; never over a file.")] = Path(
        "mission.yaml"
    ),
) -> None:
    """Write a mission to start from, with every key, its default and what it means."""
    from dronemon.mission.template import mission_template

    try:
        with file.open("x", encoding="utf-8") as target:
            target.write(mission_template())
    except OSError as exc:
        raise OptionError(f"{file}: cannot be made: {exc.strerror}; name another file") from exc
    console.print(f"{file}: change it, then: dronemon check {file}", soft_wrap=True, markup=False)


@app.command()
def missions() -> None:
    """List the shipped missions."""
    from dronemon.mission import shipped_missions

    for name, path in shipped_missions().items():
        console.print(f"{name}: {path}", soft_wrap=True, markup=False)


@app.command()
def planners() -> None:
    """List what may choose the waypoints, and what each is."""
    from dronemon.planner.registry import describe_planners

    for name, about in describe_planners().items():
        console.print(f"{name}: {about}", soft_wrap=True, markup=False)


@app.command()
def schema() -> None:
    """Print the JSON schema of mission files, for editors."""
    from dronemon.mission import Mission
    from dronemon.outside import CLASS_PATTERN
    from dronemon.planner.registry import describe_planners, is_bound

    document = Mission.model_json_schema()
    names = [name for name in describe_planners() if not is_bound(name)]
    kind = document["$defs"]["Planner"]["properties"]["kind"]
    kind["anyOf"] = [{"enum": names}, {"pattern": CLASS_PATTERN}]
    sys.stdout.write(json.dumps(document, indent=2) + "\n")


_ELSEWHERE = {
    "view": (
        "dronemon.viewing",
        "Look at a flight's recording: in a window, or without a display on a page here.",
    ),
    "detect": (
        "dronemon.detecting",
        "Try a mission's detector on pictures, a video or a stream, before it is flown.",
    ),
    "rewatch": (
        "dronemon.rewatching",
        "See and believe what a flight would have, from pictures of an earlier one.",
    ),
    "export": (
        "dronemon.export.command",
        "Write a flight's sightings and track for maps: GeoJSON, CSV, KMZ, GPX, Cursor-on-Target.",
    ),
    "report": (
        "dronemon.report.command",
        "Make a page of a flight for people: one HTML file without a network, and a map.",
    ),
    "picture": (
        "dronemon.report.picture",
        "Draw a flight at one moment, as the paper's Figures 1 and 6: beliefs, way, truth, camera.",
    ),
    "compare": ("dronemon.report.compare", "Show several flights side by side."),
    "explain": (
        "dronemon.explain.command",
        "Show why a decision of a flight was made: whom, when and where the network looked at.",
    ),
    "video": (
        "dronemon.explain.video",
        "Film whom and where the network looks at, decision by decision.",
    ),
    "replay": (
        "dronemon.explain.otherwise",
        "Ask another planner at each decision of a flight, on the same sightings.",
    ),
    "calibrate intrinsics": (
        "dronemon.calibrating.intrinsics",
        "Measure a camera's lens from pictures of a chessboard, for camera.calibration.",
    ),
    "calibrate latency": (
        "dronemon.calibrating.latency",
        "Measure how old pictures are when they arrive, for camera.latency_s.",
    ),
    "calibrate detector": (
        "dronemon.calibrating.detector",
        "Measure how a detector errs on pictures that you have labelled, for sensor.",
    ),
    "evaluate": (
        "dronemon.evaluation.command",
        "Measure planners on simulated instances, and compare them with the paper's figures.",
    ),
    "train": (
        "dronemon.training.command",
        "Train a policy. Kill it whenever you like: the same command goes on where it was.",
    ),
}
"""Commands that are defined elsewhere, as WORD_command of a module, and what they are for."""
_GROUPS = {"calibrate": "Measure what a mission has to say of its camera and detector."}


def _add_command(parent: typer.Typer, word: str, module: str, about: str) -> None:
    @parent.command(word, help=about, add_help_option=False, context_settings=_REST)
    def run(context: typer.Context) -> None:
        _hand_on(context, getattr(importlib.import_module(module), f"{word}_command"))


def _hand_on(context: typer.Context, command: Callable[..., None]) -> None:
    """Have a command that is defined elsewhere parse the rest of the line."""
    rest = typer.Typer(
        pretty_exceptions_enable=False,
        add_completion=False,
        context_settings=app.info.context_settings,
    )
    rest.command()(command)
    rest(args=context.args, prog_name=context.command_path)


_parents = {"": app} | {name: typer.Typer(no_args_is_help=True) for name in _GROUPS}
for _name, _about in _GROUPS.items():
    app.add_typer(_parents[_name], name=_name, help=_about)
for _name, (_module, _about) in _ELSEWHERE.items():
    _group, _, _word = _name.rpartition(" ")
    _add_command(_parents[_group], _word, _module, _about)

if __name__ == "__main__":
    main()
