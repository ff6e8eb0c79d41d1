"""Time as a mission sees it: the vehicle's, in seconds since its boot.

Simulators run faster than the wall clock and a vehicle may reboot, so nothing in a mission reads
the wall clock.
"""

from __future__ import annotations

from typing import Protocol


class Clock(Protocol):
    """Tells the mission's time."""

    @property
    def time_s(self) -> float:
        """Vehicle time in seconds since boot; never decreases between two boots."""
        ...
