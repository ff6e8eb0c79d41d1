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
from collections.abc import Awaitable, Callable
from typing import Any

import mavsdk
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, MavsdkConnectionError, MavsdkError
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    LinkLost,
    LinkTimeout,
    VehicleError,
)
from dronemon.types import Pose
from dronemon.vehicle.link import Landed, Mode, Setpoint, StatusText, VehicleState
from dronemon.vehicle.mode_watch import ModeWatch
from dronemon.vehicle.telemetry import PX4_OFFBOARD_MAIN_MODE, Telemetry

_POSITION_VELOCITY_YAW = (  # of a setpoint: the rest is ignored
    mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
_WANTED_HZ = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
}
_ASKED_FOR = (mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION)
_ATTEMPTS = 3
_OTHER_PARAMS = tuple(f"param{i}" for i in range(3, 8))
_STREAM_BEFORE_OFFBOARD_S = 0.5
_Send = Callable[[], Awaitable[object]]


class MavsdkLink:
    """A PX4 vehicle at a MAVLink URL. Implements VehicleLink.

    connect_timeout_s, link_loss_timeout_s: wall time
    command_timeout_s:                      vehicle time
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
        self._attempt_timeout_s = command_timeout_s / _ATTEMPTS
        self._link_loss_timeout_s = link_loss_timeout_s
        self._telemetry = Telemetry()
        self._modes = ModeWatch()
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

    async def __aexit__(self, *exc: Any) -> None:
        for reader in self._readers:
            reader.cancel()
        # A reader that fails cancels the body: only then has its group something to say.
        if isinstance(exc[1], asyncio.CancelledError):
            await self._exit.__aexit__(*exc)
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
        group = await self._exit.enter_async_context(asyncio.TaskGroup())
        self._readers = [
            group.create_task(self._read(name), name=f"mavlink {name}")
            for name in self._telemetry.messages
        ]

    # What telemetry says

    async def _read(self, name: str) -> None:
        telemetry, loop = self._telemetry, asyncio.get_running_loop()
        async for message in self._direct.subscribe_message(name):
            if message.system_id != self._system_id:
                continue
            pose = telemetry.pose
            try:
                telemetry.take(name, json.loads(message.fields_json))
            except (LookupError, TypeError, ValueError) as exc:
                logging.getLogger(__name__).warning("%s cannot be read: %r", name, exc)
            if telemetry.pose is not pose:
                self._posed_at = loop.time()
            self._changed.set()

    def texts(self) -> list[StatusText]:
        """What the autopilot said in words since the last call."""
        return self._telemetry.texts()

    @property
    def state(self) -> VehicleState:
        """The newest state."""
        return self._telemetry.state

    @property
    def pose(self) -> Pose:
        """The newest pose. Raises LinkTimeout before the first."""
        pose = self._telemetry.pose
        if pose is None:
            raise LinkTimeout(
                f"the vehicle on {self._url} sends no ATTITUDE and LOCAL_POSITION_NED; "
                "does it know its position, and does this link stream it?"
            )
        return pose

    @property
    def time_s(self) -> float:
        """Vehicle time since boot of the newest pose."""
        return self.pose.time_s

    # Waiting

    async def next_heartbeat(self) -> None:
        """Wait for the next heartbeat."""
        heard = self._telemetry.num_heartbeats
        while self._telemetry.num_heartbeats == heard:
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
        if self._telemetry.has_rebooted:
            self._telemetry.has_rebooted = False
            raise VehicleError("the autopilot rebooted: its clock went back; the flight is over")
        if checks_mode:
            self._modes.check(self.state)
        silent_s = asyncio.get_running_loop().time() - self._posed_at
        if silent_s > self._link_loss_timeout_s:
            raise LinkLost(
                f"the vehicle on {self._url} sent no position or attitude for {silent_s:.1f} s; "
                "its own failsafe is in charge until they are back"
            )

    async def next_pose(self) -> Pose:
        """Wait for a pose newer than the last one given."""
        while (pose := self._telemetry.pose) is None or pose.time_s == self._last_given_s:
            await self._next_message()
        self._last_given_s = pose.time_s
        return pose

    async def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """Wait for the poses just before and just after an instant."""
        while (pose := self._telemetry.pose) is None or pose.time_s < time_s:
            await self._next_message()
        return self._telemetry.poses_around(time_s)

    async def wait_until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Wait in vehicle time until telemetry makes `condition` true."""
        deadline_s = math.inf
        while not condition():
            await self._next_message()
            if (pose := self._telemetry.pose) is not None:
                deadline_s = min(deadline_s, pose.time_s + timeout_s)
                if pose.time_s > deadline_s:
                    raise CommandUnconfirmed(
                        f"{what}: not seen in telemetry after {timeout_s:g} s of vehicle time; "
                        f"it says {self._telemetry.describe()}"
                    )

    async def wait_ready(self, timeout_s: float) -> None:
        """Wait until position, home, origin and arming checks are there."""
        for message_id, rate_hz in _WANTED_HZ.items():
            interval_us = 1e6 / rate_hz
            await self._send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)
        loop = asyncio.get_running_loop()
        wall_deadline = loop.time() + timeout_s
        asked = -math.inf
        while missing := self._telemetry.missing():
            if loop.time() > wall_deadline:
                raise CommandUnconfirmed(
                    f"the vehicle is not ready after {timeout_s:g} s: {', '.join(missing)}; "
                    "see what it says on a ground station"
                )
            if loop.time() > asked + 1.0:
                asked = loop.time()
                for message_id in _ASKED_FOR:
                    await self._send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)
            await self._next_message()

    # Commands

    def _message(self, name: str, **fields: float) -> MavlinkMessage:
        """A message to the autopilot."""
        target = {
            "target_system": self._system_id,
            "target_component": mavlink.MAV_COMP_ID_AUTOPILOT1,
        }
        return MavlinkMessage(message_name=name, fields_json=json.dumps(target | fields))

    async def _send_command(self, command: int, param1: float, param2: float = 0.0) -> None:
        """Send a COMMAND_LONG and wait for its acknowledgement, which only says that it came."""
        params = {"param1": param1, "param2": param2} | dict.fromkeys(_OTHER_PARAMS, 0.0)
        message = self._message("COMMAND_LONG", command=command, confirmation=0, **params)
        try:
            await self._direct.send_command(message)
        except MavsdkError as exc:
            raise CommandUnconfirmed(f"no answer to command {command}: {exc}") from exc

    async def _confirm(self, name: str, send: _Send, condition: Callable[[], bool]) -> None:
        """Send a command until telemetry shows its effect, three times at most."""
        problem = ""
        for _ in range(_ATTEMPTS):
            try:
                await send()
            except (MavsdkError, CommandUnconfirmed) as exc:
                problem = f": {exc}"
            try:
                return await self.wait_until(condition, name, self._attempt_timeout_s)
            except CommandUnconfirmed:
                continue
        error = CommandRejected if problem else CommandUnconfirmed
        raise error(
            f"{name}: asked {_ATTEMPTS} times without effect{problem}; "
            f"telemetry says {self._telemetry.describe()}"
        )

    async def _change_mode(self, mode: Mode, send: _Send) -> None:
        """Ask for a mode and wait for the heartbeat that shows it; a pilot's choice wins."""
        self._modes.check(self.state)
        self._modes.expect_also(mode)
        await self._confirm(f"mode '{mode}'", send, lambda: self.state.mode is mode)
        self._modes.expect(mode)

    async def arm(self) -> None:
        """Start the motors."""
        await self._confirm("arming", self._action.arm, lambda: self.state.is_armed)

    async def disarm(self) -> None:
        """Stop the motors; only on the ground."""
        self.release()
        await self._confirm("disarming", self._action.disarm, lambda: not self.state.is_armed)

    async def take_off(self, height_m: float) -> None:
        """Climb to a height above the present place and hold there."""
        start_down_m = self.pose.position_ned_m[2]
        tolerance_m = max(1.0, 0.03 * height_m)
        self._modes.expect(self.state.mode, Mode.TAKEOFF, Mode.HOLD)
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
                    self.state.mode is Mode.TAKEOFF or self.state.landed is not Landed.ON_GROUND
                ),
            )
            self._modes.expect(Mode.TAKEOFF, Mode.HOLD)
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
        self._modes.check(self.state)
        self._modes.expect_also(Mode.OFFBOARD)
        asked_s = -math.inf
        for _ in range(_ATTEMPTS):
            start_s = self.time_s
            while self.time_s < start_s + self._attempt_timeout_s:
                await self.send_setpoint(setpoint)
                if self.state.mode is Mode.OFFBOARD:
                    self._modes.expect(Mode.OFFBOARD)
                    return
                if asked_s < start_s < self.time_s - _STREAM_BEFORE_OFFBOARD_S:
                    asked_s = self.time_s
                    await self._send_command(
                        mavlink.MAV_CMD_DO_SET_MODE,
                        mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
                        PX4_OFFBOARD_MAIN_MODE,
                    )
                await self.next_pose()
        raise CommandUnconfirmed(
            f"mode '{Mode.OFFBOARD}': asked {_ATTEMPTS} times without effect; "
            f"telemetry says {self._telemetry.describe()}"
        )

    async def send_setpoint(self, setpoint: Setpoint) -> None:
        """Send one setpoint."""
        message = self._message(
            "SET_POSITION_TARGET_LOCAL_NED",
            time_boot_ms=round(self.time_s * 1000.0),
            coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
            type_mask=_POSITION_VELOCITY_YAW,
            yaw=setpoint.yaw_rad,
            **dict(zip("xyz", setpoint.position_ned_m, strict=True)),
            **dict(zip(("vx", "vy", "vz"), setpoint.velocity_ned_m_s, strict=True)),
            **dict.fromkeys(("afx", "afy", "afz", "yaw_rate"), 0.0),
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
        self._modes.release()


def _to_logging(level: mavsdk.LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """Pass what MAVSDK says to Python's logging instead of standard output."""
    logging.getLogger("mavsdk").log(10 * (int(level) + 1), "%s", message)
    return True
