"""Trains the network: `python -m sim.detector --minutes 60 --out detector.onnx`."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

import torch
from torch.utils.data import DataLoader

from dronemon.durable import replace_text
from dronemon.types import APPEARANCES
from dronemon.version import find_commit
from sim.detector.network import DetectorNetwork, export, loss_of
from sim.detector.pictures import CAMERA, FIRST_SEED, HIGHEST_M, LOWEST_M, Labelled, Pictures

BATCH = 4
LEARNING_RATE = 3e-3
WEIGHT_DECAY = 1e-4
MAX_GRADIENT = 10.0
WARMUP_SHARE, LEAST_SHARE = 0.03, 1e-3
"""Of the time, in which the learning rate rises, and of that rate, which is kept to the end."""
_LINES = 30


Row = tuple[float, int, float]
"""Minutes, pictures, and mean loss since the row before."""


def train(network: DetectorNetwork, minutes: float, workers: int) -> list[Row]:
    """Learn for a time. workers: processes that draw pictures, or 0 for this one"""
    ahead = 8 if workers else None
    loader: DataLoader[Labelled] = DataLoader(
        Pictures(), batch_size=BATCH, num_workers=workers, prefetch_factor=ahead
    )
    optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    network.train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    began_s, losses, rows, pictures = time.monotonic(), list[float](), list[Row](), 0
    for batch in loader:
        done = min((time.monotonic() - began_s) / (60.0 * minutes), 1.0)
        share = min(done / WARMUP_SHARE, 0.5 + 0.5 * math.cos(math.pi * done))
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * max(share, LEAST_SHARE)
        shown = batch[0].to(memory_format=torch.channels_last)
        loss = loss_of(network(shown), *batch[1:])
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT)
        optimiser.step()
        pictures += BATCH
        losses.append(loss.item())
        if done * _LINES >= len(rows) + 1:
            rows.append((minutes * done, pictures, sum(losses) / len(losses)))
            _say("{:6.1f} min {:7d} pictures, loss {:.3f}".format(*rows[-1]))
            losses = []
        if done >= 1.0:
            break
    return rows


def card(path: Path, command: str, commit: str | None, rows: Sequence[Row]) -> str:
    """What the network is, as a page to lie beside its file."""
    curve = "\n".join("| {:.1f} | {} | {:.3f} |".format(*row) for row in rows)
    return f"""# {path.stem}

A network for `detector: onnx`: the simulator's animals, people and vehicles, and nothing real.

- Classes: {", ".join(APPEARANCES)}
- Input: {CAMERA.width_px} x {CAMERA.height_px} pixels, RGB from 0 to 1; output as of YOLOv8
- Trained on: pictures that the simulator drew from {LOWEST_M:g} to {HIGHEST_M:g} m with the
  default camera, people up to 35 m and animals up to 58 m; two thirds each with less light, clouds,
  an open shutter, and JPEG
- Command: `{command}`
- Commit: {commit or "unknown"}, {datetime.now(UTC):%Y-%m-%d}
- Seeds: worlds from {FIRST_SEED}
- Settings: batch {BATCH}, AdamW, learning rate {LEARNING_RATE:g} along a cosine, weight decay
  {WEIGHT_DECAY:g}

| minutes | pictures | loss |
| --- | --- | --- |
{curve}
"""


def main() -> None:
    """Read the command line, train, write the file and its card."""
    parser = argparse.ArgumentParser(prog="python -m sim.detector", description=__doc__)
    parser.add_argument("--minutes", type=_minutes, default=60.0, help="default: 60")
    parser.add_argument("--out", type=Path, required=True, help="the ONNX file; a card lies beside")
    parser.add_argument("--seed", type=_count, default=0, help="of the first weights; default: 0")
    parser.add_argument("--workers", type=_count, default=1, help="processes that draw; default: 1")
    options = parser.parse_args()
    out, commit = options.out, find_commit(Path(__file__).parents[1])
    if problem := _problem_of(out):  # rather told now than in an hour
        parser.error(problem)
    torch.manual_seed(options.seed)
    network = DetectorNetwork()
    try:
        rows = train(network, options.minutes, options.workers)
    except KeyboardInterrupt:
        parser.exit(130, "stopped; nothing was written\n")
    export(network, out, CAMERA.width_px, CAMERA.height_px)
    command = (
        f"python -m sim.detector --minutes {options.minutes:g} --seed {options.seed} "
        f"--workers {options.workers} --out {out}"
    )
    replace_text(out.with_suffix(".md"), card(out, command, commit, rows))
    _say(f"{out}: {out.stat().st_size / 2**20:.2f} MiB")


def _problem_of(out: Path) -> str | None:
    """What is against writing a network there; makes the folder."""
    if out.suffix != ".onnx" or out.is_dir():
        return f"--out {out}: is no name of a file that ends in .onnx"
    if find_spec("onnx") is None:
        return "the package onnx is missing: pip install onnx"
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        return f"--out {out}: {exc.strerror}"
    is_open = os.access(out.parent, os.W_OK)
    return None if is_open else f"--out {out}: its folder cannot be written to"


def _minutes(text: str) -> float:
    minutes = float(text)
    if not 0.0 < minutes < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is no time to train for")
    return minutes


def _count(text: str) -> int:
    count = int(text)
    if not 0 <= count < 2**32:
        raise argparse.ArgumentTypeError(f"{text} is not 0 or more")
    return count


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
