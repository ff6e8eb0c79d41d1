"""Looks at a picture, tells what it shows, and believes it: in flight, or long after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.events import Believed, EventStream, Measured, Pictured
from dronemon.frames import AreaFrame
from dronemon.mission import Mission
from dronemon.runner.preparation import make_belief
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import Detection, FloatArray, Measurement, Picture, Pose
from dronemon.vision.detector import Detector, look
from dronemon.vision.observe import observe, sighting_error_m
from dronemon.vision.owners import NOBODY, Owners


@dataclass(frozen=True, slots=True, kw_only=True)
class Glance:
    """What a picture says.

    owners: which target each find counts as, `NOBODY` for none
    score:  (N,) how surely each target was found, NaN where it was not
    """

    picture: Picture
    pose: Pose
    detections: tuple[Detection, ...]
    owners: list[int]
    score: FloatArray
    measurement: Measurement


class Eyes:
    """From pictures to beliefs. belief: what they have told so far."""

    def __init__(
        self,
        mission: Mission,
        detector: Detector,
        events: EventStream,
        frame: AreaFrame,
        sightings: Sightings,
    ) -> None:
        self._mission, self._detector = mission, detector
        self._events, self._frame = events, frame
        self._names = tuple(target.name for target in mission.targets)
        self._owners = Owners.of_mission(mission)
        self.belief = make_belief(mission, sightings)

    def look(self, picture: Picture, pose: Pose, start_s: float) -> Glance:
        """What the detector finds, whose each is, and what that says of targets. In a thread.

        start_s: when the patrol began
        Raises CameraError for a detector that fails.
        """
        detections = look(self._detector, picture.image, pose, self._frame.ground_down_m)
        measurement, owners = observe(
            detections,
            pose=pose,
            camera=self._mission.camera.model,
            frame=self._frame,
            owners=self._owners,
            sightings=self.belief.sightings,
            time_au=self._frame.s_to_au(picture.time_s - start_s),
        )
        score = np.full(len(self._names), np.nan)
        for found, target in zip(detections, owners, strict=True):
            if target != NOBODY:
                score[target] = found.score
        return Glance(
            picture=picture,
            pose=pose,
            detections=detections,
            owners=owners,
            score=score,
            measurement=measurement,
        )

    def tell(
        self,
        glance: Glance,
        tally: Tally,
        *,
        accuracy_m: float | None = None,
        battery: float | None = None,
        battery_needed: float = 0.0,
    ) -> None:
        """Tell what a picture says, and count it. Raises RecordError: it counts for nothing then.

        accuracy_m, battery, battery_needed: of the vehicle, as far as it says so
        """
        time_s, measurement = glance.picture.time_s, glance.measurement
        stretch = tally.stretch(time_s)
        self._events.emit(
            Measured(
                number=len(self.belief.sightings) + 1,
                time_s=time_s,
                measurement=measurement,
                score=glance.score,
                pose=glance.pose,
                error_m=sighting_error_m(glance.pose, self._frame, accuracy_m),
                battery=battery,
                battery_needed=battery_needed,
                stretch=stretch,
            )
        )
        seen = [n for n, is_seen in zip(self._names, measurement.seen, strict=True) if is_seen]
        tally.measure(time_s, stretch.pictured_m, seen)

    def believe(self, glance: Glance) -> None:
        """Take into the beliefs what was told, and show it. Raises RecordError."""
        sightings, picture = self.belief.sightings, glance.picture
        sightings.add(glance.measurement)
        if self._mission.record.pictures:
            self._events.emit(
                Pictured(
                    number=len(sightings),
                    picture=picture,
                    detections=glance.detections,
                    owners=glance.owners,
                    pose=glance.pose,
                )
            )
        self._events.emit(
            Believed(
                time_s=picture.time_s,
                time_au=glance.measurement.time_au,
                posterior=self.belief.posterior_of_now(),
            )
        )
