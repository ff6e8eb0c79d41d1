"""The fields of messages as a PX4 vehicle sends them."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from dronemon.vehicle.telemetry import Telemetry

HEARTBEAT = {
    "type": mavlink.MAV_TYPE_QUADROTOR,
    "autopilot": mavlink.MAV_AUTOPILOT_PX4,
    "base_mode": mavlink.MAV_MODE_FLAG_SAFETY_ARMED,
    "custom_mode": 6 << 16,  # offboard
    "system_status": mavlink.MAV_STATE_ACTIVE,
}
HOME = {"latitude": 473977420, "longitude": 85455940, "altitude": 488000}
PLACE = {"lat": 473977420, "lon": 85455940, "alt": 488000}
ACCURACY = {"pos_horiz_accuracy": 0.5, "pos_vert_accuracy": 0.7}
READY = {
    "HOME_POSITION": HOME,
    "GPS_GLOBAL_ORIGIN": HOME,
    "GLOBAL_POSITION_INT": PLACE,
    "AUTOPILOT_VERSION": {"uid": 17, "uid2": [0] * 18},
    "ESTIMATOR_STATUS": {"flags": mavlink.ESTIMATOR_POS_HORIZ_ABS, **ACCURACY},
    "SYS_STATUS": {
        "battery_remaining": 73,
        "onboard_control_sensors_health": mavlink.MAV_SYS_STATUS_PREARM_CHECK,
        "onboard_control_sensors_present": mavlink.MAV_SYS_STATUS_PREARM_CHECK,
    },
}


def position(time_s, x=0.0, vx=0.0, **others):
    still = {"y": 2.0, "z": -3.0, "vy": 0.0, "vz": 0.0}
    return {"time_boot_ms": round(time_s * 1000.0) % 2**32, "x": x, "vx": vx, **still, **others}


def attitude(time_s, **others):
    level = {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    return {"time_boot_ms": round(time_s * 1000.0) % 2**32, **level, **others}


def pose(telemetry, time_s, **others):
    telemetry.take("LOCAL_POSITION_NED", position(time_s, **others))
    telemetry.take("ATTITUDE", attitude(time_s))


def silent_until(telemetry, time_s):
    """As after a silence, after which the first stamps are believed only with the next."""
    for ago_s in (0.04, 0.02, 0.0):
        pose(telemetry, time_s - ago_s)


def posed(*times_s):
    telemetry = Telemetry()
    for time_s in times_s:
        pose(telemetry, time_s)
    return telemetry


def ready(rate_hz=50.0, duration_s=4.0, **messages):
    """Telemetry of a vehicle that is ready, but for the given messages (None: not sent)."""
    telemetry = posed(*(100.0 + i / rate_hz for i in range(round(duration_s * rate_hz))))
    for name, fields in (READY | messages).items():
        if fields is not None:
            telemetry.take(name, fields)
    return telemetry
