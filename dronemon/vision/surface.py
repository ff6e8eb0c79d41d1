"""The ground's surface as pictures are laid on it; `terrain` has the one that is not flat."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from dronemon.errors import CameraError
from dronemon.frames import pixel_to_ground
from dronemon.types import CameraModel, FloatArray, Pose


class Surface(Protocol):
    """Where the ground is, in the vehicle's local frame."""

    def places(self, pixel_px: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
        """Where the rays of pixels meet the ground first; NaN where they do not.

        pixel_px: (..., 2) u, v -> (..., 2) north, east in m
        """

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """Down coordinate of the ground. place_ned_m: (..., 2) north, east -> (...)."""

    def slope(self, place_ned_m: FloatArray) -> FloatArray:
        """How steeply it goes down. place_ned_m: (..., 2) -> (..., 2) m per m north and east."""

    def hidden_au(self, pose: Pose) -> FloatArray | None:
        """What things that stand on it hide from a camera, as `Measurement.hidden_au` has it."""


def down_below_m(surface: Surface, pose: Pose) -> float:
    """Down coordinate of the ground below a vehicle. Raises CameraError where it is not known."""
    down_m = float(surface.down_m(np.array(pose.position_ned_m[:2])))
    if not math.isfinite(down_m):
        north_m, east_m, _ = pose.position_ned_m
        raise CameraError(
            f"the terrain has no height below the drone, {north_m:.0f} m north and {east_m:.0f} m"
            " east of the origin; area.terrain is to cover more"
        )
    return down_m


class Plane:
    """Flat ground."""

    def __init__(self, down_m: float) -> None:
        self._down_m = down_m

    def places(self, pixel_px: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
        """See `Surface`."""
        return pixel_to_ground(pixel_px, camera, pose, self._down_m)

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`."""
        return np.full(np.shape(place_ned_m)[:-1], self._down_m)

    def slope(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`."""
        return np.zeros(np.shape(place_ned_m))

    def hidden_au(self, _: Pose) -> FloatArray | None:
        """See `Surface`: nothing stands on it."""
        return None
