"""PX4's numbers: its flight modes, its commands and their answers, and the vehicles that hover."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from dronemon.vehicle.link import Mode

AUTOPILOT_COMPONENT: int = mavlink.MAV_COMP_ID_AUTOPILOT1
REMOTE_ID_STATUS = "OPEN_DRONE_ID_ARM_STATUS"
"""What a remote ID, which is a component of its own, has against arming."""
_AUTO, _POSITION = 4, 3
_EVERY_GIMBAL, _UNCHANGED = 0.0, (-1.0, -1.0)
MODES = {  # main mode, sub mode
    (1, 0): Mode.MANUAL,
    (2, 0): Mode.ALTITUDE,
    (_POSITION, 0): Mode.POSITION,
    (_POSITION, 1): Mode.ORBIT,
    (_POSITION, 2): Mode.POSITION_SLOW,
    (_AUTO, 1): Mode.READY,
    (_AUTO, 2): Mode.TAKEOFF,
    (_AUTO, 3): Mode.HOLD,
    (_AUTO, 4): Mode.MISSION,
    (_AUTO, 5): Mode.RETURN,
    (_AUTO, 6): Mode.LAND,
    (_AUTO, 8): Mode.FOLLOW,
    (_AUTO, 9): Mode.PRECISION_LAND,
    (_AUTO, 10): Mode.VTOL_TAKEOFF,
    (5, 0): Mode.ACRO,
    (6, 0): Mode.OFFBOARD,
    (7, 0): Mode.STABILIZED,
    (8, 0): Mode.RATTITUDE,
    (10, 0): Mode.TERMINATION,
    (11, 0): Mode.ALTITUDE_CRUISE,
}
"""Main and sub mode of what HEARTBEAT and DO_SET_MODE carry. Source: PX4's px4_custom_mode.h."""
NUMBERS = {mode: numbers for numbers, mode in MODES.items()}
ROTORCRAFT = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
        mavlink.MAV_TYPE_GENERIC_MULTIROTOR,
        *range(mavlink.MAV_TYPE_VTOL_DUOROTOR, mavlink.MAV_TYPE_VTOL_RESERVED5 + 1),
    }
)
"""Types of vehicles that can hover."""


def mode_of(custom_mode: int) -> Mode:
    """The mode that a heartbeat's `custom_mode` names."""
    return MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24), Mode.OTHER)


@dataclass(frozen=True, slots=True)
class Command:
    """A MAV_CMD with its parameters; those that are not given are NaN."""

    number: int
    params: tuple[float, ...] = ()

    @classmethod
    def arm(cls, is_on: bool) -> Command:
        """Start or stop the motors."""
        return cls(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (float(is_on), 0.0))

    @classmethod
    def take_off(cls, altitude_m: float) -> Command:
        """Climb here to an altitude above mean sea level, and hold."""
        return cls(mavlink.MAV_CMD_NAV_TAKEOFF, (*(math.nan,) * 6, altitude_m))

    @classmethod
    def choose(cls, mode: Mode) -> Command:
        """Fly a mode; landing is taken by its own command, which PX4 never refuses."""
        if mode is Mode.LAND:
            return cls(mavlink.MAV_CMD_NAV_LAND)
        return cls(
            mavlink.MAV_CMD_DO_SET_MODE,
            (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *NUMBERS[mode]),
        )

    @classmethod
    def stream(cls, message_id: int, rate_hz: float) -> Command:
        """Send a message so often on this link."""
        return cls(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (message_id, 1e6 / rate_hz))

    @classmethod
    def take_gimbal(cls, system_id: int, component_id: int) -> Command:
        """Have somebody control the gimbals; who else may, stays."""
        params = (system_id, component_id, *_UNCHANGED, 0.0, 0.0, _EVERY_GIMBAL)
        return cls(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, params)

    @classmethod
    def send(cls, message_id: int) -> Command:
        """Send a message once."""
        return cls(mavlink.MAV_CMD_REQUEST_MESSAGE, (message_id,))


LOOK_DOWN = Command(
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
    (
        *(-90.0, 0.0, math.nan, math.nan),  # pitch and yaw in degrees, and their rates
        mavlink.GIMBAL_MANAGER_FLAGS_ROLL_LOCK
        | mavlink.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
        | mavlink.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME,
        *(0.0, _EVERY_GIMBAL),
    ),
)
"""Have the gimbals look straight down, with the vehicle's heading."""
RUN_CHECKS = Command(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
"""Say what is against arming."""
ACCEPTED, NO_ANSWER = "accepted", "no answer"
ANSWERS = {
    mavlink.MAV_RESULT_ACCEPTED: ACCEPTED,
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "refused for now",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "not supported",
    mavlink.MAV_RESULT_FAILED: "failed",
    mavlink.MAV_RESULT_IN_PROGRESS: "under way",
}
"""A COMMAND_ACK's result in words."""
