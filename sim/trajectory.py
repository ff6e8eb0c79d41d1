"""Smooth motion to a point, limited in speed, acceleration and jerk: how AUTO modes fly."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dronemon.types import Vector3

_RESPONSE_S = 0.2
_NEAR_PER_S = 0.8
"""Close to the target, speed is at most this times the distance, so that the last metre is calm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How a trajectory may move: speeds in m/s, accelerations in m/s2, jerk in m/s3."""

    speed: float
    up: float
    down: float
    acceleration: float
    acceleration_vertical: float
    jerk: float


class Trajectory:
    """A point that moves to a target: what the position control is fed with."""

    def __init__(self, position: list[float], velocity: list[float]) -> None:
        self.position = list(position)
        self.velocity = list(velocity)
        self.acceleration = [0.0, 0.0, 0.0]

    def step(self, target: Vector3, limits: Limits, dt_s: float) -> None:
        """Move towards the target for one time step."""
        north, east = target[0] - self.position[0], target[1] - self.position[1]
        distance = math.hypot(north, east)
        speed = _approach_speed(distance, limits.speed, limits.acceleration, limits.jerk)
        scale = speed / distance if distance > 1e-9 else 0.0
        self._push((0, 1), (north * scale, east * scale), limits.acceleration, limits.jerk, dt_s)
        down = target[2] - self.position[2]
        most = limits.down if down > 0.0 else limits.up
        a_max = limits.acceleration_vertical
        speed = math.copysign(_approach_speed(abs(down), most, a_max, limits.jerk), down)
        self._push((2,), (speed,), a_max, limits.jerk, dt_s)

    def _push(
        self,
        axes: tuple[int, ...],
        wanted: tuple[float, ...],
        acceleration: float,
        jerk: float,
        dt_s: float,
    ) -> None:
        """Change the velocity of some axes towards the wanted one and move along them."""
        lack = [w - self.velocity[i] for i, w in zip(axes, wanted, strict=True)]
        size = math.hypot(*lack)
        # What can be taken back, within the jerk limit, before the wanted velocity is passed.
        most = min(acceleration, math.sqrt(2.0 * jerk * size), size / _RESPONSE_S)
        scale = most / size if size > 0.0 else 0.0
        change = [v * scale - self.acceleration[i] for i, v in zip(axes, lack, strict=True)]
        size = math.hypot(*change)
        scale = jerk * dt_s / size if size > jerk * dt_s else 1.0
        for axis, step in zip(axes, change, strict=True):
            self.acceleration[axis] += step * scale
            self.velocity[axis] += self.acceleration[axis] * dt_s
            self.position[axis] += self.velocity[axis] * dt_s


def stopping_point(position: list[float], velocity: list[float], limits: Limits) -> Vector3:
    """Where a vehicle comes to rest when it brakes now."""
    speed = math.hypot(velocity[0], velocity[1])
    time_s = speed / (2.0 * limits.acceleration) + limits.acceleration / limits.jerk
    time_z_s = abs(velocity[2]) / (2.0 * limits.acceleration_vertical) + 0.3
    return (
        position[0] + velocity[0] * time_s,
        position[1] + velocity[1] * time_s,
        position[2] + velocity[2] * time_z_s,
    )


def _approach_speed(distance: float, speed: float, acceleration: float, jerk: float) -> float:
    """Speed from which braking within jerk and acceleration limits ends after `distance`."""
    lag = 4.0 * acceleration * acceleration / jerk
    braking = 0.5 * (math.sqrt(lag * lag + 8.0 * acceleration * distance) - lag)
    return min(speed, braking, _NEAR_PER_S * distance)
