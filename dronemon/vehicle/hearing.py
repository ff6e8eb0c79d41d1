"""What is heard of a vehicle, and every wait for it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

from dronemon.errors import CommandUnconfirmed, LinkLost, LinkTimeout, VehicleError
from dronemon.types import GimbalAttitude, Pose
from dronemon.vehicle.gimbal import GIMBAL_GAP_S, GimbalTrack
from dronemon.vehicle.link import StatusText, VehicleState
from dronemon.vehicle.mode_watch import ModeWatch
from dronemon.vehicle.rangefinder import RANGE_GAP_S, RangeTrack
from dronemon.vehicle.telemetry import Telemetry

_IN_CHARGE = "its own failsafe is in charge until"


class Hearing:
    """Telemetry as it comes, and the modes that are ours.

    link_loss_timeout_s: wall time without messages, poses or heartbeats after which it is lost
    """

    def __init__(self, url: str, link_loss_timeout_s: float) -> None:
        self.telemetry = Telemetry()
        self.modes = ModeWatch()
        self._url = url
        self._limit_s = link_loss_timeout_s
        self._last_given_s = -math.inf
        self._posed_at = math.inf  # the event loop's time of the newest pose
        self._beat_at = math.inf  # and heartbeat
        self._changed = asyncio.Event()

    def take(self, name: str, fields: dict[str, Any]) -> None:
        """Take one message."""
        telemetry, now = self.telemetry, asyncio.get_running_loop().time()
        pose, num_heartbeats = telemetry.pose, telemetry.num_heartbeats
        telemetry.take(name, fields)
        if telemetry.pose is not pose:
            self._posed_at = now
        if telemetry.num_heartbeats != num_heartbeats or math.isinf(self._beat_at):
            self._beat_at = now
        self._changed.set()

    @property
    def state(self) -> VehicleState:
        """The newest state."""
        return self.telemetry.state

    @property
    def pose(self) -> Pose:
        """The newest pose. Raises LinkTimeout before the first."""
        pose = self.telemetry.pose
        if pose is None:
            raise LinkTimeout(
                f"the vehicle on {self._url} sends no ATTITUDE and LOCAL_POSITION_NED; "
                "does it know its position, and does this link stream it?"
            )
        return pose

    @property
    def heartbeat_age_s(self) -> float:
        """Wall time since the last heartbeat."""
        return max(asyncio.get_running_loop().time() - self._beat_at, 0.0)

    async def next_message(self, *, checks_mode: bool = True, needs_pose: bool = True) -> None:
        """Wait for any telemetry and check what every wait must check."""
        try:
            async with asyncio.timeout(self._limit_s):
                await self._change()
        except TimeoutError as exc:
            raise LinkLost(
                f"nothing heard from the vehicle on {self._url} for {self._limit_s:g} s; "
                f"{_IN_CHARGE} it is back"
            ) from exc
        if problem := self.telemetry.pop_problem():
            raise VehicleError(problem)
        if checks_mode:
            self.modes.check(self.state)
        silent_s = asyncio.get_running_loop().time() - self._posed_at
        if needs_pose and silent_s > self._limit_s:
            raise LinkLost(
                f"the vehicle on {self._url} sent no position or attitude for {silent_s:.1f} s; "
                f"{_IN_CHARGE} they are back"
            )
        if self.heartbeat_age_s > self._limit_s:
            raise LinkLost(
                f"no heartbeat of the vehicle on {self._url} for {self.heartbeat_age_s:.1f} s, "
                "while other messages come: nobody knows its mode and whether it is armed; "
                f"{_IN_CHARGE} they are back"
            )

    async def _change(self) -> None:
        self._changed.clear()
        await self._changed.wait()

    async def next_heartbeat(self) -> None:
        """Wait for the next heartbeat."""
        heard = self.telemetry.num_heartbeats
        while self.telemetry.num_heartbeats == heard:
            await self.next_message(checks_mode=False, needs_pose=False)

    async def next_texts(self) -> list[StatusText]:
        """Wait, without a limit, until the autopilot says something."""
        while not (texts := self.telemetry.said()):
            await self._change()
        return texts

    async def next_pose(self) -> Pose:
        """Wait for a pose newer than the last one given."""
        while (pose := self.telemetry.pose) is None or pose.time_s == self._last_given_s:
            await self.next_message()
        self._last_given_s = pose.time_s
        return pose

    async def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """Wait for the poses just before and just after an instant."""
        while (pose := self.telemetry.pose) is None or pose.time_s < time_s:
            await self.next_message()
        return self.telemetry.poses_around(time_s)

    async def gimbal_around(self, time_s: float) -> tuple[GimbalAttitude, GimbalAttitude]:
        """Wait for the gimbal's attitudes just before and just after an instant."""
        await self._wait_for(self.telemetry.gimbal, time_s, GIMBAL_GAP_S)
        return self.telemetry.gimbal.around(time_s)

    async def range_at(self, time_s: float) -> float:
        """Wait for the rangefinder's readings about an instant."""
        await self._wait_for(self.telemetry.rangefinder, time_s, RANGE_GAP_S)
        return self.telemetry.rangefinder.at(time_s)

    async def _wait_for(self, track: GimbalTrack | RangeTrack, time_s: float, gap_s: float) -> None:
        """Wait until it goes on to an instant, or is too late for that."""
        while track.newest_s < time_s and self.pose.time_s < time_s + gap_s:
            await self.next_message()

    async def wait_until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Wait in vehicle time until telemetry makes `condition` true."""
        deadline_s = math.inf
        while not condition():
            await self.next_message()
            if (pose := self.telemetry.pose) is not None:
                deadline_s = min(deadline_s, pose.time_s + timeout_s)
                if pose.time_s > deadline_s:
                    raise CommandUnconfirmed(
                        f"{what}: not seen in telemetry after {timeout_s:g} s of vehicle time; "
                        f"it says {self.state.describe()}"
                    )
