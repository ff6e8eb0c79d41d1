"""`dronemon video`: whom and where the network looks at, decision by decision, as a film."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from matplotlib.figure import Figure
from PIL import Image
from rich.progress import track

from dronemon.errors import OptionError, writing
from dronemon.explain.command import RunArgument
from dronemon.explain.figure import draw_maps
from dronemon.explain.replay import Replay, replay_all
from dronemon.recorder import RunFolder
from dronemon.terminal import console, print_path
from dronemon.types import ImageArray

ToOption = Annotated[Path, typer.Option("--to", help="The film: .mp4 or .gif.", show_default=False)]
RateOption = Annotated[float, typer.Option(min=0.5, max=60.0, help="Decisions a second.")]
_SIZE_IN, _DPI = (13.0, 7.0), 80


def video_command(run: RunArgument, to: ToOption, rate: RateOption = 6.0) -> None:
    """Film whom and where the network looks at, decision by decision."""
    if to.suffix not in {".mp4", ".gif"}:
        raise OptionError(f"--to {to}: give a file that ends with .mp4 or .gif")
    if to.exists():
        raise OptionError(f"--to {to}: is there already; choose another name")
    count, replays = replay_all(RunFolder.open(run))
    frames = (_frame(replay) for replay in track(replays, "drawing", total=count, console=console))
    part = to.with_name(f".part-{to.name}")
    with writing("--to", to):
        try:
            (_write_gif if to.suffix == ".gif" else _write_mp4)(frames, part, rate)
            if to.suffix == ".mp4" and _num_frames(part) != count:  # OpenCV tells of no full disk
                raise OSError("not all of it could be written; is the disk full?")
            part.replace(to)
        finally:
            part.unlink(missing_ok=True)
    print_path(to)


def _frame(replay: Replay) -> ImageArray:
    """(H, W, 3) uint8 RGB, of an even size, as films want it."""
    figure = Figure(figsize=_SIZE_IN, layout="constrained")
    draw_maps(figure, replay)
    figure.suptitle(f"Decision {replay.number}, at {replay.time_au:.1f} au")
    file = io.BytesIO()
    figure.savefig(file, format="raw", dpi=_DPI)
    width, height = (round(side * _DPI) for side in _SIZE_IN)
    rgba = np.frombuffer(file.getvalue(), np.uint8).reshape(height, width, 4)
    return np.ascontiguousarray(rgba[..., :3])


def _write_mp4(frames: Iterator[ImageArray], path: Path, rate: float) -> None:
    first = next(frames)
    height, width, _ = first.shape
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not film.isOpened():
        raise OSError("OpenCV cannot make that film")
    try:
        film.write(first[..., ::-1])
        for frame in frames:
            film.write(frame[..., ::-1])
    finally:
        film.release()


def _num_frames(path: Path) -> int:
    film = cv2.VideoCapture(str(path))
    count = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    film.release()
    return count


def _write_gif(frames: Iterator[ImageArray], path: Path, rate: float) -> None:
    first, *rest = (Image.fromarray(frame) for frame in frames)
    first.save(path, save_all=True, append_images=rest, duration=round(1e3 / rate), loop=0)
