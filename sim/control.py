"""From setpoints to thrust: PX4's cascade of position P and velocity PID with feed-forward."""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import isnan, nan

from dronemon.types import GRAVITY_M_S2, Vector3
from sim.parameters import Parameters

UNSET: Vector3 = (nan, nan, nan)
_INTEGRAL_MAX_M_S2 = 5.0
_WINDUP_GAIN = 2.0
_THRUST_MIN_M_S2 = 0.2 * GRAVITY_M_S2
_THRUST_MAX_M_S2 = 2.0 * GRAVITY_M_S2


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectorySetpoint:
    """What to fly: NED metres and seconds; NaN leaves an axis free.

    A velocity next to a position, and an acceleration next to either, is fed forward.
    """

    position: Vector3 = UNSET
    velocity: Vector3 = UNSET
    acceleration: Vector3 = UNSET
    yaw_rad: float = nan
    yaw_rate_rad_s: float = nan

    @property
    def is_flyable(self) -> bool:
        """Whether every axis is controlled, as PX4 wants it of a setpoint."""
        axes = zip(self.position, self.velocity, self.acceleration, strict=True)
        return all(not (isnan(p) and isnan(v) and isnan(a)) for p, v, a in axes)


class PositionController:
    """Thrust over mass that brings the estimate to a setpoint."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Forget the integrals, as on the ground."""
        self._integral = [0.0, 0.0, 0.0]

    def thrust(
        self,
        setpoint: TrajectorySetpoint,
        position: list[float],
        velocity: list[float],
        acceleration: list[float],
        climb_max_m_s: float,
        dt_s: float,
    ) -> Vector3:
        """One step of control, climbing no faster than `climb_max_m_s`. -> NED thrust in m/s2."""
        p = self._parameters
        gains = (p["MPC_XY_VEL_P_ACC"], p["MPC_XY_VEL_P_ACC"], p["MPC_Z_VEL_P_ACC"])
        rates = (p["MPC_XY_VEL_I_ACC"], p["MPC_XY_VEL_I_ACC"], p["MPC_Z_VEL_I_ACC"])
        damping = (p["MPC_XY_VEL_D_ACC"], p["MPC_XY_VEL_D_ACC"], 0.0)
        wanted = self._wanted_velocity(setpoint, position, climb_max_m_s)
        push, errors = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        for axis in (0, 1, 2):
            feed = setpoint.acceleration[axis]
            push[axis] = 0.0 if isnan(feed) else feed
            if isnan(wanted[axis]):
                continue
            errors[axis] = wanted[axis] - velocity[axis]
            push[axis] += gains[axis] * errors[axis] + self._integral[axis]
            push[axis] -= damping[axis] * acceleration[axis]
        thrust = self._limited(push)
        for axis in (0, 1):  # anti-windup: what the limits take away is not integrated
            errors[axis] -= _WINDUP_GAIN / gains[axis] * (push[axis] - thrust[axis])
        for axis in (0, 1, 2):
            integral = self._integral[axis] + rates[axis] * errors[axis] * dt_s
            self._integral[axis] = min(max(integral, -_INTEGRAL_MAX_M_S2), _INTEGRAL_MAX_M_S2)
        return thrust

    def _wanted_velocity(
        self, setpoint: TrajectorySetpoint, position: list[float], climb_max_m_s: float
    ) -> list[float]:
        """Velocity setpoint: position P plus feed-forward, limited. NaN where neither is given."""
        p = self._parameters
        correction, feed, free = [0.0] * 3, [0.0] * 3, [False] * 3
        for axis, gain in enumerate((p["MPC_XY_P"], p["MPC_XY_P"], p["MPC_Z_P"])):
            at, speed = setpoint.position[axis], setpoint.velocity[axis]
            free[axis] = isnan(at) and isnan(speed)
            if not isnan(at):
                correction[axis] = (at - position[axis]) * gain
            if not isnan(speed):
                feed[axis] = speed
        north, east = _within(correction, feed, p["MPC_XY_VEL_MAX"])
        up_max = min(p["MPC_Z_VEL_MAX_UP"], climb_max_m_s)
        down = min(max(correction[2] + feed[2], -up_max), p["MPC_Z_VEL_MAX_DN"])
        return [nan if free[i] else v for i, v in enumerate((north, east, down))]

    def _limited(self, push: list[float]) -> Vector3:
        """Thrust for an acceleration, within the limits on thrust and tilt; upward comes first."""
        up = min(max(GRAVITY_M_S2 - push[2], _THRUST_MIN_M_S2), _THRUST_MAX_M_S2)
        sideways = math.hypot(push[0], push[1])
        tilt_max = math.tan(math.radians(self._parameters["MPC_TILTMAX_AIR"]))
        most = min(up * tilt_max, math.sqrt(max(_THRUST_MAX_M_S2**2 - up * up, 0.0)))
        scale = min(1.0, most / sideways) if sideways > 0.0 else 0.0
        return (push[0] * scale, push[1] * scale, -up)


def _within(first: list[float], second: list[float], limit: float) -> tuple[float, float]:
    """Horizontal sum of two vectors, shortened to a limit at the second one's cost."""
    north, east = first[0] + second[0], first[1] + second[1]
    if math.hypot(north, east) <= limit:
        return north, east
    size = math.hypot(first[0], first[1])
    if size >= limit:
        return first[0] * limit / size, first[1] * limit / size
    length = math.hypot(second[0], second[1])
    unit = (second[0] / length, second[1] / length)
    along = unit[0] * first[0] + unit[1] * first[1]
    reach = -along + math.sqrt(along * along + limit * limit - size * size)
    return first[0] + unit[0] * reach, first[1] + unit[1] * reach
