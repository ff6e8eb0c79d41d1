"""`dronemon detect`: what a mission's detector finds in pictures, before it is flown."""

from __future__ import annotations

import csv
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import Annotated, TextIO

import numpy as np
import typer

from dronemon.camera import check_size
from dronemon.camera.pictures import pictures_of
from dronemon.errors import CameraError, OptionError, writing
from dronemon.flight_options import DEFAULT_MISSION
from dronemon.mission import Mission, find_mission, load_mission
from dronemon.palette import target_rgb
from dronemon.terminal import console, print_path
from dronemon.types import Detection, ImageArray, Pose
from dronemon.vision.detector import look
from dronemon.vision.lens import Rectifier
from dronemon.vision.marks import marked, write_picture
from dronemon.vision.registry import make_detector

COLUMNS = (
    *("picture", "appearance", "score", "u_px", "v_px"),
    *("left_px", "top_px", "right_px", "bottom_px"),
)
SourceArgument = Annotated[
    str, typer.Argument(help="A picture, a folder of them, a video, a stream or a camera's number.")
]
MissionOption = Annotated[
    str, typer.Option("--mission", "-m", help="Whose camera, detector and targets.")
]
OutOption = Annotated[
    Path | None, typer.Option(help="Folder for marked pictures and detections.csv.")
]
HeightOption = Annotated[
    float | None,
    typer.Option(
        min=1.0,
        help="Height in m they were taken from, straight down.",
        show_default="the patrol's",
    ),
]
EveryOption = Annotated[int, typer.Option(min=1, help="Look at every n-th picture only.")]


def detect_command(
    source: SourceArgument,
    mission: MissionOption = DEFAULT_MISSION,
    out: OutOption = None,
    height_m: HeightOption = None,
    every: EveryOption = 1,
) -> None:
    """Try a mission's detector on pictures, and see how long it takes for one."""
    flown = load_mission(find_mission(mission)).mission
    lie = Path(source) if Path(source).is_dir() else Path(source).parent
    if out is not None and out.resolve() == lie.resolve():
        raise OptionError(f"--out {out}: is where the pictures are; name another folder")
    detector, pose = make_detector(flown), Pose.level(height_m or flown.flight.altitude_m)
    rectifier = Rectifier.of_mission(flown)
    pictures = islice(pictures_of(source), 0, None, every)
    first = next(pictures)  # before anything is written
    took_s, found_in = list[float](), Counter[str]()
    with ExitStack() as stack:
        keeper = stack.enter_context(_keeper(out, flown)) if out is not None else None
        stack.callback(_sum_up, took_s, found_in)
        for name, image in chain([first], pictures):
            with _naming(name):
                check_size(image, flown.camera.model)
                image = image if rectifier is None else rectifier(image)
                began_s = time.perf_counter()
                found = look(detector, image, pose, 0.0)
                took_s.append(time.perf_counter() - began_s)
            found_in.update({detection.appearance for detection in found})
            told = ", ".join(f"{d.appearance} {d.score:.2f}" for d in found)
            console.print(f"{name}: {told or 'nothing'}", soft_wrap=True, markup=False)
            if keeper is not None:
                keeper.keep(name, image, found)
    if out is not None:
        print_path(out)


def _sum_up(took_s: Sequence[float], found_in: Counter[str]) -> None:
    """Say what came of all pictures, also where the last could not be looked at."""
    if not took_s:
        return
    seen = ", ".join(f"{name} in {number}" for name, number in sorted(found_in.items()))
    median_s, most_s = np.quantile(took_s[1:] or took_s, (0.5, 0.95))
    console.print(
        f"{len(took_s)} pictures: {seen or 'nothing found'}; {1e3 * median_s:.0f} ms for one, "
        f"{1e3 * most_s:.0f} ms for the slowest of 20, after the first",
        soft_wrap=True,
        markup=False,
    )


@contextmanager
def _naming(picture: str) -> Iterator[None]:
    """Say of which picture an error is."""
    try:
        yield
    except CameraError as exc:
        raise CameraError(f"{picture}: {exc}") from exc


class _Keeper:
    """Writes marked pictures into a folder, and a table of all finds."""

    def __init__(self, path: Path, table: TextIO, mission: Mission) -> None:
        self._path, self._table = path, table
        self._rows = csv.writer(table)
        self._write_rows([COLUMNS])
        self._rgb = {t.appearance: target_rgb(i) for i, t in enumerate(mission.targets)}

    def keep(self, name: str, image: ImageArray, found: Sequence[Detection]) -> None:
        """Keep what was found in a picture."""
        places = [(d.score, *d.pixel_px, *(d.box_px or ())) for d in found]
        self._write_rows(
            [
                name,
                d.appearance,
                *(f"{n:.3f}" for n in place),
                *[""] * (len(COLUMNS) - 2 - len(place)),
            ]
            for d, place in zip(found, places, strict=True)
        )
        path = self._path.with_name(f"{name}.found.jpg")
        with writing("--out", path):
            write_picture(path, marked(image, found, self._rgb))

    def _write_rows(self, rows: Iterable[Sequence[str]]) -> None:
        with writing("--out", self._path):
            self._rows.writerows(rows)
            self._table.flush()


@contextmanager
def _keeper(folder: Path, mission: Mission) -> Iterator[_Keeper]:
    path = folder / "detections.csv"
    if path.exists():
        raise OptionError(f"--out {folder}: has a table already; name another folder")
    with writing("--out", path):
        table = path.open("x", encoding="utf-8", errors="backslashreplace", newline="")
    with table:
        yield _Keeper(path, table, mission)
