"""Looks at a picture, tells what it shows, and believes it: in flight, or long after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.errors import CameraError
from dronemon.events import Believed, EventStream, Measured, Pictured
from dronemon.frames import AreaFrame
from dronemon.mission import Mission
from dronemon.runner.preparation import make_belief
from dronemon.runner.tally import Tally
from dronemon.sightings import LEAST_VIEW_AU, Sightings
from dronemon.types import Detection, FloatArray, Measurement, Picture, Pose
from dronemon.vision.detector import Detector, look
from dronemon.vision.ground_error import ground_covariance, radius_m
from dronemon.vision.observe import observe
from dronemon.vision.owners import NOBODY, Owners
from dronemon.vision.project import shown_radius_m
from dronemon.vision.surface import Surface, down_below_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """A picture and where it was taken from.

    told:    how far off that may be, `told_covariance`
    surface: of the ground, where it was looked at; None where it is the mission's
    """

    picture: Picture
    pose: Pose
    told: FloatArray
    surface: Surface | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Glance:
    """What a picture says.

    owners:        which target each find counts as, `NOBODY` for none
    score:         (N,) how surely each target was found, NaN where it was not
    covariance_m2: (N, 2, 2) of the place of each target found, NaN where it was not
    """

    shot: Shot
    detections: tuple[Detection, ...]
    owners: list[int]
    score: FloatArray
    covariance_m2: FloatArray
    measurement: Measurement


class Eyes:
    """From pictures to beliefs. belief: what they have told so far."""

    def __init__(
        self,
        mission: Mission,
        detector: Detector,
        events: EventStream,
        frame: AreaFrame,
        surface: Surface,
        sightings: Sightings,
    ) -> None:
        self._mission, self._detector = mission, detector
        self._events, self._frame, self._surface = events, frame, surface
        self._names = tuple(target.name for target in mission.targets)
        self._owners = Owners.of_mission(mission)
        self.belief = make_belief(mission, sightings)

    def look(self, shot: Shot, start_s: float) -> Glance:
        """What the detector finds, whose each is, and what that says of targets. In a thread.

        start_s: when the patrol began
        Raises CameraError for a detector that fails, and for a picture that shows no target and too
        little ground to say that there is none.
        """
        picture, pose, camera = shot.picture, shot.pose, self._mission.camera.model
        surface = shot.surface or self._surface
        ground_down_m = down_below_m(surface, pose)
        detections = look(self._detector, picture.image, pose, ground_down_m)
        measurement, owners = observe(
            detections,
            pose=pose,
            camera=camera,
            frame=self._frame,
            surface=surface,
            owners=self._owners,
            sightings=self.belief.sightings,
            time_au=self._frame.s_to_au(picture.time_s - start_s),
        )
        if not measurement.seen.any():
            self._check_view(pose, ground_down_m)
        score = np.full(len(self._names), np.nan)
        pixels_px = np.full((len(self._names), 2), np.nan)
        for found, target in zip(detections, owners, strict=True):
            if target != NOBODY:
                score[target], pixels_px[target] = found.score, found.pixel_px
        return Glance(
            shot=shot,
            detections=detections,
            owners=owners,
            score=score,
            covariance_m2=ground_covariance(pixels_px, camera, pose, surface, shot.told),
            measurement=measurement,
        )

    def _check_view(self, pose: Pose, ground_down_m: float) -> None:
        """Raise where it is the camera that shows too little, not what stands in the way."""
        shown_m = shown_radius_m(self._mission.camera.model, pose, ground_down_m)
        needed_m = LEAST_VIEW_AU * self._frame.side_m
        if shown_m < needed_m:
            raise CameraError(
                f"shows {shown_m:.0f} m of ground to all sides of the drone, and {needed_m:.0f} m"
                " are needed to say that no target is there; is it too low, or the camera turned"
                " away?"
            )

    def tell(
        self,
        glance: Glance,
        tally: Tally,
        *,
        battery: float | None = None,
        battery_needed: float = 0.0,
    ) -> None:
        """Tell what a picture says, and count it. Raises RecordError: it counts for nothing then.

        battery, battery_needed: of the vehicle, as far as it says so
        """
        time_s, measurement = glance.shot.picture.time_s, glance.measurement
        stretch = tally.stretch(time_s)
        self._events.emit(
            Measured(
                number=len(self.belief.sightings) + 1,
                time_s=time_s,
                measurement=measurement,
                score=glance.score,
                pose=glance.shot.pose,
                covariance_m2=glance.covariance_m2,
                error_m=radius_m(glance.covariance_m2),
                battery=battery,
                battery_needed=battery_needed,
                stretch=stretch,
            )
        )
        seen = [n for n, is_seen in zip(self._names, measurement.seen, strict=True) if is_seen]
        tally.measure(time_s, stretch.pictured_m, seen)

    def believe(self, glance: Glance) -> None:
        """Take into the beliefs what was told, and show it. Raises RecordError."""
        sightings, picture = self.belief.sightings, glance.shot.picture
        sightings.add(glance.measurement)
        if self._mission.record.pictures:
            self._events.emit(
                Pictured(
                    number=len(sightings),
                    picture=picture,
                    detections=glance.detections,
                    owners=glance.owners,
                    pose=glance.shot.pose,
                )
            )
        self._events.emit(
            Believed(
                time_s=picture.time_s,
                time_au=glance.measurement.time_au,
                posterior=self.belief.posterior_of_now(),
            )
        )
