"""Time as a mission sees it: the vehicle's, in seconds since its boot.

Simulators run faster than the wall clock and a vehicle may reboot, so nothing in a mission reads
the wall clock. What waits on the
outside world takes a `Clock`; tests pass a `ManualClock` and never sleep.
"""

from __future__ import annotations

from typing import Protocol


class Clock(Protocol):
    """Tells the mission's time."""

    @property
    def time_s(self) -> float:
        """Vehicle time in seconds since boot; never decreases between two boots."""
        ...


class ManualClock:
    """A clock that moves only when told to."""

    def __init__(self, time_s: float = 0.0) -> None:
        self._time_s = time_s

    @property
    def time_s(self) -> float:
        """Vehicle time in seconds since boot."""
        return self._time_s

    def advance(self, seconds_s: float) -> None:
        """Move the clock on. Raises ValueError if that would move it back."""
        if seconds_s < 0:
            raise ValueError(f"a clock cannot go back: asked for {seconds_s} s")
        self._time_s += seconds_s
