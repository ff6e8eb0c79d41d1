"""`dronemon evaluate`: its options and their help."""

from __future__ import annotations

import signal
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Annotated, TypeVar, cast

import typer

from dronemon.errors import OptionError
from dronemon.evaluation.evaluate import evaluate
from dronemon.evaluation.options import (
    TABLE1_INSTANCES,
    TABLE1_SPEED_RATIOS,
    TABLE1_TARGETS,
    Options,
    PlannerSpec,
)
from dronemon.problem import Prior
from dronemon.terminal import LenientConsole, console
from dronemon.workers import num_cores

T = TypeVar("T")
DEFAULT_INSTANCES = 16
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
    str,
    typer.Option(
        help="Planners, separated by commas: names, name:checkpoint, package.module:Class."
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
InstancesOption = Annotated[
    int | None,
    typer.Option(
        help="Instances per cell; one seed is one instance.", show_default="16; 100 with --table1"
    ),
]
FirstSeedOption = Annotated[int, typer.Option(help="Seed of the first instance.")]
Table1Option = Annotated[
    bool, typer.Option("--table1", help="All 16 cells of the paper's Table I.")
]
HorizonOption = Annotated[float, typer.Option(help="Distance flown per episode, in au.")]
NodesOption = Annotated[int, typer.Option(help="Nodes of the roadmap.")]
SaveOption = Annotated[
    bool, typer.Option("--save-episodes", help="Keep the arrays of every episode.")
]
WorkersOption = Annotated[int | None, typer.Option(help="Processes.", show_default="one per core")]


def evaluate_command(
    out: OutOption,
    planner: PlannersOption = "tsp,lawnmower",
    targets: TargetsOption = None,
    speed: SpeedsOption = None,
    prior: PriorsOption = None,
    instances: InstancesOption = None,
    first_seed: FirstSeedOption = 0,
    table1: Table1Option = False,
    horizon: HorizonOption = 30.0,
    nodes: NodesOption = 200,
    save_episodes: SaveOption = False,
    workers: WorkersOption = None,
) -> None:
    """Measure planners on simulated instances, and compare them with the paper's figures."""
    if table1 and (targets, speed, prior) != (None, None, None):
        raise OptionError("--table1 sets --targets, --speed and --prior; leave them out")
    default_instances = TABLE1_INSTANCES if table1 else DEFAULT_INSTANCES
    options = Options(
        planners=_each(planner, "--planner", PlannerSpec.parse),
        out=out,
        targets=TABLE1_TARGETS if table1 else _each(targets or "4", "--targets", int),
        speed_ratios=(
            TABLE1_SPEED_RATIOS if table1 else _each(speed or "1/10", "--speed", Fraction)
        ),
        priors=_each(prior or "full", "--prior", lambda text: cast("Prior", text)),
        instances=instances if instances is not None else default_instances,
        first_seed=first_seed,
        horizon_au=horizon,
        num_nodes=nodes,
        save_episodes=save_episodes,
        workers=workers if workers is not None else num_cores(),
    )
    _evaluate(options)


def _evaluate(options: Options) -> None:
    """Run an evaluation, and say where its results lie or how it goes on."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    try:
        evaluate(options, console)
    except KeyboardInterrupt:
        LenientConsole(stderr=True).print(
            f"stopped; finished episodes are in {options.out}, and the same command goes on from"
            " there",
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
