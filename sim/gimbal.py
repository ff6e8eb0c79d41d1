"""The gimbal that carries the simulated camera: level, whatever the body does, once it is told."""

from __future__ import annotations

import math

from dronemon.types import Vector3

BOOT_S = 2.5
"""Vehicle time at which it is switched on: it counts its own from there."""
_SLEW_RAD_S = 1.5
_LOWEST_RAD, _HIGHEST_RAD = -math.pi / 2.0, math.radians(30.0)


class Gimbal:
    """It holds its pitch against the horizon, and its yaw against the vehicle's heading.

    pitch_rad, yaw_rad: how it is turned; 0 looks ahead
    is_controlled:      whether somebody took control
    is_silent:          whether it does not tell its attitude
    askew_rad:          by how much it looks above where it should
    """

    def __init__(self) -> None:
        self.is_controlled = self.is_silent = False
        self.askew_rad = 0.0
        self.yaw_rad = self._held_rad = 0.0
        self._wanted_rad = (0.0, 0.0)

    @property
    def pitch_rad(self) -> float:
        """How it is turned upwards."""
        return self._held_rad + self.askew_rad

    def point(self, pitch_rad: float, yaw_rad: float) -> bool:
        """Turn it. -> whether it does"""
        if not (self.is_controlled and _LOWEST_RAD <= pitch_rad <= _HIGHEST_RAD):
            return False
        self._wanted_rad = pitch_rad, math.remainder(yaw_rad, math.tau)
        return True

    def look_ahead(self) -> None:
        """Turn ahead, and obey nobody until told who controls it: as PX4 has it on its way home."""
        self.is_controlled, self._wanted_rad = False, (0.0, 0.0)

    def step(self, duration_s: float) -> None:
        """Turn on towards where it should look."""
        most_rad = _SLEW_RAD_S * duration_s
        turned = (self._held_rad, self.yaw_rad)
        self._held_rad, self.yaw_rad = (
            now + min(max(wanted - now, -most_rad), most_rad)
            for now, wanted in zip(turned, self._wanted_rad, strict=True)
        )

    def camera_attitude_rad(self, heading_rad: float) -> Vector3:
        """Roll, pitch and yaw of the camera, which looks straight down where they are 0."""
        return 0.0, self.pitch_rad + math.pi / 2.0, heading_rad + self.yaw_rad
