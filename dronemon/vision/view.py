"""From what height the camera sees what the detector needs, and all that is to be looked at."""

from __future__ import annotations

import math

from dronemon.mission import Mission
from dronemon.mission.schema import GIMBAL_ERROR_DEG
from dronemon.vision.prototypes import PROTOTYPES


def px_per_m(mission: Mission) -> float:
    """Size on the picture, seen from the patrol's height, of a metre on the ground."""
    return mission.camera.model.focal_px / mission.flight.altitude_m


def needed_px_per_m(mission: Mission) -> float | None:
    """The least that the detector needs of it; None where nobody has said."""
    of = mission.detector
    if of.kind == "markers" and of.needed_px_per_m is None and of.side_m is not None:
        from dronemon.vision.markers import FAMILIES, px_per_m_of_marker

        # A family that there is not is told where the detector is made.
        return px_per_m_of_marker(of.family, of.side_m) if of.family in FAMILIES else None
    if of.needed_px_per_m is not None or of.kind != "drawn":
        return of.needed_px_per_m
    looks = {target.appearance for target in mission.targets} & PROTOTYPES.keys()
    return max((PROTOTYPES[look].needed_px_per_m for look in looks), default=None)


def tilt_rad(mission: Mission) -> float:
    """How far the camera may look off straight down: as the drone banks, or as its gimbal errs."""
    is_level = mission.camera.gimbal
    return math.radians(GIMBAL_ERROR_DEG) if is_level else mission.flight.bank_rad


def needed_altitude_m(mission: Mission) -> float:
    """Height from which a tilted camera sees the whole footprint in its shorter direction."""
    camera, off_rad = mission.camera.model, tilt_rad(mission)
    half_angle_rad = min(camera.horizontal_fov_rad, camera.vertical_fov_rad) / 2.0
    if half_angle_rad <= off_rad:
        return math.inf
    return mission.sensor_radius_m / math.tan(half_angle_rad - off_rad)
