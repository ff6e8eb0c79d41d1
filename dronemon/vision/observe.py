"""What the binary sensor says about every target, given what was found in one picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dronemon.frames import AreaFrame, pixel_to_ground
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import CameraModel, Detection, Measurement, Pose

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
    appearances: Sequence[str],
    time_au: float,
) -> Measurement:
    """One observation of every target.

    A target is seen if it was found less than SENSOR_RADIUS_AU from the vehicle, over ground; what
    the picture shows beyond does not count. Of two finds the one with the higher score holds.
    appearances: of the targets, in their order
    Source: paper, equation 1.
    """
    agent_au = frame.ned_to_au(np.array(pose.position_ned_m))
    seen = np.zeros(len(appearances), np.bool_)
    target_au = np.full((len(appearances), 2), np.nan)
    for detection in sorted(detections, key=lambda d: d.score):
        pixel_px = np.array(detection.pixel_px)
        ground_ned_m = pixel_to_ground(pixel_px, camera, pose, frame.ground_down_m)
        at_au = frame.ned_to_au(ground_ned_m)
        if np.linalg.norm(at_au - agent_au) < SENSOR_RADIUS_AU:
            is_it = np.array([name == detection.appearance for name in appearances])
            seen |= is_it
            target_au[is_it] = at_au
    return Measurement(time_au=time_au, agent_au=agent_au, seen=seen, target_au=target_au)
