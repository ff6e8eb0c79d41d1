"""A decision of a recorded flight, made once more from its run folder, and why it was made."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch

from dronemon.errors import OptionError, RecordError
from dronemon.explain.decisions import Decision, Decisions, begin_anew, read_decisions
from dronemon.feasibility import make_planner
from dronemon.planner import Waypoint, has_weights
from dronemon.planner.learned import LearnedPlanner
from dronemon.policy import Explanation
from dronemon.recorder import RunFolder
from dronemon.runner.history import understanding
from dronemon.types import FloatArray

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


def replay(folder: RunFolder, number: int | None) -> Replay:
    """Decide again from where the planner began anew, up to a decision, the last one for None.

    Raises OptionError for a planner without attention or a decision that is not there; RecordError
    if the record is not whole, or another decision comes out than was flown.
    """
    decisions = _read(folder)
    count = len(decisions.made)
    number = count if number is None else number
    if not 1 <= number <= count:
        raise OptionError(f"--decision {number}: {folder.path} has {count}, counted from 1")
    *_, wanted = _decide_again(folder, decisions, number)
    return wanted


def replay_all(folder: RunFolder) -> tuple[int, Iterator[Replay]]:
    """Every decision of a run, in order, made again as each is asked for. -> how many, and they

    Raises as `replay` does.
    """
    decisions = _read(folder)
    counts = _memories(folder, decisions)
    ends = [i for i in range(1, len(counts) + 1) if i == len(counts) or counts[i] == 1]
    chains = (_decide_again(folder, decisions, number) for number in ends)
    return len(counts), itertools.chain.from_iterable(chains)


def _read(folder: RunFolder) -> Decisions:
    kind = folder.mission().planner.kind
    if not has_weights(kind):
        raise OptionError(
            f"{folder.path} was flown by planner {kind!r}, which has no attention;"
            " give a run of planner 'stamp'"
        )
    return read_decisions(folder)


def _memories(folder: RunFolder, decisions: Decisions) -> list[int]:
    """Of each decision, how many the planner had made since it began anew, itself counted."""
    with understanding(folder):
        return [int(decision.details["num_decisions"]) for decision in decisions.made]


def _of_one_memory(folder: RunFolder, decisions: Decisions, number: int) -> Sequence[Decision]:
    """The decisions from where the planner began anew until this one. Raises RecordError."""
    counts = _memories(folder, decisions)[:number]
    first = max(number - counts[-1], 0)
    if counts[first:] != list(range(1, counts[-1] + 1)):
        raise RecordError(
            f"{folder.path}: decision {number} was made with a memory of {counts[-1] - 1} "
            "decisions, not all of which are recorded, as where a pilot took over meanwhile; "
            "explain one before them"
        )
    return decisions.made[first:number]


def _decide_again(folder: RunFolder, decisions: Decisions, last: int) -> Iterator[Replay]:
    """The decisions from where the planner began anew until the last one."""
    made, mission = _of_one_memory(folder, decisions, last), decisions.mission
    torch.set_num_threads(1)  # as in flight
    planner = make_planner(mission.planner)
    assert isinstance(planner, LearnedPlanner)  # it has weights
    for decision, snapshot in begin_anew(planner, decisions, made):
        waypoint, sightings = planner.next_waypoint(snapshot), snapshot.sightings
        assert decision.chosen is not None  # it flies along the roadmap
        yield Replay(
            number=decision.number,
            time_au=decision.time_au,
            target_names=[target.name for target in mission.targets],
            nodes_au=snapshot.roadmap.nodes_au,
            last_places_au=sightings.last_places_au,
            last_seen_au=sightings.last_seen_au,
            path_au=np.array([m.agent_au for m in sightings.since(0)]).reshape(-1, 2),
            chosen=decision.chosen,
            logit_error=_logit_error(folder, decision, waypoint),
            explanation=planner.explanation(),
        )


def _logit_error(folder: RunFolder, decision: Decision, waypoint: Waypoint) -> float:
    """Largest difference of a logit from the record. Raises RecordError where it is too large."""
    again = np.array(waypoint.details["logits"])
    with understanding(folder):
        flown = np.array(decision.details["logits"])
    error = float(np.abs(again - flown).max()) if again.shape == flown.shape else np.inf
    if not error <= LOGIT_TOLERANCE:
        raise RecordError(
            f"{folder.path}: decision {decision.number} comes out otherwise than as it was "
            f"flown, its logits by {error:.2g} (limit {LOGIT_TOLERANCE:g}); use the weights and "
            "the version that flew it"
        )
    return error
