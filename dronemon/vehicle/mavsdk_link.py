"""A PX4 vehicle over MAVLink behind `VehicleLink`: every command is confirmed from telemetry."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    LinkLost,
    VehicleError,
)
from dronemon.types import GimbalAttitude, Pose
from dronemon.vehicle.fence_items import FenceItem
from dronemon.vehicle.hearing import Hearing
from dronemon.vehicle.link import AIRBORNE, BY_STICKS, Mode, Setpoint, StatusText, VehicleState
from dronemon.vehicle.pointing import point_down
from dronemon.vehicle.px4 import ACCEPTED, NO_ANSWER, RUN_CHECKS, Command
from dronemon.vehicle.readiness import problems
from dronemon.vehicle.vehicle_clock import LATE_MS
from dronemon.vehicle.wire import Wire

_WANTED_HZ = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 10.0,
}
_ASKED_FOR = (
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
)
_ATTEMPTS = 3
_ASK_EVERY_S = 1.0
_ROUND_TRIPS = 3
_STREAM_BEFORE_OFFBOARD_S = 0.5
_SETPOINT_GAP_S = 1.0
"""PX4's COM_OF_LOSS_T: after so long without a setpoint its failsafe flies. By the clock: poses of
a simulator that runs faster come in bursts, and a burst is no pause of ours."""
_TEXTS_COME_S = 1.2
_CLIMB_M, _CLIMB_WITHIN_S = 1.0, 20.0
_WORDS, _DOUBTFUL_BEATS = 4, 5


class MavsdkLink:
    """A PX4 vehicle at a MAVLink URL. Implements VehicleLink.

    is_port_held:                           whether the caller holds the port, for this link alone
    system_id:                              of the vehicle, where several are heard
    connect_timeout_s, link_loss_timeout_s: wall time
    command_timeout_s:                      vehicle time
    """

    def __init__(
        self,
        url: str,
        *,
        is_port_held: bool = False,
        system_id: int | None = None,
        connect_timeout_s: float = 10.0,
        command_timeout_s: float = 10.0,
        link_loss_timeout_s: float = 5.0,
    ) -> None:
        self._attempt_timeout_s = command_timeout_s / _ATTEMPTS
        self._heard = Hearing(url, link_loss_timeout_s)
        self._telemetry, self._modes = self._heard.telemetry, self._heard.modes
        self._wire = Wire(
            url,
            take=self._heard.take,
            names=self._telemetry.messages,
            is_port_held=is_port_held,
            system_id=system_id,
            connect_timeout_s=connect_timeout_s,
        )
        self._sent_at = -math.inf  # wall time of the newest setpoint
        self._asked_offboard_s = -math.inf

    async def __aenter__(self) -> MavsdkLink:
        await self._wire.__aenter__()
        return self

    async def __aexit__(self, *exc: Any) -> None:
        await self._wire.__aexit__(*exc)

    # Hearing

    @property
    def system_id(self) -> int:
        """By which the vehicle is heard, once it was found."""
        return self._wire.system_id

    @property
    def state(self) -> VehicleState:
        """The newest state."""
        return self._heard.state

    @property
    def pose(self) -> Pose:
        """The newest pose. Raises LinkTimeout before the first."""
        return self._heard.pose

    @property
    def time_s(self) -> float:
        """Vehicle time since boot of the newest pose."""
        return self.pose.time_s

    @property
    def heartbeat_age_s(self) -> float:
        """Wall time since the last heartbeat."""
        return self._heard.heartbeat_age_s

    async def next_texts(self) -> list[StatusText]:
        """Wait, without a limit, until the autopilot says something."""
        return await self._heard.next_texts()

    @property
    def num_heartbeats(self) -> int:
        """How many heartbeats of the autopilot were heard."""
        return self._telemetry.num_heartbeats

    async def next_heartbeat(self) -> None:
        """Wait for the next heartbeat."""
        await self._heard.next_heartbeat()

    async def next_pose(self) -> Pose:
        """Wait for a pose newer than the last one given."""
        return await self._heard.next_pose()

    async def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """Wait for the poses just before and just after an instant."""
        return await self._heard.poses_around(time_s)

    async def gimbal_around(self, time_s: float) -> tuple[GimbalAttitude, GimbalAttitude]:
        """Wait for the gimbal's attitudes just before and just after an instant."""
        return await self._heard.gimbal_around(time_s)

    async def range_at(self, time_s: float) -> float:
        """Wait for what the rangefinder tells of an instant."""
        return await self._heard.range_at(time_s)

    async def wait_until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Wait in vehicle time until telemetry makes `condition` true."""
        await self._heard.wait_until(condition, what, timeout_s)

    # Getting ready

    async def wait_ready(self, timeout_s: float) -> None:
        """Wait until position, home, origin and arming checks are there, and well heard."""
        loop = asyncio.get_running_loop()
        deadline, asked_at = loop.time() + timeout_s, -math.inf
        num_texts = self._telemetry.texts.num_heard
        round_trips_s: list[float] = []
        while missing := problems(self._telemetry, round_trips_s):
            if loop.time() > deadline:
                raise CommandUnconfirmed(
                    f"the vehicle is not ready after {timeout_s:g} s: {'; '.join(missing)}"
                    + self._said_since(num_texts)
                )
            if loop.time() > asked_at + _ASK_EVERY_S:
                with contextlib.suppress(CommandUnconfirmed, LinkLost):  # it is missing then
                    await self._ask_for_readiness()
                    round_trips_s = [await self._wire.round_trip() for _ in range(_ROUND_TRIPS)]
                asked_at = loop.time()
            await self._heard.next_message()

    async def _ask_for_readiness(self) -> None:
        """Ask for what is needed to judge, and for what hinders arming."""
        for message_id, rate_hz in _WANTED_HZ.items():
            await self._wire.command(Command.stream(message_id, rate_hz))
        for message_id in _ASKED_FOR:
            await self._wire.command(Command.send(message_id))
        state = self.state
        if state.is_armed or state.is_armable or not self._telemetry.num_heartbeats:
            return
        if state.mode is not Mode.HOLD:
            # Disarmed, PX4 may be in a mode whose check fails for good and in silence: OFFBOARD.
            await self._wire.command(Command.choose(Mode.HOLD))
        await self._wire.command(RUN_CHECKS)

    async def read_parameters(self, names: Iterable[str]) -> Mapping[str, float]:
        """Values by name of those that the vehicle has."""
        return await self._wire.parameters.read(names)

    async def write_parameter(self, name: str, value: float) -> None:
        """Set a parameter, and read it back."""
        await self._wire.parameters.write(name, value)

    async def read_fence(self) -> tuple[FenceItem, ...]:
        """The fence that the vehicle has."""
        return await self._wire.fence.read()

    async def write_fence(self, items: Sequence[FenceItem]) -> None:
        """Replace the vehicle's fence, and read it back."""
        await self._wire.fence.write(items)

    # Commands

    async def point_down(self) -> None:
        """Take control of the gimbal and have it look straight down."""
        was_armed = self.state.is_armed

        def check() -> None:
            self._modes.check(self.state)
            if self.state.is_armed and not was_armed:
                raise ControlTaken("it was armed meanwhile: others fly it", by_failsafe=False)

        await point_down(self._wire, self._heard, self._attempt_timeout_s, check)

    async def _confirm(self, what: str, command: Command, condition: Callable[[], bool]) -> None:
        """Send a command until telemetry since then shows its effect, three times at most."""
        num_texts, num_heartbeats = self._telemetry.texts.num_heard, self._telemetry.num_heartbeats
        for _ in range(_ATTEMPTS):
            with contextlib.suppress(CommandUnconfirmed):
                await self._wire.command(command, lambda: self._modes.check(self.state))
            try:
                return await self.wait_until(
                    lambda: self._telemetry.num_heartbeats > num_heartbeats and condition(),
                    what,
                    self._attempt_timeout_s,
                )
            except CommandUnconfirmed:
                self._check_sticks(what, command, num_heartbeats)
        raise self._failure(what, command, num_texts)

    def _check_sticks(self, what: str, command: Command, num_heartbeats: int) -> None:
        """Raise ControlTaken where a pilot's sticks have ended at once what was accepted.

        Between two heartbeats, so that the mode that we asked for was never seen.
        """
        is_fresh = self._telemetry.num_heartbeats > num_heartbeats + 1
        is_flown = self.state.is_armed and self.state.mode in BY_STICKS
        if is_fresh and is_flown and self._wire.answer(command) == ACCEPTED:
            raise ControlTaken(
                f"{what} was accepted, and the mode is '{self.state.mode}': the pilot flies by "
                "sticks",
                by_failsafe=False,
            )

    def _failure(self, what: str, command: Command, num_texts: int) -> VehicleError:
        """The error of a command without effect, with what the autopilot said since."""
        answer = self._wire.answer(command)
        error = CommandUnconfirmed if answer in {ACCEPTED, NO_ANSWER} else CommandRejected
        return error(
            f"{what}: asked {_ATTEMPTS} times without effect ({answer}); telemetry says "
            f"{self.state.describe()}{self._said_since(num_texts)}"
        )

    def _said_since(self, num_texts: int) -> str:
        """What the autopilot has said since, as the end of a sentence."""
        said = self._telemetry.texts.since(num_texts, self._telemetry.time_s)[-_WORDS:]
        return "".join(["; the autopilot says: " if said else "", " / ".join(said)])

    async def _change_mode(self, mode: Mode) -> None:
        """Ask for a mode and wait for the heartbeat that shows it; a pilot's choice wins."""
        for _ in range(_DOUBTFUL_BEATS):
            if not self.state.is_doubted:
                break
            await self.next_heartbeat()  # the mode may be the pilot's
        self._modes.check(self.state)
        self._modes.expect_also(mode, self.state.mode)
        await self._confirm(f"mode '{mode}'", Command.choose(mode), lambda: self.state.mode is mode)
        self._modes.expect(mode)

    async def arm(self) -> None:
        """Start the motors."""
        self._modes.expect(self.state.mode, Mode.HOLD)
        await self._confirm("arming", Command.arm(True), lambda: self.state.is_armed)
        self._modes.check(self.state)  # that of the heartbeat which shows it

    async def disarm(self) -> None:
        """Stop the motors; only on the ground."""
        await self._confirm("disarming", Command.arm(False), lambda: not self.state.is_armed)
        await self._leave_take_off()

    async def _leave_take_off(self) -> None:
        """Choose Hold with the motors off, so that whoever arms next does not take off."""
        if not self.state.is_armed and self.state.mode is Mode.TAKEOFF:
            self.release()
            with contextlib.suppress(VehicleError):
                await self._change_mode(Mode.HOLD)

    async def take_off(self, height_m: float) -> None:
        """Climb to a height above the present place and hold there; only from the ground."""
        if self.state.landed in AIRBORNE:  # armed by a pilot
            raise ControlTaken("it is in the air already: the pilot flies", by_failsafe=False)
        start_down_m, origin = self.pose.position_ned_m[2], self.state.origin
        if origin is None:
            raise CommandUnconfirmed("take-off: the origin of the local frame was not heard")
        command = Command.take_off(origin.altitude_m - start_down_m + height_m)
        num_texts = self._telemetry.texts.num_heard
        self._modes.expect(self.state.mode, Mode.TAKEOFF, Mode.HOLD)
        try:
            await self._confirm(
                "take-off",
                command,
                lambda: self.state.mode is Mode.TAKEOFF or self.state.landed in AIRBORNE,
            )
            self._modes.expect(Mode.TAKEOFF, Mode.HOLD)
            await self._climb(start_down_m, height_m, num_texts)
        except ControlTaken:
            raise
        except VehicleError:
            await self._leave_take_off()
            raise

    async def _climb(self, start_down_m: float, height_m: float, num_texts: int) -> None:
        """Wait for the height; the motors must run and the climb go on."""
        enough_m = height_m - max(1.0, 0.03 * height_m)
        reached_m = 0.0

        def climbed_m() -> float:
            return start_down_m - self.pose.position_ned_m[2]

        has_begun = False
        while self.state.is_armed and (reached_m := climbed_m()) <= enough_m:
            has_begun = has_begun or self.state.mode is Mode.TAKEOFF
            if has_begun and self.state.mode is Mode.HOLD:  # PX4 chooses it at the top alone
                raise ControlTaken(
                    f"mode '{Mode.HOLD}' was chosen at {reached_m:.1f} m of {height_m:g} m",
                    by_failsafe=self.state.is_failsafe,
                )
            next_m = min(reached_m + _CLIMB_M, enough_m)
            try:
                await self.wait_until(
                    lambda: not self.state.is_armed or climbed_m() > next_m,  # noqa: B023
                    "climb",
                    _CLIMB_WITHIN_S,
                )
            except CommandUnconfirmed as exc:
                raise CommandUnconfirmed(
                    f"it does not climb: {climbed_m():.1f} m of {height_m:g} m after "
                    f"{_CLIMB_WITHIN_S:g} s of vehicle time; telemetry says "
                    f"{self.state.describe()}{self._said_since(num_texts)}"
                ) from exc
        if not self.state.is_armed:
            await self._listen(_TEXTS_COME_S)
            raise CommandRejected(
                f"the motors stopped in the take-off, at {climbed_m():.1f} m of {height_m:g} m"
                + self._said_since(num_texts)
            )

    async def _listen(self, duration_s: float) -> None:
        """Wait for what the autopilot says about what it did; texts come up to a second later."""
        end_s = self.time_s + duration_s
        with contextlib.suppress(VehicleError):
            while self.time_s < end_s:
                await self._heard.next_message(checks_mode=False)

    async def start_offboard(self, setpoint: Setpoint) -> None:
        """Hand the vehicle over to our setpoints, which flow from here on."""
        self._modes.check(self.state)
        self._modes.expect_also(Mode.OFFBOARD, self.state.mode)
        await self.send_setpoint(setpoint)
        num_texts, start_s = self._telemetry.texts.num_heard, self.time_s
        ask_s = start_s + _STREAM_BEFORE_OFFBOARD_S
        command = Command.choose(Mode.OFFBOARD)
        while self.time_s < start_s + _ATTEMPTS * self._attempt_timeout_s:
            await self.send_setpoint(setpoint)
            if self.state.mode is Mode.OFFBOARD:
                self._modes.expect(Mode.OFFBOARD)
                return
            if self.time_s > ask_s:
                ask_s = self.time_s + self._attempt_timeout_s
                await self._wire.post(command)  # setpoints must go on while the answer is under way
                self._asked_offboard_s = self.time_s
            await self.next_pose()
        raise self._failure(f"mode '{Mode.OFFBOARD}'", command, num_texts)

    async def send_setpoint(self, setpoint: Setpoint) -> None:
        """Send one setpoint; after a pause, only once it is known that the mode is still ours.

        While others fly, none is sent as long as a late copy of our own request for offboard may
        be on its way: with setpoints, it would take the vehicle from them.
        """
        loop = asyncio.get_running_loop()
        if self._modes.is_released and self.time_s < self._asked_offboard_s + LATE_MS / 1000.0:
            return
        if loop.time() > self._sent_at + _SETPOINT_GAP_S:
            # In its failsafe PX4 would follow the setpoint again. Old telemetry may be on its way.
            await self._wire.round_trip()
            await self.next_heartbeat()
            self._modes.check(self.state)
        await self._wire.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            time_boot_ms=round(self.time_s * 1000.0) % 2**32,
            coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
            type_mask=mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE,
            yaw=setpoint.yaw_rad,
            yaw_rate=0.0,
            **dict(zip("xyz", setpoint.position_ned_m, strict=True)),
            **dict(zip(("vx", "vy", "vz"), setpoint.velocity_ned_m_s, strict=True)),
            **dict(zip(("afx", "afy", "afz"), setpoint.acceleration_ned_m_s2, strict=True)),
        )
        self._sent_at = loop.time()

    async def hold(self) -> None:
        """Stop and stay."""
        await self._change_mode(Mode.HOLD)

    async def return_home(self) -> None:
        """Begin to fly home and land there."""
        await self._change_mode(Mode.RETURN)

    async def land(self) -> None:
        """Begin to land here."""
        await self._change_mode(Mode.LAND)

    def reclaim(self) -> None:
        """From now on offboard alone is welcome."""
        self._modes.expect(Mode.OFFBOARD)

    def release(self) -> None:
        """From now on any mode is welcome."""
        self._modes.release()
