"""A small flight in memory, its record and the pictures of what it saw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from fake_link import FakeCamera, FakeLink

from dronemon.belief import Belief
from dronemon.camera import CropKeeper
from dronemon.events import Audience
from dronemon.mission import load_mission
from dronemon.planner import Planner
from dronemon.planner.lawnmower import Lawnmower
from dronemon.recorder import RunRecorder
from dronemon.runner.flight import fly_mission
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.runner.summary import summarise
from dronemon.sightings import Sightings
from dronemon.types import Detection
from dronemon.viz import FlightView

MISSION = """
name: Reserve & <north>
area: {side_m: 100, heading_deg: 30}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 1, start_au: [0.5, 0.4]}
targets:
  - {name: "Bella <1>", appearance: cow, prior_au: [0.4, 0.6]}
  - {name: "_Zürä $\\\\frac{$", appearance: zebra}
"""


PRIORS_AU = np.array([[0.4, 0.6], [np.nan, np.nan]])


class Below:
    """Sees the cow below itself in every picture."""

    def detect(self, *_: object) -> tuple[Detection, ...]:
        return (Detection(appearance="cow", pixel_px=(320.0, 240.0), score=0.9),)


async def fly(folder: Path, planner: Planner | None = None) -> None:
    (folder / "m.yaml").write_text(MISSION)
    file = load_mission(folder / "m.yaml")
    Belief(Sightings(PRIORS_AU)).posterior(np.zeros((1, 3)))  # loads what a rehearsal does
    with RunRecorder.create(file.mission, out=folder / "run") as recorder:
        async with FakeLink() as link:
            with (
                CropKeeper(recorder.folder.path, file.mission) as crops,
                FlightView(recorder.folder.new_rrd_path(), file.mission) as view,
            ):
                result = await fly_mission(
                    FlightSetup(
                        file=file,
                        link=link,
                        camera=FakeCamera(link, 640, 480),
                        detector=Below(),
                        planner=planner or Lawnmower(),
                        priors_au=PRIORS_AU,
                        record=recorder,
                        audience=Audience((crops, view)),
                        interrupts=Interrupts(),
                    )
                )
        place_of = recorder.ground_place
        summary = summarise(result, truth=(), mission=file.mission, place_of=place_of)
        recorder.finish(result.outcome, summary.as_json())
    assert not crops.lost
    assert not view.lost
