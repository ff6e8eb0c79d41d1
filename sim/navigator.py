"""Where each flight mode goes: take-off, hold, return and landing, as PX4's navigator has them."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum, auto
from math import nan

from pymavlink.dialects.v20 import common as mavlink

from dronemon.types import Vector3
from sim.commander import Say
from sim.control import UNSET, TrajectorySetpoint
from sim.estimator import Estimator
from sim.modes import Px4Mode
from sim.parameters import Parameters
from sim.trajectory import Limits, Trajectory, stopping_point

_FAR_DOWN_M = 1000.0
_INFO: int = mavlink.MAV_SEVERITY_INFO


class _Return(Enum):
    """Stages of the return to launch; it lands at once, or never with RTL_LAND_DELAY below 0."""

    CLIMB = auto()
    CRUISE = auto()
    LAND = auto()


class Navigator:
    """Turns the flight mode into setpoints; OFFBOARD's come from outside."""

    def __init__(
        self, parameters: Parameters, estimate: Estimator, origin_amsl_m: float, say: Say
    ) -> None:
        self._parameters = parameters
        self._estimate = estimate
        self._origin_amsl_m = origin_amsl_m
        self._say = say
        self._trajectory = Trajectory(estimate.position, estimate.velocity)
        self._target: Vector3 = (0.0, 0.0, 0.0)
        self._yaw_rad = 0.0
        self._return = _Return.CLIMB
        self._cruise_m_s: float | None = None
        self.home: Vector3 = (0.0, 0.0, 0.0)
        self.takeoff_down_m = nan
        """Where the next take-off ends; NaN: MIS_TAKEOFF_ALT above where it begins."""

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
            amsl_m = math.ceil(self._origin_amsl_m - self._target[2])
            above_m = math.ceil(self.home[2] - self._target[2])
            self._say(_INFO, f"RTL: start return at {amsl_m} m ({above_m} m above destination)\t")

    def follow_reset(self) -> None:
        """Go on from where the estimate has jumped to."""
        self._trajectory = Trajectory(self._estimate.position, self._estimate.velocity)

    def hold_at(self, target: Vector3, yaw_rad: float, speed_m_s: float) -> None:
        """Fly to a place and hold there; NaN leaves height, yaw or speed as they are."""
        down = self._target[2] if math.isnan(target[2]) else target[2]
        self._target = (target[0], target[1], down)
        self._yaw_rad = self._bearing(self._target) if math.isnan(yaw_rad) else yaw_rad
        self._cruise_m_s = speed_m_s if speed_m_s > 0.0 else None

    def set_cruise_speed(self, speed_m_s: float) -> None:
        """Fly at another speed until the mode changes."""
        self._cruise_m_s = speed_m_s

    def setpoint(self, mode: Px4Mode, dt_s: float, *, has_position: bool) -> TrajectorySetpoint:
        """What to fly in a mode other than OFFBOARD; without a position it drifts, held level."""
        if mode in (Px4Mode.ALTCTL, Px4Mode.MANUAL):
            return replace(self._level(), position=(nan, nan, self._target[2]))
        if mode is Px4Mode.RTL:
            self._advance_return()
        if mode is Px4Mode.LAND or (mode is Px4Mode.RTL and self._return is _Return.LAND):
            landing = self._landing_setpoint(dt_s)
            if has_position:
                return landing
            return replace(self._level(), velocity=(nan, nan, landing.velocity[2]))
        return self._moving_setpoint(self._limits(in_takeoff=mode is Px4Mode.TAKEOFF), dt_s)

    def _level(self) -> TrajectorySetpoint:
        return TrajectorySetpoint(acceleration=(0.0, 0.0, nan), yaw_rad=self._yaw_rad)

    @property
    def is_takeoff_complete(self) -> bool:
        """Whether the take-off height is reached."""
        error = abs(self._estimate.position[2] - self._target[2])
        return error < self._parameters["NAV_MC_ALT_RAD"]

    def _takeoff_target(self) -> Vector3:
        north, east, down = self._estimate.position
        wanted = self.takeoff_down_m
        if math.isnan(wanted):
            height_m = self._parameters["MIS_TAKEOFF_ALT"]
            wanted = down - height_m
            self._say(_INFO, f"Using default takeoff altitude: {height_m:.1f} m\t")
        elif wanted > down:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "Already higher than takeoff altitude\t")
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
        if self._return is _Return.CLIMB and height_error < p["NAV_MC_ALT_RAD"]:
            self._return = _Return.CRUISE
            self._target = (self.home[0], self.home[1], target[2])
            if math.hypot(self.home[0] - at[0], self.home[1] - at[1]) > p["NAV_ACC_RAD"]:
                self._yaw_rad = self._bearing(self.home)
        elif self._return is _Return.CRUISE and distance < p["NAV_ACC_RAD"]:
            if p["RTL_LAND_DELAY"] < 0.0:
                return
            self._return = _Return.LAND
            self._say(_INFO, "RTL: land at destination\t")

    def _return_down(self) -> float:
        """Down coordinate of the way home: RTL_RETURN_ALT, less within a cone, or where it is."""
        p, at = self._parameters, self._estimate.position
        away_m = math.hypot(self.home[0] - at[0], self.home[1] - at[1])
        height_m = p["RTL_RETURN_ALT"]
        half_angle_deg = p["RTL_CONE_ANG"]
        if half_angle_deg > 0 and away_m <= p["NAV_ACC_RAD"]:
            height_m = min(2.0 * away_m, height_m)
        elif half_angle_deg > 0 and away_m <= p["RTL_MIN_DIST"]:
            cone_m = away_m / math.tan(math.radians(min(half_angle_deg, 89.0)))
            height_m = min(max(cone_m, 2.0 * p["NAV_ACC_RAD"]), height_m)
        return min(at[2], self.home[2] - height_m)

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
