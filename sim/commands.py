"""Commands and offboard setpoints: what MAVLink asks of the autopilot, and its answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.types import Vector3
from sim.autopilot import Autopilot
from sim.control import TrajectorySetpoint
from sim.modes import Px4Mode

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
DENIED: int = mavlink.MAV_RESULT_DENIED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
_FORCE = 21196
_NO_COORDINATE = 2**31 - 1
_YAW_IGNORED = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE_IGNORED = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A command and its seven parameters; NaN is "not given", latitudes are degrees."""

    number: int
    params: tuple[float, ...]

    @classmethod
    def from_message(cls, message: Any) -> Command:
        """From COMMAND_LONG or COMMAND_INT."""
        m = message
        if m.get_type() == "COMMAND_LONG":
            places = (m.param5, m.param6, m.param7)
        else:
            places = (*(nan if v == _NO_COORDINATE else v / 1e7 for v in (m.x, m.y)), m.z)
        params = (m.param1, m.param2, m.param3, m.param4, *places)
        return cls(number=m.command, params=tuple(_finite(v) for v in params))


def whole(value: float) -> int:
    """The integer that a parameter carries; -1 if it is not given."""
    return -1 if math.isnan(value) else int(value)


def execute(autopilot: Autopilot, command: Command) -> int:
    """Do what a command asks. -> MAV_RESULT."""
    handler = _HANDLERS.get(command.number)
    return UNSUPPORTED if handler is None else handler(autopilot, command.params)


def _mode(autopilot: Autopilot, mode: Px4Mode) -> int:
    return ACCEPTED if autopilot.request_mode(mode) else REJECTED


def _set_mode(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    if not whole(params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return REJECTED
    try:
        mode = Px4Mode(whole(params[1]) << 16 | max(whole(params[2]), 0) << 24)
    except ValueError:
        return REJECTED
    return _mode(autopilot, mode)


def _arm_or_disarm(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    if params[0] not in (0.0, 1.0):
        return UNSUPPORTED
    if params[0] == 1.0:
        return ACCEPTED if autopilot.arm() else REJECTED
    is_forced = params[1] == _FORCE
    return ACCEPTED if autopilot.commander.disarm(is_forced=is_forced) else REJECTED


def _take_off(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    """Take off to a height above sea level, or to the default height above the present one."""
    result = _mode(autopilot, Px4Mode.TAKEOFF)
    if result == ACCEPTED:
        autopilot.navigator.takeoff_down_m = autopilot.origin.altitude_m - params[6]
    return result


def _land(autopilot: Autopilot, _: tuple[float, ...]) -> int:
    autopilot.say(mavlink.MAV_SEVERITY_INFO, "Landing at current position\t")
    return _mode(autopilot, Px4Mode.LAND)


def _return(autopilot: Autopilot, _: tuple[float, ...]) -> int:
    result = _mode(autopilot, Px4Mode.RTL)
    if result == ACCEPTED:
        autopilot.say(mavlink.MAV_SEVERITY_INFO, "Returning to launch\t")
    return result


def _run_checks(autopilot: Autopilot, _: tuple[float, ...]) -> int:
    autopilot.commander.report_problems()
    return ACCEPTED


def _reposition(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    speed, flags, _, yaw, latitude, longitude, altitude = params
    if whole(flags) != mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
        return UNSUPPORTED
    if not (math.isfinite(latitude) and math.isfinite(longitude)):
        return DENIED
    target = autopilot.map.to_ned(latitude, longitude, altitude)
    return ACCEPTED if autopilot.reposition(target, yaw, speed) else REJECTED


def _set_home(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    if not autopilot.has_origin:
        return REJECTED
    if params[0] == 1.0:
        autopilot.set_home_here(is_forced=True)
        return ACCEPTED
    if not all(math.isfinite(v) for v in params[4:]):
        return DENIED
    autopilot.set_home(list(autopilot.map.to_ned(*params[4:])))
    return ACCEPTED


def _change_speed(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    if not params[1] > 0.0:
        return DENIED
    autopilot.navigator.set_cruise_speed(params[1])
    return ACCEPTED


def _reboot(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    if params[0] != 1.0:
        return UNSUPPORTED
    if autopilot.commander.is_armed:
        return DENIED
    autopilot.reboot()
    return ACCEPTED


def _configure_gimbal(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    if autopilot.gimbal is None:
        return UNSUPPORTED
    autopilot.gimbal.is_controlled = params[0] > 0.0
    return ACCEPTED


def _point_gimbal(autopilot: Autopilot, params: tuple[float, ...]) -> int:
    """Turn it by its angles alone, and with the vehicle."""
    if autopilot.gimbal is None:
        return UNSUPPORTED
    is_from_north = max(whole(params[4]), 0) & mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
    if is_from_north or math.isnan(sum(params[:2])):
        return DENIED
    pitch_rad, yaw_rad = math.radians(params[0]), math.radians(params[1])
    return ACCEPTED if autopilot.gimbal.point(pitch_rad, yaw_rad) else DENIED


_HANDLERS: dict[int, Callable[[Autopilot, tuple[float, ...]], int]] = {
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_or_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_LAND: _land,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda autopilot, _: _mode(autopilot, Px4Mode.LOITER),
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: _run_checks,
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: _configure_gimbal,
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: _point_gimbal,
}


def setpoint_from_local(message: Any, yaw_rad: float) -> TrajectorySetpoint | None:
    """Setpoint of SET_POSITION_TARGET_LOCAL_NED; None if the autopilot does not take it.

    yaw_rad: the vehicle's, by which body frames are turned
    """
    if message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED:
        position = (message.x, message.y, message.z)
        return _setpoint(message, position, yaw_rad=0.0)
    if message.coordinate_frame == mavlink.MAV_FRAME_BODY_NED:
        return _setpoint(message, (nan, nan, nan), yaw_rad=yaw_rad)
    return None


def setpoint_from_global(message: Any, autopilot: Autopilot) -> TrajectorySetpoint | None:
    """Setpoint of SET_POSITION_TARGET_GLOBAL_INT; None if the autopilot does not take it."""
    if message.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
        home_m = autopilot.origin.altitude_m - autopilot.navigator.home[2]
    elif message.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_INT:
        home_m = 0.0
    else:
        return None
    latitude, longitude = message.lat_int / 1e7, message.lon_int / 1e7
    place = autopilot.map.to_ned(latitude, longitude, message.alt + home_m)
    return _setpoint(message, place, yaw_rad=0.0)


def _setpoint(message: Any, position: Vector3, *, yaw_rad: float) -> TrajectorySetpoint | None:
    """Apply the type mask: every ignored value is NaN. None if nothing flyable is left."""
    mask = message.type_mask
    velocity = _turned((message.vx, message.vy, message.vz), yaw_rad)
    push = _turned((message.afx, message.afy, message.afz), yaw_rad)
    setpoint = TrajectorySetpoint(
        position=_masked(position, mask),
        velocity=_masked(velocity, mask >> 3),
        acceleration=_masked(push, mask >> 6),
        yaw_rad=nan if mask & _YAW_IGNORED else _finite(message.yaw),
        yaw_rate_rad_s=nan if mask & _YAW_RATE_IGNORED else _finite(message.yaw_rate),
    )
    return setpoint if setpoint.is_flyable else None


def _masked(vector: Vector3, mask: int) -> Vector3:
    north, east, down = (nan if mask >> i & 1 else _finite(v) for i, v in enumerate(vector))
    return (north, east, down)


def _finite(value: float) -> float:
    """The value, or NaN for an infinite one: PX4 takes both as "not given"."""
    return value if math.isfinite(value) else nan


def _turned(vector: Vector3, yaw_rad: float) -> Vector3:
    """A body vector in the local frame; the body's tilt is not applied, as in PX4."""
    sin_yaw, cos_yaw = math.sin(yaw_rad), math.cos(yaw_rad)
    forward, right, down = vector
    return (cos_yaw * forward - sin_yaw * right, sin_yaw * forward + cos_yaw * right, down)
