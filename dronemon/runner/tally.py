"""What a patrol has come to so far, also across a pause."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field

from dronemon.sightings import Sightings
from dronemon.types import Pose


def _numbers() -> array[float]:
    """An array that grows with every pose of hours: eight bytes each instead of thirty."""
    return array("d")


@dataclass(kw_only=True)
class Tally:
    """The patrol's figures; they grow as it is flown.

    start_s: vehicle time at which it began; sightings: the mission's log, and
    times_s: vehicle time of each measurement in it; progress_s, progress_m: vehicle
    time and distance flown at each setpoint; speeds_m_s: over ground, at each pose.
    """

    start_s: float
    sightings: Sightings
    flown_m: float = 0.0
    duration_s: float = 0.0
    times_s: array[float] = field(default_factory=_numbers)
    last_seen_s: dict[str, float] = field(default_factory=dict)
    num_pictures_due: int = 0
    progress_s: array[float] = field(default_factory=_numbers)
    progress_m: array[float] = field(default_factory=_numbers)
    speeds_m_s: array[float] = field(default_factory=_numbers)
    decision_ms: array[float] = field(default_factory=_numbers)
    cross_track_m: array[float] = field(default_factory=_numbers)

    def move(self, last: Pose, pose: Pose) -> None:
        """Count the way between two poses: the integral of ground speed, so errors do not add."""
        duration_s = pose.time_s - last.time_s
        self.flown_m += pose.ground_speed_m_s * duration_s
        self.duration_s += duration_s
        self.speeds_m_s.append(pose.ground_speed_m_s)

    def since_seen_s(self, names: tuple[str, ...], now_s: float) -> Mapping[str, float | None]:
        """Seconds since each target was seen; None: never."""
        last_s = self.last_seen_s
        return {name: now_s - last_s[name] if name in last_s else None for name in names}
