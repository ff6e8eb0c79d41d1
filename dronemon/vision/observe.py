"""What the binary sensor says about every target, given what was found in one picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dronemon.frames import AreaFrame, pixel_to_ground
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.sightings import Sightings
from dronemon.types import CameraModel, Detection, Measurement, Pose
from dronemon.vision.owners import NOBODY, Owners

_TILT_RAD = math.radians(2.0)
"""Of the camera against what the vehicle says of its attitude, its mounting included."""
_LATE_S = 0.05
"""Of the picture's time against the pose's."""
_DEFAULT_ACCURACY_M = 2.0
_WITHIN_95 = math.sqrt(-2.0 * math.log(0.05))
"""Standard deviations along one axis in which 95 of 100 places lie, two axes being alike."""


def sighting_error_m(pose: Pose, frame: AreaFrame, accuracy_m: float | None) -> float:
    """Radius about a place seen in which the target truly is, in 95 pictures of 100.

    From the vehicle's own place, tilt and time alone; where the detector errs is not in it.
    accuracy_m: standard deviation of the vehicle's place along one axis, None where it does not say
    """
    place_m = _WITHIN_95 * (_DEFAULT_ACCURACY_M if accuracy_m is None else accuracy_m)
    tilt_m = frame.height_m(pose.position_ned_m[2]) * math.tan(_TILT_RAD)
    return math.hypot(place_m, tilt_m, pose.ground_speed_m_s * _LATE_S)


def observe(
    detections: Sequence[Detection],
    *,
    pose: Pose,
    camera: CameraModel,
    frame: AreaFrame,
    owners: Owners,
    sightings: Sightings,
    time_au: float,
) -> tuple[Measurement, list[int]]:
    """One observation of every target, and which of them each find is, or `NOBODY`.

    A target is seen if it was found less than SENSOR_RADIUS_AU from the vehicle, over ground; what
    the picture shows beyond does not count.
    sightings: what was seen before
    Source: paper, equation 1.
    """
    agent_au = frame.ned_to_au(np.array(pose.position_ned_m))
    pixels_px = np.array([d.pixel_px for d in detections]).reshape(-1, 2)
    places_au = frame.ned_to_au(pixel_to_ground(pixels_px, camera, pose, frame.ground_down_m))
    away_au = np.linalg.norm(places_au - agent_au, axis=-1)
    near = np.flatnonzero(away_au < SENSOR_RADIUS_AU).tolist()
    own = owners.of(
        [detections[d].appearance for d in near],
        [detections[d].score for d in near],
        places_au[near],
        agent_au=agent_au,
        time_au=time_au,
        sightings=sightings,
    )
    seen = np.zeros(owners.num_targets, np.bool_)
    target_au = np.full((owners.num_targets, 2), np.nan)
    whose = [NOBODY] * len(detections)
    for find, target in zip(near, own, strict=True):
        if target != NOBODY:
            whose[find], seen[target], target_au[target] = target, True, places_au[find]
    measurement = Measurement(time_au=time_au, agent_au=agent_au, seen=seen, target_au=target_au)
    return measurement, whose
