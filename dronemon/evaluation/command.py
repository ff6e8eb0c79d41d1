"""`dronemon evaluate`: its options and their help."""

from __future__ import annotations

import signal
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, TypeVar, cast

import typer

from dronemon.cluster import join_cluster
from dronemon.errors import OptionError
from dronemon.evaluation.evaluate import evaluate
from dronemon.evaluation.options import (
    CONDITIONS,
    FIGURE4,
    FIGURE5,
    PAPER_INSTANCES,
    TABLE1,
    TABLE2,
    TABLE2_PLANNERS,
    Options,
    PlannerSpec,
    Sweep,
)
from dronemon.planner import has_weights
from dronemon.problem import MOTIONS, Prior
from dronemon.sensor import Sensor
from dronemon.terminal import LenientConsole, console
from dronemon.workers import num_cores

T = TypeVar("T")
DEFAULT_INSTANCES = 16
DEFAULT_PLANNERS = "tsp,lawnmower"
CONDITIONS_INSTANCES = 24
CONDITIONS_PLANNERS = "lawnmower,tsp,tsp-heading,search,stamp,clairvoyant-search"
INTERRUPTED = 130
"""Exit code of a run that was told to stop, as a shell's for Ctrl-C."""


OutOption = Annotated[
    Path,
    typer.Option(
        help="Folder for results, tables and figures. A run there goes on; "
        "take another folder after changing code.",
        show_default=False,
    ),
]
PlannersOption = Annotated[
    str | None,
    typer.Option(
        help="Planners, separated by commas: names, name:checkpoint, package.module:Class; "
        "@50 after a learned one has it look back 50 decisions.",
        show_default=f"{DEFAULT_PLANNERS}; what the paper's table or figure compares",
    ),
]
HistoryOption = Annotated[
    str | None,
    typer.Option(
        help="How many decisions learned planners look back, such as 1,25,100; each is a row.",
        show_default="100",
    ),
]
TargetsOption = Annotated[
    str | None, typer.Option(help="Numbers of targets, such as 4,8.", show_default="4")
]
SpeedsOption = Annotated[
    str | None,
    typer.Option(help="Targets' speed over the agent's, such as 1/10,1/7.", show_default="1/10"),
]
PriorsOption = Annotated[
    str | None,
    typer.Option(
        help="Known at the start: full (positions), number (of targets) or none.",
        show_default="full",
    ),
]
MotionsOption = Annotated[
    str | None,
    typer.Option(
        help=f"How targets move: {', '.join(MOTIONS)}, or a .csv or .gpx file of tracks.",
        show_default="tsp",
    ),
]
SensorsOption = Annotated[
    str | None,
    typer.Option(
        help="How the eye errs, such as perfect,miss=0.1,miss=0.1+false_alarms=0.05; also "
        "position_au and confusion.",
        show_default="perfect",
    ),
]
InstancesOption = Annotated[
    int | None,
    typer.Option(
        help="Instances per cell; one seed is one instance.",
        show_default=f"{DEFAULT_INSTANCES}; {PAPER_INSTANCES} for the paper's tables and figures, "
        f"{CONDITIONS_INSTANCES} for --conditions",
    ),
]
FirstSeedOption = Annotated[int, typer.Option(help="Seed of the first instance.")]
Table1Option = Annotated[
    bool, typer.Option("--table1", help="All 16 cells of the paper's Table I.")
]
Table2Option = Annotated[
    bool, typer.Option("--table2", help="The paper's Table II: roadmap sizes and histories.")
]
Figure4Option = Annotated[
    bool, typer.Option("--figure4", help="The paper's Figure 4: uncertainty over time.")
]
Figure5Option = Annotated[
    bool, typer.Option("--figure5", help="The paper's Figure 5: what is known at the start.")
]
ConditionsOption = Annotated[
    bool,
    typer.Option(
        "--conditions", help="Other worlds: every motion, eyes that err, and every prior."
    ),
]
HorizonOption = Annotated[float, typer.Option(help="Distance flown per episode, in au.")]
NodesOption = Annotated[
    str | None, typer.Option(help="Nodes of the roadmap, such as 50,200.", show_default="200")
]
SaveOption = Annotated[
    bool, typer.Option("--save-episodes", help="Keep the arrays of every episode.")
]
WorkersOption = Annotated[int | None, typer.Option(help="Processes.", show_default="one per core")]
RayOption = Annotated[
    str | None,
    typer.Option(
        metavar="local|HOST:PORT",
        help="Have a Ray cluster fly: that at an address, or one started here; needs "
        "dronemon\\[ray].",
        show_default=False,
    ),
]


_PRESETS = {
    "--table1": (TABLE1, DEFAULT_PLANNERS, PAPER_INSTANCES),
    "--table2": (TABLE2, ",".join(TABLE2_PLANNERS), PAPER_INSTANCES),
    "--figure4": (FIGURE4, "stamp,search,tsp,lawnmower", PAPER_INSTANCES),
    "--figure5": (FIGURE5, "search,stamp", PAPER_INSTANCES),
    "--conditions": (CONDITIONS, CONDITIONS_PLANNERS, CONDITIONS_INSTANCES),
}
"""Option -> what it goes through, the planners that it compares, and on how many instances."""


def evaluate_command(
    out: OutOption,
    planner: PlannersOption = None,
    history: HistoryOption = None,
    targets: TargetsOption = None,
    speed: SpeedsOption = None,
    prior: PriorsOption = None,
    nodes: NodesOption = None,
    motion: MotionsOption = None,
    sensor: SensorsOption = None,
    instances: InstancesOption = None,
    first_seed: FirstSeedOption = 0,
    table1: Table1Option = False,
    table2: Table2Option = False,
    figure4: Figure4Option = False,
    figure5: Figure5Option = False,
    conditions: ConditionsOption = False,
    horizon: HorizonOption = 30.0,
    save_episodes: SaveOption = False,
    workers: WorkersOption = None,
    ray: RayOption = None,
) -> None:
    """Measure planners on simulated instances, and compare them with the paper's figures."""
    asked = {
        "--table1": table1,
        "--table2": table2,
        "--figure4": figure4,
        "--figure5": figure5,
        "--conditions": conditions,
    }
    chosen = [option for option, is_asked in asked.items() if is_asked]
    own = targets, speed, prior, nodes, motion, sensor
    if len(chosen) > 1 or (chosen and any(own)):
        raise OptionError(
            f"{chosen[0]} sets --targets, --speed, --prior, --nodes, --motion and --sensor, and "
            f"goes with no other of {', '.join(asked)}; leave them out"
        )
    sweep, planners, usual_instances = (
        _PRESETS[chosen[0]] if chosen else (_sweep(*own), DEFAULT_PLANNERS, DEFAULT_INSTANCES)
    )
    options = Options(
        planners=_planners(planners if planner is None else planner, history),
        out=out,
        sweep=sweep,
        instances=instances if instances is not None else usual_instances,
        first_seed=first_seed,
        horizon_au=horizon,
        save_episodes=save_episodes,
        workers=workers if workers is not None else num_cores(),
    )
    _evaluate(options, nullcontext() if ray is None else _cluster(ray, workers, options))


def _sweep(
    targets: str | None,
    speed: str | None,
    prior: str | None,
    nodes: str | None,
    motion: str | None,
    sensor: str | None,
) -> Sweep:
    """What the options of these names say to go through."""
    usual = Sweep()
    return Sweep(
        targets=_each(targets, "--targets", int) if targets else usual.targets,
        speed_ratios=_each(speed, "--speed", Fraction) if speed else usual.speed_ratios,
        priors=(
            _each(prior, "--prior", lambda text: cast("Prior", text)) if prior else usual.priors
        ),
        nodes=_each(nodes, "--nodes", int) if nodes else usual.nodes,
        motions=_each(motion, "--motion", str) if motion else usual.motions,
        sensors=_each(sensor, "--sensor", Sensor.parse) if sensor else usual.sensors,
    )


def _planners(text: str, history: str | None) -> tuple[PlannerSpec, ...]:
    """The planners named; of a learned one that names no history itself, one with each of these."""
    specs = _each(text, "--planner", PlannerSpec.parse)
    if history is None:
        return specs
    told = [spec for spec in specs if has_weights(spec.kind) and spec.history is None]
    if not told:
        raise OptionError(f"--history {history}: no planner of {text} looks back and has none yet")
    histories = _each(history, "--history", int)
    return tuple(
        replace(spec, history=each)
        for spec in specs
        for each in (histories if spec in told else (spec.history,))
    )


def _cluster(ray: str, workers: int | None, options: Options) -> AbstractContextManager[Executor]:
    """A Ray cluster whose nodes write episodes where this process does, if they are kept."""
    return join_cluster(ray, workers, options.out if options.save_episodes else None)


def _evaluate(options: Options, cluster: AbstractContextManager[Executor | None]) -> None:
    """Run an evaluation, and say where its results lie or how it goes on."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    try:
        with cluster as nodes:
            evaluate(options, console, nodes)
    except KeyboardInterrupt:
        is_begun = (options.out / "results.jsonl").exists()
        kept = f"finished episodes are in {options.out}" if is_begun else "no episode was finished"
        LenientConsole(stderr=True).print(
            f"stopped; {kept}, and the same command goes on from there",
            soft_wrap=True,
            markup=False,
        )
        raise typer.Exit(INTERRUPTED) from None
    table = options.out / "table.md"
    console.print(f"{table}: tables; figures and results beside it", soft_wrap=True, markup=False)


def _each(text: str, option: str, read: Callable[[str], T]) -> tuple[T, ...]:
    """Read values separated by commas. Raises OptionError naming the one that cannot be read."""
    values = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        try:
            values.append(read(part))
        except (ValueError, ZeroDivisionError) as exc:
            raise OptionError(f"{option} {part}: not a number of the kind wanted ({exc})") from exc
    return tuple(values)
