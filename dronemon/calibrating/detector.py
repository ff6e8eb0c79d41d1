"""`dronemon calibrate detector`: what a mission has to say of how its detector errs, measured."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
import yaml
from rich.table import Table
from rich.text import Text
from scipy.stats import binomtest

from dronemon.camera import check_size
from dronemon.camera.pictures import pictures_of
from dronemon.detecting import HeightOption, MissionOption, naming
from dronemon.errors import CameraError, OptionError, did_you_mean
from dronemon.flight_options import DEFAULT_MISSION
from dronemon.mission import Mission, find_mission, load_mission
from dronemon.terminal import console, print_warning
from dronemon.types import Detection, Pose
from dronemon.vision.detector import look
from dronemon.vision.lens import Rectifier
from dronemon.vision.registry import make_detector
from dronemon.vision.scoring import Score

_COLUMNS = ("picture", "appearance", "u_px", "v_px")
_FEW = 100
"""Labels below which a share is little more than a guess."""

PicturesArgument = Annotated[
    str, typer.Argument(help="A folder of pictures; one without a label shows nothing watched.")
]
LabelsOption = Annotated[
    Path,
    typer.Option(
        help="CSV of what the pictures show, with picture, appearance, u_px and v_px: what"
        " `dronemon detect --out` wrote, put right by hand.",
    ),
]
WithinOption = Annotated[
    float, typer.Option(min=0.1, max=100.0, help="Distance in m up to which a find is of a label.")
]


def detector_command(
    pictures: PicturesArgument,
    labels: LabelsOption,
    mission: MissionOption = DEFAULT_MISSION,
    height_m: HeightOption = None,
    within_m: WithinOption = 2.0,
) -> None:
    """Measure how often, and how far, a mission's detector errs on pictures that you labelled.

    Take pictures that the detector was not trained on, from the height and in the light in which
    it will fly. What lies beyond the sensor's circle does not count, as in flight.
    """
    flown = load_mission(find_mission(mission)).mission
    height_m = height_m or flown.flight.altitude_m
    shown = _read_labels(labels)
    score = _score(pictures, shown, flown, height_m, within_m)
    if not score.num_labelled:
        watched = ", ".join(score.labelled)
        raise OptionError(
            f"--labels {labels}: has nothing of what the mission watches ({watched}) within "
            f"{flown.sensor_radius_m:g} m of the pictures' middles"
        )
    _warn_of_left_out(score, [label for here in shown.values() for label in here])
    console.print(_table(score))
    console.print(_said(score, height_m), soft_wrap=True, markup=False)
    few = [name for name, number in score.labelled.items() if number < _FEW]
    if few:
        print_warning(f"fewer than {_FEW} labels of {', '.join(few)}: their shares are guesses")
    for name, taken in score.taken_for.items():
        if score.labelled[name] and not taken[name]:
            print_warning(f"{name} is never found as itself; this detector cannot watch it")
    console.print(_text(score, flown), soft_wrap=True, markup=False, highlight=False)


def _warn_of_left_out(score: Score, labels: Sequence[Detection]) -> None:
    """Say which labels do not count."""
    others = Counter(label.appearance for label in labels if label.appearance not in score.labelled)
    for name, number in others.items():
        watched = did_you_mean(name, score.labelled)
        print_warning(
            f"{number} labels of {name!r:.40}, which the mission does not watch. {watched}"
        )
    if beyond := len(labels) - others.total() - score.num_labelled:
        print_warning(
            f"{beyond} of {len(labels)} labels lie beyond the sensor's circle: not counted"
        )


def _score(
    source: str,
    labels: dict[str, list[Detection]],
    mission: Mission,
    height_m: float,
    within_m: float,
) -> Score:
    detector, pose, camera = make_detector(mission), Pose.level(height_m), mission.camera.model
    rectifier = Rectifier.of_mission(mission)
    score = Score([target.appearance for target in mission.targets], within_m)
    m_per_px = height_m / camera.focal_px
    middle_px = camera.width_px / 2.0, camera.height_px / 2.0

    def counts(find: Detection) -> bool:
        return math.dist(find.pixel_px, middle_px) * m_per_px < mission.sensor_radius_m

    names = set()
    for name, image in pictures_of(source):
        names.add(name)
        with naming(name):
            check_size(image, camera)
            image = image if rectifier is None else rectifier(image)
            found = look(detector, image, pose, 0.0)
        here = labels.get(name, ())
        for label in here:
            u_px, v_px = label.pixel_px
            if not (0.0 <= u_px <= camera.width_px and 0.0 <= v_px <= camera.height_px):
                raise OptionError(f"--labels: {u_px:g}, {v_px:g} is no place in {name}")
        shown = [label for label in here if label.appearance in score.labelled]
        told = [find for find in found if find.appearance in score.labelled]
        score.add(shown, told, m_per_px, counts)
    if strangers := sorted(set(labels) - names):
        raise OptionError(
            f"--labels: {strangers[0]!r:.100} is no picture of {source}"
            + (f", nor are {len(strangers) - 1} others" if strangers[1:] else "")
        )
    return score


def _read_labels(path: Path) -> dict[str, list[Detection]]:
    """What each picture shows. Raises OptionError."""
    labels: dict[str, list[Detection]] = {}
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line, name, label in _rows(csv.DictReader(file), path):
                here = labels.setdefault(name, [])
                if label in here:
                    raise OptionError(f"--labels {path}, line {line}: is there already")
                here.append(label)
    except (OSError, UnicodeDecodeError, csv.Error) as exc:
        raise OptionError(f"--labels {path}: cannot be read: {exc}") from exc
    return labels


def _rows(table: csv.DictReader[str], path: Path) -> Iterator[tuple[int, str, Detection]]:
    if missing := [name for name in _COLUMNS if name not in (table.fieldnames or ())]:
        raise OptionError(f"--labels {path}, line 1: has no column {', '.join(missing)}")
    for row in table:
        line = table.line_num
        name, appearance, *place = (row[column] for column in _COLUMNS)
        try:
            u_px, v_px = (float(number) for number in place)
        except (TypeError, ValueError):
            u_px = v_px = math.nan
        if not (name and appearance and math.isfinite(u_px + v_px)):
            raise OptionError(
                f"--labels {path}, line {line}: needs a picture, an appearance and two pixels;"
                " a picture that shows nothing has no line"
            )
        yield line, name, Detection(appearance=appearance, pixel_px=(u_px, v_px), score=1.0)


def _table(score: Score) -> Table:
    """Of each appearance."""
    table = Table("appearance", "labels", "missed", "95 % of such", "taken for")
    for name, number in score.labelled.items():
        taken = score.taken_for[name]
        missed = number - taken.total()
        others = Counter({other: taken[other] for other in taken if other != name})
        low, high = math.nan, math.nan
        if number:
            low, high = binomtest(missed, number).proportion_ci(method="wilson")
        table.add_row(
            Text(name),
            str(number),
            f"{missed / number:.1%}" if number else "",
            f"{low:.1%} to {high:.1%}" if number else "",
            Text(", ".join(f"{other} {times}" for other, times in others.most_common())),
        )
    return table


def _said(score: Score, height_m: float) -> str:
    return (
        f"{score.num_pictures} pictures from {height_m:g} m, {score.false_alarms} finds of nothing;"
        f" finds are {score.position_m:.2f} m off along each axis, labelling included"
    )


def _text(score: Score, mission: Mission) -> str:
    """What the mission is to say."""
    try:
        measured = asdict(score.sensor(mission.area.side_m))
    except OptionError as exc:
        raise CameraError(
            f"the detector errs more than planners can reckon with: {exc}; lower "
            "detector.min_score, fly lower, or take another detector"
        ) from exc
    sensor = {name: round(value, 4) for name, value in measured.items()}
    said: dict[str, object] = {"sensor": sensor}
    shares = {
        name: {other: round(share, 3) for other, share in of.items()}
        for name, of in score.confusion().items()
    }
    if shares:
        said["detector"] = {"confusion": shares}
    return yaml.safe_dump(said, sort_keys=False).rstrip()
