"""What happens in a flight: one stream of frozen events, told to whoever wants them.

The critical subscriber, the record, comes first: what it is told goes to the disk at once, and its
failure ends the flight. Nobody waits for a disk or a terminal: a drone flies meanwhile. All others
get what they can: one that raises is counted, never heard.
A new fact is a class here and a case in the subscriber that wants it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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

    origin:      of the vehicle's local frame
    fence_ned_m: (n, 2) corners of the fence around it, north and east
    nodes_au:    (V, 2) au places of the nodes
    edges:       (E, 2) int node numbers
    """

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
    """A picture, what was found in it, and the pose that it was taken from."""

    picture: Picture
    detections: Sequence[Detection]
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

    score:   (N,) confidence of each target seen, NaN where it was not
    pose:    that the picture was taken from
    error_m: radius about the place of a target seen in which it truly is, in 95 of 100
    """

    time_s: float
    measurement: Measurement
    score: FloatArray
    pose: Pose
    error_m: float
    battery: float | None = None
    battery_needed: float = 0.0
    stretch: Stretch


@dataclass(frozen=True, slots=True, kw_only=True)
class Believed(Event):
    """The posteriors of all targets on the grid of the view.

    mean: (N, G, G) expected presence
    std:  (N, G, G) its standard deviation
    mean_later, std_later: the same PREDICTION_AU later, when nobody looks until then
    """

    time_s: float
    mean: FloatArray
    std: FloatArray
    mean_later: FloatArray
    std_later: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Decided(Event):
    """A choice of the planner.

    position_au: (2,) au where the leg to the waypoint begins
    waypoint_au: (2,) au the waypoint
    node:        roadmap node of the waypoint, None if it is none
    num_measurements: that were known
    attention:   what a network looked at, by `policy.Explanation`'s names, for those who watch
    """

    time_s: float
    time_au: float
    position_au: FloatArray
    waypoint_au: FloatArray
    node: int | None
    num_measurements: int
    decision_ms: float
    details: Mapping[str, object]
    attention: Mapping[str, FloatArray | IntArray] = field(default_factory=dict)


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


class EventStream:
    """Tells one flight's events to the record and to all others.

    While `must_go_on`, on the way home or when the pilot flies, a record that cannot be written is
    only counted by the recorder. `dropped` counts the events that another subscriber failed at.
    """

    def __init__(self, record: Subscriber, others: Sequence[Subscriber], clock: Clock) -> None:
        self._record = record
        self._others = tuple(others)
        self._clock = clock
        self._time_s: float | None = None
        self.must_go_on = False
        self.dropped = 0

    def emit(self, event: Event) -> None:
        """Tell an event. Raises RecordError if it cannot be recorded."""
        try:
            self._record.take(event)
        except RecordError:
            if not self.must_go_on:
                raise
        finally:
            for other in self._others:
                try:
                    other.take(event)
                except (Exception, SystemExit):  # noqa: BLE001 - rich makes one of a closed pipe
                    self.dropped += 1

    def note(self, kind: str, text: str, *, level: Level = "INFO", **fields: object) -> None:
        """Tell what happened in words. Raises RecordError if it cannot be recorded."""
        with contextlib.suppress(VehicleError):  # not heard yet
            self._time_s = self._clock.time_s
        self.emit(Noted(time_s=self._time_s, kind=kind, text=text, level=level, fields=fields))
