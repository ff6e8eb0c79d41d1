"""Worlds beside the paper's: what tells each of them apart, and what holds in all."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dronemon.problem import MOTIONS
from dronemon.types import FloatArray
from dronemon.world import Instance

WALKED_AU = np.arange(0.0, 30.0, 0.01)


def places(motion: str, seed: int = 10_000, num_targets: int = 3) -> FloatArray:
    """(S, N, 2) at every 0.01 au of walking."""
    return Instance.draw(seed, num_targets, motion).paths.positions_au(WALKED_AU)


def steps_au(motion: str, seed: int = 10_000) -> FloatArray:
    """(S - 1, N) way between them."""
    return np.linalg.norm(np.diff(places(motion, seed), axis=0), axis=-1)


@pytest.mark.parametrize("motion", MOTIONS)
def test_targets_stay_in_the_square_and_one_seed_is_one_world(motion: str) -> None:
    for seed in range(10_000, 10_005):
        few, many = places(motion, seed, 2), places(motion, seed, 5)
        assert many.min() >= 0.0
        assert many.max() <= 1.0
        np.testing.assert_array_equal(few, many[:, :2])
    assert not np.allclose(places(motion, 10_000), places(motion, 10_001))


@pytest.mark.parametrize("motion", sorted(set(MOTIONS) - {"herd"}))
def test_nobody_outruns_the_speed_and_all_but_grazers_keep_it(motion: str) -> None:
    steps = steps_au(motion)
    assert steps.max() <= 0.01 + 1e-9
    standing = (steps < 1e-9).mean()
    assert (0.3 < standing < 0.7) if motion == "grazing" else standing == 0.0


def test_headings_are_those_of_the_steps_and_stay_while_a_target_rests() -> None:
    paths = Instance.draw(10_000, 3, "grazing").paths
    walked = np.arange(0.0, 90.0, 0.001)  # beyond the end, and back
    offsets = np.diff(paths.positions_au(walked), axis=0)
    headings, moves = paths.headings_rad(walked[:-1]), np.linalg.norm(offsets, axis=-1) > 9e-4
    cosine = np.cos(headings - np.arctan2(offsets[..., 1], offsets[..., 0]))
    assert (cosine[moves] > 0.9).mean() > 0.95  # but for corners
    stays = ~moves[1:] & ~moves[:-1]
    assert (np.abs(np.diff(headings, axis=0))[stays] < 1e-9).mean() > 0.99


def test_the_more_a_walk_turns_the_less_far_it_comes() -> None:
    gone = {}
    for motion in ("waypoints", "correlated", "brownian"):
        ways = [places(motion, seed) for seed in range(10_000, 10_010)]
        gone[motion] = np.mean([np.linalg.norm(w[20:] - w[:-20], axis=-1).mean() for w in ways])
    assert gone["brownian"] < 0.6 * gone["correlated"]
    assert gone["correlated"] < gone["waypoints"]


def test_a_loop_comes_round_again_the_same_way() -> None:
    paths = Instance.draw(10_000, 3, "loop").paths
    for target, length in enumerate(paths.lengths_au):
        walked = np.linspace(0.0, length, 50)
        now, later = (paths.positions_au(walked + k * length)[:, target] for k in (0, 3))
        np.testing.assert_allclose(now, later, atol=1e-9)
        radii = np.linalg.norm(now - now[:-1].mean(axis=0), axis=1)
        assert np.ptp(radii) < 0.02


def test_a_herd_keeps_together() -> None:
    ways = places("herd")
    spread = np.linalg.norm(ways - ways.mean(axis=1, keepdims=True), axis=-1)
    assert spread.max() < 0.25
    assert np.ptp(ways.mean(axis=1), axis=0).max() > 0.4
    assert 0.3 < steps_au("herd").mean() / 0.01 < 2.0


def test_roads_are_shared_and_few() -> None:
    paths = Instance.draw(10_000, 5, "road").paths
    junctions = np.unique(np.round(paths.points_au.reshape(-1, 2), 9), axis=0)
    assert len(junctions) <= 25
    legs = {
        frozenset((tuple(a), tuple(b)))
        for way in np.round(paths.points_au, 9).tolist()
        for a, b in itertools.pairwise(way)
    }
    assert len(legs) <= 40


def test_targets_may_be_of_different_speeds() -> None:
    usual, spread = (Instance.draw(10_000, 8, "waypoints", s).paths for s in (0.0, 0.5))
    np.testing.assert_array_equal(usual.points_au, spread.points_au)
    factors = usual.lengths_au / spread.lengths_au
    assert factors.min() < 0.8
    assert factors.max() > 1.2
    assert ((factors >= 0.5) & (factors <= 1.5)).all()
