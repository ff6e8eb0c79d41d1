"""`dronemon rewatch`: what a flight would see and believe, by pictures of an earlier one."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from dronemon.camera import (
    CropKeeper,
    FrameSource,
    PosedCamera,
    PosedPictures,
    RectifiedCamera,
    read_posed,
)
from dronemon.camera.taken import checked_place, number
from dronemon.detecting import EveryOption, PosesOption, time_of_each
from dronemon.errors import CameraError, OptionError
from dronemon.events import Audience
from dronemon.flight_options import DEFAULT_MISSION
from dronemon.frames import GeoPoint
from dronemon.mission import Mission, find_mission, load_mission
from dronemon.recorder import REWATCHED, Earlier, RunRecorder
from dronemon.runner.preparation import known_places_au
from dronemon.runner.rewatch import Rewatch
from dronemon.runner.summary import Flown, flown, how_flown
from dronemon.runner.watch import in_words
from dronemon.terminal import FlightDisplay, console, facts_table, print_warning
from dronemon.types import FloatArray
from dronemon.vision.lens import Rectifier
from dronemon.vision.registry import make_detector
from dronemon.vision.view import needed_px_per_m
from dronemon.viz import FlightView

_INTERRUPTED, _ENDED = 130, "interrupted"
_SETTLE_S = 10.0
"""Wall time that those who watch have to keep up with each picture."""

PicturesArgument = Annotated[
    Path, typer.Argument(metavar="PICTURES", help="A folder of pictures of one flight.")
]
MissionOption = Annotated[
    str, typer.Option("--mission", "-m", help="Whose camera, detector, targets and area.")
]
HomeOption = Annotated[
    str | None,
    typer.Option(metavar="LAT,LON", help="Home.", show_default="where the first was taken"),
]
OutOption = Annotated[
    Path | None, typer.Option(help="Run folder; a new one under runs/ if absent.")
]


def rewatch_command(
    pictures: PicturesArgument,
    mission: MissionOption = DEFAULT_MISSION,
    poses: PosesOption = None,
    home: HomeOption = None,
    out: OutOption = None,
    every: EveryOption = 1,
) -> None:
    """See and believe what a flight would have, from pictures of an earlier one and their poses.

    It leaves a run folder as a flight does, for report, export and view.
    """
    of = load_mission(find_mission(mission)).mission
    taken = read_posed(pictures, poses, of.camera).every(every)
    at = taken.start if home is None else _home(home)
    looked = Rewatch(of, taken, at, known_places_au(of, None), make_detector(of))
    _check_detail(of, looked.heights_m)
    camera = _camera(of, taken)
    if unknown := [target.name for target in of.targets if target.prior_au == "simulated"]:
        print_warning(f"prior_au is simulated, and so unknown here, of {', '.join(unknown)}")
    with RunRecorder.create(
        of, out=out, earlier=Earlier(pictures=pictures, began=taken.began)
    ) as recorder:
        console.print(f"run folder: {recorder.folder.path}", soft_wrap=True, markup=False)
        outcome = _look(looked, camera, recorder, of)
        came_to = flown(looked.tally, of, recorder.ground_place)
        recorder.finish(outcome, {**asdict(came_to), "num_blind": looked.num_blind})
    console.print(facts_table(of.name, _facts(came_to, looked)))
    raise typer.Exit(_INTERRUPTED if outcome == _ENDED else 0)


def _check_detail(mission: Mission, heights_m: FloatArray) -> None:
    """See whether the detector can find anything from so high. Raises CameraError."""
    needed, height_m = needed_px_per_m(mission), float(np.median(heights_m))
    focal_px = mission.camera.model.focal_px
    if needed is not None and focal_px < needed * height_m:
        raise CameraError(
            f"most pictures were taken from {height_m:.0f} m, where a metre is less than the "
            f"{needed:g} pixels that the detector needs (from {focal_px / needed:.0f} m); is the "
            "altitude given above the sea instead of above the start?"
        )


def _look(looked: Rewatch, camera: FrameSource, recorder: RunRecorder, mission: Mission) -> str:
    """Look at all pictures, before those who watch. -> the outcome

    A run that fails is recorded as far as it came.
    """
    unseen = mission.model_copy(update={"view": mission.view.model_copy(update={"live": False})})
    try:
        with ExitStack() as stack:
            folder = recorder.folder
            view = stack.enter_context(FlightView(folder.new_rrd_path(), unseen))
            crops = stack.enter_context(CropKeeper(folder.path, mission))
            audience = Audience((view, crops, stack.enter_context(FlightDisplay(console))))

            def settle() -> None:
                view.catch_up(_SETTLE_S)
                crops.catch_up(_SETTLE_S)

            asyncio.run(looked.run(camera, recorder, audience, settle))
        for what in audience.losses():
            print_warning(f"left out: {what}")
    except KeyboardInterrupt:
        return _ENDED
    except BaseException as exc:
        if recorder.is_empty:
            recorder.discard()
        else:
            recorder.finish("failed", {"error": str(exc) or repr(exc)})
        raise
    return REWATCHED


def _home(text: str) -> GeoPoint:
    try:
        latitude_deg, longitude_deg = map(number, text.split(","))
        return checked_place(latitude_deg, longitude_deg, 0.0)
    except ValueError as exc:
        raise OptionError(f"--home {text}: {exc}; give LAT,LON in degrees") from exc


def _camera(mission: Mission, pictures: PosedPictures) -> FrameSource:
    source, rectifier = PosedCamera(pictures), Rectifier.of_mission(mission)
    model = mission.camera.model
    return source if rectifier is None else RectifiedCamera(source, rectifier, model)


def _facts(came_to: Flown, looked: Rewatch) -> dict[str, str]:
    told = {name: in_words(how) for name, how in came_to.watched.items()}
    facts = {**told, **how_flown(asdict(came_to))}
    if looked.num_blind:
        facts["said nothing"] = f"{looked.num_blind} pictures"
    if looked.took_s:
        facts["time of detector"] = time_of_each(looked.took_s)
    return facts
