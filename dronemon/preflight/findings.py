"""What is asked before a take-off, and what is answered."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from dronemon.errors import CameraError
from dronemon.mission import Mission
from dronemon.types import GpsFix

HIGH_M = 120.0
"""What most rules allow, above the ground below."""


class Verdict(StrEnum):
    """What a row says; the last one forbids the take-off."""

    GO = "go"
    WARNING = "warning"
    NO_GO = "no-go"


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a row makes of the facts. mends: parameter values with which it would be `go`."""

    verdict: Verdict
    meaning: str
    mends: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One row, judged. value: what was found, in words."""

    name: str
    value: str
    judgement: Judgement

    def __str__(self) -> str:
        return f"{self.name} ({self.value}): {self.judgement.meaning}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """How the camera's first picture came.

    wait_s: wall time from asking for it; age_s: vehicle time from taking it
    """

    wait_s: float
    age_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnFence:
    """What the vehicle's own fence is to the flight, in numbers of its areas.

    num_against: those that do not allow the mission's area, home or the way between
    num_near:    those that do, but not all within the flight's own fence
    """

    num_areas: int
    num_against: int
    num_near: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Relief:
    """The ground where a flight goes, and what its camera needs over it.

    highest_m, lowest_m: above the take-off
    least_m, most_m:     how far below the flight it is
    top_m:               greatest height of the flight above the take-off
    px_m:                the camera's focal length: pixels a metre, times the height
    needed_m:            least height from which it shows all that is to be looked at
    needed_px_per_m:     of the detector; 0 if nobody has said
    """

    highest_m: float
    lowest_m: float
    least_m: float
    most_m: float
    top_m: float
    px_m: float
    needed_m: float
    needed_px_per_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """All that the table looks at.

    parameters:      by name; those that the vehicle does not have are missing
    away_m:          distance from home to the area's centre
    own_fence:       the vehicle's; None if it was not looked at
    has_sticks:      whether a pilot's remote control is heard
    unready:         why it cannot be armed; None if it can
    estimate_doubts: what is against the estimate, in words
    remote_id:       what its remote ID has against arming; None if none is heard
    relief:          the ground below; None where it is taken for flat, or not known yet
    sight:           how the camera's first picture came, or why not
    gimbal:          what is against the gimbal; None if it looks down, or there is none
    range_limits_m:  least and greatest range that the rangefinder tells; None if none is heard
    detector:        what is against the detector; None if it was tried
    free_bytes:      room for the record; needed_bytes: what a flight may need
    hold_limit_s:    for how long the guard lets a failsafe hold before it asks for the return
    """

    parameters: Mapping[str, float]
    away_m: float
    own_fence: OwnFence | None
    has_sticks: bool
    battery: float | None
    unready: str | None = None
    estimate_doubts: Sequence[str]
    gps: GpsFix | None
    remote_id: str | None
    relief: Relief | None = None
    sight: Sight | CameraError
    gimbal: str | None = None
    range_limits_m: tuple[float, float] | None = None
    detector: str | None = None
    free_bytes: int
    needed_bytes: int
    hold_limit_s: float

    def top_m(self, mission: Mission) -> float:
        """Greatest height of the patrol above the take-off."""
        return mission.flight.altitude_m if self.relief is None else self.relief.top_m


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table.

    parameters: without which the row cannot be judged
    value:      what was found, in words; the parameters and their values where it is None
    """

    name: str
    parameters: tuple[str, ...]
    judge: Callable[[Facts, Mission], Judgement]
    value: Callable[[Facts], str] | None = None


def go(meaning: str) -> Judgement:
    """Nothing is against it."""
    return Judgement(Verdict.GO, meaning)


def warn(meaning: str, **mends: float) -> Judgement:
    """It can be flown, but a person should know."""
    return Judgement(Verdict.WARNING, meaning, mends)


def no(meaning: str, **mends: float) -> Judgement:
    """It must not be flown."""
    return Judgement(Verdict.NO_GO, meaning, mends)
