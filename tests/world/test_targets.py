from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.types import FloatArray
from dronemon.world import Instance, TargetPaths
from dronemon.world.targets import short_path_order


def length_au(points_au: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(points_au, axis=0), axis=1).sum())


def corner_path() -> TargetPaths:
    """Right 0.5, then up 0.25."""
    return TargetPaths.along(np.array([[[0.25, 0.5], [0.75, 0.5], [0.75, 0.75]]]))


def test_target_walks_round_a_corner_and_back_from_the_end() -> None:
    walked = np.array([0.0, 0.25, 0.5, 0.625, 0.75, 1.0, 1.5, 1.75])
    expected = [
        [0.25, 0.5],
        [0.5, 0.5],
        [0.75, 0.5],
        [0.75, 0.625],
        [0.75, 0.75],
        [0.75, 0.5],
        [0.25, 0.5],
        [0.5, 0.5],
    ]
    np.testing.assert_allclose(corner_path().positions_au(walked)[:, 0], expected, atol=1e-12)


def test_headings_follow_the_path_out_and_back() -> None:
    headings = corner_path().headings_rad(np.array([0.1, 0.6, 0.8, 1.2, 1.6]))[:, 0]
    np.testing.assert_allclose(
        np.cos(headings - np.array([0.0, np.pi / 2, -np.pi / 2, np.pi, 0.0])), 1.0
    )


def test_single_distance_and_many_agree() -> None:
    paths = Instance.draw(10_000, 3).paths
    walked = np.linspace(0.0, 12.0, 50)
    np.testing.assert_array_equal(
        paths.positions_au(walked), np.stack([paths.positions_au(float(w)) for w in walked])
    )
    np.testing.assert_array_equal(
        paths.headings_rad(walked), np.stack([paths.headings_rad(float(w)) for w in walked])
    )


@pytest.mark.lengthy
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_paths_join_all_points_from_first_to_second_in_few_detours(seed: int) -> None:
    drawn = np.random.default_rng(seed).random((50, 2))
    order = short_path_order(drawn)
    assert sorted(order.tolist()) == list(range(50))
    assert (order[0], order[-1]) == (0, 1)
    ordered = drawn[order]
    assert length_au(ordered) < 7.5  # 50 random points in random order make about 26
    for i in range(48):  # no exchange of two legs shortens it
        for j in range(i + 2, 49):
            swapped = np.concatenate(
                [ordered[: i + 1], ordered[i + 1 : j + 1][::-1], ordered[j + 1 :]]
            )
            assert length_au(swapped) > length_au(ordered) - 1e-8


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), speed=st.floats(0.001, 0.2))
def test_targets_stay_in_the_square_and_never_outrun_their_speed(seed: int, speed: float) -> None:
    paths = TargetPaths.random(2, np.random.default_rng(seed))
    walked = speed * np.arange(600) * 0.1
    positions = paths.positions_au(walked)
    assert positions.min() >= 0.0
    assert positions.max() <= 1.0
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    assert steps.max() <= 0.1 * speed + 1e-12


def test_paths_outlast_the_papers_fastest_targets() -> None:
    shortest = min(Instance.draw(seed, 8).paths.lengths_au.min() for seed in range(10_000, 10_020))
    assert shortest > 30.0 / 7.0


def test_one_seed_is_one_instance() -> None:
    instance = Instance.draw(10_007, 2)
    digest = hashlib.sha256(
        np.round(np.concatenate([instance.start_au, instance.paths.points_au.ravel()]), 12)
    )
    assert digest.hexdigest()[:16] == "10393d72875abec6"


def test_first_targets_do_not_depend_on_how_many_there_are() -> None:
    few, many = Instance.draw(10_003, 2), Instance.draw(10_003, 6)
    np.testing.assert_array_equal(few.paths.points_au, many.paths.points_au[:2])
    np.testing.assert_array_equal(few.start_au, many.start_au)


def test_streams_are_their_own_and_repeatable() -> None:
    instance = Instance.draw(0, 1)
    first = instance.stream("roadmap").random(4)
    np.testing.assert_array_equal(first, instance.stream("roadmap").random(4))
    others = [instance.stream("planner"), Instance.draw(1, 1).stream("roadmap")]
    assert all(not np.allclose(first, other.random(4)) for other in others)
