"""What happens in a flight: one stream of frozen events, told to whoever wants them.

The critical subscriber, the record, comes first: what it is told goes to the disk at once, and its
failure ends the flight. Nobody waits for a disk or a terminal: a drone flies meanwhile. All others
are its audience and get what they can: one that raises is counted, never heard, and each says at
the end what it lost.
A new fact is a class here and a case in the subscriber that wants it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

from dronemon.clock import Clock
from dronemon.errors import RecordError, VehicleError
from dronemon.types import Detection, FloatArray, IntArray, Measurement, Picture, Pose

if TYPE_CHECKING:
    from dronemon.frames import AreaFrame, GeoPoint

Level = Literal["INFO", "WARN", "ERROR"]


class Event:
    """Base of all events; arrays handed over must not change afterwards."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Noted(Event):
    """Something worth a line. time_s: vehicle time, None before the vehicle is heard."""

    time_s: float | None
    kind: str
    text: str
    level: Level
    fields: Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Progressed(Event):
    """How far the flight is; about once a second of vehicle time.

    battery_needed: the level that it takes to come home from here.
    since_seen_s: seconds since each target was seen, by name; None: never.
    """

    phase: str
    flown_au: float = 0.0
    horizon_au: float = 0.0
    left_s: float = 0.0
    speed_m_s: float = 0.0
    battery: float | None = None
    battery_needed: float = 0.0
    since_seen_s: Mapping[str, float | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class AreaLaid(Event):
    """The area lies over the ground, and the roadmap in it.

    system_id:   the vehicle's
    origin:      of its local frame
    fence_ned_m: (n, 2) corners of the fence around it, north and east
    nodes_au:    (V, 2) au places of the nodes
    edges:       (E, 2) int node numbers
    """

    system_id: int
    area: AreaFrame
    origin: GeoPoint
    footprint_radius_m: float
    fence_ned_m: FloatArray
    nodes_au: FloatArray
    edges: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Moved(Event):
    """The vehicle's newest pose."""

    pose: Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Pictured(Event):
    """A picture, what was found in it, and the pose that it was taken from.

    number: of its measurement; owners: which target each find counts as, -1 for none
    """

    number: int
    picture: Picture
    detections: Sequence[Detection]
    owners: Sequence[int]
    pose: Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """How the patrol was flown until a picture: all of it, and what is new since the one before.

    pictured_m:    way flown until the picture was taken
    flown_m:       way flown until it was looked at, in duration_s
    pictures_due:  pictures due until then
    speeds_m_s:    over ground, at each pose since the measurement before
    cross_track_m: distance from the path, at each setpoint since then
    """

    pictured_m: float
    flown_m: float
    duration_s: float
    pictures_due: int
    speeds_m_s: Sequence[float]
    cross_track_m: Sequence[float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured(Event):
    """What the sensor said about all targets.

    number:        of the measurement in the run, from 1
    score:         (N,) confidence of each target seen, NaN where it was not
    pose:          that the picture was taken from
    covariance_m2: (N, 2, 2) of the place of each target seen, north and east
    error_m:       (N,) radius about it in which it truly is, in 95 of 100 or more
    """

    number: int
    time_s: float
    measurement: Measurement
    score: FloatArray
    pose: Pose
    covariance_m2: FloatArray
    error_m: FloatArray
    battery: float | None = None
    battery_needed: float = 0.0
    stretch: Stretch


@dataclass(frozen=True, slots=True, kw_only=True)
class Believed(Event):
    """What is believed from now on until the next measurement.

    posterior: of all targets; (Q, 3) au x, y, t -> mean, std, both (N, Q). It is fitted by whoever
    asks, in its own thread
    """

    time_s: float
    time_au: float
    posterior: Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decided(Event):
    """A choice of the planner.

    flown_au, remaining_au: as the planner was told, see `Snapshot`
    position_au: (2,) au where the leg to the waypoint begins
    waypoint_au: (2,) au the waypoint
    node:        roadmap node of the waypoint, None if it is none
    num_measurements: that were known
    """

    time_s: float
    time_au: float
    flown_au: float
    remaining_au: float
    position_au: FloatArray
    waypoint_au: FloatArray
    node: int | None
    num_measurements: int
    decision_ms: float
    details: Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attended(Event):
    """What the network looked at for the last choice, by `policy.Explanation`'s names."""

    time_s: float
    weights: Mapping[str, FloatArray | IntArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthTold(Event):
    """Where the simulator had the targets.

    targets_au: (N, 2) au true positions
    """

    time_s: float
    targets_au: FloatArray


class Subscriber(Protocol):
    """Whoever wants to know what happens."""

    def take(self, event: Event) -> None:
        """Take any event; those of no interest are passed over. Must not wait."""
        ...


class Watcher(Subscriber, Protocol):
    """A subscriber that the flight does without."""

    @property
    def lost(self) -> str:
        """What was not shown, sent or kept, in words; empty for nothing."""
        ...


class Audience:
    """Everybody but the record: no failure of theirs is the flight's."""

    def __init__(self, watchers: Sequence[Watcher] = ()) -> None:
        self._watchers = tuple(watchers)
        self._num_failed = 0
        self._told = set[str]()

    def take(self, event: Event) -> None:
        """Tell everybody an event."""
        for watcher in self._watchers:
            try:
                watcher.take(event)
            except (Exception, SystemExit):  # noqa: BLE001 - rich makes one of a closed pipe
                self._num_failed += 1

    def losses(self) -> list[str]:
        """What was lost and not yet told here."""
        lost = [watcher.lost for watcher in self._watchers]
        if self._num_failed:
            lost.append(f"{self._num_failed} events that a watcher failed at")
        untold = [what for what in lost if what and what not in self._told]
        self._told.update(untold)
        return untold


class EventStream:
    """Tells one flight's events to the record and to its audience.

    While `must_go_on`, on the way home or when the pilot flies, a record that cannot be written is
    only counted by the recorder.
    """

    def __init__(self, record: Subscriber, audience: Audience, clock: Clock) -> None:
        self._record = record
        self._audience = audience
        self._clock = clock
        self._time_s: float | None = None
        self.must_go_on = False

    def emit(self, event: Event) -> None:
        """Tell an event. Raises RecordError if it cannot be recorded."""
        try:
            self._record.take(event)
        except RecordError:
            if not self.must_go_on:
                raise
        finally:
            self._audience.take(event)

    def note(self, kind: str, text: str, *, level: Level = "INFO", **fields: object) -> None:
        """Tell what happened in words. Raises RecordError if it cannot be recorded."""
        with contextlib.suppress(VehicleError):  # not heard yet
            self._time_s = self._clock.time_s
        self.emit(Noted(time_s=self._time_s, kind=kind, text=text, level=level, fields=fields))
