"""What a table, or a picture itself, says of a picture taken in a flight: when, where and how."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from dronemon.errors import CameraError
from dronemon.frames import GeoPoint, gimbal_to_camera
from dronemon.types import Vector3

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.A)
_HIGHEST_M, _MOST_DEG, _FIRST_YEAR = 10_000.0, 360.0, 1970
_MOST_TOLD = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """One picture.

    told_by:      who says so: the table's file and line, or the picture
    time:         seconds, or a date
    place:        its altitude is above the ground of the start
    attitude_rad: as `Pose.attitude_rad`
    has_gimbal:   whether that is the camera's own, rather than the vehicle's
    """

    told_by: str
    name: str
    time: float | datetime
    place: GeoPoint
    attitude_rad: Vector3
    has_gimbal: bool


def number(text: str) -> float:
    """A number as loggers write it. Raises ValueError."""
    if not text.strip():
        raise ValueError("is empty")
    if not (_NUMBER.fullmatch(text.strip()) and math.isfinite(value := float(text))):
        raise ValueError(f"{text!a:.40} is no number")
    return value


def checked_time(time: datetime) -> datetime:
    """A date at which a picture may have been taken. Raises ValueError."""
    if time.year < _FIRST_YEAR:
        raise ValueError(f"{time} is before {_FIRST_YEAR}")
    return time


def checked_place(latitude_deg: float, longitude_deg: float, altitude_m: float) -> GeoPoint:
    """A place where a picture may have been taken. Raises ValueError."""
    where = f"latitude {latitude_deg:g}, longitude {longitude_deg:g}"
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        is_swapped = abs(longitude_deg) <= 90.0 and abs(latitude_deg) <= 180.0
        hint = "are they swapped?" if is_swapped else "give degrees, -90 to 90 and -180 to 180"
        raise ValueError(f"{where} is no place; {hint}")
    if latitude_deg == longitude_deg == 0.0:
        raise ValueError(f"{where} is what is written without GPS")
    if not abs(altitude_m) <= _HIGHEST_M:
        raise ValueError(f"an altitude of {altitude_m:g} m is no drone's")
    return GeoPoint(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m)


def checked_attitude(angles_deg: Sequence[float], *, has_gimbal: bool) -> Vector3:
    """Attitude of roll, pitch and yaw of a vehicle, or of a gimbal. Raises ValueError."""
    if not all(abs(angle_deg) <= _MOST_DEG for angle_deg in angles_deg):
        told = ", ".join(f"{angle_deg:g}" for angle_deg in angles_deg)
        raise ValueError(f"roll, pitch, yaw of {told} are no angles in degrees")
    roll, pitch, yaw = (math.radians(angle_deg) for angle_deg in angles_deg)
    return gimbal_to_camera((roll, pitch, yaw)) if has_gimbal else (roll, pitch, yaw)


def refuse(problems: Sequence[str]) -> None:
    """Raise CameraError with all problems, or the first of many; nothing if there is none."""
    if problems:
        more = len(problems) - _MOST_TOLD
        told = [*problems[:_MOST_TOLD], *([f"and {more} more"] if more > 0 else [])]
        raise CameraError("\n".join(told))
