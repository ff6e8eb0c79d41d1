from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.planner import Briefing, Snapshot, create_planner
from dronemon.planner.tsp import (
    TspLoop,
    Whereabouts,
    carried_on,
    last_seen,
    predicted,
)
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement

ROADMAP = Roadmap.random(10, 4, np.random.default_rng(0), np.array([0.5, 0.5]))


def briefing(priors_au: FloatArray) -> Briefing:
    return Briefing(
        num_targets=len(priors_au),
        priors_au=priors_au,
        start_au=np.array([0.5, 0.5]),
        horizon_au=30.0,
        rng=np.random.default_rng(0),
    )


def sight(time_au: float, places: dict[int, Sequence[float]], num_targets: int) -> Measurement:
    """A measurement that saw some targets."""
    seen, target_au = np.zeros(num_targets, dtype=np.bool_), np.full((num_targets, 2), np.nan)
    for target, place in places.items():
        seen[target], target_au[target] = True, place
    return Measurement(
        time_au=time_au, agent_au=np.array([0.5, 0.5]), seen=seen, target_au=target_au
    )


class Told:
    """Makes the snapshots of one mission."""

    def __init__(self, priors_au: FloatArray) -> None:
        self.sightings = Sightings(priors_au)
        self.briefing = briefing(priors_au)

    def __call__(
        self, time_au: float, position_au: Sequence[float], *measurements: Measurement
    ) -> Snapshot:
        for measurement in measurements:
            self.sightings.add(measurement)
        return Snapshot(
            time_au=time_au,
            flown_au=time_au,
            position_au=np.array(position_au),
            node=None,
            sightings=self.sightings,
            belief=Belief(self.sightings),
            roadmap=ROADMAP,
            remaining_au=30.0 - time_au,
        )


def test_goal_moves_with_its_target_and_is_skipped_where_it_is_not_found() -> None:
    planner = TspLoop("tsp", last_seen)
    snapshot = Told(np.array([[0.1, 0.5], [0.9, 0.5]]))
    planner.reset(snapshot.briefing, ROADMAP)
    first = planner.next_waypoint(snapshot(0.0, [0.4, 0.5]))
    np.testing.assert_allclose(first.position_au, [0.3, 0.5])
    seen = planner.next_waypoint(snapshot(0.1, [0.3, 0.5], sight(0.1, {0: (0.3, 0.58)}, 2)))
    np.testing.assert_allclose(seen.position_au, [0.3, 0.58])
    visited = planner.next_waypoint(snapshot(0.18, [0.3, 0.58]))
    assert visited.details["goal"] == 1
    missed = planner.next_waypoint(snapshot(0.8, [0.9, 0.5], sight(0.8, {}, 2)))
    assert missed.details["goal"] == 0
    towards = missed.position_au - [0.9, 0.5]
    np.testing.assert_allclose(towards / np.linalg.norm(towards), [-0.991, 0.132], atol=1e-3)


def test_loop_is_flown_on_in_the_same_sense() -> None:
    planner = TspLoop("tsp", last_seen)
    snapshot = Told(np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]))
    planner.reset(snapshot.briefing, ROADMAP)
    here, goals = np.array([0.1, 0.2]), []
    for step in range(1, 41):
        nudged = {step % 4: ([0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9])[step % 4]}
        waypoint = planner.next_waypoint(
            snapshot(0.1 * step, list(here), sight(0.1 * step, nudged, 4))
        )
        here = waypoint.position_au
        goals.append(waypoint.details["goal"])
    changes = [(a, b) for a, b in pairwise(goals) if a != b]
    assert changes
    assert len({(int(str(b)) - int(str(a))) % 4 for a, b in changes}) == 1


@pytest.mark.parametrize(
    ("whereabouts", "expected"),
    [(last_seen, [0.4, 0.5]), (carried_on, [0.5, 0.5])],
)
def test_where_a_walker_is_thought_to_be(whereabouts: Whereabouts, expected: list[float]) -> None:
    snapshot = Told(np.array([[0.2, 0.5]]))
    places_at = whereabouts(snapshot(2.0, [0.5, 0.5], sight(2.0, {0: (0.4, 0.5)}, 1)), ARENA)
    np.testing.assert_allclose(places_at(3.0)[0], expected)


def test_belief_is_thought_to_peak_where_the_target_was_seen() -> None:
    snapshot = Told(np.full((2, 2), np.nan))
    seen = snapshot(0.1, [0.5, 0.5], sight(0.1, {1: (0.55, 0.45)}, 2))
    places_au = predicted(seen, ARENA)(0.1)
    assert np.isnan(places_au[0]).all()
    np.testing.assert_allclose(places_au[1], [0.55, 0.45])


def test_lanes_are_flown_until_every_target_was_found() -> None:
    planner = create_planner("tsp")
    snapshot = Told(np.array([[0.3, 0.3], [np.nan, np.nan]]))
    planner.reset(snapshot.briefing, ROADMAP)
    assert "goal" not in planner.next_waypoint(snapshot(0.0, [0.5, 0.5])).details
    found = snapshot(0.1, [0.5, 0.5], sight(0.1, {1: (0.55, 0.45)}, 2))
    assert planner.next_waypoint(found).details["goal"] in (0, 1)


def test_targets_that_join_are_added_to_the_loop() -> None:
    planner = create_planner("tsp")
    snapshot = Told(np.empty((0, 2)))
    planner.reset(snapshot.briefing, ROADMAP)
    one = snapshot(5.0, [0.5, 0.5], sight(5.0, {0: (0.5, 0.55)}, 1))
    assert planner.next_waypoint(one).details["loop"] == [0]
    two = snapshot(5.1, [0.5, 0.6], sight(5.1, {1: (0.5, 0.65)}, 2))
    assert planner.next_waypoint(two).details["loop"] == [0, 1]
