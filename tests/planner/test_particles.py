from dataclasses import replace

import numpy as np
import pytest

from dronemon.arena import ARENA
from dronemon.planner import walking
from dronemon.planner.kinds import KindBelief
from dronemon.planner.moving import Walls
from dronemon.planner.particles import ParticleBelief, _Miss, _stops
from dronemon.planner.settings import MotionSettings
from dronemon.planner.speeds import SpeedBelief
from dronemon.planner.walking import (
    CURVATURE,
    HEADING,
    KIND,
    KINDS,
    RESTING,
    SPEED,
    X,
    Y,
)
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.sensor import PERFECT, Sensor
from dronemon.sightings import Sight, Sightings, is_in_view
from dronemon.types import Measurement
from dronemon.world import Instance, measure

WALLS = Walls.of(ARENA, ARENA.field)


NOTHING_HIDES = np.empty((0, 2))


def look_at(agent_au) -> walking.Stops:
    return walking.Stops(np.array([[0.0, *agent_au, 0.1]]), np.empty((1, 0, 2)))


class Told:
    """Particles, and the log that they fold over."""

    def __init__(self, priors_au, seed=0, sensor=PERFECT):
        priors_au = np.array(priors_au, dtype=float)
        self.sightings = Sightings(priors_au)
        rng = np.random.default_rng(seed)
        self.particles = ParticleBelief(priors_au, MotionSettings(), rng, sensor=sensor)

    def update(self, measurement):
        self.sightings.add(measurement)
        self.particles.learn(self.sightings)

    @property
    def walkers(self):
        return self.particles.targets[0].walkers


def sighting(time_au, target_au):
    target = np.array([target_au], dtype=float)
    return Measurement(
        time_au=time_au, agent_au=target[0] + 0.01, seen=np.array([True]), target_au=target
    )


def miss(time_au, agent_au):
    return Measurement(
        time_au=time_au,
        agent_au=np.array(agent_au, dtype=float),
        seen=np.array([False]),
        target_au=np.full((1, 2), np.nan),
    )


def test_particles_start_at_the_prior():
    belief = Told([[0.3, 0.4]])
    assert np.all(belief.walkers[:, :2] == [0.3, 0.4])


def test_unknown_target_may_be_anywhere():
    walkers = Told([[np.nan, np.nan]]).walkers
    assert walkers[:, :2].min() < 0.1
    assert walkers[:, :2].max() > 0.9


@pytest.mark.parametrize("speed", [1 / 30, 1 / 10, 1 / 7])
def test_speed_is_learned_from_a_minute_of_sightings(speed):
    instance = Instance.draw(10_000, 2)
    belief = Told(instance.paths.positions_au(0.0))
    for step in range(1, 31):
        places = instance.paths.positions_au(0.1 * step * speed)
        target = step // 5 % 2
        belief.update(measure(0.1 * step, places[target], places))
    assert belief.particles.speed.mean == pytest.approx(speed, rel=0.1)


def test_sighting_puts_all_particles_at_one_place_and_on_the_seen_heading():
    belief = Told([[0.5, 0.5]])
    belief.update(sighting(0.1, (0.51, 0.5)))
    belief.update(sighting(0.2, (0.52, 0.5)))
    walkers = belief.walkers
    assert np.all(walkers[:, :2] == [0.52, 0.5])
    assert np.median(np.abs(walkers[:, HEADING])) < 0.2


def test_miss_leaves_no_particle_in_view():
    belief = Told([[0.5, 0.5]])
    belief.update(sighting(0.1, (0.5, 0.5)))
    belief.particles.advance(1.5)
    belief.update(miss(1.6, (0.55, 0.5)))
    x, y = belief.walkers[:, [X, Y]].T
    assert np.all((x - 0.55) ** 2 + (y - 0.5) ** 2 >= 0.01 - 1e-12)


def test_a_miss_says_nothing_of_where_the_picture_did_not_look():
    belief = Told([[np.nan, np.nan]])
    belief.update(replace(miss(0.1, (0.5, 0.5)), view_au=0.05))
    away = np.hypot(*(belief.walkers[:, :2] - 0.5).T)
    assert away.min() >= 0.05
    assert np.any(away < 0.1)


def test_walks_anew_are_not_refuted_by_where_a_picture_did_not_look():
    """All its particles are refuted one after the other, but for those that stayed at the rim."""
    for view_au, is_near in ((0.1, False), (0.05, True)):
        belief = Told([[0.5, 0.5]])
        belief.update(sighting(0.1, (0.5, 0.5)))
        for step in range(2, 9):
            belief.update(replace(miss(0.1 * step, (0.5, 0.5)), view_au=view_au))
        away = np.hypot(*(belief.walkers[:, :2] - 0.5).T)
        assert np.any(away < 0.1) == is_near
        assert np.all(away >= view_au)


def hidden_from(first_au, last_au=SENSOR_RADIUS_AU, sectors=slice(0, 18)):
    """So much hidden to the north-east of the agent, of 72 sectors, or in others."""
    hidden_au = np.full((72, 2), SENSOR_RADIUS_AU)
    hidden_au[sectors] = first_au, last_au
    return hidden_au


def test_a_miss_refutes_along_a_street_and_not_behind_its_walls():
    belief = Told([[np.nan, np.nan]])
    belief.walkers[:, :2] = 0.5 + np.random.default_rng(0).uniform(
        -0.1, 0.1, (MotionSettings().num_particles, 2)
    )
    belief.update(replace(miss(1e-6, (0.5, 0.5)), view_au=0.02, hidden_au=hidden_from(0.02, 0.08)))
    away = belief.walkers[:, :2] - 0.5
    distance = np.hypot(*away.T)
    near = distance < 0.1
    assert near.any()
    assert np.all(away[near] > 0.0)
    assert distance[near].min() >= 0.02
    assert distance[near].max() <= 0.08


def test_walks_anew_survive_where_something_hides_them():
    """All its particles are refuted one after the other, but for those that stay behind a wall."""
    for hidden_au, is_there in ((hidden_from(0.1), False), (hidden_from(0.03), True)):
        belief = Told([[0.5, 0.5]])
        belief.update(sighting(0.1, (0.54, 0.54)))
        for step in range(2, 9):
            told = replace(miss(0.1 * step, (0.5, 0.5)), hidden_au=hidden_au)
            belief.update(replace(told, view_au=hidden_au.min()))
        away = belief.walkers[:, :2] - 0.5
        near = np.hypot(*away.T) < 0.1
        assert np.any(near) == is_there
        assert np.all(away[near] >= 0.0)


def test_walks_are_held_to_what_each_miss_hid():
    """Of a sight, and of a miss that says nothing of it, all beyond the view may be hidden."""
    hidden_au = hidden_from(0.03, 0.07)
    misses = [_Miss(0.1 * step, 0.5, 0.5, 0.04, h) for step, h in enumerate((hidden_au, None), 1)]
    stops = _stops(Sight(0.0, 0.5, 0.5), *misses)
    np.testing.assert_array_equal(stops.looks[:, 3], [0.0, 0.04, 0.04])
    assert (stops.hidden[0] == [0.0, SENSOR_RADIUS_AU]).all()
    np.testing.assert_array_equal(stops.hidden[1], hidden_au)
    assert (stops.hidden[2] == [0.04, SENSOR_RADIUS_AU]).all()
    assert _stops(Sight(0.0, 0.5, 0.5), misses[1]).hidden.shape == (2, 0, 2)


def test_a_sight_weighs_walks_by_what_was_hidden_between():
    """Straight on from west to east behind a wall to the north is as good as unseen."""
    stops = [(0.0, 0.3, 0.5), (0.5, 0.35, 0.44), (1.0, 0.4, 0.5)]
    open_ground = weighed(deck_at(0.3, 0.5), stops)
    walled = weighed(deck_at(0.3, 0.5), stops, hidden_au=hidden_from(0.01, sectors=slice(36)))
    assert walled["legs"] / walled["jitter"] > 1.5 * open_ground["legs"] / open_ground["jitter"]


def test_the_compiled_view_is_that_of_the_log():
    rng = np.random.default_rng(0)
    first_au = rng.uniform(0.0, SENSOR_RADIUS_AU, 72)
    hidden_au = np.stack([first_au, rng.uniform(first_au, SENSOR_RADIUS_AU)], axis=-1)
    places_au = 0.5 + rng.uniform(-0.12, 0.12, (5000, 2))
    for hidden in (NOTHING_HIDES, hidden_au):
        look = replace(
            miss(0.1, (0.5, 0.5)), view_au=0.07, hidden_au=hidden if len(hidden) else None
        )
        told = [walking.is_in_view(x, y, 0.5, 0.5, 0.07, hidden[None], 0) for x, y in places_au]
        assert told == is_in_view(look, places_au).tolist()
        assert 0.0 < np.mean(told) < 1.0


def test_misses_everywhere_never_leave_a_target_without_particles():
    belief = Told([[0.5, 0.5]])
    rng = np.random.default_rng(1)
    for step in range(1, 200):
        belief.update(miss(0.1 * step, rng.random(2)))
    walkers = belief.walkers
    assert walkers.shape == (MotionSettings().num_particles, walking.NUM_ROWS)
    assert np.isfinite(walkers).all()


def test_particles_stay_in_the_square():
    belief = Told([[0.01, 0.99]])
    now, later = belief.particles.futures(50, 40, 0.1)
    assert now.shape == (1, 50, 2)
    assert later.shape == (40, 1, 50, 2)
    assert later.min() >= 0.0
    assert later.max() <= 1.0


def test_futures_leave_the_belief_as_it_is():
    belief = Told([[0.2, 0.2]])
    before = belief.walkers.copy()
    belief.particles.futures(50, 20, 0.1)
    assert np.array_equal(before, belief.walkers)


def test_same_seed_gives_same_particles():
    beliefs = [Told([[0.5, 0.5]], seed=3) for _ in range(2)]
    for belief in beliefs:
        belief.update(sighting(0.1, (0.51, 0.5)))
        belief.update(miss(0.2, (0.9, 0.9)))
    assert np.array_equal(beliefs[0].walkers, beliefs[1].walkers)


def test_noisy_sightings_do_not_mislead_the_speed():
    rng = np.random.default_rng(5)
    speed = SpeedBelief(MotionSettings(), PERFECT, 1)
    for _ in range(60):
        step = np.array([0.05 * 0.3, 0.0]) + rng.normal(0.0, 0.0035, 2)
        speed.observe(0, float(np.hypot(*step)), 0.3)
    assert speed.mean == pytest.approx(0.05, rel=0.2)


def speeds_seen(speeds, count=10):
    belief = SpeedBelief(MotionSettings(), PERFECT, len(speeds) + 1)
    for i, speed in enumerate(speeds):
        for _ in range(count):
            belief.observe(i, 0.3 * speed, 0.3)
    return belief


def test_targets_of_one_speed_are_believed_of_one_and_others_apart():
    alike = speeds_seen([0.1, 0.1, 0.1])
    assert alike.mean_of(3) == pytest.approx(0.1, rel=0.05)  # not seen yet, as the others
    apart = speeds_seen([0.05, 0.1, 0.2])
    assert [apart.mean_of(i) for i in range(3)] == pytest.approx([0.05, 0.1, 0.2], rel=0.05)

    def spread(belief):
        drawn = belief.draw(3, 2000, np.random.default_rng(0))
        return np.log(drawn).std()

    assert spread(alike) < 0.1 < 0.3 < spread(apart)


def test_who_tours_is_seldom_on_the_old_trail_and_no_less_likely_to_tour():
    belief = Told([[0.9, 0.9]])
    target = belief.particles.targets[0]
    target.trail.append(Sight(-20.0, 0.5, 0.8))
    target.walkers[:, SPEED] = 0.0
    target.walkers[:, :2] = 0.8, 0.8
    target.walkers[::2, X] = 0.5  # on the trail
    before = target.walkers.copy()
    belief.update(miss(0.1, (0.1, 0.1)))
    after = belief.walkers
    for kind, asked in enumerate(KINDS):
        is_of = before[:, KIND] == kind
        assert (after[:, KIND] == kind).sum() == is_of.sum() > 20
        left = (after[after[:, KIND] == kind, X] == 0.5).sum() / (before[is_of, X] == 0.5).sum()
        assert left == pytest.approx(1.0 - asked.trail_doubt, abs=0.2)
    assert [kind.trail_doubt for kind in KINDS] == [0.9, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_doubt_is_near_the_trail_alone_and_of_the_kinds_that_have_it():
    walkers = np.zeros((3, walking.NUM_ROWS))
    walkers[:, :2] = (0.5, 0.8), (0.56, 0.8), (0.5, 0.8)
    walkers[:, KIND] = 0, 0, 1
    trail = np.array([[0.2, 0.2], [0.5, 0.8]])
    doubts = walking.doubts(walkers, trail, 0.05, walking.table_of(KINDS))
    assert doubts.tolist() == [KINDS[0].trail_doubt, 0.0, 0.0]
    assert not walking.doubts(walkers, trail[:0], 0.05, walking.table_of(KINDS)).any()


def test_an_eye_that_misses_removes_no_more_than_it_would_have_seen():
    walkers = np.zeros((4000, walking.NUM_ROWS))
    rng = np.random.default_rng(0)
    gone = walking.refuted(walkers, look_at([0.05, 0.0]), 0.3, rng)
    assert len(gone) / 4000 == pytest.approx(0.7, abs=0.03)
    assert len(walking.refuted(walkers, look_at([0.15, 0.0]), 0.3, rng)) == 0


SEEDS = (10_003, 10_005, 10_007)


def patrolled(motion, seed=10_003):
    """Particles of three targets, of which an agent visits each for 0.4 au of every 3.2."""
    instance = Instance.draw(seed, 3, motion)
    belief = Told(instance.paths.positions_au(0.0))
    rng = np.random.default_rng(0)
    for step in range(1, 300):
        places = instance.paths.positions_au(0.1 * step * 0.1)
        turn = step // 4 % 8
        agent = places[turn] + rng.uniform(-0.05, 0.05, 2) if turn < 3 else rng.random(2)
        belief.update(measure(0.1 * step, agent, places))
    return belief.particles


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("motion", "fitting"),
    [
        ("tsp", {"tour", "legs"}),
        ("waypoints", {"legs"}),
        ("correlated", {"wander", "legs"}),
        ("brownian", {"jitter"}),
        ("grazing", {"graze"}),
        ("loop", {"circle"}),
    ],
)
def test_how_targets_move_is_learned_from_what_is_seen_of_them(motion, fitting):
    beliefs = [patrolled(motion, seed).kinds.shares for seed in SEEDS]
    shares = dict(zip([k.name for k in KINDS], np.mean(beliefs, axis=0), strict=True))
    assert sum(shares[name] for name in fitting) > 0.6, shares


@pytest.mark.lengthy
def test_tours_are_taken_for_tours_more_than_all_else_is():
    shares = {
        motion: np.mean([patrolled(motion, seed).kinds.shares[0] for seed in SEEDS])
        for motion in ("tsp", "waypoints", "loop")
    }
    assert shares["tsp"] > 0.3 > 0.1 > max(shares["waypoints"], shares["loop"])


def test_before_anything_is_seen_no_way_of_moving_is_likelier():
    assert np.ptp(Told([[0.5, 0.5]]).particles.kinds.shares) == 0.0


@pytest.mark.lengthy
def test_circling_targets_keep_the_curve_that_they_were_seen_on():
    particles = patrolled("loop")
    paths = Instance.draw(10_003, 3, "loop").paths
    headings = np.unwrap(paths.headings_rad(np.array([0.0, 0.02])), axis=0)
    turns = (headings[1] - headings[0]) / 0.02
    circle = [kind.name for kind in KINDS].index("circle")
    for target, turn in zip(particles.targets, turns, strict=True):
        curves = target.walkers[target.walkers[:, KIND] == circle, CURVATURE]
        assert (np.sign(curves) == np.sign(turn)).mean() > 0.95
        assert np.std(np.log(np.abs(curves))) < 0.35  # at first 0.73


def weighed(deck, stops, hidden_au=NOTHING_HIDES, **sensor):
    """Shares of the kinds after two sights in a row, and looks with all of the sensor between."""
    rng = np.random.default_rng(0)
    belief = KindBelief(MotionSettings(), Sensor(**sensor), WALLS, rng)
    looks = np.array([(*stop, 0.1) for stop in stops])
    told = walking.Stops(looks, np.stack([hidden_au] * len(stops)))
    belief.observe(deck, told, np.empty((0, 2)), 0.1)
    return dict(zip([kind.name for kind in KINDS], belief.shares, strict=True))


def deck_at(x, y, *, speed=0.1, resting=0.0):
    deck = np.zeros((240, walking.NUM_ROWS))
    deck[:, X], deck[:, Y], deck[:, SPEED], deck[:, RESTING] = x, y, speed, resting
    return deck


def test_misses_on_the_straight_way_weigh_against_those_that_go_straight():
    away = [(0.0, 0.3, 0.5), (0.5, 0.9, 0.9), (1.0, 0.4, 0.5)]
    passed = weighed(deck_at(0.3, 0.5), away)
    missed = weighed(deck_at(0.3, 0.5), [(0.0, 0.3, 0.5), (0.5, 0.44, 0.5), (1.0, 0.4, 0.5)])
    assert passed["legs"] > passed["jitter"]
    assert missed["legs"] / missed["jitter"] < 0.7 * passed["legs"] / passed["jitter"]
    hardly = weighed(deck_at(0.3, 0.5), [away[0], (0.5, 0.35, 0.5), away[2]], miss=0.9)
    assert hardly["legs"] > hardly["jitter"]


def test_who_rested_and_is_where_it_was_is_grazing():
    stays = [(0.0, 0.3, 0.5), (1.0, 0.3, 0.5)]
    shares = weighed(deck_at(0.3, 0.5, resting=1.0), stays)
    assert max(shares, key=shares.get) == "graze"


def test_who_was_not_seen_since_others_taught_the_speed_is_walked_anew_with_it():
    instance = Instance.draw(10_000, 2)
    belief = Told(instance.paths.positions_au(0.0))
    for step in range(1, 31):
        places = instance.paths.positions_au(0.1 * step * 0.05)
        belief.update(measure(0.1 * step, places[0], np.array([places[0], [9.0, 9.0]])))
    unseen = belief.particles.targets[1]
    unseen.walkers[:, :2] = [0.5, 0.5]
    agent = np.array([0.5, 0.5])
    belief.update(measure(3.1, agent, np.array([[9.0, 9.0], [9.0, 9.0]])))
    assert np.median(unseen.walkers[:, SPEED]) == pytest.approx(0.05, rel=0.1)
    assert np.subtract(*np.quantile(np.log(unseen.walkers[:, SPEED]), [0.75, 0.25])) < 0.5


def test_who_may_be_taken_for_another_is_not_gone_when_it_is_not_told_of():
    sensor = Sensor(miss=0.2, confusion=0.5)
    assert sensor.untold == pytest.approx(0.6)
    belief = Told([[0.5, 0.5], [0.9, 0.9]], sensor=sensor)
    belief.update(measure(0.1, np.array([0.5, 0.5]), np.full((2, 2), 9.0)))
    away = np.linalg.norm(belief.walkers[:, :2] - [0.5, 0.5], axis=1)
    assert (away < 0.1).all()  # copied from those that the eye may have missed


def test_a_false_alarm_far_off_leaves_most_particles_and_further_sights_move_them():
    belief = Told([[0.2, 0.2], [0.8, 0.2]], sensor=Sensor(miss=0.1, false_alarms=0.2))

    def told(time_au, place_au):
        both = np.array([place_au, [np.nan, np.nan]])
        agent = np.array(place_au) + 0.03
        seen = np.array([True, False])
        belief.update(Measurement(time_au=time_au, agent_au=agent, seen=seen, target_au=both))
        return np.linalg.norm(belief.walkers[:, :2] - place_au, axis=-1) < 0.05

    assert told(0.1, (0.205, 0.2)).all()
    first = told(0.2, (0.7, 0.7)).mean()
    further = [told(0.1 * k, (0.69 + 0.003 * k, 0.7)).mean() for k in range(3, 8)]
    assert first < 0.1
    assert further[-1] > 0.9


def test_a_perfect_eye_is_believed_at_once():
    belief = Told([[0.2, 0.2]])
    belief.update(sighting(0.1, (0.7, 0.7)))
    assert np.all(belief.walkers[:, :2] == [0.7, 0.7])
