"""The simulated vehicle: body, estimate, control, commander and battery on one clock.

It behaves as PX4 v1.17 does in SITL, as far as an application can tell over MAVLink.
"""

from __future__ import annotations

import math
import random
import secrets
from collections import deque
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from dronemon.frames import GeoPoint
from dronemon.types import GRAVITY_M_S2, Vector3
from sim.commander import Commander, CommanderInputs
from sim.control import PositionController, TrajectorySetpoint
from sim.dynamics import Quadrotor, Wind
from sim.estimator import READY_AFTER_S, Estimator
from sim.fence import Geofence
from sim.geodesy import LocalMap
from sim.gimbal import Gimbal
from sim.mission_protocol import MissionStore
from sim.modes import Px4Mode
from sim.navigator import Navigator
from sim.parameters import Parameters

STEP_S = 0.01
BOOT_S = 1.6
"""From boot to the first heartbeat."""
_READY_AFTER_S = 5.0
_FENCE_INTERVAL_STEPS = 20
_HOME_MOVES_M = 1.0
_HOME_RISES_M = 1.5
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
    noise_m:     error of its estimated position, one sigma per axis
    problems:    arming checks that fail for reasons of their own, as PX4 says them
    breach:      what the fence says, for reasons of its own
    board:       number of its board, as no other vehicle has it
    gimbal:      what it manages, if it carries one
    has_rangefinder: whether it has one that looks down; is_range_lost: and that finds no ground
    """

    def __init__(
        self,
        *,
        origin: GeoPoint,
        start_ned_m: Vector3,
        make_wind: Callable[[], Wind],
        endurance_s: float,
        noise_m: float,
        rng: random.Random,
    ) -> None:
        self.origin = origin
        self.map = LocalMap(origin)
        self.endurance_s = endurance_s
        self.parameters = Parameters()
        self.missions = MissionStore()
        self._start_ned_m = start_ned_m
        self._make_wind = make_wind
        self._noise_m = noise_m
        self._rng = rng
        self.texts: deque[tuple[int, str]] = deque(maxlen=20)
        self.has_gps = True
        self.ignores_setpoints = False
        self.problems: tuple[str, ...] = ()
        self.breach: str | None = None
        self.battery_level = 1.0
        self.board = secrets.randbits(63)
        self.gimbal: Gimbal | None = None
        self.has_rangefinder = self.is_range_lost = False
        self.num_boots = 0
        self.reboot()

    def reboot(self) -> None:
        """Start again as after power-up: at the start, on the ground, time 0."""
        self._num_steps = 0
        self.time_s = 0.0
        self.num_boots += 1
        self.body = Quadrotor(self._start_ned_m, 0.0, self._make_wind())
        self.estimate = Estimator(self.body, self._rng, self._noise_m)
        self.commander = Commander(self.parameters, self.say)
        self.navigator = Navigator(self.parameters, self.estimate, self.origin.altitude_m, self.say)
        self.fence = Geofence(self.parameters, self.missions, self.map, self.say)
        self._breach: str | None = None
        self._control = PositionController(self.parameters)
        self._entered: Px4Mode | None = None
        self._offboard = TrajectorySetpoint()
        self._offboard_at_s = -math.inf
        self.setpoint = TrajectorySetpoint()
        self.is_landed = True
        self.has_home = False
        self._is_home_manual = False
        self._down_since_s = 0.0
        self._flying_since_s = 0.0
        self._yaw_rad = 0.0
        self.texts.clear()

    def say(self, severity: int, text: str) -> None:
        """Leave a message for the operator."""
        self.texts.append((severity, text))

    @property
    def has_origin(self) -> bool:
        """Whether the estimator has initialised, so that there is a position, if a bad one."""
        return self.time_s >= READY_AFTER_S

    @property
    def is_setpoint_late(self) -> bool:
        """Whether it flies an offboard setpoint that should have been followed by another."""
        is_flying_it = self.commander.is_armed and self.commander.mode is Px4Mode.OFFBOARD
        return is_flying_it and self._setpoint_age_s > _SETPOINT_LATE_S

    @property
    def _is_offboard_alive(self) -> bool:
        is_recent = self._setpoint_age_s <= self.parameters["COM_OF_LOSS_T"]
        return is_recent and self.estimate.has_position

    @property
    def _setpoint_age_s(self) -> float:
        return self.time_s - self._offboard_at_s

    def take_offboard(self, setpoint: TrajectorySetpoint) -> None:
        """Take a setpoint from outside; it counts as a sign of life of its sender."""
        if self.ignores_setpoints:
            return
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
            self.set_home_here()
        return True

    def set_home(self, position: list[float]) -> None:
        """Make a place of the local frame home, for good."""
        self.navigator.home = (position[0], position[1], position[2])
        self.has_home = self._is_home_manual = True

    def set_home_here(self, *, is_forced: bool = False) -> None:
        """Make the present place home, unless one was set that is to stay."""
        if is_forced or not self._is_home_manual:
            self.set_home(self.estimate.position)
            self._is_home_manual = False

    def jump(self, distance_m: float) -> None:
        """Have the estimated position jump."""
        self.estimate.jump(distance_m)
        self.estimate.step(0.0, has_gps=self.has_gps)
        self.navigator.follow_reset()

    def reposition(self, target: Vector3, yaw_rad: float, speed_m_s: float) -> bool:
        """Hold at another place, or here if the fence is in the way. -> whether hold may fly."""
        if not self.request_mode(Px4Mode.LOITER):
            return False
        self._update_commander()
        if self.fence.refuses(target, self._home):
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Reposition is outside geofence\t")
        else:
            self.navigator.hold_at(target, yaw_rad, speed_m_s)
        return True

    def set_clock(self, time_s: float) -> None:
        """Have it be so long since boot."""
        self._num_steps = round(time_s / STEP_S)
        self.time_s = self._num_steps * STEP_S

    def step(self) -> None:
        """One step of the vehicle's time."""
        self._num_steps += 1
        self.time_s = self._num_steps * STEP_S
        self._update_home()
        if self._num_steps % _FENCE_INTERVAL_STEPS == 0:
            self.fence.load(self._home, None if self.is_landed else self.estimate.position)
            self._breach = self.fence.breach(self.estimate.position, self._home)
        self._update_commander()
        self._finish_takeoff()
        self._fly()
        self.estimate.step(STEP_S, has_gps=self.has_gps)
        self._detect_landing()
        if self.gimbal is not None:
            if self.commander.is_armed and self.commander.mode in (Px4Mode.RTL, Px4Mode.LAND):
                self.gimbal.look_ahead()
            self.gimbal.step(STEP_S)
        if not self.is_landed:
            self.battery_level = max(0.0, self.battery_level - STEP_S / self.endurance_s)

    @property
    def _home(self) -> Vector3 | None:
        return self.navigator.home if self.has_home else None

    def _update_home(self) -> None:
        """Home moves along while the vehicle is disarmed on the ground, as where it has landed."""
        at, home = self.estimate.position, self.navigator.home
        if self.commander.is_armed or not self.is_landed or not self.estimate.has_position:
            return
        moved = math.dist(at[:2], home[:2]) > _HOME_MOVES_M or at[2] - home[2] > _HOME_RISES_M
        if self.time_s >= _READY_AFTER_S and (moved or not self.has_home):
            self.set_home_here()

    def _problems(self) -> tuple[str, ...]:
        """Arming checks that fail. Without a position no mode that needs one can be armed in."""
        if self.time_s < _READY_AFTER_S:
            return ("Preflight Fail: ekf2 missing data",)
        if self.estimate.gps_lost_s > 0.0 and self.parameters["COM_ARM_WO_GPS"] == 0:
            return ("Preflight Fail: GPS fix too low", *self.problems)
        return self.problems

    def _update_commander(self) -> None:
        self.commander.update(
            CommanderInputs(
                time_s=self.time_s,
                is_landed=self.is_landed,
                problems=self._problems(),
                has_position=self.estimate.has_position,
                is_offboard_alive=self._is_offboard_alive,
                battery_level=self.battery_level,
                breach=self.breach or self._breach,
            )
        )
        flown = self.commander.mode if self.commander.is_armed else None
        if flown is not self._entered:
            self._entered = flown
            self._yaw_rad = self.estimate.yaw
            if flown is not None:
                self.navigator.enter(flown)

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
            has_position = self.estimate.has_position
            self.setpoint = self.navigator.setpoint(mode, STEP_S, has_position=has_position)
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
        self.set_home_here()
        self.navigator.follow_reset()
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
        """Landed after a while on the ground, pushed down or without thrust; disarmed anywhere."""
        pushes_up = self.body.thrust_m_s2 > _LANDING_THRUST_M_S2
        if self.commander.is_armed and (pushes_up or not self.body.is_on_ground):
            self._down_since_s = self.time_s
        elif self.time_s - self._down_since_s >= _LANDED_AFTER_S:
            self.is_landed = True
