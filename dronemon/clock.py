"""Time as a mission sees it: the vehicle's, in seconds since its boot.

Simulators run faster than the wall clock and a vehicle may reboot, so nothing in a mission reads
the wall clock. Between two programs that fly it, the machine's own clock tells what has passed.
"""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path
from typing import Protocol


class Clock(Protocol):
    """Tells the mission's time."""

    @property
    def time_s(self) -> float:
        """Vehicle time in seconds since boot; never decreases between two boots."""
        ...


def machine_time() -> tuple[str, float]:
    """Which boot of this machine it is, and seconds since then; "" where the system does not tell.

    Unlike the wall clock, nobody sets it; it goes on while the machine sleeps.
    """
    boot = _boot()
    return boot, time.clock_gettime(time.CLOCK_BOOTTIME) if boot else 0.0


@cache
def _boot() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""
