"""`dronemon detect`: what a mission's detector finds in pictures, before it is flown."""

from __future__ import annotations

import csv
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated, TextIO

import numpy as np
import typer

from dronemon.camera.pictures import pictures_of
from dronemon.errors import CameraError, blaming, writing
from dronemon.flight_options import DEFAULT_MISSION
from dronemon.mission import Mission, find_mission, load_mission
from dronemon.palette import target_rgb
from dronemon.terminal import console, print_path
from dronemon.types import Detection, ImageArray, Pose
from dronemon.vision.marks import marked, write_picture
from dronemon.vision.registry import make_detector

COLUMNS = ("picture", "appearance", "score", "u_px", "v_px", "left", "top", "right", "bottom")
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
EveryOption = Annotated[int, typer.Option(min=1, help="Look at every so manieth picture.")]


def detect_command(
    source: SourceArgument,
    mission: MissionOption = DEFAULT_MISSION,
    out: OutOption = None,
    height_m: HeightOption = None,
    every: EveryOption = 1,
) -> None:
    """Try a mission's detector on pictures, and see how long it takes for one."""
    of = load_mission(find_mission(mission)).mission
    detector, pose = make_detector(of), _level(height_m or of.flight.altitude_m)
    count, took_s, found_in = 0, list[float](), Counter[str]()
    with ExitStack() as stack:
        keeper = stack.enter_context(_keeper(out, of)) if out is not None else None
        for name, image in islice(pictures_of(source), 0, None, every):
            began_s = time.perf_counter()
            with _naming(name), blaming("the detector", CameraError):
                found = tuple(detector.detect(image, pose, 0.0))
            took_s.append(time.perf_counter() - began_s)
            count += 1
            found_in.update({detection.appearance for detection in found})
            told = ", ".join(f"{d.appearance} {d.score:.2f}" for d in found)
            console.print(f"{name}: {told or 'nothing'}", soft_wrap=True, markup=False)
            if keeper is not None:
                keeper.keep(name, image, found)
    seen = ", ".join(f"{name} in {number}" for name, number in sorted(found_in.items()))
    median_s, most_s = np.quantile(took_s[1:] or took_s, (0.5, 0.95))
    console.print(
        f"{count} pictures: {seen or 'nothing found'}; {1e3 * median_s:.0f} ms for one, "
        f"{1e3 * most_s:.0f} ms for the slowest of 20, after the first",
        soft_wrap=True,
        markup=False,
    )
    if out is not None:
        print_path(out)


def _level(height_m: float) -> Pose:
    return Pose(
        time_s=0.0,
        position_ned_m=(0.0, 0.0, -height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
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

    def __init__(self, folder: Path, table: TextIO, mission: Mission) -> None:
        self._folder = folder
        self._rows = csv.writer(table)
        self._rows.writerow(COLUMNS)
        self._rgb = {t.appearance: target_rgb(i) for i, t in enumerate(mission.targets)}

    def keep(self, name: str, image: ImageArray, found: Sequence[Detection]) -> None:
        """Keep what was found in a picture."""
        for d in found:
            numbers = (d.score, *d.pixel_px, *(d.box_px or ()))
            self._rows.writerow([name, d.appearance, *(f"{number:.3f}" for number in numbers)])
        path = self._folder / f"{Path(name).stem}.jpg"
        with writing("--out", path):
            write_picture(path, marked(image, found, self._rgb))


@contextmanager
def _keeper(folder: Path, mission: Mission) -> Iterator[_Keeper]:
    path = folder / "detections.csv"
    with writing("--out", path), ExitStack() as stack:
        folder.mkdir(parents=True, exist_ok=True)
        table = stack.enter_context(path.open("w", encoding="utf-8", newline=""))
        yield _Keeper(folder, table, mission)
