"""Whether motors stopped in the air: what a flight's end looks like alone does not tell."""

from __future__ import annotations

from dronemon.types import Pose
from dronemon.vehicle.link import AIRBORNE, Landed

_GAP_S = 2.5
"""One heartbeat may be lost between the last of running motors and the first of stopped ones."""


class MotorWatch:
    """Follows the heartbeats of one vehicle.

    PX4 calls whatever is disarmed landed, and leaves a killed or terminated vehicle armed until it
    lies on the ground: what counts is where it was when its motors ran for the last time.
    """

    def __init__(self) -> None:
        self._ran: tuple[float, Pose | None] | None = None
        self.stopped_at: Pose | None = None

    def take(self, *, is_running: bool, landed: Landed, pose: Pose | None, time_s: float) -> None:
        """Take a heartbeat. stopped_at: the pose in the air at the last one of running motors."""
        if is_running:
            self._ran = time_s, pose if landed in AIRBORNE else None
            self.stopped_at = None
        elif self._ran is not None:
            ran_s, at = self._ran
            self._ran = None
            self.stopped_at = at if time_s - ran_s <= _GAP_S else None
