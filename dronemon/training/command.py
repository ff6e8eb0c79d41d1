"""`dronemon train`: options, progress on the terminal, and where the result lies."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from dronemon.cluster import join_cluster
from dronemon.errors import OptionError
from dronemon.terminal import LenientConsole
from dronemon.training.peers import join_peers
from dronemon.training.ppo import PpoConfig
from dronemon.training.recipe import load_recipe
from dronemon.training.train import METRICS, Listener, Plan, train
from dronemon.workers import num_cores

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # of mallopt
_SHOWN = ("unc", "imitation_loss", "regret", "agreement", "kl", "val_unc", "decisions_per_s")


RecipeOption = Annotated[
    str,
    typer.Option(
        help="A recipe file, or a shipped one: paper, anywhere, expert, stamp, table2, "
        "table2-no-predictions, table2-lstm. Several, separated by commas, are trained one after "
        "another, each with this budget, in folders of their names."
    ),
]
OutOption = Annotated[Path, typer.Option(help="Folder of the run; a run found there goes on.")]
MinutesOption = Annotated[
    float | None,
    typer.Option(min=0.1, help="Budget, over all resumptions.", show_default="60"),
]
IterationsOption = Annotated[
    int | None,
    typer.Option(min=1, help="Budget in iterations instead: as large on a busy machine."),
]
SeedOption = Annotated[int, typer.Option(min=0, help="Root of all randomness.")]
StartOption = Annotated[
    str | None, typer.Option(help="Checkpoint (path or name) whose weights to begin with.")
]
DeviceOption = Annotated[str, typer.Option(help="auto, cpu or cuda.")]
WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, help="Processes that give lessons.", show_default="one per core"),
]
RayOption = Annotated[
    str | None,
    typer.Option(
        metavar="local|HOST:PORT",
        help="Have a Ray cluster give the lessons: that at an address, or one started here; needs "
        "dronemon\\[ray], and --out in a folder that all nodes share.",
        show_default=False,
    ),
]
ValidationMinutesOption = Annotated[
    float, typer.Option(min=0.0, help="How often to fly the development seeds.")
]
ValidationEpisodesOption = Annotated[
    int, typer.Option(min=1, help="How many of them, by the average of the weights.")
]


def train_command(
    recipe: RecipeOption = "expert",
    out: OutOption = Path("runs/train"),
    minutes: MinutesOption = None,
    iterations: IterationsOption = None,
    seed: SeedOption = 0,
    start: StartOption = None,
    device: DeviceOption = "auto",
    workers: WorkersOption = None,
    ray: RayOption = None,
    validation_minutes: ValidationMinutesOption = 14.0,
    validation_episodes: ValidationEpisodesOption = 32,
) -> None:
    """Train a policy. Kill it whenever you like: the same command goes on where it was.

    Several GPUs: torchrun --nproc-per-node 4 -m dronemon.training --recipe paper ...
    """
    names = _names(recipe)
    if minutes is not None and iterations is not None:
        raise OptionError("--minutes and --iterations are two budgets; give one of them")
    plans = [
        Plan(
            out=out if len(names) == 1 else out / Path(name).stem,
            recipe=load_recipe(name),
            start=start,
            minutes=minutes if minutes is not None else 60.0,
            iterations=iterations,
            seed=seed,
            num_workers=workers if workers is not None else num_cores(),
            validation_minutes=validation_minutes,
            validation_episodes=validation_episodes,
        )
        for name in names
    ]
    if ray is not None:
        for name, plan in zip(names, plans, strict=True):
            if isinstance(plan.recipe.settings, PpoConfig):
                raise OptionError(f"--ray: {name} is PPO, which has no lessons to share")
    _set_up_process()
    with (
        join_peers(device) as peers,  # once: processes that part do not find each other again
        nullcontext() if ray is None else join_cluster(ray, workers, out) as cluster,
    ):
        console = LenientConsole(quiet=not peers.is_first)
        for plan in plans:
            with _display(console) as display:
                best = train(plan, peers, command=_command(), listen=display, cluster=cluster)
            if best.exists():
                console.print(f"best weights: {best}, their card: {best.with_suffix('.md')}")


def _names(recipes: str) -> list[str]:
    """The recipes named. Raises OptionError where two would share a folder."""
    names = [name.strip() for name in recipes.split(",")]
    if len({Path(name).stem for name in names}) < len(names):
        raise OptionError(f"--recipe {recipes}: two have the same name, and so the same folder")
    return names


def _command() -> str:
    """The command line that runs this, for the card."""
    program = Path(sys.argv[0]).name
    if program == "__main__.py":
        size = int(os.environ.get("WORLD_SIZE", "1"))
        launcher = f"torchrun --standalone --nproc-per-node {size}" if size > 1 else "python"
        program = f"{launcher} -m dronemon.training"
    return " ".join([program, *sys.argv[1:]])


def _set_up_process() -> None:
    """Give this process its share of the cores, and have glibc keep what is freed.

    Fetching each large tensor anew would cost a third more.
    """
    if "WORLD_SIZE" in os.environ:
        torch.set_num_threads(max(1, (os.cpu_count() or 1) // int(os.environ["WORLD_SIZE"])))
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_MMAP_MAX, 0)
        libc.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)


@contextmanager
def _display(console: LenientConsole) -> Iterator[Listener]:
    """A progress bar over the budget, and a line for each iteration."""
    percent = TextColumn("{task.percentage:3.0f} %")
    columns = TextColumn("training"), BarColumn(), percent, TimeRemainingColumn()
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=1.0)

        def show(progress: float, metrics: Mapping[str, float]) -> None:
            assert metrics.keys() <= METRICS.keys(), metrics.keys() - METRICS.keys()
            shown = [f"{name} {metrics[name]:.4g}" for name in _SHOWN if name in metrics]
            iteration = f"{metrics['minutes']:6.1f} min  iteration {metrics['iteration']:.0f}"
            bar.update(task, completed=min(1.0, progress))
            console.print("  ".join([iteration, *shown]), highlight=False, soft_wrap=True)

        yield show
