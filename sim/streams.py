"""The messages that the autopilot streams or sends on request, and their rates.

A builder returns None while it has nothing to say, such as a position before the estimator is
initialised.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.types import GRAVITY_M_S2, Vector3
from sim.autopilot import Autopilot
from sim.estimator import GPS_LOSS_TOLERATED_S
from sim.gimbal import BOOT_S as GIMBAL_BOOT_S
from sim.modes import Px4Mode

COMPONENTS = {
    mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: mavlink.MAV_COMP_ID_GIMBAL,
}
"""Senders of messages that are not the autopilot's own."""
Builder = Callable[[Autopilot], Any]
_EPOCH_US = 1_760_000_000_000_000
"""What the simulated GPS calls the time of boot."""
_UNKNOWN_16 = 65535
_BAD_POSITION_LAG_S = 1.0
"""By how much the estimator's flags are behind HEARTBEAT, both once a second."""
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_AHRS
)
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_SOFTWARE_VERSION = 1 << 24 | 17 << 16 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL
_RANGE_M = (0.1, 120.0)
"""Least and greatest range of the rangefinder."""
_CELL_EMPTY_V, _CELL_FULL_V = 3.5, 4.05
_HOVER_CURRENT_A = 15.0


def time_boot_ms(autopilot: Autopilot) -> int:
    """Vehicle time as MAVLink stamps it."""
    return round(autopilot.time_s * 1000.0)


def _time_us(autopilot: Autopilot) -> int:
    return round(autopilot.time_s * 1e6)


def _place(autopilot: Autopilot, position_ned_m: list[float] | Vector3) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 degrees and altitude in mm, as MAVLink carries them."""
    latitude_deg, longitude_deg, altitude_m = autopilot.map.to_geo(position_ned_m)
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1000.0)


def _heartbeat(autopilot: Autopilot) -> Any:
    commander = autopilot.commander
    base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    if commander.mode.is_manual:
        base_mode |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    elif commander.mode is not Px4Mode.OFFBOARD:
        base_mode |= mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    status = mavlink.MAV_STATE_STANDBY if commander.can_arm else mavlink.MAV_STATE_UNINIT
    if commander.is_armed:
        base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        status = mavlink.MAV_STATE_ACTIVE
        if commander.is_in_failsafe:
            status = mavlink.MAV_STATE_CRITICAL
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, base_mode, commander.mode, status, 3
    )


def _sys_status(autopilot: Autopilot) -> Any:
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    health = _SENSORS if autopilot.has_gps else _SENSORS & ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
    if autopilot.commander.can_arm:
        health |= prearm
    present = _SENSORS | prearm
    if autopilot.commander.has_sticks:
        present |= mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        health |= mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    return mavlink.MAVLink_sys_status_message(
        present,
        present,
        health,
        300,
        round(_voltage_v(autopilot) * 1000.0),
        round(_current_a(autopilot) * 100.0),
        round(autopilot.battery_level * 100.0),
        *(0,) * 6,
    )


def _voltage_v(autopilot: Autopilot) -> float:
    cell = _CELL_EMPTY_V + (_CELL_FULL_V - _CELL_EMPTY_V) * autopilot.battery_level
    return cell * autopilot.parameters["BAT1_N_CELLS"]


def _current_a(autopilot: Autopilot) -> float:
    return _HOVER_CURRENT_A * autopilot.body.thrust_m_s2 / GRAVITY_M_S2


def _extended_sys_state(autopilot: Autopilot) -> Any:
    mode = autopilot.commander.mode
    state = mavlink.MAV_LANDED_STATE_IN_AIR
    if autopilot.is_landed:
        state = mavlink.MAV_LANDED_STATE_ON_GROUND
    elif mode is Px4Mode.TAKEOFF:
        state = mavlink.MAV_LANDED_STATE_TAKEOFF
    elif mode is Px4Mode.LAND or (mode is Px4Mode.RTL and autopilot.navigator.is_landing):
        state = mavlink.MAV_LANDED_STATE_LANDING
    return mavlink.MAVLink_extended_sys_state_message(0, state)


def _local_position_ned(autopilot: Autopilot) -> Any:
    if not autopilot.has_origin:
        return None
    estimate = autopilot.estimate
    return mavlink.MAVLink_local_position_ned_message(
        time_boot_ms(autopilot), *estimate.position, *estimate.velocity
    )


def _attitude(autopilot: Autopilot) -> Any:
    estimate, body = autopilot.estimate, autopilot.body
    return mavlink.MAVLink_attitude_message(
        time_boot_ms(autopilot),
        *(estimate.roll, estimate.pitch, estimate.yaw),
        *(body.roll_rate, body.pitch_rate, body.yaw_rate),
    )


def _attitude_quaternion(autopilot: Autopilot) -> Any:
    estimate, body = autopilot.estimate, autopilot.body
    return mavlink.MAVLink_attitude_quaternion_message(
        time_boot_ms(autopilot),
        *quaternion(estimate.roll, estimate.pitch, estimate.yaw),
        *(body.roll_rate, body.pitch_rate, body.yaw_rate),
    )


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Rotation of the body in the NED frame as w, x, y, z."""
    sr, cr = math.sin(roll / 2.0), math.cos(roll / 2.0)
    sp, cp = math.sin(pitch / 2.0), math.cos(pitch / 2.0)
    sy, cy = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _odometry(autopilot: Autopilot) -> Any:
    """The estimate in the local frame, and how often it was reset."""
    if not autopilot.has_origin:
        return None
    estimate, body = autopilot.estimate, autopilot.body
    return mavlink.MAVLink_odometry_message(
        _time_us(autopilot),
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_LOCAL_NED,
        *estimate.position,
        quaternion(estimate.roll, estimate.pitch, estimate.yaw),
        *estimate.velocity,
        *(body.roll_rate, body.pitch_rate, body.yaw_rate),
        [math.nan] * 21,
        [math.nan] * 21,
        estimate.num_resets % 256,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        0,
    )


def _heading_deg(autopilot: Autopilot) -> float:
    return math.degrees(autopilot.estimate.yaw) % 360.0


def _global_position_int(autopilot: Autopilot) -> Any:
    if not autopilot.has_origin:
        return None
    estimate = autopilot.estimate
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms(autopilot),
        *_place(autopilot, estimate.position),
        round(autopilot.navigator.height_m * 1000.0),
        *(round(v * 100.0) for v in estimate.velocity),
        round(_heading_deg(autopilot) * 100.0) % 36000,
    )


def _gps_raw_int(autopilot: Autopilot) -> Any:
    v_north, v_east, _ = autopilot.body.velocity
    course_deg = math.degrees(math.atan2(v_east, v_north)) % 360.0
    has_fix = autopilot.has_gps
    return mavlink.MAVLink_gps_raw_int_message(
        _time_us(autopilot),
        mavlink.GPS_FIX_TYPE_3D_FIX if has_fix else mavlink.GPS_FIX_TYPE_NO_FIX,
        *(_place(autopilot, autopilot.body.position) if has_fix else (0, 0, 0)),
        80 if has_fix else _UNKNOWN_16,
        80 if has_fix else _UNKNOWN_16,
        round(math.hypot(v_north, v_east) * 100.0),
        round(course_deg * 100.0) % 36000,
        14 if has_fix else 0,
    )


def _altitude(autopilot: Autopilot) -> Any:
    if not autopilot.has_origin:
        return None
    down = autopilot.estimate.position[2]
    amsl = autopilot.origin.altitude_m - down
    height = autopilot.navigator.height_m
    return mavlink.MAVLink_altitude_message(
        _time_us(autopilot), amsl, amsl, -down, height, math.nan, math.nan
    )


def _vfr_hud(autopilot: Autopilot) -> Any:
    estimate = autopilot.estimate
    speed = math.hypot(estimate.velocity[0], estimate.velocity[1])
    throttle = round(50.0 * autopilot.body.thrust_m_s2 / GRAVITY_M_S2)
    return mavlink.MAVLink_vfr_hud_message(
        speed,
        speed,
        round(_heading_deg(autopilot)) % 360,
        throttle,
        autopilot.origin.altitude_m - estimate.position[2],
        -estimate.velocity[2],
    )


def _position_target_local_ned(autopilot: Autopilot) -> Any:
    if autopilot.is_landed:
        return None
    setpoint = autopilot.setpoint
    return mavlink.MAVLink_position_target_local_ned_message(
        time_boot_ms(autopilot),
        mavlink.MAV_FRAME_LOCAL_NED,
        0,
        *setpoint.position,
        *setpoint.velocity,
        *setpoint.acceleration,
        setpoint.yaw_rad,
        setpoint.yaw_rate_rad_s,
    )


def _battery_status(autopilot: Autopilot) -> Any:
    cells = int(autopilot.parameters["BAT1_N_CELLS"])
    cell_mv = round(_voltage_v(autopilot) / cells * 1000.0)
    left = autopilot.battery_level
    state = mavlink.MAV_BATTERY_CHARGE_STATE_OK + autopilot.commander.charge
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        32767,
        [cell_mv if i < cells else _UNKNOWN_16 for i in range(10)],
        round(_current_a(autopilot) * 100.0),
        -1,
        -1,
        round(left * 100.0),
        round(left * autopilot.endurance_s),
        state,
    )


def _home_position(autopilot: Autopilot) -> Any:
    if not autopilot.has_home:
        return None
    home, upright, approach = autopilot.navigator.home, [1.0, 0.0, 0.0, 0.0], (0.0, 0.0, 0.0)
    return mavlink.MAVLink_home_position_message(
        *_place(autopilot, home), *home, upright, *approach, _time_us(autopilot)
    )


def _gps_global_origin(autopilot: Autopilot) -> Any:
    if not autopilot.has_origin:
        return None
    origin = _place(autopilot, (0.0, 0.0, 0.0))
    return mavlink.MAVLink_gps_global_origin_message(*origin, _time_us(autopilot))


def _estimator_status(autopilot: Autopilot) -> Any:
    """That GPS is gone shows at once; that the position is no good, after the failsafe for it."""
    flags = (
        mavlink.ESTIMATOR_ATTITUDE
        | mavlink.ESTIMATOR_VELOCITY_VERT
        | mavlink.ESTIMATOR_POS_VERT_ABS
    )
    lost_s = autopilot.estimate.gps_lost_s
    is_news = GPS_LOSS_TOLERATED_S <= lost_s < GPS_LOSS_TOLERATED_S + _BAD_POSITION_LAG_S
    if autopilot.estimate.has_position or is_news:
        flags |= (
            mavlink.ESTIMATOR_VELOCITY_HORIZ
            | mavlink.ESTIMATOR_POS_HORIZ_REL
            | mavlink.ESTIMATOR_POS_HORIZ_ABS
        )
    if lost_s == 0.0 and autopilot.has_origin:
        flags |= mavlink.ESTIMATOR_PRED_POS_HORIZ_REL | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
    if autopilot.is_landed:
        flags |= mavlink.ESTIMATOR_CONST_POS_MODE
    return mavlink.MAVLink_estimator_status_message(
        _time_us(autopilot), flags, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.3 + lost_s, 0.4
    )


def _mission_current(autopilot: Autopilot) -> Any:
    missions = autopilot.missions
    return mavlink.MAVLink_mission_current_message(
        missions.current, len(missions.items[mavlink.MAV_MISSION_TYPE_MISSION])
    )


def _system_time(autopilot: Autopilot) -> Any:
    return mavlink.MAVLink_system_time_message(
        _EPOCH_US + _time_us(autopilot), time_boot_ms(autopilot)
    )


def _autopilot_version(autopilot: Autopilot) -> Any:
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, _SOFTWARE_VERSION, 0, 0, 0, nothing, nothing, nothing, 0, 0, autopilot.board
    )


def _distance_sensor(autopilot: Autopilot) -> Any:
    """Along the body's own down, as PX4's simulated one: 0 where there is no ground in reach."""
    if not autopilot.has_rangefinder:
        return None
    body = autopilot.body
    leaning = math.cos(body.roll) * math.cos(body.pitch)
    range_m = (body.ground_down_m - body.position[2]) / max(leaning, 1e-6)
    is_found = not autopilot.is_range_lost and _RANGE_M[0] <= range_m <= _RANGE_M[1]
    least_cm, most_cm = (round(100.0 * limit) for limit in _RANGE_M)
    return mavlink.MAVLink_distance_sensor_message(
        time_boot_ms(autopilot),
        *(least_cm, most_cm, round(100.0 * range_m) if is_found else 0),
        *(mavlink.MAV_DISTANCE_SENSOR_LASER, 0, mavlink.MAV_SENSOR_ROTATION_PITCH_270, 0),
    )


def _gimbal_device_attitude_status(autopilot: Autopilot) -> Any:
    """Stamped with the gimbal's own time, and turned from the vehicle's heading."""
    gimbal, since_s = autopilot.gimbal, autopilot.time_s - GIMBAL_BOOT_S
    if gimbal is None or gimbal.is_silent or since_s < 0.0:
        return None
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        *(0, 0, round(since_s * 1000.0)),
        mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
        | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
        | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
        quaternion(0.0, gimbal.pitch_rad, gimbal.yaw_rad),
        *(math.nan, math.nan, math.nan, 0),
        *(autopilot.estimate.yaw, math.nan, 0),
    )


STREAMS: dict[int, tuple[Builder, float]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: (_heartbeat, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: (_attitude, 98.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (_local_position_ned, 30.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: (_odometry, 30.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (_attitude_quaternion, 49.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (_global_position_int, 49.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: (_gps_raw_int, 8.0),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: (_distance_sensor, 10.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: (_sys_status, 5.0),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (_extended_sys_state, 5.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: (_altitude, 10.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: (_vfr_hud, 10.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: (_position_target_local_ned, 10.0),
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: (_estimator_status, 1.0),
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: (_mission_current, 1.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: (_system_time, 1.0),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: (_battery_status, 0.5),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: (_home_position, 0.5),
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: (_gps_global_origin, 0.0),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: (_autopilot_version, 0.0),
    mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: (_gimbal_device_attitude_status, 5.0),
}
"""Message id -> builder and Hz of vehicle time, as on PX4's offboard link; 0 is on request only.

What PX4 also sends there is left out, since nothing here simulates it: raw inertial data, attitude
and servo targets, and time-sync and ping requests of its own.
"""
