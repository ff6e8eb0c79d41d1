"""PX4's flight modes, as HEARTBEAT's `custom_mode` and DO_SET_MODE's parameters name them."""

from __future__ import annotations

from enum import IntEnum


class Px4Mode(IntEnum):
    """Flight modes of the simulated autopilot; a value is main mode << 16 | sub mode << 24."""

    MANUAL = 1 << 16
    ALTCTL = 2 << 16
    POSCTL = 3 << 16
    OFFBOARD = 6 << 16
    TAKEOFF = 4 << 16 | 2 << 24
    LOITER = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RTL = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24

    @property
    def label(self) -> str:
        """What PX4's texts call it."""
        return _LABELS.get(self, self.name.capitalize())

    @property
    def is_manual(self) -> bool:
        """Whether a pilot's sticks decide, so that it needs them."""
        return self in (Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.POSCTL)

    @property
    def needs_position(self) -> bool:
        """Whether it cannot fly without a valid position."""
        return self in (
            Px4Mode.POSCTL,
            Px4Mode.TAKEOFF,
            Px4Mode.LOITER,
            Px4Mode.MISSION,
            Px4Mode.RTL,
        )

    @property
    def allows_arming(self) -> bool:
        """Whether the vehicle may be armed in it."""
        return self not in (Px4Mode.RTL, Px4Mode.LAND)


_LABELS = {
    Px4Mode.ALTCTL: "Altitude",
    Px4Mode.POSCTL: "Position",
    Px4Mode.LOITER: "Hold",
    Px4Mode.RTL: "Return",
}
