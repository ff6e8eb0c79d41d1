"""Short tours of places, by the distances between them."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.planner.tours import shortest_loop
from dronemon.types import FloatArray


def between(points_au: FloatArray) -> FloatArray:
    return np.linalg.norm(points_au[:, None] - points_au, axis=-1)


def loop_length_au(points_au: FloatArray) -> float:
    return float(np.linalg.norm(points_au - np.roll(points_au, 1, axis=0), axis=1).sum())


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
def test_loop_of_few_points_is_the_shortest(seed: int, count: int) -> None:
    points_au = np.random.default_rng(seed).random((count, 2))
    best = min(loop_length_au(points_au[list(order)]) for order in permutations(range(count)))
    assert loop_length_au(points_au[shortest_loop(between(points_au))]) == pytest.approx(best)


@pytest.mark.parametrize("count", [8, 9, 12, 20])
def test_loop_round_a_circle_is_the_circle(count: int) -> None:
    angles = np.random.default_rng(count).permutation(2 * np.pi * np.arange(count) / count)
    points_au = 0.5 + 0.4 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    order = shortest_loop(between(points_au))
    assert order[0] == 0
    assert sorted(order.tolist()) == list(range(count))
    assert loop_length_au(points_au[order]) == pytest.approx(
        2 * count * 0.4 * np.sin(np.pi / count)
    )
