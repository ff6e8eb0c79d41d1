"""Where on the globe a detector's finds are, in pictures whose poses are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from dronemon.camera import PosedPictures
from dronemon.export.formats import geojson
from dronemon.export.story import Fix, Sighting, Story
from dronemon.frames import ned_to_geo
from dronemon.mission import Mission
from dronemon.runner.inspection import lay_area
from dronemon.runner.relief import surface_of
from dronemon.types import Detection, Pose
from dronemon.vision.ground_error import ground_covariance, radius_m, told_covariance


class Finds:
    """All finds of one flight's pictures.

    columns: of each: its place, also in metres from the ground below the first picture, and the
    radius about it in which it truly is in 95 of 100
    """

    columns = ("latitude_deg", "longitude_deg", "north_m", "east_m", "error_m")

    def __init__(self, mission: Mission, pictures: PosedPictures) -> None:
        self._mission, self._pictures, self._home = mission, pictures, pictures.start
        self._frame = lay_area(mission, self._home, self._home, 0.0)
        self._surface = surface_of(mission, self._frame, self._home, self._home)
        self._sightings: list[Sighting] = []

    def add(self, found: Sequence[Detection], pose: Pose, marked: Path) -> list[tuple[str, ...]]:
        """Take in a picture's finds. -> `columns` of each, empty where no ground is to be seen

        marked: the picture's copy
        """
        pixels_px = np.array([d.pixel_px for d in found]).reshape(-1, 2)
        camera, surface = self._mission.camera.model, self._surface
        places_m = surface.places(pixels_px, camera, pose)
        told = told_covariance(self._mission.errors, pose)
        errors_m = radius_m(ground_covariance(pixels_px, camera, pose, surface, told))
        rows = list[tuple[str, ...]]()
        for detection, (north_m, east_m), error_m in zip(
            found, places_m.tolist(), errors_m.tolist(), strict=True
        ):
            if not (math.isfinite(north_m) and self._frame.height_m(pose.position_ned_m[2]) > 0.0):
                rows.append(("",) * len(self.columns))
                continue
            place = ned_to_geo((north_m, east_m, 0.0), self._home)
            degrees = (f"{n:.7f}" for n in (place.latitude_deg, place.longitude_deg))
            rows.append((*degrees, *(f"{n:.2f}" for n in (north_m, east_m, error_m))))
            self._sightings.append(
                Sighting(
                    number=0,
                    target=detection.appearance,
                    appearance=detection.appearance,
                    time=self._time(pose.time_s),
                    place=place,
                    error_m=error_m,
                    score=detection.score,
                    crop=marked,
                )
            )
        return rows

    def geojson(self) -> bytes:
        """The way flown, and all finds so far, whose pictures are beside it."""
        track = (Fix(time=self._time(p.time_s), place=p.place) for p in self._pictures.pictures)
        return geojson(
            Story(
                name=self._mission.name,
                title=self._mission.name,
                started=self._pictures.began,
                cell_m=0.0,
                corners=(),
                track=tuple(track),
                sightings=tuple(self._sightings),
            ),
            pictures="",
        )

    def _time(self, time_s: float) -> datetime:
        return self._pictures.began + timedelta(seconds=time_s)
