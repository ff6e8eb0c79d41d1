"""The metrics against cases worked out by hand and against slow, plain code."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.distance import jensenshannon
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from dronemon.arena import ARENA, Arena
from dronemon.belief import Belief, EpisodeMetrics, episode_metrics, fit
from dronemon.belief.grid import evaluation_grid
from dronemon.belief.metrics import (
    area_std,
    jensen_shannon,
    peak_error_au,
    since_seen_au,
)
from dronemon.sightings import Sightings

GRID = np.stack(
    np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 40), indexing="ij"), axis=-1
).reshape(-1, 2)
SQUARE = evaluation_grid(ARENA)


def plain_area(target):
    """The target area by the paper's words."""
    square = ((GRID - target) ** 2).sum(-1)
    return np.exp(-square / (2 * 0.1**2)) > np.exp(-0.5)


def plain_jsd(mean, target):
    bump = np.exp(-((GRID - target) ** 2).sum(-1) / (2 * 0.1**2))
    return jensenshannon(bump + 1e-8, np.maximum(mean, 0) + 1e-8) ** 2


def test_grid_is_40_by_40():
    np.testing.assert_allclose(SQUARE.points_au, GRID, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "target",
    [(0.0, 0.0), (1.0, 1.0), (1.0, 0.37), (0.013, 0.99), (0.5, 0.5), (19 / 39, 7 / 39)],
)
def test_target_area_at_borders_and_within(target):
    points, is_inside = SQUARE.target_area(torch.tensor(target, dtype=torch.float64))
    got = points[is_inside].numpy()
    want = GRID[plain_area(np.array(target))]
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)
    assert len(got) >= 14


def test_target_area_anywhere():
    targets = torch.rand(500, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    _, is_inside = SQUARE.target_area(targets)
    assert is_inside.sum(-1).tolist() == [int(plain_area(t).sum()) for t in targets.numpy()]


def test_area_std_of_one_observation():
    target = np.array([0.31, 0.64])
    posterior = fit(
        torch.tensor([[[*target, 1.0]]], dtype=torch.float64),
        torch.ones(1, 1, dtype=torch.float64),
        torch.ones(1, 1, dtype=torch.bool),
    )
    got = area_std(posterior, torch.as_tensor(target[None]), torch.tensor([2.5]).double(), SQUARE)
    area = GRID[plain_area(target)]
    r = math.sqrt(3) * np.sqrt((((area - target) / 0.1) ** 2).sum(-1) + (1.5 / 3.0) ** 2)
    want = np.sqrt(1.0 - ((1.0 + r) * np.exp(-r)) ** 2).mean()
    assert got.item() == pytest.approx(want, abs=1e-9)


def test_jsd_of_perfect_flat_and_false_beliefs():
    target = torch.tensor([0.4, 0.6], dtype=torch.float64)
    bump = torch.exp(-(SQUARE.points_au - target).square().sum(-1) / 0.02)
    assert jensen_shannon(bump, target, SQUARE).item() == pytest.approx(0.0, abs=1e-12)
    assert jensen_shannon(3.0 * bump, target, SQUARE).item() == pytest.approx(0.0, abs=1e-6)
    flat = torch.zeros_like(bump)
    for mean in (flat, flat - 0.2, bump.roll(300), bump - 0.5):
        want = plain_jsd(mean.numpy(), target.numpy())
        assert jensen_shannon(mean, target, SQUARE).item() == pytest.approx(want, abs=1e-12)
    elsewhere = (SQUARE.points_au == 1.0).all(-1).double()
    assert jensen_shannon(elsewhere, target, SQUARE).item() == pytest.approx(math.log(2), abs=1e-3)


def test_peak_error():
    mean = torch.zeros(3, 1600, dtype=torch.float64)
    mean[0, 0], mean[1, 39] = 0.7, 0.2
    error = peak_error_au(mean, torch.tensor([[0.3, 0.4], [0.0, 0.0], [0.0, 0.0]]).double(), SQUARE)
    assert error[:2].tolist() == pytest.approx([0.5, 1.0])
    assert math.isnan(error[2])


def test_time_since_seen_counts_from_the_start():
    observed = np.array([[0, 1], [0, 0], [1, 0], [0, 0]], dtype=bool)
    got = since_seen_au(np.array([0.0, 0.1, 0.2, 0.3]), observed)
    np.testing.assert_allclose(got, [[0, 0], [0.1, 0.1], [0, 0.2], [0.1, 0.3]], atol=1e-15)


def test_scores_leave_out_the_start():
    metrics = EpisodeMetrics(
        unc=np.array([[0.0, 0.0], [0.5, 0.95], [0.7, 0.7]]),
        jsd=np.array([[9.0, 9.0], [0.1, 0.2], [0.3, 0.4]]),
        peak_error_au=np.array([[9.0, 9.0], [np.nan, 0.1], [np.nan, 0.3]]),
        since_seen_au=np.array([[0.0, 0.0], [0.1, 0.1], [0.2, 0.0]]),
        observed=np.array([[True, True], [True, False], [True, True]]),
    )
    scores = metrics.scores
    assert scores.unc == pytest.approx((0.5 + 0.95 + 0.7 + 0.7) / 4)
    assert scores.unc_std == pytest.approx((0.225 + 0.0) / 2)
    assert scores.lost == pytest.approx(0.25)
    assert scores.min_ob == 1
    assert scores.jsd == pytest.approx(0.25)
    assert scores.since_seen_au == pytest.approx(0.1)
    assert scores.peak_error_au == pytest.approx(0.2)


def episode(num_targets, steps=130, seed=10):
    """An agent that walks about among targets that do too, all crossing the borders' vicinity."""
    rng = np.random.default_rng(seed)
    walks = rng.normal(size=(steps + 1, num_targets + 1, 2)) * 0.06
    places = np.abs((rng.random((num_targets + 1, 2)) + walks.cumsum(0)) % 2.0 - 1.0)
    agent, targets = places[:, 0], places[:, 1:]
    observed = np.linalg.norm(targets - agent[:, None], axis=-1) < 0.1
    told = np.where(observed[..., None], targets, np.nan)
    return 0.1 * np.arange(steps + 1), agent, targets, told


@pytest.mark.parametrize("prior", ["full", "number", "none"])
def test_episode_metrics_equal_plain_code(prior):
    time, agent, targets, told = episode(3)
    observed = ~np.isnan(told[..., 0])
    got = episode_metrics(time, agent, targets, told, prior=prior)
    assert observed[1:].any(axis=0).sum() >= 2, "the case must have targets that are seen"
    kernel = Matern(length_scale=[0.1, 0.1, 3.0], nu=1.5)
    for k in (0, 1, 2, 40, 59, 60, 61, 130):
        for i in range(3):
            points, values = [], []
            if prior == "full" and time[k] < 5.979:
                points.append([*targets[0, i], 0.0])
                values.append(1.0)
            if prior != "none" or observed[1 : k + 1, i].any():
                for j in range(1, k + 1):
                    if time[k] - time[j] < 5.979:
                        place = targets[j, i] if observed[j, i] else agent[j]
                        points.append([*place, time[j]])
                        values.append(float(observed[j, i]))
            at = np.column_stack([GRID, np.full(1600, time[k])])
            mean, std = np.zeros(1600), np.ones(1600)
            if points:
                process = GaussianProcessRegressor(kernel, optimizer=None, alpha=1e-10)
                mean, std = process.fit(points, values).predict(at, return_std=True)
            assert got.unc[k, i] == pytest.approx(std[plain_area(targets[k, i])].mean(), abs=1e-8)
            assert got.jsd[k, i] == pytest.approx(plain_jsd(mean, targets[k, i]), abs=1e-7)
            if mean.max() > 1e-6:
                error = np.linalg.norm(GRID[mean.argmax()] - targets[k, i])
                assert got.peak_error_au[k, i] == pytest.approx(error, abs=1e-12)


def test_episode_metrics_follow_the_targets_order():
    time, agent, targets, told = episode(12, steps=70)
    order = np.random.default_rng(0).permutation(12)
    straight = episode_metrics(time, agent, targets, told)
    turned = episode_metrics(time, agent, targets[:, order], told[:, order])
    np.testing.assert_allclose(turned.unc, straight.unc[:, order], rtol=0, atol=1e-10)
    np.testing.assert_allclose(turned.jsd, straight.jsd[:, order], rtol=0, atol=1e-8)
    alone = episode_metrics(time, agent, targets[:, :1], told[:, :1])
    np.testing.assert_allclose(alone.unc, straight.unc[:, :1], rtol=0, atol=1e-10)


@pytest.mark.parametrize("target_au", [(1.3, 0.5), (-0.1001, 0.0131), (1.08, 1.08), (5.0, -5.0)])
def test_a_target_wholly_outside_is_judged_at_the_nearest_place_of_the_arena(target_au):
    outside = torch.tensor([target_au], dtype=torch.float64)
    belief = Belief(Sightings(np.array([[0.9, 0.5]]))).process
    at = torch.zeros(1, 1, dtype=torch.float64)
    got, nearest = (
        area_std(belief, t[None], at, SQUARE) for t in (outside, outside.clamp(0.0, 1.0))
    )
    assert torch.isfinite(got).all()
    torch.testing.assert_close(got, nearest, rtol=0.0, atol=0.0)


def test_a_target_a_little_outside_is_judged_around_itself():
    points, is_inside = SQUARE.target_area(torch.tensor([1.05, 0.5], dtype=torch.float64))
    assert (points[is_inside] - torch.tensor([1.05, 0.5])).norm(dim=-1).max() < 0.1
    assert points[is_inside][:, 0].max() <= 1.0


def test_what_is_told_falsely_is_believed_and_not_counted():
    time, agent, targets, told = episode(2)
    told[1:, 0] = np.nan
    false = told.copy()
    false[40, 0] = agent[40] + [0.0, 0.05]
    right, wrong = (episode_metrics(time, agent, targets, at) for at in (told, false))
    assert not right.observed[1:, 0].any()
    assert np.linalg.norm(targets[40, 0] - agent[40]) > 0.1, "the alarm must be a false one"
    np.testing.assert_array_equal(wrong.observed, right.observed)
    np.testing.assert_array_equal(wrong.jsd[:40], right.jsd[:40])
    assert wrong.peak_error_au[40, 0] == pytest.approx(
        np.linalg.norm(targets[40, 0] - false[40, 0]), abs=0.03
    )


L_SHAPE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.5], [0.5, 0.5], [0.5, 1.0], [0.0, 1.0]])


def test_of_a_field_only_its_own_points_count():
    grid = evaluation_grid(Arena.polygon(L_SHAPE))
    x, y = grid.points_au.T.numpy()
    assert ((x < 0.5 + 1e-9) | (y < 0.5 + 1e-9)).all()
    assert len(x) == pytest.approx(39**2 * 1.25, rel=0.05)  # as dense as the square's
    corner = torch.tensor([0.5, 0.5], dtype=torch.float64)
    points, is_inside = grid.target_area(corner)
    near = grid.points_au[(grid.points_au - corner).norm(dim=-1) < 0.1]
    np.testing.assert_allclose(sorted(points[is_inside].tolist()), sorted(near.tolist()))
    outside = torch.tensor([1.5, 0.9], dtype=torch.float64)
    points, is_inside = grid.target_area(outside)
    assert points[is_inside][:, 1].max() <= 0.5
    assert 20 < is_inside.sum() < 40


def test_scores_in_a_field_that_is_the_square_are_the_square_s():
    time, agent, targets, told = episode(3)
    square = Arena.polygon(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    got = episode_metrics(time, agent, targets, told, arena=square)
    want = episode_metrics(time, agent, targets, told)
    np.testing.assert_allclose(got.unc, want.unc, atol=1e-12)
    np.testing.assert_allclose(got.jsd, want.jsd, atol=1e-12)
