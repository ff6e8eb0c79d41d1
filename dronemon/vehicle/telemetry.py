"""What a PX4 vehicle says of itself: MAVLink messages to state, poses and texts.

Nothing here waits or sends: `Telemetry` is told the fields of one message after the other. What a
message says is checked here: one that cannot be is counted and left out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CameraError
from dronemon.frames import GeoPoint
from dronemon.types import GpsFix, Pose, Vector3
from dronemon.vehicle.gimbal import GIMBAL_MESSAGES, GimbalTrack
from dronemon.vehicle.link import Landed, Mode, StatusText, VehicleState
from dronemon.vehicle.motor_watch import MotorWatch
from dronemon.vehicle.px4 import REMOTE_ID_STATUS, ROTORCRAFT, mode_of
from dronemon.vehicle.rangefinder import RANGE_MESSAGE, RangeTrack
from dronemon.vehicle.status_texts import StatusTexts
from dronemon.vehicle.unstamped import Unstamped
from dronemon.vehicle.vehicle_clock import LATE_MS, VehicleClock

_LANDED = {
    mavlink.MAV_LANDED_STATE_UNDEFINED: Landed.UNKNOWN,
    mavlink.MAV_LANDED_STATE_ON_GROUND: Landed.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: Landed.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: Landed.TAKING_OFF,
    mavlink.MAV_LANDED_STATE_LANDING: Landed.LANDING,
}
_UNKNOWN: dict[str, dict[str, Any]] = {  # what is not known once its message stays away
    "EXTENDED_SYS_STATE": {"landed": Landed.UNKNOWN},
    "SYS_STATUS": {"battery": None, "is_armable": False, "has_sticks": False},
    "ESTIMATOR_STATUS": {
        "is_estimate_heard": False,
        "estimate_doubts": ("no word of it",),
        "accuracy_m": None,
        "height_accuracy_m": None,
    },
    "GPS_RAW_INT": {"gps": None},
    REMOTE_ID_STATUS: {"remote_id": None},
}
_ESTIMATED = {
    "attitude": mavlink.ESTIMATOR_ATTITUDE,
    "horizontal velocity": mavlink.ESTIMATOR_VELOCITY_HORIZ,
    "vertical velocity": mavlink.ESTIMATOR_VELOCITY_VERT,
    "position": mavlink.ESTIMATOR_POS_HORIZ_ABS,
    "height": mavlink.ESTIMATOR_POS_VERT_ABS,
}
_ESTIMATE_ERRORS = {
    "a GPS glitch": mavlink.ESTIMATOR_GPS_GLITCH,
    "an accelerometer error": mavlink.ESTIMATOR_ACCEL_ERROR,
}
_TRUSTED_S = 10.0
_STALE_POSITION_S = 0.5
_FUTURE_S = 1.0
_POSES_KEPT = 512
_FURTHEST_M, _FASTEST_M_S, _WIDEST_RAD = 1e6, 1e3, 4.0 * math.pi
_JUMP_M, _JUMP_RATIO, _JUMP_WITHIN_S = 2.0, 3.0, 1.0
# Not CONST_POS_MODE, which PX4 also sets while it stands still on the ground.
_Status = tuple[Mode, bool, bool]


class Telemetry:
    """The newest state and the last poses of one vehicle.

    num_heartbeats: of the autopilot, so far
    texts:          what it says in words
    gimbal:         how its gimbal was turned of late, if it has one
    rangefinder:    how far the ground below it was of late, likewise
    """

    def __init__(self) -> None:
        self.num_heartbeats = 0
        self.texts = StatusTexts()
        self.gimbal = GimbalTrack()
        self.rangefinder = RangeTrack()
        self._state = VehicleState()
        self._clock = VehicleClock()
        self._motors = MotorWatch()
        self._stamps: dict[str, int] = {}  # the newest by message, ATTITUDE apart
        self._heard_s: dict[str, float] = {}
        self._status: Unstamped[_Status] = Unstamped((Mode.OTHER, False, False), _stops)
        self._landed = Unstamped(Landed.UNKNOWN)
        self._poses: deque[Pose] = deque(maxlen=_POSES_KEPT)
        self._position: tuple[float, Vector3, Vector3] | None = None
        self._num_jumps, self._jumped_down_m = 0, 0.0  # told with the first pose after each
        self._handlers: dict[str, Callable[[dict[str, Any]], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "ATTITUDE": self._on_attitude,
            "LOCAL_POSITION_NED": self._on_local_position,
            "EXTENDED_SYS_STATE": self._on_landed,
            "SYS_STATUS": self._on_sys_status,
            "ESTIMATOR_STATUS": self._on_estimator_status,
            "HOME_POSITION": lambda fields: self._update(home=_geo_point(fields)),
            "GPS_GLOBAL_ORIGIN": lambda fields: self._update(origin=_geo_point(fields)),
            "GLOBAL_POSITION_INT": lambda fields: self._update(place=_geo_point(fields)),
            "GPS_RAW_INT": lambda fields: self._update(gps=_gps_fix(fields)),
            "AUTOPILOT_VERSION": self._on_version,
            REMOTE_ID_STATUS: self._on_remote_id,
            RANGE_MESSAGE: self._on_range,
            "STATUSTEXT": lambda fields: self.texts.take(fields, self.time_s),
            **{name: partial(self._on_gimbal, name) for name in GIMBAL_MESSAGES},
        }

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the messages that say something here."""
        return tuple(self._handlers)

    def take(self, name: str, fields: dict[str, Any]) -> None:
        """Take one message."""
        try:
            if self._is_late(name, fields):
                return
            self._handlers[name](fields)
        except Exception:  # noqa: BLE001 - no message may end a flight
            self._update(num_unreadable=self._state.num_unreadable + 1)
        else:
            self._heard_s[name] = self.time_s

    def _is_late(self, name: str, fields: dict[str, Any]) -> bool:
        """Whether a message with a stamp is not of the present.

        ATTITUDE apart, and what several of a vehicle's parts may send, each with its own stamps.
        """
        boot_ms = _whole(fields.get("time_boot_ms", 0), 0, 2**32 - 1)
        if name in ("ATTITUDE", RANGE_MESSAGE) or name in GIMBAL_MESSAGES:
            return False
        if "time_boot_ms" in fields:
            stamp, ahead_ms = boot_ms, self._clock.ahead_ms
            is_late = ahead_ms(stamp) < ahead_ms(self._stamps.get(name, stamp))
            is_late = is_late or ahead_ms(stamp) > LATE_MS  # of another clock
        else:  # `time_usec` counts from boot or from 1970
            stamp = _whole(fields.get("time_usec", 0), 0, 2**64 - 1)
            is_late = 0 < self._stamps.get(name, 0) - stamp <= LATE_MS * 1000
        if not is_late:
            self._stamps[name] = stamp
        return is_late

    @property
    def state(self) -> VehicleState:
        """The newest state; what has not been heard for long is not known any more."""
        oldest_s = self.time_s - _TRUSTED_S
        stale = [name for name in _UNKNOWN if self._heard_s.get(name, math.inf) < oldest_s]
        changes = {key: value for name in stale for key, value in _UNKNOWN[name].items()}
        if (limits_m := self.rangefinder.limits_m(self.time_s)) is not None:
            changes["range_limits_m"] = limits_m
        state = replace(self._state, **changes) if changes else self._state
        if state.is_estimate_heard or not state.is_position_good:
            return state
        is_placed = self._heard_s.get("GLOBAL_POSITION_INT", -math.inf) >= oldest_s
        return replace(state, is_position_good=is_placed and bool(state.gps and state.gps.is_3d))

    @property
    def pose(self) -> Pose | None:
        """The newest pose."""
        return self._poses[-1] if self._poses else None

    @property
    def time_s(self) -> float:
        """Vehicle time, 0 as long as it is not known."""
        return self._poses[-1].time_s if self._poses else 0.0

    def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """The poses just before and just after an instant that is not newer than the newest."""
        for index in range(len(self._poses) - 1, 0, -1):
            if self._poses[index - 1].time_s <= time_s:
                return self._poses[index - 1], self._poses[index]
        raise CameraError(
            f"no pose is kept for vehicle time {time_s:.2f} s, the oldest is of "
            f"{self._poses[0].time_s:.2f} s; the picture is too old to be placed"
        )

    def pose_times_s(self) -> list[float]:
        """Vehicle times of the poses that are kept, the oldest first."""
        return [pose.time_s for pose in self._poses]

    def said(self) -> list[StatusText]:
        """What the autopilot said in words since the last call."""
        return self.texts.said(self.time_s)

    def pop_problem(self) -> str | None:
        """What has become wrong with the vehicle's clock since the last call."""
        return self._clock.pop_problem()

    def _update(self, **changes: Any) -> None:
        self._state = replace(self._state, **changes)

    def _on_heartbeat(self, fields: dict[str, Any]) -> None:
        """Take mode and armed state. Armed in termination, or killed, it flies no mode any more."""
        if fields["autopilot"] != mavlink.MAV_AUTOPILOT_PX4 or fields["type"] not in ROTORCRAFT:
            raise ValueError("not the autopilot's")
        mode = mode_of(_whole(fields["custom_mode"], 0, 2**32 - 1))
        is_armed = bool(_whole(fields["base_mode"], 0, 255) & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        standing = _whole(fields["system_status"], 0, 8)
        is_over = is_armed and standing == mavlink.MAV_STATE_FLIGHT_TERMINATION
        status = (
            Mode.TERMINATION if is_over else mode,
            is_armed,
            is_over or standing == mavlink.MAV_STATE_CRITICAL,
        )
        self.num_heartbeats += 1
        self._motors.take(
            is_running=is_armed and not is_over,
            landed=self._state.landed,
            poses=reversed(self._poses),
        )
        self._status.take(status, self.time_s)
        mode, is_armed, is_failsafe = self._status.value
        self._update(
            mode=mode,
            is_armed=is_armed,
            is_failsafe=is_failsafe,
            is_doubted=self._status.doubted is not None,
            fell_from=self._motors.fell_from,
        )

    def _on_landed(self, fields: dict[str, Any]) -> None:
        self._landed.take(_LANDED[fields["landed_state"]], self.time_s)
        self._update(landed=self._landed.value)

    def _on_local_position(self, fields: dict[str, Any]) -> None:
        position = _vector(fields, ("x", "y", "z"), _FURTHEST_M)
        velocity = _vector(fields, ("vx", "vy", "vz"), _FASTEST_M_S)
        newest = (self._clock.time_s(fields["time_boot_ms"]), position, velocity)
        if self._position is not None and _is_jump(self._position, newest):
            self._num_jumps += 1
            self._jumped_down_m += position[2] - self._position[1][2]
        self._position = newest

    def _on_attitude(self, fields: dict[str, Any]) -> None:
        attitude_rad = _vector(fields, ("roll", "pitch", "yaw"), _WIDEST_RAD)
        num_reboots = self._clock.num_reboots
        time_s = self._clock.take(fields["time_boot_ms"], attitude_rad)
        if self._clock.are_two != self._state.are_two:
            self._update(are_two=self._clock.are_two)
        if self._clock.num_reboots != num_reboots:
            self._position = None
            self._poses.clear()
            self._stamps.clear()
            self._status.forget()
            self._landed.forget()
            self.gimbal.forget()
            self.rangefinder.forget()
            self._heard_s.clear()
        if time_s is None or self._position is None:
            return
        # Positions come at a third of the attitude's rate: carry the newest one along its velocity.
        position_time_s, (north, east, down), velocity = self._position
        if position_time_s > time_s + _FUTURE_S:  # wrongly stamped: true ones would seem late
            self._position = None
            del self._stamps["LOCAL_POSITION_NED"]
            return
        ahead_s = max(time_s - position_time_s, 0.0)
        if ahead_s > _STALE_POSITION_S:
            return  # no pose is better than an old place with a new time
        if self._num_jumps != self._state.num_resets:
            self._update(num_resets=self._num_jumps, jumped_down_m=self._jumped_down_m)
        self._poses.append(
            Pose(
                time_s=time_s,
                position_ned_m=(
                    north + velocity[0] * ahead_s,
                    east + velocity[1] * ahead_s,
                    down + velocity[2] * ahead_s,
                ),
                velocity_ned_m_s=velocity,
                attitude_rad=attitude_rad,
            )
        )

    def _on_gimbal(self, name: str, fields: dict[str, Any]) -> None:
        if self._poses:  # before, it is not known when it is
            self.gimbal.take(name, fields, self.time_s)

    def _on_range(self, fields: dict[str, Any]) -> None:
        if self._poses:  # as of a gimbal
            time_s = self._clock.time_s(fields["time_boot_ms"])
            self.rangefinder.take(fields, time_s, self.time_s)

    def _on_sys_status(self, fields: dict[str, Any]) -> None:
        remaining = _whole(fields["battery_remaining"], -1, 100)
        health = fields["onboard_control_sensors_health"]
        self._update(
            battery=remaining / 100.0 if remaining >= 0 else None,
            is_armable=bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK),
            has_sticks=bool(
                health
                & fields["onboard_control_sensors_present"]
                & mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
            ),
        )

    def _on_estimator_status(self, fields: dict[str, Any]) -> None:
        flags = _whole(fields["flags"], 0, 2**16 - 1)
        self._update(
            is_estimate_heard=True,
            is_position_good=bool(flags & mavlink.ESTIMATOR_POS_HORIZ_ABS),
            accuracy_m=_accuracy_m(fields["pos_horiz_accuracy"]),
            height_accuracy_m=_accuracy_m(fields["pos_vert_accuracy"]),
            estimate_doubts=(
                *(f"no {what}" for what, flag in _ESTIMATED.items() if not flags & flag),
                *(what for what, flag in _ESTIMATE_ERRORS.items() if flags & flag),
            ),
        )

    def _on_version(self, fields: dict[str, Any]) -> None:
        """The board's long number, or its short one where it has no long one; zeros are no name."""
        long_id = bytes(_whole(byte, 0, 255) for byte in fields["uid2"])
        short_id = _whole(fields["uid"], 0, 2**64 - 1).to_bytes(8, "big")
        if any(name := long_id if any(long_id) else short_id):
            self._update(hardware=name.hex())

    def _on_remote_id(self, fields: dict[str, Any]) -> None:
        is_good = fields["status"] == mavlink.MAV_ODID_ARM_STATUS_GOOD_TO_ARM
        self._update(remote_id="" if is_good else str(fields["error"]) or "it does not say why")


def _stops(before: _Status, after: _Status) -> bool:
    """Whether motors stop: taken for true, it ends a flight."""
    return before[1] and not after[1]


def _is_jump(before: tuple[float, Vector3, Vector3], after: tuple[float, Vector3, Vector3]) -> bool:
    """Whether two places in a row are further apart than their velocities explain."""
    (time_s, place, velocity), (next_time_s, next_place, next_velocity) = before, after
    moved_m, passed_s = math.dist(place, next_place), next_time_s - time_s
    explained_m = max(math.hypot(*velocity), math.hypot(*next_velocity)) * passed_s
    return passed_s < _JUMP_WITHIN_S and moved_m > max(_JUMP_M, _JUMP_RATIO * explained_m)


def _vector(fields: dict[str, Any], names: tuple[str, str, str], limit: float) -> Vector3:
    """Three numbers of a message. Raises ValueError if one cannot be."""
    first, second, third = (float(fields[name]) for name in names)
    if not all(abs(value) <= limit for value in (first, second, third)):  # NaN is never
        raise ValueError(f"{names}: {first}, {second}, {third}")
    return first, second, third


def _accuracy_m(told: float | None) -> float | None:
    """A standard deviation of a message; None where it is none, as NaN, which comes as None."""
    return told if told is not None and 0.0 < told < math.inf else None


def _whole(value: int, least: int, most: int) -> int:
    """A whole number of a message. Raises ValueError if it cannot be."""
    if not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{value} is not within {least} to {most}")
    return value


def _gps_fix(fields: dict[str, Any]) -> GpsFix:
    number, eph = _whole(fields["satellites_visible"], 0, 255), _whole(fields["eph"], 0, 65535)
    return GpsFix(
        is_3d=_whole(fields["fix_type"], 0, 255) >= mavlink.GPS_FIX_TYPE_3D_FIX,
        num_satellites=None if number == 255 else number,
        dilution=None if eph == 65535 else eph / 100.0,
    )


def _geo_point(fields: dict[str, Any]) -> GeoPoint:
    names = ("lat", "lon", "alt") if "alt" in fields else ("latitude", "longitude", "altitude")
    latitude, longitude, altitude = (fields[name] for name in names)
    return GeoPoint(
        latitude_deg=_whole(latitude, -900_000_000, 900_000_000) / 1e7,
        longitude_deg=_whole(longitude, -1_800_000_000, 1_800_000_000) / 1e7,
        altitude_m=_whole(altitude, -(2**31), 2**31) / 1e3,
    )
