"""A vehicle in memory behind `VehicleLink`, with faults as the simulator has them.

It lives on the event loop's time, which tests let jump (`virtual_time`). It flies without inertia
and knows of PX4 what a mission must survive: heartbeats once a second, failsafes, refusals.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dronemon.camera import FrameSource
from dronemon.errors import (
    CameraError,
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    LinkLost,
    LinkTimeout,
    VehicleError,
)
from dronemon.frames import GeoPoint, body_to_ned, ned_to_geo
from dronemon.mission.faults import parse_fault
from dronemon.mission.schema import GIMBAL_ERROR_DEG
from dronemon.types import GimbalAttitude, GpsFix, Picture, Pose, Vector3
from dronemon.vehicle import Landed, Mode, Setpoint, StatusText, VehicleState
from dronemon.vehicle.fence_items import FenceItem
from dronemon.vehicle.motor_watch import MotorWatch
from sim.faults import FaultSchedule
from sim.parameters import TABLE as PARAMETERS

STEP_S = 0.02
ORIGIN = GeoPoint(latitude_deg=47.4, longitude_deg=8.5, altitude_m=488.0)
_ATTEMPTS = 3
_SETPOINT_LIMIT_S, _FAILSAFE_HOLD_S = 1.0, 5.0
_DISARM_AFTER_S = 2.0
_SPEED_M_S, _CLIMB_M_S, _FALL_M_S = 20.0, 3.0, 15.0


class FakeVehicle:
    """The vehicle and its autopilot: what is, as against what the link has heard."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self.position: list[float] = [0.0, 0.0, 0.0]
        self.velocity: list[float] = [0.0, 0.0, 0.0]
        self.intent = Mode.HOLD
        self.is_armed = False
        self.has_gps = True
        self.is_position_good = self.is_estimate_heard = True
        self.battery: float | None = 0.9
        self.is_deaf = False
        self.refused: set[str] = set()
        """Names of commands that are refused; `all` refuses every one."""
        self.failsafe: Mode | None = None
        """Mode of a failsafe that a test imposes."""
        self.target_down_m = 0.0
        self.setpoint: Setpoint | None = None
        self.setpoint_s = -math.inf
        self._on_ground_s = 0.0
        self._has_flown = False
        self.disarm_after_s = _DISARM_AFTER_S
        self.setpoint_limit_s = _SETPOINT_LIMIT_S
        self.height_error_m = 0.0
        self.attitude_rad: Vector3 = (0.0, 0.0, 0.0)
        self.climb_m_s = self.speed_m_s = _SPEED_M_S
        self.fall_m_s = _FALL_M_S  # disarmed
        self.drift_m_s = 0.0
        self.parameters = {p.name: float(p.default) for p in PARAMETERS}
        self.parameters |= {"COM_OBL_RC_ACT": 3.0, "COM_RC_OVERRIDE": 3.0, "GF_ACTION": 3.0}
        self.has_sticks = True
        self.fence: tuple[FenceItem, ...] = ()
        self.range_limits_m: tuple[float, float] | None = (0.1, 120.0)
        self.is_range_lost = False
        self.ground_m = 0.0
        """How far the ground below lies under that at home."""
        self.is_gimbal_silent = False
        self.gimbal_off_deg = 0.0
        """By how much the gimbal looks above what it is told."""

    @property
    def is_on_ground(self) -> bool:
        return self.position[2] > -0.1

    @property
    def mode(self) -> Mode:
        return self._failsafe() or self.intent

    def _failsafe(self) -> Mode | None:
        if not self.is_armed:
            return None
        if not self.has_gps and self.intent is not Mode.LAND:
            return Mode.ALTITUDE
        if self.failsafe is not None:
            return self.failsafe
        late_s = self.time_s - self.setpoint_s - self.setpoint_limit_s
        if self.intent is not Mode.OFFBOARD or late_s <= 0.0:
            return None
        return Mode.HOLD if late_s < _FAILSAFE_HOLD_S else Mode.RETURN

    @property
    def is_failsafe(self) -> bool:
        return self._failsafe() is not None

    def command(self, name: str) -> bool:
        """-> whether it obeys."""
        return not (self.is_deaf or {name, "all"} & self.refused)

    def choose(self, mode: Mode) -> None:
        """A new mode replaces what a failsafe imposed."""
        self.intent, self.failsafe = mode, None

    def step(self) -> None:
        self.time_s = round(self.time_s + STEP_S, 6)
        before = list(self.position)
        if self.is_armed and self.mode is not Mode.TERMINATION:
            self._fly()
        else:
            self._move(2, 0.0, self.fall_m_s)
        self.velocity = [(b - a) / STEP_S for a, b in zip(before, self.position, strict=True)]
        self._has_flown = self.is_armed and (self._has_flown or not self.is_on_ground)
        if not (self.is_on_ground and self._has_flown):
            self._on_ground_s = self.time_s
        if self.time_s - self._on_ground_s > self.disarm_after_s:
            self.is_armed = False

    def _fly(self) -> None:
        mode = self.mode
        if mode is Mode.TAKEOFF:
            self._move(2, self.target_down_m, _CLIMB_M_S)
            if self.position[2] <= self.target_down_m:
                self.intent = Mode.HOLD
        elif mode is Mode.OFFBOARD and self.setpoint is not None:
            for axis in range(3):
                speed_m_s = self.climb_m_s if axis == 2 else self.speed_m_s
                self._move(axis, self.setpoint.position_ned_m[axis], speed_m_s)
            self.position[0] += self.drift_m_s * STEP_S
        elif mode is Mode.LAND or (mode is Mode.RETURN and self._is_over_home()):
            self._move(2, 0.0, _CLIMB_M_S)
        elif mode is Mode.RETURN:
            for axis in range(2):
                self._move(axis, 0.0, _SPEED_M_S)

    def _is_over_home(self) -> bool:
        return math.hypot(*self.position[:2]) < 0.01

    def _move(self, axis: int, goal: float, speed_m_s: float) -> None:
        way = goal - self.position[axis]
        self.position[axis] += math.copysign(min(abs(way), speed_m_s * STEP_S), way)


class FakeLink:
    """A link to a fake vehicle, open inside its `async with`. Implements VehicleLink.

    faults: as for `python -m sim`, in vehicle time after arming.
    """

    def __init__(
        self,
        *,
        faults: Sequence[str] = (),
        link_loss_timeout_s: float = 2.0,
        command_timeout_s: float = 9.0,
        heartbeat_s: float = 1.0,
    ) -> None:
        self.vehicle = FakeVehicle()
        self.is_silent = False
        self.is_camera_silent = self.is_camera_frozen = False
        self.commands: list[str] = []
        """Every command that was sent, heard or not."""
        self.num_setpoints = 0
        self._loss_s, self._timeout_s = link_loss_timeout_s, command_timeout_s
        self._heartbeat_s, self._heartbeat_due_s = heartbeat_s, 0.0
        self._num_heartbeats, self._beat_at = 0, 0.0
        self.num_resets, self.jumped_down_m = 0, 0.0
        self.hardware, self.origin = "fake", ORIGIN
        self._misled: dict[str, Any] = {}
        self._state = VehicleState()
        self._motors = MotorWatch()
        self._poses: list[Pose] = []
        self._given_s = -math.inf
        self._expected: frozenset[Mode] | None = None
        self._has_rebooted = False
        self._said: list[StatusText] = []
        self._changed = asyncio.Event()
        self._timer: asyncio.TimerHandle | None = None
        self._faults = self._schedule(faults)

    def _schedule(self, faults: Sequence[str]) -> FaultSchedule:
        vehicle = self.vehicle

        def lose_gps(is_lost: float | None) -> None:
            """The failsafe is seen before the position's flag clears, as with PX4."""
            vehicle.has_gps = not is_lost
            asyncio.get_running_loop().call_later(
                2.5 if is_lost else 0.0,
                lambda: setattr(vehicle, "is_position_good", vehicle.has_gps),
            )
            vehicle.refused = {"return"} if is_lost else set()

        def reject(is_on: float | None) -> None:
            vehicle.refused = {"all"} if is_on else set()

        switches: dict[str, Callable[[float | None], None]] = {
            "silence": lambda is_on: setattr(self, "is_silent", bool(is_on)),
            "deaf": lambda is_on: setattr(vehicle, "is_deaf", bool(is_on)),
            "reject": reject,
            "gps": lose_gps,
            "gimbal": lambda is_on: setattr(vehicle, "is_gimbal_silent", bool(is_on)),
            "range": lambda is_on: setattr(vehicle, "is_range_lost", bool(is_on)),
            "askew": lambda off_deg: setattr(vehicle, "gimbal_off_deg", off_deg or 0.0),
            "camera": lambda is_on: setattr(self, "is_camera_silent", bool(is_on)),
            "freeze": lambda is_on: setattr(self, "is_camera_frozen", bool(is_on)),
            "pilot": lambda is_on: vehicle.choose(Mode.POSITION if is_on else Mode.OFFBOARD),
            "battery": lambda level: setattr(vehicle, "battery", level),
            "reboot": lambda _: setattr(self, "_has_rebooted", True),
        }
        return FaultSchedule(
            [parse_fault(fault) for fault in faults], lambda kind, value: switches[kind](value)
        )

    async def __aenter__(self) -> FakeLink:
        self._tick()
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._timer is not None
        self._timer.cancel()

    def hear_another(self) -> None:
        """Find that two vehicles of one system id are heard."""
        self._state = replace(self._state, are_two=True)

    def _tick(self) -> None:
        vehicle = self.vehicle
        vehicle.step()
        self._faults.advance(vehicle.time_s, vehicle.is_armed)
        if not self.is_silent:
            self._publish()
            self._changed.set()
        self._timer = asyncio.get_running_loop().call_later(STEP_S, self._tick)

    def _publish(self) -> None:
        vehicle = self.vehicle
        if vehicle.time_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = vehicle.time_s + self._heartbeat_s
            self._num_heartbeats += 1
            self._beat_at = asyncio.get_running_loop().time()
            said = {
                "mode": vehicle.mode,
                "is_armed": vehicle.is_armed,
                "is_failsafe": vehicle.is_failsafe,
                "place": ned_to_geo(np.array(vehicle.position), self.origin),
            }
            self._motors.take(
                is_running=vehicle.is_armed and vehicle.mode is not Mode.TERMINATION,
                landed=self._state.landed,
                poses=reversed(self._poses),
            )
            said["fell_from"] = self._motors.fell_from
            self._state = replace(self._state, **(said | self._misled))
            self._misled = {}
        self._state = replace(
            self._state,
            is_armable=True,
            is_position_good=vehicle.is_position_good,
            is_estimate_heard=vehicle.is_estimate_heard,
            num_resets=self.num_resets,
            jumped_down_m=self.jumped_down_m,
            # As PX4 has it: whatever is disarmed has landed.
            landed=Landed.IN_AIR
            if vehicle.is_armed and not vehicle.is_on_ground
            else Landed.ON_GROUND,
            battery=vehicle.battery,
            estimate_doubts=(),
            range_limits_m=vehicle.range_limits_m,
            has_sticks=vehicle.has_sticks,
            gps=GpsFix(is_3d=True, num_satellites=14, dilution=0.8),
            hardware=self.hardware,
            home=ORIGIN,
            origin=self.origin,
        )
        self._poses.append(
            Pose(
                time_s=vehicle.time_s,
                position_ned_m=_vector(
                    [*vehicle.position[:2], vehicle.position[2] + vehicle.height_error_m]
                ),
                velocity_ned_m_s=_vector(vehicle.velocity),
                attitude_rad=vehicle.attitude_rad,
            )
        )

    @property
    def system_id(self) -> int:
        return 1

    @property
    def state(self) -> VehicleState:
        return self._state

    @property
    def pose(self) -> Pose:
        if not self._poses:
            raise LinkTimeout("no pose was heard yet")
        return self._poses[-1]

    @property
    def time_s(self) -> float:
        return self.pose.time_s

    def mislead(self, **changes: Any) -> None:
        """Have one heartbeat say something else than is so."""
        self._misled = changes
        self._heartbeat_due_s = 0.0

    def say(self, text: str) -> None:
        """Have the autopilot say something."""
        self._said.append(StatusText(severity=6, text=text))

    async def next_texts(self) -> list[StatusText]:
        while not self._said:
            self._changed.clear()
            await self._changed.wait()
        said, self._said = self._said, []
        return said

    @property
    def heartbeat_age_s(self) -> float:
        return asyncio.get_running_loop().time() - self._beat_at

    # Waiting

    async def _next_message(self, *, checks_mode: bool = True) -> None:
        self._changed.clear()
        try:
            async with asyncio.timeout(self._loss_s):
                await self._changed.wait()
        except TimeoutError as exc:
            raise LinkLost(
                f"nothing heard from the vehicle for {self._loss_s:g} s; its own failsafe is in "
                "charge"
            ) from exc
        if self._has_rebooted:
            self._has_rebooted = False
            raise VehicleError("the autopilot rebooted: its clock went back; the flight is over")
        if checks_mode:
            self._check_mode()

    def _check_mode(self) -> None:
        is_ours = self._expected is None or self._state.mode in self._expected
        if self._state.is_armed and not is_ours:
            is_failsafe = self._state.is_failsafe
            who = "a failsafe of the autopilot" if is_failsafe else "the pilot"
            raise ControlTaken(f"{who} chose mode '{self._state.mode}'", by_failsafe=is_failsafe)

    async def next_pose(self) -> Pose:
        while not self._poses or self.time_s == self._given_s:
            await self._next_message()
        self._given_s = self.time_s
        return self.pose

    async def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        while not self._poses or self.time_s < time_s:
            await self._next_message()
        after = next(i for i, pose in enumerate(self._poses) if i and pose.time_s >= time_s)
        return self._poses[after - 1], self._poses[after]

    async def gimbal_around(self, time_s: float) -> tuple[GimbalAttitude, GimbalAttitude]:
        await self.wait_until(lambda: self.time_s > time_s, "the gimbal", 1.0)
        if self.vehicle.is_gimbal_silent:
            raise CameraError("the gimbal's attitude at the picture's instant was not heard")
        pitch_rad = math.radians(self.vehicle.gimbal_off_deg - 90.0)
        before = GimbalAttitude(
            time_s=time_s - STEP_S,
            rotation=body_to_ned((0.0, pitch_rad, 0.0)),
            is_from_heading=True,
        )
        return before, replace(before, time_s=time_s + STEP_S)

    async def range_at(self, time_s: float) -> float:
        await self.wait_until(lambda: self.time_s > time_s, "the rangefinder", 1.0)
        if self.vehicle.is_range_lost:
            raise CameraError("the rangefinder finds no ground 0.1 to 120 m below the drone")
        height_m = self.vehicle.ground_m - self.vehicle.position[2]
        return height_m / float(body_to_ned(self.vehicle.attitude_rad)[2, 2])

    async def wait_until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        end_s = self.time_s + timeout_s if self._poses else math.inf
        while not condition():
            await self._next_message()
            if self.time_s > end_s:
                armed = "armed" if self._state.is_armed else "disarmed"
                raise CommandUnconfirmed(
                    f"{what}: not seen in telemetry after {timeout_s:g} s of vehicle time; "
                    f"it is {armed}"
                )

    async def wait_ready(self, timeout_s: float) -> None:
        await self.wait_until(lambda: self._state.home is not None, "ready", timeout_s)

    @property
    def num_heartbeats(self) -> int:
        return self._num_heartbeats

    async def next_heartbeat(self) -> None:
        heard = self._num_heartbeats
        while self._num_heartbeats == heard:
            await self._next_message(checks_mode=False)

    async def read_parameters(self, names: Iterable[str]) -> dict[str, float]:
        parameters = self.vehicle.parameters
        return {name: parameters[name] for name in names if name in parameters}

    async def write_parameter(self, name: str, value: float) -> None:
        if name not in self.vehicle.parameters or not self.vehicle.command("set"):
            raise CommandRejected(f"{name}: not set")
        self.commands.append(f"{name}={value:g}")
        self.vehicle.parameters[name] = value

    async def read_fence(self) -> tuple[FenceItem, ...]:
        return self.vehicle.fence

    async def write_fence(self, items: Sequence[FenceItem]) -> None:
        if not self.vehicle.command("fence"):
            raise CommandRejected("the fence is refused")
        self.vehicle.fence = tuple(items)

    # Commands

    async def _confirm(self, name: str, obey: Callable[[], None], done: Callable[[], bool]) -> None:
        for _ in range(_ATTEMPTS):
            self.commands.append(name)
            if self.vehicle.command(name):
                obey()
            try:
                await self.wait_until(done, name, self._timeout_s / _ATTEMPTS)
            except CommandUnconfirmed:
                continue
            return
        raise CommandRejected(f"{name}: asked {_ATTEMPTS} times without effect")

    async def _change_mode(self, name: str, mode: Mode) -> None:
        self._check_mode()
        self._expected = (self._expected or frozenset({self._state.mode})) | {mode}
        await self._confirm(
            name, lambda: self.vehicle.choose(mode), lambda: self._state.mode is mode
        )
        self._expected = frozenset({mode})

    async def point_down(self) -> None:
        self.commands.append("point down")
        if not self.vehicle.command("point down"):
            raise CommandRejected("the gimbal, taking control: asked 3 times (denied)")
        if self.vehicle.is_gimbal_silent:
            raise CommandUnconfirmed("no attitude of a gimbal is heard")
        if self.vehicle.gimbal_off_deg > GIMBAL_ERROR_DEG:
            raise CommandUnconfirmed(f"it looks {self.vehicle.gimbal_off_deg:.0f} degrees off")

    async def arm(self) -> None:
        await self._confirm("arm", self._set_armed, lambda: self._state.is_armed)

    def _set_armed(self, is_armed: bool = True) -> None:
        self.vehicle.is_armed = is_armed

    async def disarm(self) -> None:
        self.release()
        await self._confirm(
            "disarm", lambda: self._set_armed(False), lambda: not self._state.is_armed
        )

    async def take_off(self, height_m: float) -> None:
        vehicle, top_m = self.vehicle, self.pose.position_ned_m[2] - height_m
        self._expected = frozenset({self._state.mode, Mode.TAKEOFF, Mode.HOLD})

        def climb() -> None:
            vehicle.target_down_m = top_m
            vehicle.choose(Mode.TAKEOFF)

        await self._confirm("take-off", climb, lambda: self._state.mode is Mode.TAKEOFF)
        self._expected = frozenset({Mode.TAKEOFF, Mode.HOLD})
        await self.wait_until(
            lambda: self.pose.position_ned_m[2] < top_m + 1.0, f"climb to {height_m:g} m", 90.0
        )

    async def start_offboard(self, setpoint: Setpoint) -> None:
        self._check_mode()
        self._expected = (self._expected or frozenset({self._state.mode})) | {Mode.OFFBOARD}
        end_s = self.time_s + self._timeout_s
        while self._state.mode is not Mode.OFFBOARD:
            if self.time_s > end_s:
                raise CommandUnconfirmed("offboard: asked without effect")
            await self.send_setpoint(setpoint)
            self.commands.append("offboard")
            if self.vehicle.command("offboard"):
                self.vehicle.choose(Mode.OFFBOARD)
            await self.next_pose()
        self._expected = frozenset({Mode.OFFBOARD})

    async def send_setpoint(self, setpoint: Setpoint) -> None:
        self.num_setpoints += 1
        if not self.vehicle.is_deaf:
            self.vehicle.setpoint, self.vehicle.setpoint_s = setpoint, self.vehicle.time_s

    async def hold(self) -> None:
        await self._change_mode("hold", Mode.HOLD)

    async def return_home(self) -> None:
        await self._change_mode("return", Mode.RETURN)

    async def land(self) -> None:
        await self._change_mode("land", Mode.LAND)

    def reclaim(self) -> None:
        self._expected = frozenset({Mode.OFFBOARD})

    def release(self) -> None:
        self._expected = None


class FakeCamera:
    """Grey pictures taken at once by a fake link's vehicle, each another unless it is frozen."""

    def __init__(self, link: FakeLink, width_px: int = 64, height_px: int = 64) -> None:
        self._link = link
        noise = np.random.default_rng(0).integers(100, 150, (height_px, width_px, 3))
        self._image = noise.astype(np.uint8)

    async def __aenter__(self) -> FakeCamera:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def capture(self) -> Picture:
        if self._link.is_camera_silent:
            await asyncio.sleep(1.5)
            raise CameraError("no picture within 1.5 s")
        if not self._link.is_camera_frozen:
            self._image = np.roll(self._image, 1, axis=0)
        return Picture(time_s=self._link.time_s, image=self._image)


def _vector(values: list[float]) -> Vector3:
    north, east, down = values
    return north, east, down


_: type[FrameSource] = FakeCamera
