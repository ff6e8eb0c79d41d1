"""What a PX4 vehicle says of itself: MAVLink messages to state, poses and texts.

Nothing here waits or sends: `Telemetry` is told the fields of one message after the other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import VehicleError
from dronemon.frames import GeoPoint
from dronemon.types import Pose, Vector3
from dronemon.vehicle.link import Landed, Mode, StatusText, VehicleState

PX4_OFFBOARD_MAIN_MODE = 6
_PX4_MODES = {  # HEARTBEAT's custom_mode: main mode << 16 | sub mode << 24
    3 << 16: Mode.POSITION,
    PX4_OFFBOARD_MAIN_MODE << 16: Mode.OFFBOARD,
    4 << 16 | 2 << 24: Mode.TAKEOFF,
    4 << 16 | 3 << 24: Mode.HOLD,
    4 << 16 | 5 << 24: Mode.RETURN,
    4 << 16 | 6 << 24: Mode.LAND,
}
_LANDED = {
    mavlink.MAV_LANDED_STATE_UNDEFINED: Landed.UNKNOWN,
    mavlink.MAV_LANDED_STATE_ON_GROUND: Landed.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: Landed.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: Landed.TAKING_OFF,
    mavlink.MAV_LANDED_STATE_LANDING: Landed.LANDING,
}
_STALE_POSITION_S = 0.5
_REBOOT_JUMP_S = 1.0
_POSES_KEPT = 512
_TEXTS_KEPT = 100
_CHUNK_BYTES = 50
_CHUNK_WAIT_S = 1.0
_LOST = "…"


class Telemetry:
    """The newest state and the last poses of one vehicle.

    state:          everything slow
    num_heartbeats: of the autopilot, so far
    has_rebooted:   its clock went back since this was last set to False
    """

    def __init__(self) -> None:
        self.state = VehicleState()
        self.num_heartbeats = 0
        self.has_rebooted = False
        self._poses: deque[Pose] = deque(maxlen=_POSES_KEPT)
        self._position: tuple[float, Vector3, Vector3] | None = None
        self._texts = _StatusTexts()
        self._handlers: dict[str, Callable[[dict[str, Any]], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "ATTITUDE": self._on_attitude,
            "LOCAL_POSITION_NED": self._on_local_position,
            "EXTENDED_SYS_STATE": lambda fields: self._update(
                landed=_LANDED[fields["landed_state"]]
            ),
            "SYS_STATUS": self._on_sys_status,
            "ESTIMATOR_STATUS": self._on_estimator_status,
            "HOME_POSITION": lambda fields: self._update(home=_geo_point(fields)),
            "GPS_GLOBAL_ORIGIN": lambda fields: self._update(origin=_geo_point(fields)),
            "STATUSTEXT": lambda fields: self._texts.take(fields, self._time_s),
        }

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the messages that say something here."""
        return tuple(self._handlers)

    def take(self, name: str, fields: dict[str, Any]) -> None:
        """Take one message. Raises LookupError, TypeError or ValueError if it cannot be read."""
        self._handlers[name](fields)

    @property
    def pose(self) -> Pose | None:
        """The newest pose."""
        return self._poses[-1] if self._poses else None

    def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """The poses just before and just after an instant that is not newer than the newest."""
        for index in range(len(self._poses) - 1, 0, -1):
            if self._poses[index - 1].time_s <= time_s:
                return self._poses[index - 1], self._poses[index]
        raise VehicleError(
            f"no pose is kept for vehicle time {time_s:.2f} s, the oldest is of "
            f"{self._poses[0].time_s:.2f} s; the picture is too old to be placed"
        )

    def texts(self) -> list[StatusText]:
        """What the autopilot said in words since the last call."""
        return self._texts.said(self._time_s)

    def describe(self) -> str:
        """The state in words."""
        state = self.state
        return (
            f"mode '{state.mode}', {'armed' if state.is_armed else 'disarmed'}, {state.landed}"
            + ("" if state.is_armable else ", arming checks not passed")
        )

    def missing(self) -> list[str]:
        """What a vehicle that is ready has said and this one has not."""
        checks = {
            "no local position": bool(self._poses),
            "no home position": self.state.home is not None,
            "no origin of the local frame": self.state.origin is not None,
            "arming checks not passed": self.state.is_armable,
        }
        return [name for name, is_there in checks.items() if not is_there]

    @property
    def _time_s(self) -> float:
        """Vehicle time, as far as it is known."""
        return self._poses[-1].time_s if self._poses else 0.0

    def _update(self, **changes: Any) -> None:
        self.state = replace(self.state, **changes)

    def _on_heartbeat(self, fields: dict[str, Any]) -> None:
        if fields["autopilot"] != mavlink.MAV_AUTOPILOT_PX4:
            return  # a camera or gimbal of the same system
        self._update(
            mode=_PX4_MODES.get(fields["custom_mode"], Mode.OTHER),
            is_armed=bool(fields["base_mode"] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
            is_failsafe=fields["system_status"] == mavlink.MAV_STATE_CRITICAL,
        )
        self.num_heartbeats += 1

    def _on_local_position(self, fields: dict[str, Any]) -> None:
        time_s = fields["time_boot_ms"] / 1000.0
        if self._position is not None and time_s < self._position[0] - _REBOOT_JUMP_S:
            self.has_rebooted = True
        self._position = (
            time_s,
            (fields["x"], fields["y"], fields["z"]),
            (fields["vx"], fields["vy"], fields["vz"]),
        )

    def _on_attitude(self, fields: dict[str, Any]) -> None:
        if self._position is None:
            return
        time_s = fields["time_boot_ms"] / 1000.0
        if self._poses and time_s <= self._poses[-1].time_s:
            if time_s > self._poses[-1].time_s - _REBOOT_JUMP_S:
                return  # a late datagram
            self.has_rebooted = True
            self._poses.clear()
        # Positions come at a third of the attitude's rate: carry the newest one along its velocity.
        position_time_s, (north, east, down), velocity = self._position
        ahead_s = max(time_s - position_time_s, 0.0)
        if ahead_s > _STALE_POSITION_S:
            return  # no pose is better than an old place with a new time
        self._poses.append(
            Pose(
                time_s=time_s,
                position_ned_m=(
                    north + velocity[0] * ahead_s,
                    east + velocity[1] * ahead_s,
                    down + velocity[2] * ahead_s,
                ),
                velocity_ned_m_s=velocity,
                attitude_rad=(fields["roll"], fields["pitch"], fields["yaw"]),
            )
        )

    def _on_sys_status(self, fields: dict[str, Any]) -> None:
        remaining = fields["battery_remaining"]
        health = fields["onboard_control_sensors_health"]
        self._update(
            battery=remaining / 100.0 if remaining >= 0 else None,
            is_armable=bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK),
        )

    def _on_estimator_status(self, fields: dict[str, Any]) -> None:
        self._update(is_position_good=bool(fields["flags"] & mavlink.ESTIMATOR_POS_HORIZ_ABS))


class _StatusTexts:
    """Puts the chunks of STATUSTEXT together.

    A chunk that is not full is a text's last. PX4 ends its texts with a tab, and sends nothing more
    after a chunk that the text just fills.
    Source: MAVLink common message set, STATUSTEXT.
    """

    def __init__(self) -> None:
        self._said: deque[StatusText] = deque(maxlen=_TEXTS_KEPT)
        self._chunks: list[str] = []  # of the text under way
        self._severity = self._number = self._next_chunk = 0
        self._since_s = 0.0

    def take(self, fields: dict[str, Any], now_s: float) -> None:
        """Take one chunk; MAVLink 1 has no `id` and `chunk_seq`."""
        chunk = str(fields["text"]).split("\0", 1)[0]
        number, sequence = fields.get("id", 0), fields.get("chunk_seq", 0)
        if number != self._number or sequence < self._next_chunk:
            self._finish(_LOST)
        if not self._chunks:
            self._severity, self._number, self._since_s = fields["severity"], number, now_s
        self._chunks += [chunk] if sequence == self._next_chunk else [_LOST, chunk]
        self._next_chunk = sequence + 1
        if len(chunk.encode()) < _CHUNK_BYTES or chunk.endswith("\t"):
            self._finish()

    def said(self, now_s: float) -> list[StatusText]:
        """The texts since the last call, and one whose end does not come."""
        if not 0.0 <= now_s - self._since_s < _CHUNK_WAIT_S:
            self._finish(_LOST)
        said = list(self._said)
        self._said.clear()
        return said

    def _finish(self, mark: str = "") -> None:
        if self._chunks:
            text = "".join(self._chunks).rstrip() + mark
            self._said.append(StatusText(severity=self._severity, text=text))
        self._chunks, self._next_chunk = [], 0


def _geo_point(fields: dict[str, Any]) -> GeoPoint:
    return GeoPoint(
        latitude_deg=fields["latitude"] / 1e7,
        longitude_deg=fields["longitude"] / 1e7,
        altitude_m=fields["altitude"] / 1e3,
    )
