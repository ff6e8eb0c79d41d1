"""Where each flight mode goes: take-off, hold, return and landing, as PX4's navigator has them."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum, auto
from math import nan

from dronemon.types import Vector3
from sim.control import UNSET, TrajectorySetpoint
from sim.estimator import Estimator
from sim.modes import Px4Mode
from sim.parameters import Parameters
from sim.trajectory import Limits, Trajectory, stopping_point

_FAR_DOWN_M = 1000.0
_AT_REST_M_S = 0.5


class _Return(Enum):
    """Stages of the return to launch."""

    CLIMB = auto()
    CRUISE = auto()
    DESCEND = auto()
    LAND = auto()


class Navigator:
    """Turns the flight mode into setpoints; OFFBOARD's come from outside."""

    def __init__(self, parameters: Parameters, estimate: Estimator) -> None:
        self._parameters = parameters
        self._estimate = estimate
        self._trajectory = Trajectory(estimate.position, estimate.velocity)
        self._target: Vector3 = (0.0, 0.0, 0.0)
        self._yaw_rad = 0.0
        self._return = _Return.CLIMB
        self._cruise_m_s: float | None = None
        self.home: Vector3 = (0.0, 0.0, 0.0)
        self.takeoff_down_m = nan
        """Where the next take-off ends; NaN: MIS_TAKEOFF_ALT above home."""

    @property
    def is_landing(self) -> bool:
        """Whether a return has reached its last stage."""
        return self._return is _Return.LAND

    @property
    def height_m(self) -> float:
        """Estimated height above home."""
        return self.home[2] - self._estimate.position[2]

    def enter(self, mode: Px4Mode) -> None:
        """Begin a mode from where the vehicle is."""
        estimate = self._estimate
        self._trajectory = Trajectory(estimate.position, estimate.velocity)
        self._yaw_rad = estimate.yaw
        self._cruise_m_s = None
        self._target = stopping_point(estimate.position, estimate.velocity, self._limits())
        if mode is Px4Mode.TAKEOFF:
            self._target = self._takeoff_target()
        elif mode is Px4Mode.RTL:
            self._return = _Return.CLIMB
            self._target = (*self._target[:2], self._return_down())

    def hold_at(self, target: Vector3, yaw_rad: float, speed_m_s: float) -> None:
        """Fly to a place and hold there; NaN leaves height, yaw or speed as they are."""
        down = self._target[2] if math.isnan(target[2]) else target[2]
        self._target = (target[0], target[1], down)
        self._yaw_rad = self._bearing(self._target) if math.isnan(yaw_rad) else yaw_rad
        self._cruise_m_s = speed_m_s if speed_m_s > 0.0 else None

    def set_cruise_speed(self, speed_m_s: float) -> None:
        """Fly at another speed until the mode changes."""
        self._cruise_m_s = speed_m_s

    def setpoint(self, mode: Px4Mode, dt_s: float) -> TrajectorySetpoint:
        """What to fly in a mode other than OFFBOARD."""
        if mode is Px4Mode.ALTCTL:
            free = (nan, nan, self._target[2])
            return TrajectorySetpoint(
                position=free, acceleration=(0.0, 0.0, nan), yaw_rad=self._yaw_rad
            )
        if mode is Px4Mode.RTL:
            self._advance_return()
        if mode is Px4Mode.LAND or (mode is Px4Mode.RTL and self._return is _Return.LAND):
            return self._landing_setpoint(dt_s)
        return self._moving_setpoint(self._limits(in_takeoff=mode is Px4Mode.TAKEOFF), dt_s)

    @property
    def is_takeoff_complete(self) -> bool:
        """Whether the take-off height is reached."""
        error = abs(self._estimate.position[2] - self._target[2])
        return error < self._parameters["NAV_MC_ALT_RAD"]

    def _takeoff_target(self) -> Vector3:
        north, east, down = self._estimate.position
        wanted = self.takeoff_down_m
        if math.isnan(wanted):
            wanted = self.home[2] - self._parameters["MIS_TAKEOFF_ALT"]
        return (north, east, min(wanted, down))

    def _moving_setpoint(self, limits: Limits, dt_s: float) -> TrajectorySetpoint:
        trajectory = self._trajectory
        trajectory.step(self._target, limits, dt_s)
        return TrajectorySetpoint(
            position=_vector(trajectory.position),
            velocity=_vector(trajectory.velocity),
            acceleration=_vector(trajectory.acceleration),
            yaw_rad=self._yaw_rad,
        )

    def _landing_setpoint(self, dt_s: float) -> TrajectorySetpoint:
        """Hold the place and sink, slower near the ground."""
        p = self._parameters
        share = (self.height_m - p["MPC_LAND_ALT2"]) / (p["MPC_LAND_ALT1"] - p["MPC_LAND_ALT2"])
        slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
        limits = self._limits(down_m_s=slow + min(max(share, 0.0), 1.0) * (fast - slow))
        self._target = (*self._target[:2], self._trajectory.position[2] + _FAR_DOWN_M)
        moving = self._moving_setpoint(limits, dt_s)
        return replace(moving, position=(*moving.position[:2], nan), acceleration=UNSET)

    def _advance_return(self) -> None:
        """Go on to the next stage when one is complete."""
        p, target = self._parameters, self._target
        at = self._estimate.position
        distance = math.hypot(target[0] - at[0], target[1] - at[1])
        height_error = abs(target[2] - at[2])
        speed = math.hypot(self._estimate.velocity[0], self._estimate.velocity[1])
        if self._return is _Return.CLIMB and height_error < p["NAV_MC_ALT_RAD"]:
            self._return = _Return.CRUISE
            self._target = (self.home[0], self.home[1], target[2])
            if math.hypot(self.home[0] - at[0], self.home[1] - at[1]) > p["NAV_ACC_RAD"]:
                self._yaw_rad = self._bearing(self.home)
        elif self._return is _Return.CRUISE and distance < p["NAV_ACC_RAD"]:
            self._return = _Return.DESCEND
            descend = self.home[2] - p["RTL_DESCEND_ALT"]
            self._target = (self.home[0], self.home[1], max(target[2], descend))
        elif (
            self._return is _Return.DESCEND
            and height_error < p["NAV_MC_ALT_RAD"]
            and speed < _AT_REST_M_S
        ):
            self._return = _Return.LAND

    def _return_down(self) -> float:
        """Down coordinate of the way home: RTL_RETURN_ALT, or where it is if higher or near."""
        p, at = self._parameters, self._estimate.position
        if math.hypot(self.home[0] - at[0], self.home[1] - at[1]) < p["RTL_MIN_DIST"]:
            return at[2]
        return min(at[2], self.home[2] - p["RTL_RETURN_ALT"])

    def _bearing(self, to: Vector3) -> float:
        at = self._estimate.position
        return math.atan2(to[1] - at[1], to[0] - at[0])

    def _limits(self, *, in_takeoff: bool = False, down_m_s: float | None = None) -> Limits:
        p = self._parameters
        slow = in_takeoff and self.height_m < p["MPC_LAND_ALT1"]
        cruise = p["MPC_XY_CRUISE"] if self._cruise_m_s is None else self._cruise_m_s
        return Limits(
            speed=min(cruise, p["MPC_XY_VEL_MAX"]),
            up=p["MPC_TKO_SPEED"] if slow else p["MPC_Z_V_AUTO_UP"],
            down=p["MPC_Z_V_AUTO_DN"] if down_m_s is None else down_m_s,
            acceleration=p["MPC_ACC_HOR"],
            acceleration_vertical=p["MPC_ACC_DOWN_MAX"],
            jerk=p["MPC_JERK_AUTO"],
        )


def _vector(values: list[float]) -> Vector3:
    return (values[0], values[1], values[2])
