"""Whether motors stopped in the air: what a flight's end looks like alone does not tell."""

from __future__ import annotations

from collections.abc import Iterable

from dronemon.types import Pose
from dronemon.vehicle.link import AIRBORNE, Landed

_FALL_M_S = 5.0
"""Faster than a drone sinks as it returns and lands."""


class MotorWatch:
    """Follows the heartbeats of one vehicle.

    PX4 calls whatever is disarmed landed, and leaves a killed or terminated vehicle armed until it
    lies on the ground. What is unheard, as while the link is silent, may have been a landing: only
    poses that fall show a fall.

    fell_from: the pose when the motors ran for the last time, in the air, if it has fallen since.
    """

    def __init__(self) -> None:
        self._ran_at: Pose | None = None
        self.fell_from: Pose | None = None

    def take(self, *, is_running: bool, landed: Landed, poses: Iterable[Pose]) -> None:
        """Take a heartbeat; poses: the last ones, the newest first."""
        if is_running:
            newest = next(iter(poses), None)
            self._ran_at = newest if landed in AIRBORNE else None
            self.fell_from = None
        elif self._ran_at is not None and self.fell_from is None:
            for pose in poses:
                if pose.time_s <= self._ran_at.time_s:
                    break
                if pose.velocity_ned_m_s[2] > _FALL_M_S:
                    self.fell_from = self._ran_at
                    break
