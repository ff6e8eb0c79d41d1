"""`dronemon detect`: what a mission's detector finds in pictures, before it is flown."""

from __future__ import annotations

import csv
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import numpy as np
import typer

from dronemon.camera import PosedPictures, check_size, has_poses, read_posed
from dronemon.camera.pictures import pictures_of, read_picture
from dronemon.errors import CameraError, OptionError, writing
from dronemon.flight_options import DEFAULT_MISSION
from dronemon.mission import Mission, find_mission, load_mission
from dronemon.palette import target_rgb
from dronemon.terminal import console, print_path, print_warning
from dronemon.types import Detection, ImageArray, Pose
from dronemon.vision.detector import look
from dronemon.vision.lens import Rectifier
from dronemon.vision.marks import marked, write_picture
from dronemon.vision.registry import make_detector

if TYPE_CHECKING:
    from dronemon.export.finds import Finds

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
    Path | None,
    typer.Option(
        help="Folder for marked pictures, detections.csv and, with poses, detections.geojson."
    ),
]
HeightOption = Annotated[
    float | None,
    typer.Option(
        min=1.0,
        help="Height in m they were taken from, straight down.",
        show_default="the patrol's",
    ),
]
PosesOption = Annotated[
    Path | None,
    typer.Option(
        help="CSV of picture,time_s,latitude,longitude,altitude_m and roll_deg,pitch_deg,yaw_deg "
        "or gimbal_roll_deg and so on.",
        show_default="the one beside them, else their EXIF and XMP",
    ),
]
EveryOption = Annotated[int, typer.Option(min=1, help="Look at every n-th picture only.")]


def detect_command(
    source: SourceArgument,
    mission: MissionOption = DEFAULT_MISSION,
    out: OutOption = None,
    height_m: HeightOption = None,
    every: EveryOption = 1,
    poses: PosesOption = None,
) -> None:
    """Try a mission's detector on pictures, and see how long it takes for one.

    Of a folder whose pictures have poses it also says where on the globe each find is.
    """
    flown = load_mission(find_mission(mission)).mission
    lie = Path(source) if Path(source).is_dir() else Path(source).parent
    if out is not None and out.resolve() == lie.resolve():
        raise OptionError(f"--out {out}: is where the pictures are; name another folder")
    detector, rectifier = make_detector(flown), Rectifier.of_mission(flown)
    posed = _posed(source, poses, height_m, flown)
    level = Pose.level(height_m or flown.flight.altitude_m)
    shown = _as_taken(posed) if posed else _level(source, level)
    pictures = islice(shown, 0, None, every)
    first = next(pictures)  # before anything is written
    took_s, found_in = list[float](), Counter[str]()
    with ExitStack() as stack:
        keeper = stack.enter_context(_keeper(out, flown, posed)) if out is not None else None
        stack.callback(_sum_up, took_s, found_in)
        for name, image, pose in chain([first], pictures):
            with naming(name):
                check_size(image, flown.camera.model)
                image = image if rectifier is None else rectifier(image)
                began_s = time.perf_counter()
                found = look(detector, image, pose, 0.0)
                took_s.append(time.perf_counter() - began_s)
            found_in.update({detection.appearance for detection in found})
            told = ", ".join(f"{d.appearance} {d.score:.2f}" for d in found)
            console.print(f"{name}: {told or 'nothing'}", soft_wrap=True, markup=False)
            if keeper is not None:
                keeper.keep(name, image, found, pose)
    if out is not None:
        print_path(out)


def _posed(
    source: str, poses: Path | None, height_m: float | None, mission: Mission
) -> PosedPictures | None:
    """The pictures with their poses, which are looked for where no height is given."""
    if poses is not None and height_m is not None:
        raise OptionError("--height-m: is what --poses tells of each picture; leave one")
    if poses is not None:
        return read_posed(Path(source), poses, mission.camera)
    if height_m is None and has_poses(Path(source)):
        try:
            return read_posed(Path(source), None, mission.camera)
        except CameraError as exc:  # as of pictures of several flights
            print_warning(f"where finds are on the globe is not told: {exc}")
    return None


def _level(source: str, level: Pose) -> Iterator[tuple[str, ImageArray, Pose]]:
    for name, image in pictures_of(source):
        yield name, image, level


def _as_taken(posed: PosedPictures) -> Iterator[tuple[str, ImageArray, Pose]]:
    for picture, pose in zip(posed.pictures, posed.poses(posed.start), strict=True):
        yield picture.name, read_picture(picture.file), pose


def _sum_up(took_s: Sequence[float], found_in: Counter[str]) -> None:
    """Say what came of all pictures, also where the last could not be looked at."""
    if not took_s:
        return
    seen = ", ".join(f"{name} in {number}" for name, number in sorted(found_in.items()))
    console.print(
        f"{len(took_s)} pictures: {seen or 'nothing found'}; {time_of_each(took_s)}",
        soft_wrap=True,
        markup=False,
    )


def time_of_each(took_s: Sequence[float]) -> str:
    """How long pictures took, in words. took_s: of each, one at least"""
    median_s, most_s = np.quantile(took_s[1:] or took_s, (0.5, 0.95))
    return (
        f"{1e3 * median_s:.0f} ms for one, {1e3 * most_s:.0f} ms for the slowest of 20, after the "
        "first"
    )


@contextmanager
def naming(picture: str) -> Iterator[None]:
    """Say of which picture an error is."""
    try:
        yield
    except CameraError as exc:
        raise CameraError(f"{picture}: {exc}") from exc


class _Keeper:
    """Writes marked pictures into a folder, and a table of all finds.

    finds: places them on the globe; None where it is not known where the pictures were taken
    """

    def __init__(self, path: Path, table: TextIO, mission: Mission, finds: Finds | None) -> None:
        self._path, self._table, self._finds = path, table, finds
        self._rows = csv.writer(table)
        self._write_rows([COLUMNS if finds is None else (*COLUMNS, *finds.columns)])
        self._rgb = {t.appearance: target_rgb(i) for i, t in enumerate(mission.targets)}

    def keep(self, name: str, image: ImageArray, found: Sequence[Detection], pose: Pose) -> None:
        """Keep what was found in a picture."""
        path = self._path.with_name(f"{name}.found.jpg")
        places = self._finds.add(found, pose, path) if self._finds else [()] * len(found)
        self._write_rows(
            [name, d.appearance, *_numbers(d), *place]
            for d, place in zip(found, places, strict=True)
        )
        with writing("--out", path):
            write_picture(path, marked(image, found, self._rgb))

    def finish(self) -> None:
        """Write the finds once more, for maps, if it is known where they are."""
        if self._finds is not None:
            path = self._path.with_suffix(".geojson")
            with writing("--out", path):
                path.write_bytes(self._finds.geojson())

    def _write_rows(self, rows: Iterable[Sequence[str]]) -> None:
        with writing("--out", self._path):
            self._rows.writerows(rows)
            self._table.flush()


def _numbers(find: Detection) -> list[str]:
    """Score, middle and box, as far as it has one."""
    numbers = [f"{n:.3f}" for n in (find.score, *find.pixel_px, *(find.box_px or ()))]
    return numbers + [""] * (len(COLUMNS) - 2 - len(numbers))


@contextmanager
def _keeper(folder: Path, mission: Mission, posed: PosedPictures | None) -> Iterator[_Keeper]:
    path = folder / "detections.csv"
    if path.exists() or path.with_suffix(".geojson").exists():
        raise OptionError(f"--out {folder}: has a table already; name another folder")
    finds = _finds(mission, posed) if posed else None
    with writing("--out", path):
        table = path.open("x", encoding="utf-8", errors="backslashreplace", newline="")
    with table:
        keeper = _Keeper(path, table, mission, finds)
        try:
            yield keeper
        finally:
            keeper.finish()


def _finds(mission: Mission, posed: PosedPictures) -> Finds:
    from dronemon.export.finds import Finds  # slow, and needed for these alone

    return Finds(mission, posed)
