"""What a run had come to when its program ended, read back from its folder."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from dronemon.arena import Arena
from dronemon.clock import machine_time
from dronemon.errors import RecordError
from dronemon.events import Stretch
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned, ned_to_geo
from dronemon.mission import Mission
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.recorder import RunFolder
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement, Vector3

GOING_ON = "resuming"
"""Kind of the first event of every flight but a run's first: the vehicle's clock may be another."""
_TAKEN = "control taken"
_CONTROL = {_TAKEN, "control given back", "armed", "attached"}
"""Kinds of events that say who has control from then on."""
_CLOCK_DOUBT_S, ORIGIN_DOUBT_M = 5.0, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Laid:
    """Where the area was laid, in the local frame of then, whose origin was there.

    fence_ned_m: (n, 2) corners of the fence that the vehicle was given
    """

    frame: AreaFrame
    origin: GeoPoint
    fence_ned_m: FloatArray

    @property
    def centre(self) -> GeoPoint:
        """Of the area, on the globe."""
        return ned_to_geo(np.array([*self.frame.centre_ned_m, 0.0]), self.origin)

    @classmethod
    def told_by(cls, event: Mapping[str, Any]) -> Laid:
        """What the line of a vehicle that is ready says."""
        frame = event["frame"]
        return cls(
            frame=AreaFrame(
                **{
                    **frame,
                    "centre_ned_m": tuple(frame["centre_ned_m"]),
                    "arena": Arena.told(frame.get("arena", {})),  # runs of before have none
                }
            ),
            origin=GeoPoint(**event["origin"]),
            fence_ned_m=np.array(event["fence_ned_m"], dtype=np.float64),
        )

    def holds_with(self, origin: GeoPoint) -> bool:
        """Whether the local frame of then is that of this origin."""
        return math.hypot(*geo_to_ned(origin, self.origin)[:2]) < ORIGIN_DOUBT_M


@dataclass(frozen=True, slots=True, kw_only=True)
class Armed:
    """When it was armed last, in vehicle time, and where."""

    time_s: float
    home_ned_m: Vector3


@dataclass(frozen=True, slots=True, kw_only=True)
class Newest:
    """The newest that a run says of its vehicle's clock.

    time_s, wall: newest vehicle time, and the wall time at which it was
    boot, up_s:   the same by the machine's clock, see `machine_time`
    start_s:      vehicle time at which the patrol began, None if it had not
    """

    time_s: float
    wall: datetime
    boot: str
    up_s: float
    start_s: float | None

    def now_s(self) -> float:
        """What the vehicle's clock shows now, if it has gone on."""
        return self.time_s + max(self._passed_s(), 0.0)

    def is_clock_behind(self) -> bool:
        """Whether this machine's clock shows less than then: what has passed is not known."""
        return self._passed_s() < 0.0

    def _passed_s(self) -> float:
        """By the wall clock, which may have been set since, only after a start of the machine."""
        boot, up_s = machine_time()
        if boot and boot == self.boot:
            return up_s - self.up_s
        return (datetime.now(UTC) - self.wall).total_seconds()


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """Where a run goes on from.

    laid, armed:       None if it did not come so far
    hardware:          the vehicle's board, None if it did not say
    is_pilots:         whether a pilot had taken control, and not given it back
    tally:             what the patrol had come to; None if it had not begun
    waypoint_au, node: where the drone was flying to
    """

    newest: Newest
    laid: Laid | None
    armed: Armed | None
    hardware: str | None
    tally: Tally | None
    waypoint_au: FloatArray | None
    node: int | None
    is_pilots: bool = False

    def is_other(self, hardware: str | None) -> bool:
        """Whether that is not the board of the vehicle that flew so far; no if one is unknown."""
        return None not in {hardware, self.hardware} and hardware != self.hardware

    def _pictured_s(self) -> float:
        """The last picture's time by the newest clock: events, which tell that clock, are rarer."""
        if self.tally is None or self.laid is None:
            return -math.inf
        return self.tally.start_s + self.laid.frame.au_to_s(self.tally.sightings.time_au)

    def go_over_to(self, clock_s: float, hardware: str | None) -> bool:
        """Go over to the clock that a vehicle shows now. -> whether it is the one of then

        A vehicle that was switched off since has a new one: it shows less than has passed.
        """
        then_s, now_s = self.newest.time_s, max(self.newest.now_s(), self._pictured_s())
        is_on = clock_s >= max(then_s, now_s - _CLOCK_DOUBT_S)
        is_same = is_on and not self.is_other(hardware)
        if not is_same and self.tally is not None:
            self.tally.start_s += clock_s - now_s
            for name in self.tally.last_seen_s:
                self.tally.last_seen_s[name] += clock_s - now_s
        return is_same


def read_newest(folder: RunFolder) -> Newest:
    """When a run that is to go on was left. Raises RecordError if nothing is left to fly."""
    refuse_what_is_over(folder)
    with understanding(folder):
        return _newest(folder, folder.events())


def refuse_what_is_over(folder: RunFolder) -> None:
    """Raise RecordError for a run that cannot go on."""
    if folder.rewatched() is not None:
        raise RecordError(f"{folder.path} was made of pictures: it was not flown, and cannot go on")
    if folder.summary().get("outcome") == "completed":
        raise RecordError(f"{folder.path} is completed: nothing is left to fly")


@contextlib.contextmanager
def understanding(folder: RunFolder) -> Iterator[None]:
    """Lines are read meanwhile. Raises RecordError for those of another version."""
    try:
        yield
    except (AttributeError, LookupError, TypeError, ValueError) as exc:
        raise RecordError(
            f"{folder.path}: its lines are not those of this version ({exc!r})"
        ) from exc


def _newest(folder: RunFolder, events: Iterable[Mapping[str, Any]]) -> Newest:
    """By the clock in which area and patrol are told: before the vehicle rebooted, if it did.

    A flight that goes on may meet another clock; what it tells before it is ready, where it goes
    over to that, counts only if it becomes ready.
    """
    flights: list[list[Mapping[str, Any]]] = [[]]
    for event in events:
        if event["kind"] == GOING_ON:
            flights.append([])
        flights[-1].append(event)
    while len(flights) > 1 and all(event["kind"] != "ready" for event in flights[-1]):
        flights.pop()
    heard = [event for event in flights[-1] if event["time_s"] is not None]
    if not heard:
        raise RecordError(f"the vehicle of {folder.path} was not heard: fly the mission anew")
    newest = heard[0]
    for event in heard:
        if event["time_s"] < newest["time_s"]:
            break
        if event["time_s"] > newest["time_s"]:  # else told again, as nothing newer was heard
            newest = event
    starts_s = (e["start_s"] for flight in flights for e in flight if "start_s" in e)
    return Newest(
        time_s=newest["time_s"],
        wall=datetime.fromisoformat(newest["wall"]),
        boot=newest["boot"],
        up_s=newest["up_s"],
        start_s=next(iter(deque(starts_s, maxlen=1)), None),
    )


def read_history(folder: RunFolder, mission: Mission, priors_au: FloatArray) -> History:
    """Read a run that is to go on. priors_au: (N, 2) NaN where unknown. Raises RecordError."""
    with understanding(folder):
        return _read(folder, mission, priors_au)


def _read(folder: RunFolder, mission: Mission, priors_au: FloatArray) -> History:
    events = list(folder.events())
    newest = _newest(folder, events)
    latest = {event["kind"]: event for event in events}
    laid = Laid.told_by(latest["ready"]) if "ready" in latest else None
    armed = latest.get("armed")
    decisions = list(folder.decisions())
    control = [event["kind"] for event in events if event["kind"] in _CONTROL]
    tally = None
    if newest.start_s is not None and laid is not None:
        tally = Tally(start_s=newest.start_s, sightings=Sightings(priors_au, mission.sensor.model))
        tally.decision_ms.extend(decision["decision_ms"] for decision in decisions)
        _recall(tally, folder, laid.frame, [target.name for target in mission.targets])
        tally.num_before = len(tally.sightings)
    return History(
        newest=newest,
        laid=laid,
        armed=Armed(time_s=armed["time_s"], home_ned_m=tuple(armed["home_ned_m"]))
        if armed
        else None,
        hardware=latest["ready"]["hardware"] if "ready" in latest else None,
        tally=tally,
        waypoint_au=np.array(decisions[-1]["waypoint_au"]) if decisions else None,
        node=decisions[-1]["node"] if decisions else None,
        is_pilots=control[-1:] == [_TAKEN],
    )


def measurement_of(line: Mapping[str, Any], names: Sequence[str]) -> Measurement:
    """What a line of observations says of the targets of these names."""
    targets = [line["targets"][name] for name in names]
    places = [target["position_au"] or (np.nan, np.nan) for target in targets]
    hidden_au = line.get("hidden_au")  # where nothing stands none is said
    return Measurement(
        time_au=line["time_au"],
        agent_au=np.array(line["agent_au"]),
        seen=np.array([target["seen"] for target in targets], dtype=np.bool_),
        target_au=np.array(places, dtype=np.float64),
        view_au=line.get("view_au", SENSOR_RADIUS_AU),  # earlier versions did not say
        hidden_au=None if hidden_au is None else np.array(hidden_au, np.float64).reshape(-1, 2),
    )


def recorded(folder: RunFolder, mission: Mission) -> tuple[Sightings, list[Measurement]]:
    """What was known when the patrol began, and what was measured since, oldest first.

    Raises LookupError, TypeError or ValueError where the lines are not those of this version.
    """
    began = next((event for event in folder.events() if "priors_au" in event), None)
    if began is None:
        raise RecordError(f"{folder.path}: its patrol never began: nothing is there to tell")
    names = [target.name for target in mission.targets]
    measurements = [measurement_of(line, names) for line in folder.observations()]
    priors_au = np.array(began["priors_au"], dtype=np.float64)
    return Sightings(priors_au, mission.sensor.model), measurements


def _recall(tally: Tally, folder: RunFolder, frame: AreaFrame, names: list[str]) -> None:
    """Take the measurements into a tally."""
    for line in folder.observations():
        measurement = measurement_of(line, names)
        tally.sightings.add(measurement)
        stretch = Stretch(**line["stretch"])
        tally.go_on_from(stretch)
        tally.measure(line["time_s"], stretch.pictured_m, ())
        now_s = tally.start_s + frame.au_to_s(measurement.time_au)  # by the newest clock
        seen = (name for name, is_seen in zip(names, measurement.seen, strict=True) if is_seen)
        tally.last_seen_s |= dict.fromkeys(seen, now_s)
