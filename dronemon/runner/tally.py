"""What a patrol has come to so far, also across a pause."""

from __future__ import annotations

from array import array
from bisect import bisect
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dronemon.sightings import Sightings
from dronemon.types import Pose


def _numbers() -> array[float]:
    return array("d")


def _small_numbers() -> array[float]:
    """What grows with every pose of hours: four bytes each instead of thirty."""
    return array("f")


@dataclass(kw_only=True)
class Tally:
    """The patrol's figures; they grow as it is flown.

    start_s: vehicle time at which it began; sightings: the mission's log, and
    times_s, pictured_m: vehicle time of each measurement in it and distance flown by then;
    speeds_m_s: over ground, at each pose; cross_track_m: at each setpoint.
    """

    start_s: float
    sightings: Sightings
    flown_m: float = 0.0
    duration_s: float = 0.0
    times_s: array[float] = field(default_factory=_numbers)
    pictured_m: array[float] = field(default_factory=_numbers)
    last_seen_s: dict[str, float] = field(default_factory=dict)
    num_pictures_due: int = 0
    speeds_m_s: array[float] = field(default_factory=_small_numbers)
    decision_ms: array[float] = field(default_factory=_numbers)
    cross_track_m: array[float] = field(default_factory=_small_numbers)
    recent_s: array[float] = field(default_factory=_numbers)
    recent_m: array[float] = field(default_factory=_numbers)
    """Vehicle time and distance flown at each pose since the last measurement's."""

    def move(self, last: Pose, pose: Pose) -> None:
        """Count the way between two poses: the integral of ground speed, so errors do not add."""
        duration_s = pose.time_s - last.time_s
        self.flown_m += pose.ground_speed_m_s * duration_s
        self.duration_s += duration_s
        self.speeds_m_s.append(pose.ground_speed_m_s)
        self.recent_s.append(pose.time_s)
        self.recent_m.append(self.flown_m)

    def measure(self, time_s: float) -> None:
        """Count a measurement of an instant in the recent past, later than the last one."""
        is_flown = len(self.recent_s) > 0
        flown_m = np.interp(time_s, self.recent_s, self.recent_m) if is_flown else self.flown_m
        self.times_s.append(time_s)
        self.pictured_m.append(float(flown_m))
        passed = max(bisect(self.recent_s, time_s) - 1, 0)
        del self.recent_s[:passed], self.recent_m[:passed]

    def since_seen_s(self, names: tuple[str, ...], now_s: float) -> Mapping[str, float | None]:
        """Seconds since each target was seen; None: never."""
        last_s = self.last_seen_s
        return {name: now_s - last_s[name] if name in last_s else None for name in names}
