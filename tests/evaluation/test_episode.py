from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from dronemon.errors import PlannerError
from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.planner import Briefing, Snapshot, Waypoint, create_planner
from dronemon.roadmap import Roadmap
from dronemon.sensor import Sensor
from dronemon.types import FloatArray
from dronemon.world import Instance, TargetPaths


class Route:
    """Flies given points, and keeps what it was told."""

    name = "route"

    def __init__(self, *points_au: tuple[float, float]) -> None:
        self._points_au = points_au
        self.snapshots: list[Snapshot] = []
        self.num_told: list[int] = []

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self.briefing = briefing
        self.snapshots.clear()

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        point_au = self._points_au[len(self.snapshots) % len(self._points_au)]
        self.snapshots.append(snapshot)
        self.num_told.append(len(snapshot.sightings))
        return Waypoint(position_au=np.array(point_au))


def walkers(*starts_au: tuple[float, float]) -> Instance:
    """Targets that walk right from their starts; the agent starts at (0.1, 0.1)."""
    starts: FloatArray = np.array(starts_au)
    paths = TargetPaths.along(np.stack([starts, starts + np.array([0.4, 0.0])], axis=1))
    return Instance(seed=0, start_au=np.array([0.1, 0.1]), paths=paths)


def test_agent_measures_every_tenth_also_round_corners_and_targets_move_meanwhile() -> None:
    route = Route((0.35, 0.1), (0.35, 0.35), (0.1, 0.1))
    episode = fly_episode(route, walkers((0.4, 0.15)), Conditions(speed_ratio=0.1, horizon_au=0.5))
    np.testing.assert_allclose(
        episode.agent_au,
        [[0.1, 0.1], [0.2, 0.1], [0.3, 0.1], [0.35, 0.15], [0.35, 0.25], [0.35, 0.35]],
        atol=1e-12,
    )
    np.testing.assert_allclose(episode.targets_au[:, 0, 0], 0.4 + 0.01 * np.arange(6))
    assert np.flatnonzero(~np.isnan(episode.told_au[:, 0, 0])).tolist() == [3]
    np.testing.assert_allclose(episode.conditions.times_au, 0.1 * np.arange(6))


def test_planner_is_told_everything_once_with_the_time_of_its_arrival() -> None:
    route = Route((0.35, 0.1), (0.35, 0.35), (0.1, 0.35))
    fly_episode(route, walkers((0.4, 0.15)), Conditions(speed_ratio=0.1, horizon_au=0.7))
    first, second, third = route.snapshots
    told = third.sightings.since(0)
    assert [s.time_au for s in route.snapshots] == pytest.approx([0.0, 0.25, 0.5])
    assert [s.remaining_au for s in route.snapshots] == pytest.approx([0.7, 0.45, 0.2])
    assert [s.flown_au for s in route.snapshots] == pytest.approx([0.0, 0.25, 0.5])
    assert [m.time_au for m in told] == pytest.approx(np.arange(1, 8) / 10.0)
    assert route.num_told == [0, 2, 5]
    assert first.node == 0
    np.testing.assert_allclose(first.roadmap.nodes_au[0], [0.1, 0.1])
    assert second.node is None
    np.testing.assert_allclose(told[2].target_au, [[0.43, 0.15]])


@pytest.mark.parametrize(("prior", "known"), [("full", 2), ("number", 2), ("none", 0)])
def test_briefing_tells_what_the_prior_allows(prior: str, known: int) -> None:
    route = Route((0.9, 0.1))
    instance = walkers((0.4, 0.15), (0.2, 0.8))
    fly_episode(route, instance, Conditions(speed_ratio=0.0, prior=prior, horizon_au=0.5))  # type: ignore[arg-type]  # parametrised
    assert route.briefing.num_targets == known
    assert route.briefing.priors_au.shape == (known, 2)
    assert np.isfinite(route.briefing.priors_au).all() == (prior != "number")


def test_targets_join_in_the_order_of_their_first_sight() -> None:
    route = Route((0.5, 0.1), (0.5, 0.5), (0.9, 0.5))
    instance = walkers((0.9, 0.9), (0.5, 0.45), (0.35, 0.1))
    conditions = Conditions(speed_ratio=0.0, prior="none", horizon_au=0.9)
    episode = fly_episode(route, instance, conditions)
    told = route.snapshots[-1].sightings.since(0)[:8]
    assert [len(m.seen) for m in told] == [0, 1, 1, 1, 1, 1, 2, 2]
    last = told[-1]
    assert last.seen.tolist() == [False, True]  # the second to be met is the true target 1
    np.testing.assert_allclose(last.target_au[1], [0.5, 0.45])
    assert route.snapshots[-1].belief.num_targets == 2
    assert episode.told_au.shape == (10, 3, 2)
    unc = episode.metrics().unc
    assert unc.shape == (10, 3)
    assert np.all(unc[:, 0] == 1.0)  # never met


def test_metrics_of_a_target_in_view_are_good_and_of_a_lost_one_bad() -> None:
    route = Route((0.15, 0.1), (0.1, 0.1))
    episode = fly_episode(
        route, walkers((0.1, 0.1), (0.8, 0.8)), Conditions(speed_ratio=0.0, horizon_au=7.0)
    )
    metrics = episode.metrics()
    assert metrics.unc.shape == (71, 2)
    scores = metrics.scores
    assert scores.min_ob == 0
    assert metrics.unc[-1, 0] < 0.7
    assert metrics.unc[-1, 1] == pytest.approx(1.0, abs=1e-3)
    assert metrics.jsd[-1, 0] < 0.1 < metrics.jsd[-1, 1]


@pytest.mark.parametrize(
    ("point_au", "complaint"),
    [
        ((1.2, 0.5), "not in the arena"),
        ((np.nan, 0.5), "no place"),
        ((0.1, 0.1), "cannot stop"),
    ],
)
def test_waypoints_that_cannot_be_flown_to_are_the_planners_error(
    point_au: tuple[float, float], complaint: str
) -> None:
    with pytest.raises(PlannerError, match=f"planner route, seed 0, gave at 0.000 au.*{complaint}"):
        fly_episode(Route(point_au), walkers((0.5, 0.5)), Conditions(speed_ratio=0.1))


class _Wrong(Route):
    def __init__(self, answer: Callable[[Snapshot], object]) -> None:
        super().__init__()
        self.answer = answer

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        return self.answer(snapshot)  # type: ignore[return-value]  # wrong on purpose


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (lambda _: 1 // 0, "failed: ZeroDivisionError"),
        (lambda _: sys.exit(3), r"failed: SystemExit\(3\)"),
        (lambda _: None, "None, which is no Waypoint"),
        (lambda _: Waypoint(position_au=np.zeros(3)), "not two numbers"),
        (lambda _: Waypoint(position_au=np.ones(2), node="a"), "no number of a node"),  # type: ignore[arg-type]  # wrong on purpose
    ],
)
def test_whatever_a_planner_does_wrong_is_its_error(
    answer: Callable[[Snapshot], object], complaint: str
) -> None:
    with pytest.raises(PlannerError, match=f"planner route, seed 0, .*{complaint}"):
        fly_episode(_Wrong(answer), walkers((0.5, 0.5)), Conditions(speed_ratio=0.1))


def test_a_planner_that_writes_into_what_it_is_told_moves_nothing() -> None:
    def write(snapshot: Snapshot) -> Waypoint:
        snapshot.position_au[:] = 0.9
        return Waypoint(position_au=np.array([0.5, 0.1]))

    conditions = Conditions(speed_ratio=0.1, horizon_au=0.3)
    episode = fly_episode(_Wrong(write), walkers((0.5, 0.5)), conditions)
    np.testing.assert_allclose(episode.agent_au[:, 0], [0.1, 0.2, 0.3, 0.4])


def test_clairvoyant_planner_meets_targets_it_was_never_told_of() -> None:
    instance = Instance.draw(10_005, 3)
    conditions = Conditions(speed_ratio=0.1, prior="none", horizon_au=6.0)
    seen = fly_episode(create_planner("clairvoyant"), instance, conditions).metrics().observed
    assert np.all(seen.sum(axis=0) >= 3)


def test_carrying_headings_on_finds_targets_that_the_plain_loop_loses() -> None:
    instance = walkers((0.1, 0.9), (0.55, 0.1))
    conditions = Conditions(speed_ratio=0.12, horizon_au=3.2)
    plain, carried = (
        fly_episode(create_planner(kind), instance, conditions).metrics().observed.sum()
        for kind in ("tsp", "tsp-heading")
    )
    assert carried > plain


def test_an_eye_that_errs_is_in_the_world_and_told_to_the_planner() -> None:
    sensor = Sensor(miss=0.5, false_alarms=0.2)
    briefed: list[Sensor] = []
    planner = create_planner("lawnmower")
    reset = planner.reset

    def noted(briefing: Briefing, roadmap: Roadmap) -> None:
        briefed.append(briefing.sensor)
        reset(briefing, roadmap)

    planner.reset = noted  # type: ignore[method-assign]
    episode = fly_episode(
        planner, Instance.draw(10_000, 4), Conditions(speed_ratio=0.1, sensor=sensor)
    )
    assert briefed == [sensor]
    offset_au = episode.targets_au - episode.agent_au[:, None]
    in_view = np.linalg.norm(offset_au, axis=-1)[1:] < 0.1
    told = ~np.isnan(episode.told_au[1:, :, 0])
    assert 0.25 < (in_view & ~told).sum() / in_view.sum() < 0.75
    assert (told & ~in_view).sum() > 20
    assert (episode.metrics().observed[1:] == (told & in_view)).all()
