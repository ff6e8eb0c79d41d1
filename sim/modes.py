"""PX4's flight modes, as HEARTBEAT's `custom_mode` and DO_SET_MODE's parameters name them."""

from __future__ import annotations

from enum import IntEnum


class Px4Mode(IntEnum):
    """Flight modes of the simulated autopilot; a value is main mode << 16 | sub mode << 24."""

    ALTCTL = 2 << 16
    POSCTL = 3 << 16
    OFFBOARD = 6 << 16
    TAKEOFF = 4 << 16 | 2 << 24
    LOITER = 4 << 16 | 3 << 24
    RTL = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24

    @property
    def is_manual(self) -> bool:
        """Whether a pilot's sticks decide."""
        return self in (Px4Mode.ALTCTL, Px4Mode.POSCTL)
