"""A quadrotor's true motion in wind: tilt follows thrust, acceleration follows tilt.

The thrust direction lags and its rate is limited, so that acceleration has no steps and a camera
that is fixed to the body tilts as a real one would. Plain floats: this runs at 100 Hz of vehicle
time, up to 20 times faster than the wall clock.
"""

from __future__ import annotations

import math
import random

from dronemon.types import GRAVITY_M_S2, Pose, Vector3

_DRAG_PER_S = 0.15
"""Deceleration per airspeed; 5 m/s of it needs 4.4 degrees of tilt."""
_ATTITUDE_RAD_S = 12.0
"""Natural frequency of the (critically damped) attitude control."""
_TILT_RATE_MAX_RAD_S = math.radians(220.0)
_THRUST_LAG_S = 0.05
_YAW_PER_S = 2.8
_YAW_ACCELERATION_RAD_S2 = 3.0
_GUST_SHARE = 0.15
_GUST_TIME_S = 5.0


def wrap_angle(angle_rad: float) -> float:
    """Give the same direction within -pi to pi."""
    return math.remainder(angle_rad, math.tau)


class Wind:
    """Steady wind with slow gusts of 15 % (one sigma) of its mean."""

    def __init__(self, mean_m_s: float, from_rad: float, rng: random.Random) -> None:
        self._mean_ned = (-mean_m_s * math.cos(from_rad), -mean_m_s * math.sin(from_rad))
        self._sigma = _GUST_SHARE * mean_m_s
        self._gust = [0.0, 0.0]
        self._rng = rng
        self.north_m_s, self.east_m_s = self._mean_ned

    def step(self, dt_s: float) -> None:
        """Let the gusts wander."""
        if self._sigma == 0.0:
            return
        keep = math.exp(-dt_s / _GUST_TIME_S)
        spread = self._sigma * math.sqrt(1.0 - keep * keep)
        for axis in (0, 1):
            self._gust[axis] = keep * self._gust[axis] + spread * self._rng.gauss(0.0, 1.0)
        self.north_m_s = self._mean_ned[0] + self._gust[0]
        self.east_m_s = self._mean_ned[1] + self._gust[1]


class Quadrotor:
    """The body: true position, velocity, acceleration and attitude in the local NED frame.

    position:         north, east, down in m
    velocity:         m/s
    acceleration:     m/s2
    roll, pitch, yaw: rad; their rates rad/s
    thrust_m_s2:      over mass; hovering needs 9.8
    ground_down_m:    down coordinate of the ground below
    """

    def __init__(self, start_ned_m: Vector3, yaw_rad: float, wind: Wind) -> None:
        self.ground_down_m = start_ned_m[2]
        self._wind = wind
        self.position = list(start_ned_m)
        self.velocity = [0.0, 0.0, 0.0]
        self.acceleration = [0.0, 0.0, 0.0]
        self.roll = self.pitch = 0.0
        self.yaw = yaw_rad
        self.roll_rate = self.pitch_rate = self.yaw_rate = 0.0
        self.thrust_m_s2 = 0.0

    @property
    def is_on_ground(self) -> bool:
        """Whether the ground carries it."""
        return self.position[2] >= self.ground_down_m

    def pose(self, time_s: float) -> Pose:
        """The true pose, stamped with `time_s`."""
        north, east, down = self.position
        v_north, v_east, v_down = self.velocity
        return Pose(
            time_s=time_s,
            position_ned_m=(north, east, down),
            velocity_ned_m_s=(v_north, v_east, v_down),
            attitude_rad=(self.roll, self.pitch, self.yaw),
        )

    def step(
        self, thrust_ned_m_s2: Vector3, yaw_rad: float, yaw_rate_max_rad_s: float, dt_s: float
    ) -> None:
        """Move on, pushed towards the given thrust over mass and turned towards a yaw."""
        self._wind.step(dt_s)
        self._turn(yaw_rad, yaw_rate_max_rad_s, dt_s)
        self._tilt(thrust_ned_m_s2, dt_s)
        self._move(dt_s)

    def _turn(self, yaw_rad: float, rate_max_rad_s: float, dt_s: float) -> None:
        wanted = wrap_angle(yaw_rad - self.yaw) * _YAW_PER_S
        wanted = min(max(wanted, -rate_max_rad_s), rate_max_rad_s)
        most = _YAW_ACCELERATION_RAD_S2 * dt_s
        self.yaw_rate += min(max(wanted - self.yaw_rate, -most), most)
        self.yaw = wrap_angle(self.yaw + self.yaw_rate * dt_s)

    def _tilt(self, thrust: Vector3, dt_s: float) -> None:
        """Turn the body's down axis against the wanted thrust."""
        size = math.sqrt(thrust[0] ** 2 + thrust[1] ** 2 + thrust[2] ** 2)
        roll = pitch = 0.0
        if size > 1e-6 and not (self.is_on_ground and size < GRAVITY_M_S2):
            sin_yaw, cos_yaw = math.sin(self.yaw), math.cos(self.yaw)
            forward = cos_yaw * thrust[0] + sin_yaw * thrust[1]
            right = cos_yaw * thrust[1] - sin_yaw * thrust[0]
            pitch = math.atan2(-forward, -thrust[2])
            roll = math.asin(right / size)
        self.thrust_m_s2 += (size - self.thrust_m_s2) * (1.0 - math.exp(-dt_s / _THRUST_LAG_S))
        self.roll_rate = _approach(roll - self.roll, self.roll_rate, dt_s)
        self.pitch_rate = _approach(pitch - self.pitch, self.pitch_rate, dt_s)
        self.roll += self.roll_rate * dt_s
        self.pitch += self.pitch_rate * dt_s

    def _move(self, dt_s: float) -> None:
        sin_yaw, cos_yaw = math.sin(self.yaw), math.cos(self.yaw)
        sin_pitch, cos_pitch = math.sin(self.pitch), math.cos(self.pitch)
        sin_roll, cos_roll = math.sin(self.roll), math.cos(self.roll)
        along, across = sin_pitch * cos_roll, -sin_roll
        push = -self.thrust_m_s2
        a_north = push * (cos_yaw * along - sin_yaw * across)
        a_east = push * (sin_yaw * along + cos_yaw * across)
        a_down = push * cos_pitch * cos_roll + GRAVITY_M_S2
        velocity, position = self.velocity, self.position
        a_north -= _DRAG_PER_S * (velocity[0] - self._wind.north_m_s)
        a_east -= _DRAG_PER_S * (velocity[1] - self._wind.east_m_s)
        a_down -= _DRAG_PER_S * velocity[2]
        if position[2] >= self.ground_down_m and a_down >= 0.0:
            self.position[2] = self.ground_down_m
            self.velocity = [0.0, 0.0, 0.0]
            self.acceleration = [0.0, 0.0, 0.0]
            return
        self.acceleration = [a_north, a_east, a_down]
        for axis in (0, 1, 2):
            before = velocity[axis]
            velocity[axis] = before + self.acceleration[axis] * dt_s
            position[axis] += 0.5 * (before + velocity[axis]) * dt_s
        if position[2] > self.ground_down_m:
            position[2] = self.ground_down_m
            velocity[:] = (0.0, 0.0, 0.0)


def _approach(error_rad: float, rate_rad_s: float, dt_s: float) -> float:
    """Next rate of a critically damped, rate-limited turn by `error_rad`."""
    turn = _ATTITUDE_RAD_S * _ATTITUDE_RAD_S * error_rad - 2.0 * _ATTITUDE_RAD_S * rate_rad_s
    rate = rate_rad_s + turn * dt_s
    return min(max(rate, -_TILT_RATE_MAX_RAD_S), _TILT_RATE_MAX_RAD_S)
