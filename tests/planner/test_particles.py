import numpy as np
import pytest

from dronemon.planner.particles import ParticleBelief, SpeedBelief, refuted
from dronemon.planner.settings import MotionSettings
from dronemon.sightings import Sightings
from dronemon.types import Measurement
from dronemon.world import Instance, measure


class Told:
    """Particles, and the log that they fold over."""

    def __init__(self, priors_au, seed=0):
        priors_au = np.array(priors_au, dtype=float)
        self.sightings = Sightings(priors_au)
        self.particles = ParticleBelief(priors_au, MotionSettings(), np.random.default_rng(seed))

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
    assert np.all(belief.walkers[:2] == [[0.3], [0.4]])


def test_unknown_target_may_be_anywhere():
    walkers = Told([[np.nan, np.nan]]).walkers
    assert walkers[:2].min() < 0.1
    assert walkers[:2].max() > 0.9


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
    assert np.all(walkers[:2] == [[0.52], [0.5]])
    assert np.median(np.abs(walkers[2])) < 0.2


def test_miss_leaves_no_particle_in_view():
    belief = Told([[0.5, 0.5]])
    belief.update(sighting(0.1, (0.5, 0.5)))
    belief.particles.advance(1.5)
    belief.update(miss(1.6, (0.55, 0.5)))
    x, y = belief.walkers[:2]
    assert np.all((x - 0.55) ** 2 + (y - 0.5) ** 2 >= 0.01 - 1e-12)


def test_misses_everywhere_never_leave_a_target_without_particles():
    belief = Told([[0.5, 0.5]])
    rng = np.random.default_rng(1)
    for step in range(1, 200):
        belief.update(miss(0.1 * step, rng.random(2)))
    walkers = belief.walkers
    assert walkers.shape == (3, MotionSettings().num_particles)
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
    speed = SpeedBelief(MotionSettings())
    for _ in range(60):
        step = np.array([0.05 * 0.3, 0.0]) + rng.normal(0.0, 0.0035, 2)
        speed.observe(float(np.hypot(*step)), 0.3)
    assert speed.mean == pytest.approx(0.05, rel=0.2)


def test_a_miss_on_the_old_trail_removes_as_many_as_the_doubt_says():
    walkers = np.zeros((3, 4000))
    walkers[0], walkers[1] = 0.8, 0.8
    walkers[0, 2000:] = 0.5  # on the trail
    trail, agent = np.array([[0.5, 0.8]]), np.array([0.1, 0.1])
    doubt = MotionSettings().trail_doubt
    for share in (doubt, 0.0, 1.0):
        gone = refuted(walkers, agent, trail, 0.05, share, np.random.default_rng(0))
        assert len(gone) / 2000 == pytest.approx(share, abs=0.03)
        assert (gone >= 2000).all()
    assert doubt > 0.5
