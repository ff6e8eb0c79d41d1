"""MAVSDK 4.1 behind `VehicleLink`: a PX4 vehicle over MAVLink.

Telemetry is read message by message (`mavlink_direct`), since only those carry the vehicle's time.
Setpoints go out message by message too. MAVSDK's offboard plugin would repeat the last one at 20 Hz
by itself, also while this program hangs, and so defeat the autopilot's own failsafe.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import replace
from types import TracebackType
from typing import Any

import mavsdk
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, MavsdkConnectionError, MavsdkError
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage

from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    LinkLost,
    LinkTimeout,
    VehicleError,
)
from dronemon.frames import GeoPoint
from dronemon.types import Pose, Vector3
from dronemon.vehicle.link import Landed, Mode, Setpoint, VehicleState

# PX4 custom modes: main << 16 | sub << 24.
_PX4_MODES = {
    196608: Mode.POSITION,
    393216: Mode.OFFBOARD,
    33816576: Mode.TAKEOFF,
    50593792: Mode.HOLD,
    84148224: Mode.RETURN,
    100925440: Mode.LAND,
}
_LANDED = (
    Landed.UNKNOWN,
    Landed.ON_GROUND,
    Landed.IN_AIR,
    Landed.TAKING_OFF,
    Landed.LANDING,
)
_ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_CUSTOM_MODE_FLAG = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_PREARM_CHECK = 268435456  # MAV_SYS_STATUS_PREARM_CHECK
_STATE_CRITICAL = 5  # MAV_STATE_CRITICAL: a failsafe is in charge
_AUTOPILOT_PX4 = 12
_DO_SET_MODE, _SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 176, 511, 512
_GPS_GLOBAL_ORIGIN, _HOME_POSITION, _ATTITUDE, _LOCAL_POSITION_NED = 49, 242, 30, 32
_PX4_OFFBOARD_MAIN_MODE = 6
_POSITION_VELOCITY_YAW = 0b1001_1100_0000  # type_mask: ignore acceleration and yaw rate
_ATTEMPTS = 3
_POS_HORIZ_ABS = 16  # ESTIMATOR_POS_HORIZ_ABS
_EXPECTED_AFTER = {Mode.RETURN: frozenset({Mode.RETURN, Mode.LAND})}
_STREAM_BEFORE_OFFBOARD_S = 0.5
_STALE_POSITION_S = 0.5
_TEXTS_KEPT = 100
_POSES_KEPT = 512
_REBOOT_JUMP_S = 1.0


class MavsdkLink:
    """A PX4 vehicle at a MAVLink URL. Implements VehicleLink.

    connect_timeout_s, link_loss_timeout_s: wall time; command_timeout_s: vehicle time.
    """

    def __init__(
        self,
        url: str,
        *,
        connect_timeout_s: float = 10.0,
        command_timeout_s: float = 10.0,
        link_loss_timeout_s: float = 5.0,
    ) -> None:
        self._url = url
        self._connect_timeout_s = connect_timeout_s
        self._command_timeout_s = command_timeout_s
        self._link_loss_timeout_s = link_loss_timeout_s
        self._texts: deque[str] = deque(maxlen=_TEXTS_KEPT)
        self._num_heartbeats = 0
        self._state = VehicleState()
        self._expected_modes: frozenset[Mode] | None = None  # None: any
        self._position: tuple[float, Vector3, Vector3] | None = None
        self._poses: deque[Pose] = deque(maxlen=_POSES_KEPT)
        self._has_rebooted = False
        self._last_given_s = -math.inf
        self._posed_at = math.inf  # the event loop's time of the newest pose
        self._changed: asyncio.Event = asyncio.Event()
        self._readers: list[asyncio.Task[None]] = []
        self._exit = contextlib.AsyncExitStack()

    async def __aenter__(self) -> MavsdkLink:
        try:
            await self._connect()
        except BaseException:
            await self._exit.aclose()
            raise
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for reader in self._readers:
            reader.cancel()
        # A reader that fails cancels the body: only then has its group something to say.
        if isinstance(exc, asyncio.CancelledError):
            await self._exit.__aexit__(exc_type, exc, traceback)
        else:
            await self._exit.aclose()

    async def _connect(self) -> None:
        mavsdk.log_subscribe(_to_logging)
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        connections = await self._exit.enter_async_context(Mavsdk(configuration))
        try:
            await connections.add_any_connection(self._url)
        except MavsdkConnectionError as exc:
            raise LinkTimeout(
                f"cannot open {self._url}: {exc}; is the port free and the URL right?"
            ) from exc
        system = await connections.first_autopilot(timeout_s=self._connect_timeout_s)
        if system is None:
            raise LinkTimeout(
                f"no autopilot heard on {self._url} after {self._connect_timeout_s:g} s; "
                "is the vehicle on and streaming there?"
            )
        self._system_id = await system.get_system_id()
        self._direct = MavlinkDirectAsync(system)
        self._exit.callback(self._direct.destroy)
        self._action = ActionAsync(system)
        self._exit.callback(self._action.destroy)
        readers: dict[str, Callable[[dict[str, Any]], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "ATTITUDE": self._on_attitude,
            "LOCAL_POSITION_NED": self._on_local_position,
            "EXTENDED_SYS_STATE": self._on_extended_state,
            "SYS_STATUS": self._on_sys_status,
            "ESTIMATOR_STATUS": self._on_estimator_status,
            "HOME_POSITION": self._on_home,
            "GPS_GLOBAL_ORIGIN": self._on_origin,
            "STATUSTEXT": self._on_statustext,
        }
        group = await self._exit.enter_async_context(asyncio.TaskGroup())
        self._readers = [
            group.create_task(self._read(name, handler), name=f"mavlink {name}")
            for name, handler in readers.items()
        ]

    # What telemetry says

    async def _read(self, name: str, handler: Callable[[dict[str, Any]], None]) -> None:
        async for message in self._direct.subscribe_message(name):
            if message.system_id == self._system_id:
                try:
                    handler(json.loads(message.fields_json))
                except (LookupError, TypeError, ValueError) as exc:
                    logging.getLogger(__name__).warning("%s cannot be read: %r", name, exc)
                self._changed.set()

    def _on_heartbeat(self, fields: dict[str, Any]) -> None:
        if fields["autopilot"] != _AUTOPILOT_PX4:
            return  # a camera or gimbal of the same system
        self._state = replace(
            self._state,
            mode=_PX4_MODES.get(fields["custom_mode"], Mode.OTHER),
            is_armed=bool(fields["base_mode"] & _ARMED_FLAG),
            is_failsafe=fields["system_status"] == _STATE_CRITICAL,
        )
        self._num_heartbeats += 1

    def _on_local_position(self, fields: dict[str, Any]) -> None:
        time_s = fields["time_boot_ms"] / 1000.0
        if self._position is not None and time_s < self._position[0] - _REBOOT_JUMP_S:
            self._has_rebooted = True
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
            self._has_rebooted = True
            self._poses.clear()
        # Positions come at a third of the attitude's rate: carry the newest one along its velocity.
        position_time_s, position, velocity = self._position
        ahead_s = max(time_s - position_time_s, 0.0)
        if ahead_s > _STALE_POSITION_S:
            return  # no pose is better than an old place with a new time
        self._posed_at = asyncio.get_running_loop().time()
        self._poses.append(
            Pose(
                time_s=time_s,
                position_ned_m=(
                    position[0] + velocity[0] * ahead_s,
                    position[1] + velocity[1] * ahead_s,
                    position[2] + velocity[2] * ahead_s,
                ),
                velocity_ned_m_s=velocity,
                attitude_rad=(fields["roll"], fields["pitch"], fields["yaw"]),
            )
        )

    def _on_extended_state(self, fields: dict[str, Any]) -> None:
        self._state = replace(self._state, landed=_LANDED[fields["landed_state"]])

    def _on_sys_status(self, fields: dict[str, Any]) -> None:
        remaining = fields["battery_remaining"]
        self._state = replace(
            self._state,
            battery=remaining / 100.0 if remaining >= 0 else None,
            is_armable=bool(fields["onboard_control_sensors_health"] & _PREARM_CHECK),
        )

    def _on_estimator_status(self, fields: dict[str, Any]) -> None:
        is_good = bool(fields["flags"] & _POS_HORIZ_ABS)
        self._state = replace(self._state, is_position_good=is_good)

    def _on_home(self, fields: dict[str, Any]) -> None:
        self._state = replace(self._state, home=_geo_point(fields))

    def _on_origin(self, fields: dict[str, Any]) -> None:
        self._state = replace(self._state, origin=_geo_point(fields))

    def _on_statustext(self, fields: dict[str, Any]) -> None:
        self._texts.append(str(fields["text"]).rstrip("\0"))

    def texts(self) -> list[str]:
        """What the autopilot said in words since the last call."""
        said = list(self._texts)
        self._texts.clear()
        return said

    @property
    def state(self) -> VehicleState:
        """The newest state."""
        return self._state

    @property
    def pose(self) -> Pose:
        """The newest pose. Raises LinkTimeout before the first."""
        if not self._poses:
            raise LinkTimeout(
                f"the vehicle on {self._url} sends no ATTITUDE and LOCAL_POSITION_NED; "
                "does it know its position, and does this link stream it?"
            )
        return self._poses[-1]

    @property
    def time_s(self) -> float:
        """Vehicle time since boot of the newest pose."""
        return self.pose.time_s

    # Waiting

    async def next_heartbeat(self) -> None:
        """Wait for the next heartbeat."""
        heard = self._num_heartbeats
        while self._num_heartbeats == heard:
            await self._next_message(checks_mode=False)

    async def _next_message(self, *, checks_mode: bool = True) -> None:
        """Wait for any telemetry and check what every wait must check."""
        self._changed.clear()
        try:
            async with asyncio.timeout(self._link_loss_timeout_s):
                await self._changed.wait()
        except TimeoutError as exc:
            raise LinkLost(
                f"nothing heard from the vehicle on {self._url} for "
                f"{self._link_loss_timeout_s:g} s; its own failsafe is in charge until it is back"
            ) from exc
        if self._has_rebooted:
            self._has_rebooted = False
            raise VehicleError("the autopilot rebooted: its clock went back; the flight is over")
        if checks_mode:
            self._check_mode()
        silent_s = asyncio.get_running_loop().time() - self._posed_at
        if silent_s > self._link_loss_timeout_s:
            raise LinkLost(
                f"the vehicle on {self._url} sent no position or attitude for {silent_s:.1f} s; "
                "its own failsafe is in charge until they are back"
            )

    def _check_mode(self) -> None:
        """Raise ControlTaken if the mode is none that we asked for."""
        if self._expected_modes is not None and self._state.mode not in self._expected_modes:
            by_failsafe = self._state.is_failsafe
            who = "a failsafe of the autopilot" if by_failsafe else "the pilot"
            raise ControlTaken(
                f"{who} chose mode '{self._state.mode}' where "
                f"'{' or '.join(sorted(self._expected_modes))}' was ours",
                by_failsafe=by_failsafe,
            )

    async def next_pose(self) -> Pose:
        """Wait for a pose newer than the last one given."""
        while not self._poses or self._poses[-1].time_s == self._last_given_s:
            await self._next_message()
        self._last_given_s = self._poses[-1].time_s
        return self._poses[-1]

    async def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """Wait for the poses just before and just after an instant."""
        while not self._poses or self._poses[-1].time_s < time_s:
            await self._next_message()
        for index in range(len(self._poses) - 1, 0, -1):
            if self._poses[index - 1].time_s <= time_s:
                return self._poses[index - 1], self._poses[index]
        raise VehicleError(
            f"no pose is kept for vehicle time {time_s:.2f} s, the oldest is of "
            f"{self._poses[0].time_s:.2f} s; the picture is too old to be placed"
        )

    async def wait_until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Wait in vehicle time until telemetry makes `condition` true."""
        deadline_s = math.inf
        while not condition():
            await self._next_message()
            if self._poses:
                deadline_s = min(deadline_s, self._poses[-1].time_s + timeout_s)
                if self._poses[-1].time_s > deadline_s:
                    raise CommandUnconfirmed(
                        f"{what}: not seen in telemetry after {timeout_s:g} s of vehicle time; "
                        f"it says {self._describe()}"
                    )

    def _describe(self) -> str:
        state = self._state
        return (
            f"mode '{state.mode}', {'armed' if state.is_armed else 'disarmed'}, {state.landed}"
            + ("" if state.is_armable else ", arming checks not passed")
        )

    async def wait_ready(self, timeout_s: float) -> None:
        """Wait until position, home, origin and arming checks are there."""
        for message_id, rate_hz in ((_ATTITUDE, 50), (_LOCAL_POSITION_NED, 30)):
            await self._send_command(_SET_MESSAGE_INTERVAL, param1=message_id, param2=1e6 / rate_hz)
        loop = asyncio.get_running_loop()
        wall_deadline = loop.time() + timeout_s
        asked = -math.inf
        while missing := self._missing():
            if loop.time() > wall_deadline:
                raise CommandUnconfirmed(
                    f"the vehicle is not ready after {timeout_s:g} s: {', '.join(missing)}; "
                    "see what it says on a ground station"
                )
            if loop.time() > asked + 1.0:
                asked = loop.time()
                for message_id in (_GPS_GLOBAL_ORIGIN, _HOME_POSITION):
                    await self._send_command(_REQUEST_MESSAGE, param1=message_id)
            await self._next_message()

    def _missing(self) -> list[str]:
        checks = {
            "no local position": bool(self._poses),
            "no home position": self._state.home is not None,
            "no origin of the local frame": self._state.origin is not None,
            "arming checks not passed": self._state.is_armable,
        }
        return [name for name, is_there in checks.items() if not is_there]

    # Commands

    async def _send_command(self, command: int, **params: float) -> int:
        """Send a COMMAND_LONG and give the result of its acknowledgement."""
        fields = {
            "target_system": self._system_id,
            "target_component": 1,
            "command": command,
            "confirmation": 0,
        } | {f"param{i}": params.get(f"param{i}", 0) for i in range(1, 8)}
        message = MavlinkMessage(message_name="COMMAND_LONG", fields_json=json.dumps(fields))
        try:
            ack = await self._direct.send_command(message)
        except MavsdkError as exc:
            raise CommandUnconfirmed(f"no answer to command {command}: {exc}") from exc
        return int(json.loads(ack.fields_json)["result"])

    async def _confirm(
        self,
        name: str,
        send: Callable[[], Awaitable[object]],
        condition: Callable[[], bool],
        timeout_s: float | None = None,
    ) -> None:
        """Send a command until telemetry shows its effect, three times at most."""
        problem = ""
        for _ in range(_ATTEMPTS):
            try:
                await send()
            except (MavsdkError, CommandUnconfirmed) as exc:
                problem = f": {exc}"
            try:
                await self.wait_until(
                    condition, name, timeout_s or self._command_timeout_s / _ATTEMPTS
                )
            except CommandUnconfirmed:
                continue
            return
        error = CommandRejected if problem else CommandUnconfirmed
        raise error(
            f"{name}: asked {_ATTEMPTS} times without effect{problem}; "
            f"telemetry says {self._describe()}"
        )

    async def _change_mode(self, mode: Mode, send: Callable[[], Awaitable[object]]) -> None:
        """Ask for a mode and wait for the heartbeat that shows it; a pilot's choice wins."""
        self._check_mode()
        self._expect_also(mode)
        await self._confirm(f"mode '{mode}'", send, lambda: self._state.mode is mode)
        self._expected_modes = _EXPECTED_AFTER.get(mode, frozenset({mode}))

    def _expect_also(self, *modes: Mode) -> None:
        """While a command is under way, the mode is either still the old one or what we asked."""
        if self._expected_modes is not None:
            self._expected_modes |= frozenset(modes)

    async def arm(self) -> None:
        """Start the motors."""
        await self._confirm("arming", self._action.arm, lambda: self._state.is_armed)

    async def disarm(self) -> None:
        """Stop the motors; only on the ground."""
        self.release()
        await self._confirm("disarming", self._action.disarm, lambda: not self._state.is_armed)

    async def take_off(self, height_m: float) -> None:
        """Climb to a height above the present place and hold there."""
        start_down_m = self.pose.position_ned_m[2]
        tolerance_m = max(1.0, 0.03 * height_m)
        self._expected_modes = frozenset({self._state.mode, Mode.TAKEOFF, Mode.HOLD})
        try:
            usual_m = await self._action.get_takeoff_altitude()
            await self._action.set_takeoff_altitude(height_m)
        except MavsdkError as exc:
            raise CommandRejected(f"take-off altitude {height_m:g} m was refused: {exc}") from exc
        try:
            await self._confirm(
                "take-off",
                self._action.takeoff,
                lambda: (
                    self._state.mode is Mode.TAKEOFF or self._state.landed is not Landed.ON_GROUND
                ),
            )
            self._expected_modes = frozenset({Mode.TAKEOFF, Mode.HOLD})
            await self.wait_until(
                lambda: start_down_m - self.pose.position_ned_m[2] > height_m - tolerance_m,
                f"climb to {height_m:g} m",
                timeout_s=30.0 + 2.0 * height_m,
            )
        finally:  # the parameter is the vehicle's: leave it as it was
            with contextlib.suppress(MavsdkError):
                await self._action.set_takeoff_altitude(usual_m)

    async def start_offboard(self, setpoint: Setpoint) -> None:
        """Hand the vehicle over to our setpoints; they must have begun to flow before."""
        self._check_mode()
        self._expect_also(Mode.OFFBOARD)
        asked_s = -math.inf
        for _ in range(_ATTEMPTS):
            start_s = self.time_s
            while self.time_s < start_s + self._command_timeout_s / _ATTEMPTS:
                await self.send_setpoint(setpoint)
                if self._state.mode is Mode.OFFBOARD:
                    self._expected_modes = frozenset({Mode.OFFBOARD})
                    return
                if asked_s < start_s < self.time_s - _STREAM_BEFORE_OFFBOARD_S:
                    asked_s = self.time_s
                    await self._send_command(
                        _DO_SET_MODE, param1=_CUSTOM_MODE_FLAG, param2=_PX4_OFFBOARD_MAIN_MODE
                    )
                await self.next_pose()
        raise CommandUnconfirmed(
            f"mode '{Mode.OFFBOARD}': asked {_ATTEMPTS} times without effect; "
            f"telemetry says {self._describe()}"
        )

    async def send_setpoint(self, setpoint: Setpoint) -> None:
        """Send one setpoint."""
        (x, y, z), (vx, vy, vz) = setpoint.position_ned_m, setpoint.velocity_ned_m_s
        fields = {
            "time_boot_ms": round(self.time_s * 1000.0),
            "target_system": self._system_id,
            "target_component": 1,
            "coordinate_frame": 1,  # MAV_FRAME_LOCAL_NED
            "type_mask": _POSITION_VELOCITY_YAW,
            "yaw": setpoint.yaw_rad,
        }
        fields |= {"x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz}
        fields |= {"afx": 0.0, "afy": 0.0, "afz": 0.0, "yaw_rate": 0.0}
        message = MavlinkMessage(
            message_name="SET_POSITION_TARGET_LOCAL_NED", fields_json=json.dumps(fields)
        )
        try:
            await self._direct.send_message(message)
        except MavsdkError as exc:
            raise LinkLost(f"a setpoint could not be sent to {self._url}: {exc}") from exc

    async def hold(self) -> None:
        """Stop and stay."""
        await self._change_mode(Mode.HOLD, self._action.hold)

    async def return_home(self) -> None:
        """Begin to fly home and land there."""
        await self._change_mode(Mode.RETURN, self._action.return_to_launch)

    async def land(self) -> None:
        """Begin to land here."""
        await self._change_mode(Mode.LAND, self._action.land)

    def release(self) -> None:
        """From now on any mode is welcome."""
        self._expected_modes = None


def _to_logging(level: mavsdk.LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """Pass what MAVSDK says to Python's logging instead of standard output."""
    logging.getLogger("mavsdk").log(10 * (int(level) + 1), "%s", message)
    return True


def _geo_point(fields: dict[str, Any]) -> GeoPoint:
    return GeoPoint(
        latitude_deg=fields["latitude"] / 1e7,
        longitude_deg=fields["longitude"] / 1e7,
        altitude_m=fields["altitude"] / 1e3,
    )
