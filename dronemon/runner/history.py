"""What a run had come to when its program ended, read back from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from dronemon.errors import RecordError
from dronemon.events import Stretch
from dronemon.frames import AreaFrame, GeoPoint
from dronemon.mission import Mission
from dronemon.recorder import RunFolder
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement, Vector3

_CLOCK_DOUBT_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Laid:
    """Where the area was laid: in the local frame of then, and its centre on the globe."""

    frame: AreaFrame
    centre: GeoPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Armed:
    """When it was armed last, in vehicle time, and where."""

    time_s: float
    home_ned_m: Vector3


@dataclass(frozen=True, slots=True, kw_only=True)
class Newest:
    """The newest that a run says of its vehicle's clock.

    time_s, wall: newest vehicle time, and the wall time at which it was
    start_s:      vehicle time at which the patrol began, None if it had not
    """

    time_s: float
    wall: datetime
    start_s: float | None

    def now_s(self) -> float:
        """What the vehicle's clock shows now, if it has gone on."""
        return self.time_s + max((datetime.now(UTC) - self.wall).total_seconds(), 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """Where a run goes on from.

    laid, armed:       None if it did not come so far
    tally:             what the patrol had come to; None if it had not begun
    waypoint_au, node: where the drone was flying to
    """

    newest: Newest
    laid: Laid | None
    armed: Armed | None
    tally: Tally | None
    waypoint_au: FloatArray | None
    node: int | None

    def go_over_to(self, clock_s: float) -> bool:
        """Go over to the clock that a vehicle shows now. -> whether it is the one of then

        A vehicle that was switched off since has a new one: it shows less than has passed.
        """
        then_s, now_s = self.newest.time_s, self.newest.now_s()
        is_same = clock_s >= max(then_s, now_s - _CLOCK_DOUBT_S)
        if not is_same and self.tally is not None:
            self.tally.start_s += clock_s - now_s
            for name in self.tally.last_seen_s:
                self.tally.last_seen_s[name] += clock_s - now_s
        return is_same


def read_newest(folder: RunFolder) -> Newest:
    """When a run that is to go on was left. Raises RecordError if nothing is left to fly."""
    if folder.summary().get("outcome") == "completed":
        raise RecordError(f"{folder.path} is completed: nothing is left to fly")
    events = [event for event in folder.events() if event["time_s"] is not None]
    if not events:
        raise RecordError(f"the vehicle of {folder.path} was not heard: fly the mission anew")
    start_s = next((e["start_s"] for e in reversed(events) if "start_s" in e), None)
    wall = datetime.fromisoformat(events[-1]["wall"])
    return Newest(time_s=events[-1]["time_s"], wall=wall, start_s=start_s)


def read_history(folder: RunFolder, mission: Mission, priors_au: FloatArray) -> History:
    """Read a run that is to go on. priors_au: (N, 2) NaN where unknown. Raises RecordError."""
    newest = read_newest(folder)
    try:
        return _read(folder, newest, mission, priors_au)
    except (LookupError, TypeError, ValueError) as exc:
        raise RecordError(
            f"{folder.path} cannot go on: its lines are not those of this version ({exc!r})"
        ) from exc


def _read(folder: RunFolder, newest: Newest, mission: Mission, priors_au: FloatArray) -> History:
    latest = {event["kind"]: event for event in folder.events()}
    laid = _laid(latest["ready"]) if "ready" in latest else None
    armed = latest.get("armed")
    decisions = list(folder.decisions())
    tally = None
    if newest.start_s is not None and laid is not None:
        tally = Tally(start_s=newest.start_s, sightings=Sightings(priors_au))
        tally.decision_ms.extend(decision["decision_ms"] for decision in decisions)
        _recall(tally, folder, laid.frame, [target.name for target in mission.targets])
    return History(
        newest=newest,
        laid=laid,
        armed=Armed(time_s=armed["time_s"], home_ned_m=tuple(armed["home_ned_m"]))
        if armed
        else None,
        tally=tally,
        waypoint_au=np.array(decisions[-1]["waypoint_au"]) if decisions else None,
        node=decisions[-1]["node"] if decisions else None,
    )


def _laid(event: Mapping[str, Any]) -> Laid:
    frame = event["frame"]
    return Laid(
        frame=AreaFrame(**{**frame, "centre_ned_m": tuple(frame["centre_ned_m"])}),
        centre=GeoPoint(**event["centre"]),
    )


def _recall(tally: Tally, folder: RunFolder, frame: AreaFrame, names: list[str]) -> None:
    """Take the measurements into a tally."""
    for line in folder.observations():
        targets = [line["targets"][name] for name in names]
        places = [target["position_au"] or (np.nan, np.nan) for target in targets]
        measurement = Measurement(
            time_au=line["time_au"],
            agent_au=np.array(line["agent_au"]),
            seen=np.array([target["seen"] for target in targets], dtype=np.bool_),
            target_au=np.array(places, dtype=np.float64),
        )
        tally.sightings.add(measurement)
        stretch = Stretch(**line["stretch"])
        tally.go_on_from(stretch)
        tally.measure(line["time_s"], stretch.pictured_m, ())
        now_s = tally.start_s + frame.au_to_s(measurement.time_au)  # by the newest clock
        seen = (name for name, target in zip(names, targets, strict=True) if target["seen"])
        tally.last_seen_s |= dict.fromkeys(seen, now_s)
