from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.arena import ARENA
from dronemon.planner import moving
from dronemon.world import sample_leg


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


@settings(max_examples=100)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 12),
    residual_au=st.floats(0.0, 0.0999),
)
def test_compiled_legs_measure_where_the_worlds_legs_do(seed, count, residual_au):
    rng = np.random.default_rng(seed)
    nodes_au = rng.random((count + 1, 2))
    following = np.tile(np.minimum(np.arange(count + 1) + 1, count)[:, None], (1, count + 1))
    ground = moving.Ground.of(ARENA)._replace(nodes=nodes_au, next_hop=following)
    path_au = np.zeros((400, 2))
    k, x, y, node, due, hop = moving.follow(
        *nodes_au[-1], count, ground, path_au, np.int64(0), *nodes_au[0], 0, 0.1 - residual_au
    )
    expected = []
    for start_au, end_au in pairwise(nodes_au):
        leg = sample_leg(start_au, end_au, residual_au)
        expected += leg.positions_au.tolist()
        residual_au = leg.residual_au
    assert (node, hop, k) == (count, 1, len(expected))
    np.testing.assert_allclose(path_au[:k], np.reshape(expected, (-1, 2)), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose([x, y], nodes_au[-1])
    assert due == pytest.approx(0.1 - residual_au, abs=1e-9)
