"""Trains the network: `python -m sim.eyes --minutes 60 --out models/eyes.onnx`."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import torch
from torch.utils.data import DataLoader

from dronemon.durable import replace_text
from dronemon.types import APPEARANCES
from dronemon.version import code_version
from sim.eyes.network import Eyes, export, loss_of
from sim.eyes.pictures import CAMERA, FIRST_SEED, HIGHEST_M, LOWEST_M, Labelled, Pictures

BATCH = 4
LEARNING_RATE = 3e-3
WEIGHT_DECAY = 1e-4
MAX_GRADIENT = 10.0
WARMUP_SHARE = 0.03
"""Of the time, in which the learning rate rises; then it falls along a cosine."""
_LINES = 30


def train(eyes: Eyes, minutes: float, workers: int) -> list[tuple[float, int, float]]:
    """Learn for a time. -> rows of minutes, pictures and mean loss since the row before"""
    loader: DataLoader[Labelled] = DataLoader(
        Pictures(), batch_size=BATCH, num_workers=workers, prefetch_factor=8
    )
    optimiser = torch.optim.AdamW(eyes.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    eyes.train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    began_s, losses, pictures = time.monotonic(), list[float](), 0
    rows: list[tuple[float, int, float]] = []
    for batch in loader:
        done = (time.monotonic() - began_s) / (60.0 * minutes)
        if done >= 1.0:
            break
        share = done / WARMUP_SHARE if done < WARMUP_SHARE else 0.5 + 0.5 * math.cos(math.pi * done)
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * max(share, 1e-3)
        shown = batch[0].to(memory_format=torch.channels_last)
        loss = loss_of(eyes(shown), *batch[1:])
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(eyes.parameters(), MAX_GRADIENT)
        optimiser.step()
        pictures += BATCH
        losses.append(loss.item())
        if done * _LINES >= len(rows) + 1:
            rows.append((minutes * done, pictures, sum(losses) / len(losses)))
            _say("{:6.1f} min {:7d} pictures, loss {:.3f}".format(*rows[-1]))
            losses = []
    return rows


def card(path: Path, command: str, rows: Sequence[tuple[float, int, float]]) -> str:
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
- Commit: {code_version()}, {datetime.now(UTC):%Y-%m-%d}
- Seeds: worlds from {FIRST_SEED}
- Settings: batch {BATCH}, AdamW, learning rate {LEARNING_RATE:g} along a cosine, weight decay
  {WEIGHT_DECAY:g}

| minutes | pictures | loss |
| --- | --- | --- |
{curve}
"""


def main() -> None:
    """Read the command line, train, write the file and its card."""
    parser = argparse.ArgumentParser(prog="python -m sim.eyes", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="default: 60")
    parser.add_argument("--out", type=Path, default=Path("models/eyes.onnx"))
    parser.add_argument("--seed", type=int, default=0, help="of the first weights")
    parser.add_argument("--workers", type=int, default=1, help="processes that draw; default: 1")
    options = parser.parse_args()
    if not (options.minutes > 0.0 and options.workers >= 0):
        parser.error("--minutes is above 0, --workers 0 or more")
    torch.manual_seed(options.seed)
    eyes = Eyes()
    rows = train(eyes, options.minutes, options.workers)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    export(eyes, options.out, CAMERA.width_px, CAMERA.height_px)
    command = f"python -m sim.eyes --minutes {options.minutes:g} --out {options.out}"
    replace_text(options.out.with_suffix(".md"), card(options.out, command, rows))
    _say(f"{options.out}: {options.out.stat().st_size / 2**20:.2f} MiB")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
