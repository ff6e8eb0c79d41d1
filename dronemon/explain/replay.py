"""A decision of a recorded flight, made once more from its run folder, and why it was made."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch

from dronemon.belief import Belief
from dronemon.errors import OptionError, RecordError
from dronemon.feasibility import make_planner
from dronemon.mission import Mission, load_mission
from dronemon.planner import Snapshot, Waypoint, has_weights
from dronemon.planner.learned import LearnedPlanner
from dronemon.policy import Explanation
from dronemon.recorder import MISSION_FILE, RunFolder
from dronemon.roadmap import Roadmap
from dronemon.runner.history import recorded, understanding
from dronemon.runner.preparation import brief, draw_start_and_roadmap, make_belief
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement

LOGIT_TOLERANCE = 1e-3
"""How far logits may be from the recorded ones: processors differ in the last digits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """A decision, what was known when it was made, and the weights behind it.

    number:         its line in the record, from 1
    target_names:   (N,)
    nodes_au:       (V, 2) the roadmap
    last_places_au: (N, 2) where each target was seen last, a known start counted; NaN if never
    last_seen_au:   (N,)   when
    path_au:        (M, 2) where the pictures known so far were taken
    chosen:         the roadmap node chosen
    logit_error:    largest difference of a logit from the recorded one
    """

    number: int
    time_au: float
    target_names: Sequence[str]
    nodes_au: FloatArray
    last_places_au: FloatArray
    last_seen_au: FloatArray
    path_au: FloatArray
    chosen: int
    logit_error: float
    explanation: Explanation

    def arrays(self) -> dict[str, Any]:
        """All of it by name, the weights as in `Explanation`."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        del own["explanation"]
        return {**own, **self.explanation.arrays()}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Decision:
    """What a line of the record says of a decision.

    node:             where it was made
    num_measurements: that were known
    num_decisions:    of the planner since it began anew, this one counted
    """

    time_au: float
    position_au: FloatArray
    node: int
    chosen: int
    logits: FloatArray
    num_measurements: int
    num_decisions: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Record:
    priors_au: FloatArray
    decisions: Sequence[_Decision]
    measurements: Sequence[Measurement]


def replay(folder: RunFolder, number: int | None) -> Replay:
    """Decide again from where the planner began anew, up to a decision, the last one for None.

    Raises OptionError for a planner without attention or a decision that is not there; RecordError
    if the record is not whole, or another decision comes out than was flown.
    """
    mission, record = _flown_with_weights(folder)
    number = len(record.decisions) if number is None else number
    if not 1 <= number <= len(record.decisions):
        count = len(record.decisions)
        raise OptionError(f"--decision {number}: {folder.path} has {count}, counted from 1")
    *_, wanted = _decide_again(folder, mission, record, number)
    return wanted


def replay_all(folder: RunFolder) -> tuple[int, Iterator[Replay]]:
    """Every decision of a run, in order, made again as each is asked for. -> how many, and they

    Raises as `replay` does.
    """
    mission, record = _flown_with_weights(folder)
    counts = [decision.num_decisions for decision in record.decisions]
    ends = [i for i in range(1, len(counts) + 1) if i == len(counts) or counts[i] == 1]
    chains = (_decide_again(folder, mission, record, number) for number in ends)
    return len(counts), itertools.chain.from_iterable(chains)


def _flown_with_weights(folder: RunFolder) -> tuple[Mission, _Record]:
    mission = load_mission(folder.path / MISSION_FILE).mission
    if not has_weights(mission.planner.kind):
        raise OptionError(
            f"{folder.path} was flown by planner {mission.planner.kind!r}, which has no attention;"
            " give a run of planner 'stamp'"
        )
    with understanding(folder):
        return mission, _read(folder, mission)


def _read(folder: RunFolder, mission: Mission) -> _Record:
    decisions = list(_decisions(folder))
    if not decisions:
        raise RecordError(f"{folder.path}: no decision was made in this run")
    sightings, measurements = recorded(folder, mission)
    return _Record(priors_au=sightings.priors_au, decisions=decisions, measurements=measurements)


def _decisions(folder: RunFolder) -> Iterator[_Decision]:
    node = 0
    for line in folder.decisions():
        details: Mapping[str, Any] = line["details"]
        yield _Decision(
            time_au=line["time_au"],
            position_au=np.array(line["position_au"]),
            node=node,
            chosen=line["node"],
            logits=np.array(details["logits"]),
            num_measurements=line["num_measurements"],
            num_decisions=details["num_decisions"],
        )
        node = line["node"]


def _of_one_memory(folder: RunFolder, record: _Record, number: int) -> Sequence[_Decision]:
    """The decisions from where the planner began anew until this one. Raises RecordError."""
    count = record.decisions[number - 1].num_decisions
    made = record.decisions[max(number - count, 0) : number]
    if [decision.num_decisions for decision in made] != list(range(1, count + 1)):
        raise RecordError(
            f"{folder.path}: decision {number} was made with a memory of {count - 1} decisions, "
            "not all of which are recorded, as where a pilot took over meanwhile; explain one "
            "before them"
        )
    if made[-1].num_measurements > len(record.measurements):
        raise RecordError(
            f"{folder.path}: decision {number} was made after {made[-1].num_measurements} "
            f"pictures, of which {len(record.measurements)} are recorded"
        )
    return made


def _decide_again(
    folder: RunFolder, mission: Mission, record: _Record, last: int
) -> Iterator[Replay]:
    """The decisions from where the planner began anew until the last one."""
    made = _of_one_memory(folder, record, last)
    torch.set_num_threads(1)  # as in flight
    planner = make_planner(mission.planner)
    assert isinstance(planner, LearnedPlanner)  # it has weights
    start_au, roadmap = draw_start_and_roadmap(mission)
    planner.reset(brief(mission, record.priors_au, start_au, stream="planner"), roadmap)
    belief = make_belief(mission, Sightings(record.priors_au))
    for number, decision in enumerate(made, start=last - len(made) + 1):
        for measurement in record.measurements[len(belief.sightings) : decision.num_measurements]:
            belief.sightings.add(measurement)
        time_au, position_au = decision.time_au, decision.position_au
        snapshot = snapshot_at(time_au, position_au, decision.node, belief, roadmap, mission)
        waypoint, explanation = planner.explain(snapshot)
        yield Replay(
            number=number,
            time_au=decision.time_au,
            target_names=[target.name for target in mission.targets],
            nodes_au=roadmap.nodes_au,
            last_places_au=belief.sightings.last_places_au,
            last_seen_au=belief.sightings.last_seen_au,
            path_au=np.array([m.agent_au for m in belief.sightings.since(0)]).reshape(-1, 2),
            chosen=decision.chosen,
            logit_error=_logit_error(folder, decision, waypoint, number),
            explanation=explanation,
        )


def snapshot_at(
    time_au: float,
    position_au: FloatArray,
    node: int | None,
    belief: Belief,
    roadmap: Roadmap,
    mission: Mission,
) -> Snapshot:
    """What a planner is shown where a recorded decision was made."""
    return Snapshot(
        time_au=time_au,
        flown_au=time_au,
        position_au=position_au,
        node=node,
        sightings=belief.sightings,
        belief=belief,
        roadmap=roadmap,
        remaining_au=max(mission.horizon_au - time_au, 0.0),
    )


def _logit_error(folder: RunFolder, decision: _Decision, waypoint: Waypoint, number: int) -> float:
    """Largest difference of a logit from the record. Raises RecordError where it is too large."""
    again = np.array(waypoint.details["logits"])
    is_alike = again.shape == decision.logits.shape
    error = float(np.abs(again - decision.logits).max()) if is_alike else np.inf
    if not error <= LOGIT_TOLERANCE:
        raise RecordError(
            f"{folder.path}: decision {number} comes out otherwise than as it was flown, its "
            f"logits by {error:.2g} (limit {LOGIT_TOLERANCE:g}); use the weights and the version "
            "that flew it"
        )
    return error
