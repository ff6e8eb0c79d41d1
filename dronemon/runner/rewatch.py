"""Looks at the pictures of an earlier flight as a flight would have, and believes them."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np

from dronemon.camera import FrameSource, Freshness, PosedPictures, check_picture
from dronemon.errors import CameraError
from dronemon.events import Audience, EventStream, Moved, Progressed, Subscriber
from dronemon.fence import Fence
from dronemon.frames import GeoPoint
from dronemon.mission import Mission
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.runner.eyes import Eyes, Shot
from dronemon.runner.ground import area_laid, tell_laid
from dronemon.runner.inspection import lay_area
from dronemon.runner.preparation import draw_start_and_roadmap
from dronemon.runner.relief import surface_of
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Picture, Pose
from dronemon.vision.detector import Detector
from dronemon.vision.ground_error import told_covariance


class Rewatch:
    """One look through all pictures; also the clock of its events.

    time_s:    of the newest picture
    tally:     what it has come to
    num_blind: pictures that said nothing
    took_s:    time for each that was looked at
    """

    def __init__(
        self,
        mission: Mission,
        pictures: PosedPictures,
        home: GeoPoint,
        priors_au: FloatArray,
        detector: Detector,
    ) -> None:
        """priors_au: (N, 2) known positions of the targets, NaN where unknown.

        Raises CameraError where no picture was taken over the mission's area.
        """
        self.time_s = 0.0
        self.tally = Tally(start_s=0.0, sightings=Sightings(priors_au, mission.sensor.model))
        self.num_blind = 0
        self.took_s: list[float] = []
        self._mission, self._pictures, self._home = mission, pictures, home
        self._detector = detector
        self._poses = pictures.poses(home)
        self._way_m = sum(
            math.dist(a.position_ned_m[:2], b.position_ned_m[:2]) for a, b in pairwise(self._poses)
        )
        self._frame = lay_area(mission, home, home, 0.0)
        self._check_area()
        self._freshness = Freshness()
        self._num_in_a_row = 0  # that said nothing

    @property
    def heights_m(self) -> FloatArray:
        """Height of each picture above the ground of the start. -> (P,)"""
        return np.array([self._frame.height_m(pose.position_ned_m[2]) for pose in self._poses])

    def _check_area(self) -> None:
        places_au = self._frame.ned_to_au(np.array([pose.position_ned_m for pose in self._poses]))
        out_au = np.linalg.norm(np.maximum(np.abs(places_au - 0.5) - 0.5, 0.0), axis=-1)
        if (nearest_au := float(out_au.min())) > SENSOR_RADIUS_AU:
            area = self._mission.area
            raise CameraError(
                f"{self._pictures.folder}: no picture shows the mission's area, the nearest is "
                f"{nearest_au * area.side_m:.0f} m off; is it area.latitude_deg and longitude_deg, "
                "or --home, that lies elsewhere, or are the pictures' swapped?"
            )

    async def run(
        self,
        camera: FrameSource,
        record: Subscriber,
        audience: Audience,
        settle: Callable[[], None],
    ) -> None:
        """Look at all. settle: lets the audience keep up; it may wait.

        Raises RecordError, and CameraError where no picture says anything.
        """
        self._events = EventStream(record, audience, self)
        log = self.tally.sightings
        surface = surface_of(self._mission, self._frame, self._home, self._home)
        self._eyes = Eyes(self._mission, self._detector, self._events, self._frame, surface, log)
        self._begin()
        began_s, last = time.monotonic(), None
        async with camera:
            for taken, pose in zip(self._pictures.pictures, self._poses, strict=True):
                self._move(last, pose)
                with self._counting(taken.name):
                    await self._look(await camera.capture(), pose)
                self._progress(pose, time.monotonic() - began_s)
                await asyncio.to_thread(settle)
                last = pose
        due, seen = self.tally.num_pictures_due, len(self.took_s)
        if not self.took_s:
            raise CameraError(f"{self._pictures.folder}: none of its {due} pictures says anything")
        self._events.note("outcome", f"{seen} of {due} pictures say something")

    def _begin(self) -> None:
        """Tell where the area lies, and what is known at first."""
        mission, (_, roadmap) = self._mission, draw_start_and_roadmap(self._mission)
        fence = Fence.around(
            self._frame,
            [(0.0, 0.0)],
            altitude_m=mission.flight.altitude_m,
            margin_m=mission.flight.fence_margin_m,
        )
        laid = area_laid(mission, self._frame, self._home, fence, roadmap, system_id=0)
        tell_laid(self._events, laid, f"pictures of {self._pictures.folder}", hardware=None)
        if mission.area.rangefinder:
            what = "no ranges are known of pictures; the ground is level, or as area.terrain says"
            self._events.note("ground", what, level="WARN")
        priors_au = self.tally.sightings.priors_au
        self._events.note("patrol", "the first picture", start_s=0.0, priors_au=priors_au)

    def _move(self, last: Pose | None, pose: Pose) -> None:
        """Go on to where the next picture was taken."""
        self.time_s = pose.time_s
        self.tally.num_pictures_due += 1
        if last is not None:
            self.tally.move(last, pose)
        self._events.emit(Moved(pose=pose))

    async def _look(self, picture: Picture, pose: Pose) -> None:
        """Look at a picture and believe it. Raises CameraError if it says nothing."""
        check_picture(picture, self._mission.camera.model, self.time_s, -math.inf)
        self._freshness.check(picture, pose)
        began_s = time.perf_counter()
        told = told_covariance(self._mission.errors, pose)
        shot = Shot(picture=picture, pose=pose, told=told)
        glance = await asyncio.to_thread(self._eyes.look, shot, self.tally.start_s)
        self.took_s.append(time.perf_counter() - began_s)
        self._eyes.tell(glance, self.tally)
        self._eyes.believe(glance)

    @contextmanager
    def _counting(self, name: str) -> Iterator[None]:
        """Count a picture that says nothing, and tell of the first of a row, and of their end."""
        try:
            yield
        except CameraError as exc:
            self.num_blind += 1
            self._num_in_a_row += 1
            if self._num_in_a_row == 1:
                self._events.note("camera", f"{name} says nothing: {exc}", level="WARN")
            return
        if self._num_in_a_row > 1:
            what = f"{name} says something again, after {self._num_in_a_row} that did not"
            self._events.note("camera", what)
        self._num_in_a_row = 0

    def _progress(self, pose: Pose, took_s: float) -> None:
        """Tell how far it is. took_s: wall time so far"""
        tally, side_m = self.tally, self._mission.area.side_m
        names = [target.name for target in self._mission.targets]
        self._events.emit(
            Progressed(
                phase="pictures",
                flown_au=tally.flown_m / side_m,
                horizon_au=round(self._way_m / side_m, 1),
                left_s=took_s * (len(self._poses) / tally.num_pictures_due - 1.0),
                speed_m_s=pose.ground_speed_m_s,
                since_seen_s=tally.since_seen_s(names, self.time_s),
            )
        )
