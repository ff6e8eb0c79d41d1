"""The simulated vehicle: body, estimate, control, commander and battery on one clock.

It behaves as PX4 v1.17 does in SITL, as far as an application can tell over MAVLink.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from dronemon.frames import GeoPoint
from dronemon.types import Vector3
from sim.commander import Commander, CommanderInputs
from sim.control import PositionController, TrajectorySetpoint
from sim.dynamics import GRAVITY_M_S2, Quadrotor, Wind
from sim.estimator import Estimator
from sim.geodesy import LocalMap
from sim.mission_protocol import MissionStore
from sim.modes import Px4Mode
from sim.navigator import Navigator
from sim.parameters import Parameters

STEP_S = 0.01
BOOT_S = 1.6
"""From boot to the first heartbeat."""
_POSITION_AFTER_S = 3.0
_READY_AFTER_S = 5.0
_LANDED_AFTER_S = 1.0
_LANDING_THRUST_M_S2 = 0.9 * GRAVITY_M_S2
_CLIMB_WISH_M = 0.3
_SETPOINT_LATE_S = 0.3
_IDLE: Vector3 = (0.0, 0.0, 0.0)


class Autopilot:
    """One vehicle; `step` moves it on by STEP_S of its time.

    time_s:      since boot
    origin:      of the local frame
    start_ned_m: where it stands at boot, which is home
    """

    def __init__(
        self,
        *,
        origin: GeoPoint,
        start_ned_m: Vector3,
        make_wind: Callable[[], Wind],
        endurance_s: float,
        rng: random.Random,
    ) -> None:
        self.origin = origin
        self.map = LocalMap(origin)
        self.endurance_s = endurance_s
        self.parameters = Parameters()
        self.missions = MissionStore()
        self._start_ned_m = start_ned_m
        self._make_wind = make_wind
        self._rng = rng
        self.texts: deque[tuple[int, str]] = deque(maxlen=20)
        self.has_gps = True
        self.battery_level = 1.0
        self.num_boots = 0
        self.reboot()

    def reboot(self) -> None:
        """Start again as after power-up: at the start, on the ground, time 0."""
        self._num_steps = 0
        self.time_s = 0.0
        self.num_boots += 1
        self.body = Quadrotor(self._start_ned_m, 0.0, self._make_wind())
        self.estimate = Estimator(self.body, self._rng)
        self.commander = Commander(self.parameters, self.say)
        self.navigator = Navigator(self.parameters, self.estimate)
        self._control = PositionController(self.parameters)
        self._entered = self.commander.mode
        self._offboard = TrajectorySetpoint()
        self._offboard_at_s = -math.inf
        self.setpoint = TrajectorySetpoint()
        self.is_landed = True
        self.has_home = False
        self._down_since_s = 0.0
        self._flying_since_s = 0.0
        self._yaw_rad = 0.0
        self.texts.clear()

    def say(self, severity: int, text: str) -> None:
        """Leave a message for the operator."""
        self.texts.append((severity, text))

    @property
    def has_position(self) -> bool:
        """Whether the estimator has initialised."""
        return self.time_s >= _POSITION_AFTER_S

    @property
    def is_ready(self) -> bool:
        """Whether the arming checks pass."""
        return self.time_s >= _READY_AFTER_S and self.estimate.gps_lost_s == 0.0

    @property
    def is_setpoint_late(self) -> bool:
        """Whether it flies an offboard setpoint that should have been followed by another."""
        is_flying_it = self.commander.is_armed and self.commander.mode is Px4Mode.OFFBOARD
        return is_flying_it and self._setpoint_age_s > _SETPOINT_LATE_S

    @property
    def _setpoint_age_s(self) -> float:
        return self.time_s - self._offboard_at_s

    def take_offboard(self, setpoint: TrajectorySetpoint) -> None:
        """Take a setpoint from outside; it counts as a sign of life of its sender."""
        self._offboard = setpoint
        self._offboard_at_s = self.time_s

    def request_mode(self, mode: Px4Mode) -> bool:
        """Ask for a mode. -> whether it may fly."""
        self._update_commander()
        return self.commander.request_mode(mode)

    def arm(self) -> bool:
        """Arm, if allowed. Home becomes the place where it is armed."""
        self._update_commander()
        was_armed = self.commander.is_armed
        if not self.commander.arm():
            return False
        if not was_armed:
            self.set_home(self.estimate.position)
        return True

    def set_home(self, position: list[float]) -> None:
        """Make a place of the local frame home."""
        self.navigator.home = (position[0], position[1], position[2])
        self.has_home = True

    def reposition(self, target: Vector3, yaw_rad: float, speed_m_s: float) -> bool:
        """Hold at another place. -> whether hold may fly."""
        if not self.request_mode(Px4Mode.LOITER):
            return False
        self._update_commander()
        self.navigator.hold_at(target, yaw_rad, speed_m_s)
        return True

    def step(self) -> None:
        """One step of the vehicle's time."""
        self._num_steps += 1
        self.time_s = self._num_steps * STEP_S
        if self.is_ready and not self.has_home:
            self.set_home(self.estimate.position)
            self.say(mavlink.MAV_SEVERITY_INFO, "Ready for takeoff!")
        self._update_commander()
        self._finish_takeoff()
        self._fly()
        self.estimate.step(STEP_S, has_gps=self.has_gps)
        self._detect_landing()
        if not self.is_landed:
            self.battery_level = max(0.0, self.battery_level - STEP_S / self.endurance_s)

    def _update_commander(self) -> None:
        self.commander.update(
            CommanderInputs(
                time_s=self.time_s,
                is_landed=self.is_landed,
                is_ready=self.is_ready,
                is_offboard_alive=self._setpoint_age_s <= self.parameters["COM_OF_LOSS_T"],
                battery_level=self.battery_level,
                gps_lost_s=self.estimate.gps_lost_s,
            )
        )
        if self.commander.mode is not self._entered:
            self._entered = self.commander.mode
            self._yaw_rad = self.estimate.yaw
            self.navigator.enter(self._entered)

    def _finish_takeoff(self) -> None:
        if self._entered is not Px4Mode.TAKEOFF or self.is_landed:
            return
        if self.navigator.is_takeoff_complete:
            self.navigator.takeoff_down_m = math.nan
            self.commander.complete_takeoff()
            # Hold keeps the take-off's target instead of stopping where it is.
            self._entered = Px4Mode.LOITER

    def _fly(self) -> None:
        """Setpoint, control and motion."""
        mode = self.commander.mode
        yaw_max = math.radians(self.parameters["MPC_YAWRAUTO_MAX"])
        is_idle = self.is_landed and not self._may_lift_off(mode)
        if is_idle or not self.commander.is_armed:
            self._control.reset()
            self.body.step(_IDLE, self.body.yaw, yaw_max, STEP_S)
            return
        if mode is Px4Mode.OFFBOARD:
            self.setpoint = self._offboard
        else:
            self.setpoint = self.navigator.setpoint(mode, STEP_S)
        self._steer_yaw()
        thrust = self._control.thrust(
            self.setpoint,
            self.estimate.position,
            self.estimate.velocity,
            self.body.acceleration,
            self._climb_limit(),
            STEP_S,
        )
        self.body.step(thrust, self._yaw_rad, yaw_max, STEP_S)

    def _may_lift_off(self, mode: Px4Mode) -> bool:
        """Whether to leave the ground now: armed, spooled up and asked to climb."""
        armed_since_s = self.commander.armed_since_s
        if armed_since_s is None:
            return False
        if self.time_s - armed_since_s < self.parameters["COM_SPOOLUP_TIME"]:
            return False
        if not (mode is Px4Mode.TAKEOFF or (mode is Px4Mode.OFFBOARD and self._wants_climb())):
            return False
        self.is_landed = False
        self._flying_since_s = self._down_since_s = self.time_s
        self.navigator.enter(mode)
        self.say(mavlink.MAV_SEVERITY_INFO, "Takeoff detected")
        return True

    def _wants_climb(self) -> bool:
        down, speed = self._offboard.position[2], self._offboard.velocity[2]
        return down < self.estimate.position[2] - _CLIMB_WISH_M or speed < -_CLIMB_WISH_M

    def _climb_limit(self) -> float:
        """Most climb speed: it grows from nothing during the take-off's ramp."""
        most = self.parameters["MPC_Z_VEL_MAX_UP"]
        ramp_s = self.parameters["MPC_TKO_RAMP_T"]
        aloft_s = self.time_s - self._flying_since_s
        return most if aloft_s >= ramp_s else most * aloft_s / ramp_s

    def _steer_yaw(self) -> None:
        if not math.isnan(self.setpoint.yaw_rad):
            self._yaw_rad = self.setpoint.yaw_rad
        elif not math.isnan(self.setpoint.yaw_rate_rad_s):
            self._yaw_rad += self.setpoint.yaw_rate_rad_s * STEP_S

    def _detect_landing(self) -> None:
        """Landed after a while on the ground, pushed down or without thrust."""
        pushes_up = self.body.thrust_m_s2 > _LANDING_THRUST_M_S2
        if not self.body.is_on_ground or (pushes_up and self.commander.is_armed):
            self._down_since_s = self.time_s
        elif self.time_s - self._down_since_s >= _LANDED_AFTER_S:
            self.is_landed = True
