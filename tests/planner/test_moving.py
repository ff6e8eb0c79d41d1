import numpy as np
import pytest

from dronemon.arena import ARENA
from dronemon.planner import moving


def test_a_step_over_the_border_goes_along_it_as_far():
    rng = np.random.default_rng(10_000)
    bearings = 2.0 * np.pi * rng.random(2000)
    places = np.concatenate([rng.random((1000, 2)), rng.choice([0.0, 0.02, 0.98, 1.0], (1000, 2))])
    for (x, y), bearing in zip(places, bearings, strict=True):
        to = np.array(
            moving.step_inside(ARENA.bounds, x, y, 0.1 * np.cos(bearing), 0.1 * np.sin(bearing))
        )
        assert np.all((to >= 0.0) & (to <= 1.0))
        assert np.hypot(*(to - (x, y))) == pytest.approx(0.1)
