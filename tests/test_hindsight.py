"""What an eye that errs is believed to have seen: against all stories written out one by one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon import hindsight
from dronemon.arena import ARENA
from dronemon.belief import Belief, episode_metrics, metrics
from dronemon.belief.grid import GRID_SIZE
from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.evaluation.figures import believe
from dronemon.hindsight import Hindsight
from dronemon.planner import Briefing, Snapshot, Waypoint, create_planner
from dronemon.problem import Prior
from dronemon.roadmap import Roadmap
from dronemon.sensor import PERFECT, Sensor
from dronemon.sightings import Sightings, Window
from dronemon.types import BoolArray, FloatArray, Measurement
from dronemon.world import Instance

ERRS = Sensor(miss=0.2, false_alarms=0.05)
Place = tuple[float, float]


def look(time_au: float, agent_au: Place, *told_au: Place | None) -> Measurement:
    """What a picture told of each target: its place where seen."""
    return Measurement(
        time_au=time_au,
        agent_au=np.array(agent_au),
        seen=np.array([place is not None for place in told_au], dtype=np.bool_),
        target_au=np.array([place or (math.nan, math.nan) for place in told_au]).reshape(-1, 2),
    )


def believed(prior_au: Place, looks: Sequence[Measurement], sensor: Sensor = ERRS) -> FloatArray:
    """What is made in the end of all looks at one target. -> (n, 2)"""
    told = Hindsight(sensor, np.array([prior_au]))
    for each in looks:
        told.add(each)
    return told.believed_au(0)[:, 0]


UNKNOWN = (math.nan, math.nan)


def test_a_false_alarm_is_taken_back_once_the_target_is_seen_elsewhere() -> None:
    walk = [(0.2 + 0.01 * k, 0.2) for k in range(9)]
    looks = [look(0.1 * (k + 1), place, place) for k, place in enumerate(walk)]
    looks.append(look(2.0, (0.28, 0.27), (0.28, 0.25)))
    np.testing.assert_array_equal(believed(walk[0], looks)[9], (0.28, 0.25))
    elsewhere = [(0.30, 0.09), (0.31, 0.09)]
    looks += [look(2.1 + 0.1 * k, place, place) for k, place in enumerate(elsewhere)]
    told = believed(walk[0], looks)
    np.testing.assert_array_equal(told[:9], walk)
    assert np.isnan(told[9]).all()
    np.testing.assert_array_equal(told[10:], elsewhere)


def test_a_miss_between_two_sights_is_seen_through() -> None:
    looks = [look(0.1, (0.5, 0.5), (0.5, 0.52)), look(0.2, (0.5, 0.5), None)]
    looks.append(look(0.3, (0.5, 0.5), (0.52, 0.52)))
    told = believed(UNKNOWN, looks)
    np.testing.assert_allclose(told[1], (0.51, 0.52), atol=1e-12)


def test_who_was_just_seen_and_is_missed_is_believed_to_be_there_still() -> None:
    looks = [look(0.1, (0.5, 0.5), (0.5, 0.52)), look(0.2, (0.5, 0.5), None)]
    np.testing.assert_array_equal(believed((0.5, 0.52), looks)[1], (0.5, 0.52))
    looks += [look(0.2 + 0.1 * k, (0.5, 0.5), None) for k in range(1, 30)]
    assert np.isnan(believed((0.5, 0.52), looks)[-1]).all(), "for a while"


def test_an_eye_that_misses_nobody_is_not_seen_through() -> None:
    looks = [look(0.1, (0.5, 0.5), (0.5, 0.52)), look(0.2, (0.5, 0.5), None)]
    told = believed(UNKNOWN, looks, Sensor(false_alarms=0.05))
    assert np.isnan(told[1]).all()


def test_who_was_not_seen_for_long_may_be_anywhere() -> None:
    looks = [look(0.1 * k, (0.1, 0.1), (0.1, 0.1)) for k in range(1, 5)]
    looks.append(look(20.0, (0.9, 0.9), (0.9, 0.9)))
    told = believed((0.1, 0.1), looks, Sensor(miss=0.1, false_alarms=0.01))
    np.testing.assert_array_equal(told, [(0.1, 0.1)] * 4 + [(0.9, 0.9)])


def test_nobody_may_be_known_of() -> None:
    log = Sightings(np.empty((0, 2)), Sensor(miss=0.1, false_alarms=0.01))
    log.add(look(0.1, (0.5, 0.5)))
    assert log.believed_au(0).shape == (1, 0, 2)
    log.add(look(0.2, (0.5, 0.5), (0.5, 0.52)))
    np.testing.assert_array_equal(log.believed_au(1), [[(0.5, 0.52)]])


def test_a_target_out_of_view_stays_unseen() -> None:
    looks = [look(0.1, (0.5, 0.5), (0.5, 0.52)), look(0.2, (0.5, 0.9), None)]
    assert np.isnan(believed(UNKNOWN, looks)[1]).all()


def test_what_little_was_looked_at_is_no_miss() -> None:
    """A picture that showed a tenth of the radius tells nothing of who is beyond."""
    small = Measurement(
        time_au=0.2,
        agent_au=np.array([0.5, 0.5]),
        seen=np.array([False]),
        target_au=np.full((1, 2), np.nan),
        view_au=0.01,
    )
    told = believed(UNKNOWN, [look(0.1, (0.5, 0.5), (0.55, 0.5)), small])
    assert np.isnan(told[1]).all()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    speed=st.floats(0.0, 0.95),
    miss=st.floats(0.0, 0.3),
    false_alarms=st.floats(0.0, 0.3),
)
def test_whoever_walks_in_view_is_believed(
    seed: int, speed: float, miss: float, false_alarms: float
) -> None:
    """A target that is followed and never missed: every sight holds, whatever the eye is feared."""
    rng = np.random.default_rng(seed)
    heading = rng.normal(0.0, 1.0, 30).cumsum() * 0.3
    steps = 0.1 * speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    walk = np.array([0.5, 0.5]) + steps.cumsum(axis=0)
    offset = 0.05 * rng.normal(size=(30, 2)).clip(-1.0, 1.0)
    looks = [
        look(0.1 * (k + 1), tuple(place + off), tuple(place))
        for k, (place, off) in enumerate(zip(walk, offset, strict=True))
    ]
    sensor = Sensor(miss=miss, false_alarms=false_alarms)
    np.testing.assert_array_equal(believed((0.5, 0.5), looks, sensor), walk)


def plain_share(place: FloatArray, radius: float, agent: FloatArray) -> float:
    """The module's own words on how much of a disc is in view, one disc at a time."""
    overlap = (0.1 + radius - math.dist(place, agent)) / (2 * min(0.1, radius))
    return min(max(overlap, 0.0), 1.0) * min(1.0, (0.1 / radius) ** 2)


def plain_score(
    speed: float,
    story: Sequence[int],
    sights: Sequence[tuple[float, FloatArray]],
    looks: Sequence[Measurement],
    num_prior: int,
    sensor: Sensor,
) -> float:
    """Log-likelihood of that just these sights are true, looks and sights one at a time."""
    found, false = 1 - sensor.miss, sensor.false_alarms / 2 / (math.pi * 0.1**2)
    score = math.log(false) * (len(sights) - len(story))
    score += math.log(found) * (len(story) - num_prior)
    for a, b in pairwise(story):
        (then, came_from), (now, came_to) = sights[a], sights[b]
        reach = 1.1 * speed * (now - then) + 0.008 + 2 * sensor.position_au
        came = math.dist(came_from, came_to)
        score += max(-math.log(math.pi * reach**2) - max(came - reach, 0.0) / 0.01, -30.0)
        for each in looks:
            if then < each.time_au < now:
                part = (each.time_au - then) / (now - then)
                aside = math.sqrt(max(reach**2 - came**2, 0.0)) * min(part, 1 - part)
                place = came_from + part * (came_to - came_from)
                score += math.log1p(-found * plain_share(place, 0.004 + aside, each.agent_au))
    if story:
        last, place = sights[story[-1]]
        for each in looks:
            if each.time_au > last:
                radius = 0.004 + speed * (each.time_au - last)
                score += math.log1p(-found * plain_share(place, radius, each.agent_au))
    return score


@pytest.mark.parametrize("sensor", [ERRS, Sensor(miss=0.1, false_alarms=0.3, position_au=0.01)])
@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("seed", range(7))
def test_the_story_is_the_likeliest_of_all(seed: int, is_known: bool, sensor: Sensor) -> None:
    """Every subset of up to seven sights at every speed, by plain code; one of two targets."""
    rng = np.random.default_rng(seed)
    target, agent = rng.random((2, 2))
    prior_au = (float(target[0]), float(target[1])) if is_known else UNKNOWN
    looks: list[Measurement] = []
    sights = [(0.0, target)] if is_known else []
    for k in range(1, 40):
        target = (target + rng.normal(0.0, 0.02, 2)).clip(0.0, 1.0)
        agent = (agent + 0.1 * (target - agent) + rng.normal(0.0, 0.05, 2)).clip(0.0, 1.0)
        told = None
        if len(sights) < 7 and math.dist(target, agent) < 0.1 and rng.random() < 0.6:
            told = target
        elif len(sights) < 7 and rng.random() < 0.15:
            told = agent + rng.uniform(-0.07, 0.07, 2)
        looks.append(look(0.1 * k, tuple(agent), None if told is None else tuple(told), None))
        if told is not None:
            sights.append((looks[-1].time_au, told))
    first = int(is_known)
    stories = [
        (0,) * first + rest
        for size in range(len(sights) - first + 1)
        for rest in combinations(range(first, len(sights)), size)
    ]
    best = max(
        ((speed, story) for story in stories for speed in hindsight._SPEEDS),
        key=lambda of: plain_score(*of, sights, looks, first, sensor),
    )[1]
    hearing = Hindsight(sensor, np.array([prior_au, UNKNOWN]))
    for each in looks:
        hearing.add(each)
    told_au = hearing.believed_au(0)[:, 0]
    times = [each.time_au for each in looks]
    for index in range(first, len(sights)):
        time_au, place = sights[index]
        is_believed = np.array_equal(told_au[times.index(time_au)], place)
        assert is_believed == (index in best), (index, best, len(sights))


def test_targets_do_not_depend_on_their_order_and_may_join() -> None:
    rng = np.random.default_rng(3)
    priors_au = rng.random((2, 2))
    straight, turned = Hindsight(ERRS, priors_au), Hindsight(ERRS, priors_au[::-1])
    joining = Hindsight(ERRS, priors_au[:1])
    for k in range(50):
        agent = tuple(rng.random(2))
        told = [tuple(agent + 0.1 * rng.random(2)) if rng.random() < 0.3 else None for _ in "ab"]
        straight.add(look(0.1 * k, agent, *told))
        turned.add(look(0.1 * k, agent, *told[::-1]))
        joining.add(look(0.1 * k, agent, *(told[:1] if k < 20 else told)))
    np.testing.assert_array_equal(straight.believed_au(7), turned.believed_au(7)[:, ::-1])
    assert joining.believed_au(0).shape == (50, 2, 2)
    assert np.isnan(joining.believed_au(0)[:20, 1]).all()
    assert np.isfinite(joining.believed_au(20)[:, 1]).any()


def test_a_perfect_eye_is_taken_at_its_word() -> None:
    log = Sightings(np.array([(0.2, 0.2)]))
    log.add(look(0.1, (0.8, 0.8), (0.8, 0.8)))
    np.testing.assert_array_equal(log.believed_au(0), [[(0.8, 0.8)]])
    assert not PERFECT.needs_hindsight
    assert not Sensor(position_au=0.01).needs_hindsight


@pytest.mark.parametrize("prior", ["full", "number", "none"])
def test_what_is_scored_is_what_was_believed_in_flight(prior: Prior) -> None:
    sensor = Sensor(miss=0.2, false_alarms=0.3, confusion=0.2)
    conditions = Conditions(speed_ratio=0.1, prior=prior, horizon_au=8.0, sensor=sensor)
    windows: dict[int, Window] = {}

    class Watching:
        """Flies about and keeps what beliefs are made of."""

        name = "watching"

        def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
            windows.clear()

        def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
            step_au = 0.1 * np.array([np.cos(a := 0.3 * len(windows)), np.sin(a)])
            windows[len(snapshot.sightings)] = snapshot.sightings.window(5.979)
            return Waypoint(position_au=(snapshot.position_au + step_au).clip(0.0, 1.0))

    flown = fly_episode(Watching(), Instance.draw(10_401, 4), conditions)
    scored = metrics._History.of(
        conditions.times_au,
        flown.agent_au,
        flown.targets_au,
        flown.told_au,
        prior,
        sensor,
        5.979,
    )
    last = max(windows)
    assert windows[last].points.shape[0] == 4, "all targets are known in the end"
    for now in sorted(windows)[30:]:
        points, values, mask = (of[0].numpy() for of in scored.windows(torch.tensor([now])))
        known = np.flatnonzero(mask.any(axis=1))
        got = sorted(_observations(points[i], values[i], mask[i]) for i in known)
        # In flight targets stand in the order in which they became known.
        in_flight = zip(*windows[now], strict=True)
        assert got == sorted(_observations(*of) for of in in_flight if of[2].any())


def _observations(
    points: FloatArray, values: FloatArray, mask: BoolArray
) -> list[tuple[float, ...]]:
    """Those that count, in the order of time."""
    return sorted(
        (float(t), float(x), float(y), float(value))
        for (x, y, t), value in zip(points[mask], values[mask], strict=True)
    )


def test_beliefs_and_their_scores_are_of_what_is_believed() -> None:
    """On a flight: most false alarms are out, few true sights lost, and beliefs are better."""
    conditions = Conditions(speed_ratio=0.1, horizon_au=15.0, sensor=ERRS)
    flown = fly_episode(create_planner("tsp-heading"), Instance.draw(10_400, 4), conditions)
    log = Sightings(flown.targets_au[0], ERRS)
    for time_au, agent, told in zip(
        conditions.times_au[1:], flown.agent_au[1:], flown.told_au[1:], strict=True
    ):
        seen = ~np.isnan(told[:, 0])
        log.add(Measurement(time_au=time_au, agent_au=agent, seen=seen, target_au=told))
    told_au, truth_au = flown.told_au[1:], flown.targets_au[1:]
    was_told = ~np.isnan(told_au[..., 0])
    is_true = was_told & (np.linalg.norm(told_au - truth_au, axis=-1) < 1e-9)
    is_held = was_told & (log.believed_au(0) == told_au).all(axis=-1)
    assert (was_told & ~is_true).sum() >= 4
    assert (is_held & ~is_true).sum() <= 0.5 * (was_told & ~is_true).sum()
    assert (is_held & is_true).sum() >= 0.95 * is_true.sum()
    scored = flown.metrics()
    unaware = episode_metrics(
        conditions.times_au, flown.agent_au, flown.targets_au, flown.told_au, prior="full"
    )
    assert scored.scores.jsd < 0.95 * unaware.scores.jsd
    np.testing.assert_array_equal(scored.observed, unaware.observed)
    query = np.column_stack([ARENA.grid(GRID_SIZE), np.full(GRID_SIZE**2, log.time_au)])
    mean = Belief(log).mean(query)
    pictured = believe(flown, len(log)).reshape(mean.shape)
    np.testing.assert_allclose(pictured, mean, atol=1e-12)
    plain = Sightings(flown.targets_au[0])
    for held, each in zip(log.believed_au(0), log.since(0), strict=True):
        plain.add(replace(each, seen=~np.isnan(held[:, 0]), target_au=held))
    np.testing.assert_allclose(mean, Belief(plain).mean(query), atol=1e-12)
    asked = log.window(2.0, in_hindsight=False)
    unjudged = Sightings(flown.targets_au[0])
    for each in log.since(0):
        unjudged.add(each)
    for got, expected in zip(asked, unjudged.window(2.0), strict=True):
        np.testing.assert_array_equal(got, expected)
