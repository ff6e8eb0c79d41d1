"""Takes a picture when one is due, looks at it, and tells the beliefs what it shows."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from dronemon.camera import Freshness, check_picture
from dronemon.errors import CameraError
from dronemon.events import Believed, EventStream, Measured, Pictured
from dronemon.frames import AreaFrame
from dronemon.runner.battery import Battery
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.ground import surface_of
from dronemon.runner.preparation import LOOK_LIMIT_S, FlightSetup, make_belief
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import Detection, FloatArray, Measurement, Picture, Pose
from dronemon.vision.detector import look
from dronemon.vision.ground_error import ground_covariance, radius_m, told_covariance
from dronemon.vision.observe import observe
from dronemon.vision.owners import NOBODY, Owners
from dronemon.vision.project import interpolate_pose, turning
from dronemon.vision.surface import down_below_m

BLIND_LIMIT_S = 30.0
"""Vehicle time for which the patrol goes on while too few pictures say anything, ..."""
_BLIND_PICTURES = 3
"""... and number of pictures that must have failed by then."""
_ENOUGH, _NEWEST = 0.15, 0.2
"""Share of pictures before one that says something: a quarter of them is enough, a fifth is not;
the newest picture's weight in it."""
_MAX_PENDING = 8
"""Pictures that wait to be looked at; while there are so many, none is taken."""


class _Shot(NamedTuple):
    """A picture, where it was taken from, and how far off that may be: see `told_covariance`."""

    picture: Picture
    pose: Pose
    told: FloatArray


class Observer:
    """The patrol's eyes; `tally` is given when it begins, or goes on.

    belief: what the pictures have told so far.
    """

    def __init__(
        self,
        setup: FlightSetup,
        events: EventStream,
        frame: AreaFrame,
        battery: Battery,
        tally: Tally | None,
    ) -> None:
        self._setup = setup
        self._mission = setup.file.mission
        self._link = setup.link
        self._events = events
        self._frame = frame
        self._surface = surface_of(self._mission, frame, self._link.state)
        self._battery = battery
        self._names = tuple(target.name for target in self._mission.targets)
        self._owners = Owners.of_mission(self._mission)
        self._unseen: deque[_Shot] = deque()  # taken and not yet looked at
        self._pictured_s = -math.inf  # vehicle time of the newest picture
        self._freshness = Freshness()
        self._blind_since_s: float | None = None
        self._num_blind = 0  # since then
        self._share = 1.0  # of pictures, of late, that said something
        self._told_s = -math.inf
        self._due = asyncio.Event()
        self._is_taking = False
        self.tally = tally
        sightings = tally.sightings if tally else Sightings(setup.priors_au)
        self.belief = make_belief(self._mission, sightings)

    @property
    def is_taking(self) -> bool:
        """Whether a picture is due or under way."""
        return self._is_taking or self._due.is_set()

    @property
    def has_unseen(self) -> bool:
        """Whether a picture waits to be looked at."""
        return bool(self._unseen)

    def is_blind(self, now_s: float) -> bool:
        """Whether too few pictures have said anything for too long."""
        since_s = self._blind_since_s
        is_long = since_s is not None and now_s > since_s + BLIND_LIMIT_S
        return is_long and self._num_blind >= _BLIND_PICTURES

    def ask(self) -> None:
        """A picture is due now."""
        if self._due.is_set():
            self._miss(
                CameraError("the camera is slow: a picture came later than the next was due")
            )
        self._due.set()

    def resume(self) -> None:
        """Forget how long nothing was seen, but not what was taken."""
        self._blind_since_s, self._share, self._is_taking = None, 1.0, False
        self._freshness = Freshness()
        self._due.clear()

    async def photograph(self, work: asyncio.Event) -> None:
        """Take every picture that is asked for, and say that there is work."""
        while True:
            await self._due.wait()
            self._due.clear()
            self._is_taking = True
            try:
                if len(self._unseen) >= _MAX_PENDING:
                    raise CameraError(f"the detector is slow: {_MAX_PENDING} pictures wait for it")
                picture = await self._setup.camera.capture()
                now_s, last_s = self._link.time_s, self._pictured_s
                check_picture(picture, self._mission.camera.model, now_s, last_s)
                self._pictured_s = picture.time_s
                poses = await self._link.poses_around(picture.time_s)
                pose = interpolate_pose(*poses, picture.time_s)
                self._freshness.check(picture, pose)
            except CameraError as exc:
                self._miss(exc)
            else:
                self._unseen.append(_Shot(picture, pose, self._told(poses, pose)))
                work.set()
            finally:
                self._is_taking = False

    def _miss(self, exc: CameraError) -> None:
        """A picture says nothing: for a while the beliefs do without."""
        now_s = self._link.time_s
        self._share *= 1.0 - _NEWEST
        if self._blind_since_s is None:
            self._blind_since_s, self._num_blind = now_s, 0
            if now_s > self._told_s + BLIND_LIMIT_S:
                self._told_s = now_s
                what = f"{exc}; the patrol goes on without for {BLIND_LIMIT_S:g} s at most"
                self._events.note("camera", what, level="WARN")
        self._num_blind += 1

    def _see(self) -> None:
        """A picture says something; where few do, one alone does not mean that all is well."""
        if self._share >= _ENOUGH:
            self._blind_since_s = None
        self._share += _NEWEST * (1.0 - self._share)

    async def look_at_the_rest(self) -> None:
        """Look at the pictures that were taken and not yet looked at when the patrol ended."""
        while self._unseen:
            await self.look()

    async def look(self) -> None:
        """Look at the oldest picture taken. One that says nothing is told, and counts."""
        try:
            await self._look(self._unseen[0])
        except CameraError as exc:
            self._unseen.popleft()
            self._miss(exc)

    async def _look(self, shot: _Shot) -> None:
        tally, (picture, pose, _) = self.tally, shot
        assert tally is not None  # pictures are asked for only once the patrol has begun
        time_au = self._frame.s_to_au(picture.time_s - tally.start_s)
        detect = partial(self._detect, shot, time_au)
        detections, owners, measurement, covariance_m2 = await in_daemon_thread(
            detect, "the detector", CameraError, LOOK_LIMIT_S
        )
        stretch, number = tally.stretch(picture.time_s), len(self.belief.sightings) + 1
        self._events.emit(
            Measured(
                number=number,
                time_s=picture.time_s,
                measurement=measurement,
                score=self._scores(detections, owners),
                pose=pose,
                covariance_m2=covariance_m2,
                error_m=radius_m(covariance_m2),
                battery=self._link.state.battery,
                battery_needed=self._battery.needed,
                stretch=stretch,
            )
        )
        seen = (
            name for name, is_seen in zip(self._names, measurement.seen, strict=True) if is_seen
        )
        tally.measure(picture.time_s, stretch.pictured_m, seen)
        self._unseen.popleft()
        self._see()
        self.belief.sightings.add(measurement)
        if self._mission.record.pictures:
            pictured = Pictured(
                number=number, picture=picture, detections=detections, owners=owners, pose=pose
            )
            self._events.emit(pictured)
        self._events.emit(
            Believed(
                time_s=picture.time_s,
                time_au=measurement.time_au,
                posterior=self.belief.posterior_of_now(),
            )
        )

    def _detect(
        self, shot: _Shot, time_au: float
    ) -> tuple[tuple[Detection, ...], list[int], Measurement, FloatArray]:
        """What the detector finds, whose each is, and what that says of targets. In a thread.

        With it the covariance of each target's place, (N, 2, 2), NaN where it was not found.
        """
        picture, pose, _ = shot
        below_m = down_below_m(self._surface, pose)
        detections = look(self._setup.detector, picture.image, pose, below_m)
        measurement, owners = observe(
            detections,
            pose=pose,
            camera=self._mission.camera.model,
            frame=self._frame,
            surface=self._surface,
            owners=self._owners,
            sightings=self.belief.sightings,
            time_au=time_au,
        )
        return detections, owners, measurement, self._covariance_m2(shot, detections, owners)

    def _told(self, poses: tuple[Pose, Pose], pose: Pose) -> FloatArray:
        """How far off is what tells the places in a picture that was taken between two poses."""
        errors, state = self._mission.errors, self._link.state
        accuracies_m = state.accuracy_m, state.height_accuracy_m
        return told_covariance(errors, pose, turning(*poses), *accuracies_m)

    def _covariance_m2(
        self, shot: _Shot, detections: Sequence[Detection], owners: Sequence[int]
    ) -> FloatArray:
        """Of the place of each target found. -> (N, 2, 2), NaN where it was not."""
        pixels_px = np.full((len(self._names), 2), np.nan)
        for found, target in zip(detections, owners, strict=True):
            if target != NOBODY:
                pixels_px[target] = found.pixel_px
        camera = self._mission.camera.model
        return ground_covariance(pixels_px, camera, shot.pose, self._surface, shot.told)

    def _scores(self, detections: Sequence[Detection], owners: Sequence[int]) -> FloatArray:
        """How surely each target was found. -> (N,), NaN where it was not."""
        scores = np.full(len(self._names), np.nan)
        for found, target in zip(detections, owners, strict=True):
            if target != NOBODY:
                scores[target] = found.score
        return scores
