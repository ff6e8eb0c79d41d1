"""`dronemon train`: options, progress on the terminal, and where the result lies."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from dronemon.policy import NetworkConfig
from dronemon.training.imitation import ExpertConfig
from dronemon.training.ppo import PpoConfig
from dronemon.training.train import METRICS, Plan, train

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # of mallopt
_SHOWN = ("unc", "imitation_loss", "regret", "agreement", "kl", "val_unc", "decisions_per_s")


class RecipeName(StrEnum):
    """Ways to train."""

    PAPER = "paper"
    EXPERT = "expert"


class TemporalName(StrEnum):
    """Ways to read history."""

    ATTENTION = "attention"
    LSTM = "lstm"


def train_command(
    recipe: Annotated[
        RecipeName,
        typer.Option(help="paper: PPO from scratch. expert: imitate the search planner."),
    ] = RecipeName.EXPERT,
    out: Annotated[Path, typer.Option(help="Folder of the run; a run found there goes on.")] = Path(
        "runs/train"
    ),
    minutes: Annotated[
        float, typer.Option(min=0.1, help="Time budget, over all resumptions.")
    ] = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Root of all randomness.")] = 0,
    start: Annotated[
        str | None, typer.Option(help="Checkpoint (path or name) whose weights to begin with.")
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    width: Annotated[int, typer.Option(help="d, width of the network.")] = 128,
    feed_forward: Annotated[
        int | None, typer.Option(help="Width of the feed-forward parts; 4 d if absent.")
    ] = None,
    temporal: Annotated[
        TemporalName, typer.Option(help="How history is read; lstm is the ablation.")
    ] = TemporalName.ATTENTION,
    predictions: Annotated[
        bool, typer.Option("--predictions/--no-predictions", help="Show beliefs a little later.")
    ] = True,
    newest: Annotated[
        bool, typer.Option("--newest/--no-newest", help="Ours: show the newest belief by itself.")
    ] = False,
    ways: Annotated[
        bool,
        typer.Option(
            "--ways/--no-ways", help="Ours: tell nodes how far apart they are, and by which way."
        ),
    ] = False,
    geometry: Annotated[
        bool,
        typer.Option(
            "--geometry/--no-geometry",
            help="Ours: tell the decoder where neighbours lie and where the agent comes from.",
        ),
    ] = False,
    tracks: Annotated[
        bool,
        typer.Option("--tracks/--no-tracks", help="Ours: show each target's last sightings."),
    ] = False,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes per iteration, over all processes.")
    ] = None,
    decisions: Annotated[int, typer.Option(min=2, help="Decisions per episode.")] = 256,
    imitation_share: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="expert: share of the time, PPO takes the rest."),
    ] = 1.0,
    validation_minutes: Annotated[
        float, typer.Option(min=0.0, help="How often to fly the development seeds.")
    ] = 14.0,
    validation_episodes: Annotated[
        int, typer.Option(min=1, help="How many of them, by the average of the weights.")
    ] = 32,
) -> None:
    """Train a policy. Kill it whenever you like: the same command goes on where it was.

    Several GPUs: torchrun --nproc-per-node 4 -m dronemon.training --recipe paper ...
    """
    paper, expert = PpoConfig(decisions=decisions), ExpertConfig(decisions=decisions)
    if episodes is not None:
        paper = replace(paper, episodes_per_iteration=episodes)
        expert = replace(expert, round_episodes=episodes)
    expert = replace(
        expert,
        imitation_share=imitation_share,
        finish=replace(expert.finish, decisions=decisions),
    )
    plan = Plan(
        out=out,
        recipe=recipe.value,
        network=NetworkConfig(
            width=width,
            feed_forward=feed_forward if feed_forward is not None else 4 * width,
            temporal=temporal.value,
            predictions=predictions,
            newest=newest,
            ways=ways,
            geometry=geometry,
            tracks=tracks,
        ),
        paper=paper,
        expert=expert,
        start=start,
        minutes=minutes,
        seed=seed,
        device=device,
        validation_minutes=validation_minutes,
        validation_episodes=validation_episodes,
    )
    _keep_freed_memory()
    if "WORLD_SIZE" in os.environ:
        torch.set_num_threads(max(1, (os.cpu_count() or 1) // int(os.environ["WORLD_SIZE"])))
    command = _command()
    console = Console(quiet=os.environ.get("RANK", "0") != "0")
    with _Display(console) as display:
        best = train(plan, command=command, listen=display)
    if best.exists():
        console.print(f"best weights: {best}, their card: {best.with_suffix('.md')}")


def _command() -> str:
    """The command line that runs this, for the card."""
    program = Path(sys.argv[0]).name
    if program == "__main__.py":
        size = int(os.environ.get("WORLD_SIZE", "1"))
        launcher = f"torchrun --standalone --nproc-per-node {size}" if size > 1 else "python"
        program = f"{launcher} -m dronemon.training"
    return " ".join([program, *sys.argv[1:]])


def _keep_freed_memory() -> None:
    """Have glibc keep what is freed; fetching each large tensor anew would cost a third more."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_MMAP_MAX, 0)
        libc.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)


class _Display:
    """A progress bar over the time budget, and a line for each iteration."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("training"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._progress.add_task("training", total=1.0)

    def __enter__(self) -> _Display:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def __call__(self, progress: float, metrics: Mapping[str, float]) -> None:
        """Show an iteration."""
        assert metrics.keys() <= METRICS.keys(), metrics.keys() - METRICS.keys()
        shown = [f"{name} {metrics[name]:.4g}" for name in _SHOWN if name in metrics]
        self._progress.update(self._task, completed=min(1.0, progress))
        self._console.print(
            f"{metrics['minutes']:6.1f} min  iteration {metrics['iteration']:.0f}  "
            + "  ".join(shown),
            highlight=False,
            soft_wrap=True,
        )
