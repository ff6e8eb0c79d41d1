"""The decisions of a recorded flight, and what was known at each: to make them again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dronemon.errors import PlannerError, RecordError, blaming
from dronemon.mission import Mission
from dronemon.planner import Planner, Snapshot
from dronemon.recorder import RunFolder
from dronemon.runner.history import recorded, understanding
from dronemon.runner.preparation import brief, draw_start_and_roadmap, make_belief
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What a line of the record says of a decision.

    number:       its line, from 1
    flown_au, remaining_au: as the planner was told, see `Snapshot`
    position_au:  (2,) where it was made; node: the same as a roadmap node, None if it is none
    waypoint_au:  (2,) what was chosen; chosen: the same as a roadmap node
    num_measurements: that were known
    details:      what the planner thought
    """

    number: int
    time_au: float
    flown_au: float
    remaining_au: float
    position_au: FloatArray
    node: int | None
    waypoint_au: FloatArray
    chosen: int | None
    num_measurements: int
    details: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decisions:
    """All decisions of a run, and what was measured. priors_au: (N, 2), see `Sightings`."""

    folder: RunFolder
    mission: Mission
    priors_au: FloatArray
    made: Sequence[Decision]
    measurements: Sequence[Measurement]


def read_decisions(folder: RunFolder) -> Decisions:
    """Read a run. Raises RecordError if no decision was made."""
    mission = folder.mission()
    with understanding(folder):
        made = list(_decisions(folder))
        if not made:
            raise RecordError(f"{folder.path}: no decision was made in this run")
        sightings, measurements = recorded(folder, mission)
    return Decisions(
        folder=folder,
        mission=mission,
        priors_au=sightings.priors_au,
        made=made,
        measurements=measurements,
    )


def _decisions(folder: RunFolder) -> Iterator[Decision]:
    node: int | None = 0
    for number, line in enumerate(folder.decisions(), start=1):
        yield Decision(
            number=number,
            time_au=line["time_au"],
            flown_au=line["flown_au"],
            remaining_au=line["remaining_au"],
            position_au=np.array(line["position_au"]),
            node=node,
            waypoint_au=np.array(line["waypoint_au"]),
            chosen=line["node"],
            num_measurements=line["num_measurements"],
            details=line["details"],
        )
        node = line["node"]


def begin_anew(
    planner: Planner, decisions: Decisions, made: Sequence[Decision]
) -> Iterator[tuple[Decision, Snapshot]]:
    """Brief a planner as before the flight. -> each of some decisions, and what it was shown then

    Raises PlannerError; RecordError if pictures that one of them knew are missing.
    """
    mission, num_recorded = decisions.mission, len(decisions.measurements)
    if made[-1].num_measurements > num_recorded:
        raise RecordError(
            f"{decisions.folder.path}: decision {made[-1].number} was made after "
            f"{made[-1].num_measurements} pictures, of which {num_recorded} are recorded"
        )
    start_au, roadmap = draw_start_and_roadmap(mission)
    belief = make_belief(mission, Sightings(decisions.priors_au, mission.sensor.model))
    sightings = belief.sightings
    with blaming(f"planner '{planner.name}'", PlannerError):
        planner.reset(brief(mission, decisions.priors_au, start_au, stream="planner"), roadmap)
    for decision in made:
        for measurement in decisions.measurements[len(sightings) : decision.num_measurements]:
            sightings.add(measurement)
        yield (
            decision,
            Snapshot(
                time_au=decision.time_au,
                flown_au=decision.flown_au,
                position_au=decision.position_au.copy(),
                node=decision.node,
                sightings=sightings,
                belief=belief,
                roadmap=roadmap,
                remaining_au=decision.remaining_au,
            ),
        )
