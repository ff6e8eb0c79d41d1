from dataclasses import replace

import numpy as np
import pytest
from arenas import U

from dronemon.arena import ARENA, Arena
from dronemon.belief import Belief
from dronemon.errors import PlannerError
from dronemon.planner import Briefing, Snapshot, scoring, walking
from dronemon.planner.paths import Found
from dronemon.planner.search import (
    ClairvoyantSearchPlanner,
    PresentSearchPlanner,
    RoadmapSearchPlanner,
    SearchPlanner,
)
from dronemon.planner.settings import MotionSettings, SearchSettings
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.world import Instance, measure, sample_leg

QUICK = SearchSettings(num_drawn=40, num_refined=20, num_planned=30)


def fly(
    planner,
    *,
    prior="full",
    num_targets=3,
    speed=0.05,
    length_au=6.0,
    seed=10_000,
    noise=0.0,
    is_late=False,
):
    """Agent's places and what was seen, (S, 2) and (S, N), of one short mission.

    is_late: the planner hears of a measurement one decision later
    """
    instance = Instance.draw(seed, num_targets)
    roadmap = Roadmap.random(200, 10, instance.stream("roadmap"), instance.start_au)
    if hasattr(planner, "foresee"):
        planner.foresee(lambda times_au: instance.paths.positions_au(times_au * speed))
    priors = instance.paths.positions_au(0.0)
    known = 0 if prior == "none" else num_targets
    priors = priors if prior == "full" else np.full((known, 2), np.nan)
    planner.reset(
        Briefing(
            num_targets=known,
            priors_au=priors,
            start_au=instance.start_au,
            horizon_au=length_au,
            rng=instance.stream("planner"),
        ),
        roadmap,
    )
    met: list[int] = list(range(known))
    sightings = Sightings(priors)
    belief = Belief(sightings)
    rng = np.random.default_rng(seed)
    position, node, time, residual, pending = instance.start_au, 0, 0.0, 0.0, []
    places, seen, waiting = [], [], []
    while time < length_au - 1e-9:
        for measurement in waiting if is_late else pending:
            sightings.add(measurement)
        waypoint = planner.next_waypoint(
            Snapshot(
                time_au=time,
                flown_au=time,
                position_au=position,
                node=node,
                sightings=sightings,
                belief=belief,
                roadmap=roadmap,
                remaining_au=length_au - time,
            )
        )
        assert np.all((waypoint.position_au >= 0.0) & (waypoint.position_au <= 1.0))
        leg = sample_leg(position, waypoint.position_au, residual)
        waiting, pending = pending, []
        for offset, place in zip(leg.offsets_au, leg.positions_au, strict=True):
            whole = measure(
                time + offset, place, instance.paths.positions_au((time + offset) * speed)
            )
            met += [i for i in np.flatnonzero(whole.seen) if i not in met]
            target_au = whole.target_au[met] + rng.normal(0.0, noise, (len(met), 2))
            pending.append(replace(whole, seen=whole.seen[met], target_au=target_au))
            places.append(place)
            seen.append(whole.seen)
        time += float(np.linalg.norm(waypoint.position_au - position))
        position, node, residual = waypoint.position_au, waypoint.node, leg.residual_au
    return np.array(places), np.array(seen)


@pytest.mark.lengthy
def test_keeps_all_targets_in_sight_again_and_again():
    _, seen = fly(SearchPlanner(QUICK), length_au=10.0)
    assert seen.sum(axis=0).min() >= 8


@pytest.mark.lengthy
def test_same_seed_flies_the_same_path():
    first, _ = fly(SearchPlanner(QUICK), length_au=3.0)
    second, _ = fly(SearchPlanner(QUICK), length_au=3.0)
    assert np.array_equal(first, second)


@pytest.mark.lengthy
def test_finds_targets_whose_places_are_unknown():
    _, seen = fly(SearchPlanner(QUICK), prior="number", length_au=15.0)
    assert seen.any(axis=0).all()


@pytest.mark.lengthy
def test_finds_targets_of_which_nothing_is_known():
    every = [
        fly(SearchPlanner(QUICK), prior="none", length_au=15.0, seed=seed)[1]
        for seed in range(10_000, 10_004)
    ]
    assert sum(int(seen.any(axis=0).sum()) for seen in every) >= 11  # of 12


@pytest.mark.lengthy
def test_noisy_sightings_are_followed():
    _, seen = fly(SearchPlanner(QUICK), noise=0.0025, length_au=10.0)
    assert seen.sum(axis=0).min() >= 8


@pytest.mark.lengthy
@pytest.mark.parametrize("bound", [ClairvoyantSearchPlanner, PresentSearchPlanner])
def test_who_is_told_where_targets_are_sees_them_more_often(bound):
    fast = {"speed": 1 / 7, "num_targets": 4, "length_au": 6.0}
    _, blind = fly(SearchPlanner(QUICK), **fast)
    _, told = fly(bound(QUICK), **fast)
    assert told.sum() > blind.sum()


def test_who_is_told_the_present_has_its_particles_there_and_going_there():
    planner = PresentSearchPlanner(QUICK)
    fly(planner, length_au=2.0)
    paths = Instance.draw(10_000, 3).paths
    for target, x_y, heading in zip(
        planner._particles.targets,
        paths.positions_au(1.9 * 0.05),
        paths.headings_rad(1.9 * 0.05),
        strict=True,
    ):
        walkers = target.walkers[:40]
        assert np.linalg.norm(np.median(walkers[:, :2], axis=0) - x_y) < 0.02
        assert np.median(np.cos(walkers[:, walking.HEADING] - heading)) > 0.9


def test_roadmap_search_stays_on_edges_and_scores_every_neighbour():
    planner = RoadmapSearchPlanner(QUICK)
    instance = Instance.draw(10_001, 2)
    roadmap = Roadmap.random(200, 10, instance.stream("roadmap"), instance.start_au)
    planner.reset(
        Briefing(
            num_targets=2,
            priors_au=instance.paths.positions_au(0.0),
            start_au=instance.start_au,
            horizon_au=30.0,
            rng=instance.stream("planner"),
        ),
        roadmap,
    )
    sightings = Sightings(instance.paths.positions_au(0.0))
    belief = Belief(sightings)
    node, position, time = 0, instance.start_au, 0.0
    for _ in range(10):
        waypoint = planner.next_waypoint(
            Snapshot(
                time_au=time,
                flown_au=time,
                position_au=position,
                node=node,
                sightings=sightings,
                belief=belief,
                roadmap=roadmap,
                remaining_au=30.0 - time,
            )
        )
        others = roadmap.neighbours[node][roadmap.neighbours[node] != node]
        gains = np.array(waypoint.details["neighbour_gains"])
        assert waypoint.details["neighbours"] == others.tolist()
        assert np.isfinite(gains).all()
        assert others[gains.argmax()] == waypoint.node
        time += float(np.linalg.norm(waypoint.position_au - position))
        node, position = waypoint.node, waypoint.position_au


@pytest.mark.lengthy
def test_roadmap_search_keeps_targets_in_sight():
    _, seen = fly(RoadmapSearchPlanner(QUICK), length_au=10.0)
    assert seen.sum(axis=0).min() >= 5


@pytest.mark.parametrize("planner", [SearchPlanner(QUICK), ClairvoyantSearchPlanner(QUICK)])
def test_waypoints_are_one_measurement_apart(planner, monkeypatch):
    steps = []
    decide = planner.next_waypoint

    def noted(snapshot):
        waypoint = decide(snapshot)
        steps.append(float(np.linalg.norm(waypoint.position_au - snapshot.position_au)))
        return waypoint

    monkeypatch.setattr(planner, "next_waypoint", noted)
    fly(planner, length_au=3.0)
    assert len(steps) >= 30
    assert steps == pytest.approx([0.1] * len(steps))


@pytest.mark.parametrize(
    ("goals_au", "expected_au"),
    [
        ([[0.13, 0.9], [0.15, 0.5]], [0.13, 0.9]),  # there and back: it measures where it is
        ([[0.15, 0.9], [0.15, 0.5]], [0.15, 0.86]),
        ([[0.15, 0.9], [0.13, 0.88]], [0.13, 0.88]),
    ],
)
def test_a_path_in_a_polygon_is_flown_to_where_it_first_turns_or_measures(
    monkeypatch, goals_au, expected_au
):
    here_au = np.array([0.15, 0.9])
    sightings = Sightings(here_au[None])
    roadmap = Roadmap(nodes_au=here_au[None], neighbours=np.zeros((1, 1), dtype=np.int64))
    planner = SearchPlanner(QUICK)
    briefing = Briefing(
        num_targets=1,
        priors_au=sightings.priors_au,
        start_au=here_au,
        horizon_au=1.0,
        rng=np.random.default_rng(0),
        arena=U,
    )
    planner.reset(briefing, roadmap)
    found = Found(1.0, np.tile(here_au, (5, 1)), np.array(goals_au), len(goals_au), -1, np.empty(0))
    monkeypatch.setattr(planner, "_search", lambda *_: found)
    snapshot = Snapshot(
        time_au=0.06,
        flown_au=0.06,
        position_au=here_au,
        node=None,
        sightings=sightings,
        belief=Belief(sightings),
        roadmap=roadmap,
        remaining_au=0.94,
    )
    assert planner.next_waypoint(snapshot).position_au == pytest.approx(expected_au)


@pytest.mark.lengthy
def test_measurements_that_come_a_decision_late_do_not_hold_it_up():
    # In flight the picture at a waypoint is taken after the next one was asked for.
    _, seen = fly(SearchPlanner(QUICK), length_au=10.0, is_late=True)
    assert seen.sum(axis=0).min() >= 5


def test_no_worth_at_all_is_an_error_and_not_a_flight_to_the_corner():
    planner = SearchPlanner(replace(QUICK, unfound_weight=float("nan")))
    with pytest.raises(PlannerError, match="no path"):
        fly(planner, prior="number", length_au=1.0)


@pytest.mark.parametrize("num_targets", [1, 4, 20, 50])
@pytest.mark.parametrize("speed", [0.03, 0.28])
def test_what_paths_are_scored_against_is_bounded(num_targets: int, speed: float):
    settings = SearchSettings(motion=MotionSettings(slowest=speed, fastest=speed))
    scored = []

    class Noted(SearchPlanner):
        def _foreseen(self, time_au):
            foreseen = super()._foreseen(time_au)
            scored.append(foreseen[1].shape[:3])
            return foreseen

    fly(Noted(settings), num_targets=num_targets, length_au=0.1)
    steps, targets, each = scored[0]
    assert (steps, targets) == (settings.horizon(speed), num_targets)
    assert steps * targets * each <= settings.num_places
    assert (
        each
        == {
            (1, 26): 80,
            (4, 26): 60,
            (20, 26): 12,
            (50, 26): 4,
            (1, 7): 80,
            (4, 7): 80,
            (20, 7): 44,
            (50, 7): 17,
        }[targets, steps]
    )


def test_all_walks_are_compiled_before_take_off():
    fly(SearchPlanner(QUICK), length_au=0.1)
    called = (walking.walk, walking.refuted, walking.walk_anew, walking.outlived, walking.doubts)
    assert all(function.signatures for function in called)


def test_fields_of_means_are_as_fine_as_ever_in_the_square_and_bounded_in_large_fields() -> None:
    assert scoring.mean_cells(ARENA) == (48, 48)
    columns, rows = scoring.mean_cells(Arena(high_au=(12.5, 7.5)))
    assert columns * rows <= 1.02 * scoring.MOST_MEAN_CELLS
    assert columns / rows == pytest.approx(12.5 / 7.5, rel=0.02)
