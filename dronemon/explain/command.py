"""`dronemon explain`: its options and their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from dronemon.errors import writing
from dronemon.explain.figure import caption, draw
from dronemon.explain.replay import replay
from dronemon.recorder import RunFolder
from dronemon.terminal import console

RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder of planner `stamp`.")]
OutOption = Annotated[
    Path, typer.Option(help="Folder for decision-K.png and decision-K.npz.", show_default=False)
]
DecisionOption = Annotated[
    int | None,
    typer.Option(
        help="Which: its line in decisions.jsonl, counted from 1.", show_default="the last"
    ),
]


def explain_command(run: RunArgument, out: OutOption, decision: DecisionOption = None) -> None:
    """Show why a decision was made: whom, when and where the network looked at.

    The flight is decided again from its record, up to there. The NPZ holds the weights of every
    head of every attention, by the names of `dronemon.policy.Explanation`, and what was known.
    """
    replayed = replay(RunFolder.open(run), decision)
    picture = out / f"decision-{replayed.number}.png"
    with writing("--out", picture):
        draw(replayed, picture)
        np.savez(picture.with_suffix(".npz"), **replayed.arrays())
    console.print(caption(replayed), markup=False, highlight=False)
    console.print(
        f"{picture} and .npz; logits as recorded to {replayed.logit_error:.0e}",
        soft_wrap=True,
        markup=False,
    )
