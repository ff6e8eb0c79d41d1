"""What the autopilot believes about its motion: the truth plus a slowly wandering error.

Besides the position's error, which the mission sets, there are 0.15 degrees (one sigma) of tilt.
Without GPS the horizontal position drifts away by up to 16 m.
"""

from __future__ import annotations

import math
import random

from sim.dynamics import Quadrotor

READY_AFTER_S = 3.0
"""From boot to the first position."""
GPS_LOSS_TOLERATED_S = 5.4
"""How long the position counts as valid without GPS."""
_TRUSTED_AGAIN_S = 2.0
_TILT_SIGMA_RAD = math.radians(0.15)
_WANDER_RAD_S = 0.1
_DRIFT_M_S = 0.8
_DRIFT_MAX_M = 16.0
_RECOVERY_TIME_S = 1.0


class _Wander:
    """A smooth stationary error: white noise through a critically damped second-order filter."""

    def __init__(self, sigma: float, rng: random.Random) -> None:
        self._rng = rng
        self._kick = sigma * 2.0 * _WANDER_RAD_S**1.5
        self.value = rng.gauss(0.0, sigma)
        self.rate = rng.gauss(0.0, sigma * _WANDER_RAD_S)

    def step(self, dt_s: float) -> None:
        pull = -_WANDER_RAD_S * (2.0 * self.rate + _WANDER_RAD_S * self.value)
        self.rate += pull * dt_s + self._kick * math.sqrt(dt_s) * self._rng.gauss(0.0, 1.0)
        self.value += self.rate * dt_s


class Estimator:
    """Position, velocity and attitude as telemetry reports them and the control uses them.

    gps_lost_s:   how long GPS has been away; 0 while it is there
    has_position: whether the horizontal position is valid
    num_resets:   jumps of the position since boot
    """

    def __init__(self, body: Quadrotor, rng: random.Random, noise_m: float) -> None:
        self._body = body
        self._errors = [_Wander(noise_m, rng) for _ in range(3)]
        self._tilt_errors = [_Wander(_TILT_SIGMA_RAD, rng) for _ in range(2)]
        self._drift_heading_rad = rng.uniform(-math.pi, math.pi)
        self._drift_m = 0.0
        self._jump_m = 0.0
        self._age_s = 0.0
        self._distrusted_until_s = READY_AFTER_S
        self.gps_lost_s = 0.0
        self.num_resets = 0
        self.position = [0.0, 0.0, 0.0]
        self.velocity = [0.0, 0.0, 0.0]
        self.roll = self.pitch = self.yaw = 0.0
        self.step(0.0, has_gps=True)

    @property
    def has_position(self) -> bool:
        """Whether the horizontal position is valid; after a loss it is on probation."""
        return self._age_s >= self._distrusted_until_s

    def jump(self, distance_m: float) -> None:
        """Be off by this distance from now on, as when the GPS receiver's position jumps."""
        self._jump_m = distance_m
        self.num_resets += 1

    def step(self, dt_s: float, *, has_gps: bool) -> None:
        """Estimate the body's new motion."""
        self._age_s += dt_s
        drift_rate = self._step_drift(dt_s, has_gps=has_gps)
        toward = (math.cos(self._drift_heading_rad), math.sin(self._drift_heading_rad), 0.0)
        for axis, error in enumerate(self._errors):
            error.step(dt_s)
            away_m = (self._drift_m + self._jump_m) * toward[axis]
            self.position[axis] = self._body.position[axis] + error.value + away_m
            self.velocity[axis] = self._body.velocity[axis] + error.rate + drift_rate * toward[axis]
        for error in self._tilt_errors:
            error.step(dt_s)
        self.roll = self._body.roll + self._tilt_errors[0].value
        self.pitch = self._body.pitch + self._tilt_errors[1].value
        self.yaw = self._body.yaw

    def _step_drift(self, dt_s: float, *, has_gps: bool) -> float:
        """Grow or heal the drift. -> its rate in m/s."""
        if has_gps:
            self.gps_lost_s = 0.0
            self._drift_m *= math.exp(-dt_s / _RECOVERY_TIME_S)
            return 0.0
        self.gps_lost_s += dt_s
        if self.gps_lost_s >= GPS_LOSS_TOLERATED_S:
            self._distrusted_until_s = self._age_s + _TRUSTED_AGAIN_S
        if self._drift_m >= _DRIFT_MAX_M:
            return 0.0
        self._drift_m += _DRIFT_M_S * dt_s
        return _DRIFT_M_S
