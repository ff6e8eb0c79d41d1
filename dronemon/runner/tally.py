"""What a patrol has come to so far, also across a pause."""

from __future__ import annotations

from array import array
from bisect import bisect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from dronemon.events import Progressed, Stretch
from dronemon.mission import Mission
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
    num_before: measurements of the flights before, where this one goes on with a run.
    """

    start_s: float
    sightings: Sightings
    flown_m: float = 0.0
    duration_s: float = 0.0
    times_s: array[float] = field(default_factory=_numbers)
    pictured_m: array[float] = field(default_factory=_numbers)
    last_seen_s: dict[str, float] = field(default_factory=dict)
    num_pictures_due: int = 0
    num_before: int = 0
    speeds_m_s: array[float] = field(default_factory=_small_numbers)
    decision_ms: array[float] = field(default_factory=_numbers)
    cross_track_m: array[float] = field(default_factory=_small_numbers)
    recent_s: array[float] = field(default_factory=_numbers)
    recent_m: array[float] = field(default_factory=_numbers)
    """Vehicle time and distance flown at each pose since the last measurement's."""
    _num_told: tuple[int, int] = (0, 0)

    def move(self, last: Pose, pose: Pose) -> None:
        """Count the way between two poses: the integral of ground speed, so errors do not add."""
        duration_s = pose.time_s - last.time_s
        self.flown_m += pose.ground_speed_m_s * duration_s
        self.duration_s += duration_s
        self.speeds_m_s.append(pose.ground_speed_m_s)
        self.recent_s.append(pose.time_s)
        self.recent_m.append(self.flown_m)

    def stretch(self, time_s: float) -> Stretch:
        """What is new at a measurement of an instant in the recent past, later than the last."""
        is_flown = len(self.recent_s) > 0
        # Copies: an array that numpy looks at cannot grow, not even while a debugger holds a frame.
        known = np.array(self.recent_s), np.array(self.recent_m)
        flown_m = np.interp(time_s, *known) if is_flown else self.flown_m
        passed = max(bisect(self.recent_s, time_s) - 1, 0)
        del self.recent_s[:passed], self.recent_m[:passed]
        speeds, crosses = self._num_told
        self._num_told = len(self.speeds_m_s), len(self.cross_track_m)
        return Stretch(
            pictured_m=float(flown_m),
            flown_m=self.flown_m,
            duration_s=self.duration_s,
            pictures_due=self.num_pictures_due,
            speeds_m_s=[round(value, 4) for value in self.speeds_m_s[speeds:]],
            cross_track_m=[round(value, 4) for value in self.cross_track_m[crosses:]],
        )

    def measure(self, time_s: float, pictured_m: float, seen: Iterable[str]) -> None:
        """Count a measurement of this instant, and those whom it saw."""
        self.times_s.append(time_s)
        self.pictured_m.append(pictured_m)
        self.last_seen_s |= dict.fromkeys(seen, time_s)

    def go_on_from(self, stretch: Stretch) -> None:
        """Take over what was flown until a measurement, in the order in which it was."""
        self.flown_m, self.duration_s = stretch.flown_m, stretch.duration_s
        self.num_pictures_due = stretch.pictures_due
        self.speeds_m_s.extend(stretch.speeds_m_s)
        self.cross_track_m.extend(stretch.cross_track_m)
        self._num_told = len(self.speeds_m_s), len(self.cross_track_m)

    def since_seen_s(self, names: Iterable[str], now_s: float) -> Mapping[str, float | None]:
        """Seconds since each target was seen; None: never."""
        last_s = self.last_seen_s
        return {name: now_s - last_s[name] if name in last_s else None for name in names}


def progress(
    phase: str,
    mission: Mission,
    tally: Tally | None,
    now_s: float | None,
    *,
    battery: float | None,
    battery_needed: float = 0.0,
    speed_m_s: float = 0.0,
) -> Progressed:
    """How far a patrol is, in any phase.

    tally: None if it has not begun; now_s: by its clock, None where that is not known
    """
    names = [target.name for target in mission.targets]
    flown_au = tally.flown_m / mission.area.side_m if tally else 0.0
    left_m = max(mission.horizon_au - flown_au, 0.0) * mission.area.side_m
    return Progressed(
        phase=phase,
        flown_au=flown_au,
        horizon_au=mission.horizon_au,
        left_s=left_m / mission.flight.cruise_speed_m_s,
        speed_m_s=speed_m_s,
        battery=battery,
        battery_needed=battery_needed,
        since_seen_s=tally.since_seen_s(names, now_s)
        if tally and now_s is not None
        else dict.fromkeys(names),
    )
