"""The batched Gaussian process against scikit-learn and against itself."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from dronemon.belief import Matern32, fit, gp
from dronemon.errors import BeliefError

BATCH, NUM_OBSERVATIONS, NUM_QUERY = 3, 60, 150


def observations(num_targets, seed=0, batch=BATCH, num_observations=NUM_OBSERVATIONS):
    """Observations as one agent makes them: what is not seen lies where the agent was."""
    rng = np.random.default_rng(seed)
    time = np.broadcast_to(
        0.1 * np.arange(num_observations)[:, None], (batch, num_targets, num_observations, 1)
    )
    agent = rng.random((batch, 1, num_observations, 2))
    seen = rng.random((batch, num_targets, num_observations)) < 0.2
    place = np.where(seen[..., None], rng.random((batch, num_targets, num_observations, 2)), agent)
    return (
        torch.as_tensor(np.concatenate([place, time], axis=-1)),
        torch.as_tensor(seen, dtype=torch.float64),
        torch.as_tensor(rng.random(seen.shape) < 0.9),
    )


def query(*shape, seed=1, num_query=NUM_QUERY):
    points = np.random.default_rng(seed).random((*shape, num_query, 3))
    points[..., 2] = 6.0 + 2.0 * (np.arange(num_query) % 2)
    return torch.as_tensor(points)


def sklearn_posterior(points, values, at):
    kernel = Matern(length_scale=[0.1, 0.1, 3.0], nu=1.5)
    regressor = GaussianProcessRegressor(kernel, optimizer=None, alpha=1e-10)
    return regressor.fit(points.numpy(), values.numpy()).predict(at.numpy(), return_std=True)


@pytest.mark.lengthy
@pytest.mark.parametrize("num_targets", [1, 4, 12])
def test_posterior_equals_scikit_learn(num_targets):
    points, values, mask = observations(num_targets)
    at = query(BATCH, 1)
    mean, std = fit(points, values, mask).predict(at)
    for b in range(BATCH):
        for i in range(num_targets):
            keep = mask[b, i]
            expected = sklearn_posterior(points[b, i, keep], values[b, i, keep], at[b, 0])
            np.testing.assert_allclose(mean[b, i], expected[0], rtol=0, atol=1e-8)
            np.testing.assert_allclose(std[b, i], expected[1], rtol=0, atol=1e-8)


def test_posterior_equals_direct_solution():
    points, values, _ = observations(2, batch=1)
    at = query(1, 2)
    mean, std = fit(points, values, torch.ones_like(values, dtype=torch.bool)).predict(at)
    kernel = Matern32()
    covariance, cross = kernel(points, points), kernel(points, at)
    solved = torch.linalg.solve(covariance, torch.cat([values[..., None], cross], dim=-1))
    torch.testing.assert_close(mean, (cross.mT @ solved[..., :1])[..., 0], rtol=0, atol=1e-8)
    variance = 1.0 - (cross * solved[..., 1:]).sum(-2)
    torch.testing.assert_close(std.square(), variance, rtol=0, atol=1e-8)


@pytest.mark.parametrize("num_targets", [1, 4, 12])
@pytest.mark.parametrize(("num_observations", "num_query"), [(1, 1), (6, 7), (61, 1100)])
@pytest.mark.parametrize("num_sets", [1, "one for each target"])
def test_compiled_equals_batched(monkeypatch, num_targets, num_observations, num_query, num_sets):
    points, values, mask = observations(num_targets, num_observations=num_observations)
    mask[0, -1] = False  # a target that is not believed in
    points = torch.where(mask[..., None], points, torch.nan)
    at = query(BATCH, 1 if num_sets == 1 else num_targets, num_query=num_query)
    compiled = fit(points, values, mask)
    monkeypatch.setattr(gp, "is_compiled", lambda _: False)
    batched = fit(points, values, mask)
    assert type(compiled.groups[0]) is not type(batched.groups[0])
    expected = batched.predict(at)
    torch.testing.assert_close(compiled.predict(at), expected, rtol=0, atol=1e-12)
    torch.testing.assert_close(compiled.mean(at), expected[0], rtol=0, atol=1e-12)
    torch.testing.assert_close(compiled.std(at), expected[1], rtol=0, atol=1e-12)


def test_common_query_equals_one_for_each_target():
    points, values, mask = observations(4)
    posterior, at = fit(points, values, mask), query(BATCH, 1)
    expected = posterior.predict(at.expand(BATCH, 4, NUM_QUERY, 3).contiguous())
    torch.testing.assert_close(posterior.predict(at), expected, rtol=0, atol=1e-13)
    torch.testing.assert_close(posterior.mean(at), expected[0], rtol=0, atol=1e-12)
    torch.testing.assert_close(posterior.std(at), expected[1], rtol=0, atol=1e-13)
    first = posterior.predict(at[0, 0])
    torch.testing.assert_close(first[1][0], expected[1][0], rtol=0, atol=1e-13)


def test_padding_changes_nothing():
    points, values, _ = observations(3)
    everything = torch.ones_like(values, dtype=torch.bool)
    expected = fit(points, values, everything).predict(query(BATCH, 1))
    pad = torch.nn.functional.pad
    padded = fit(
        pad(points, (0, 0, 4, 9), value=torch.nan), pad(values, (4, 9)), pad(everything, (4, 9))
    )
    torch.testing.assert_close(padded.predict(query(BATCH, 1)), expected, rtol=0, atol=1e-12)


def test_order_of_targets_does_not_matter():
    points, values, mask = observations(12)
    order = torch.randperm(12, generator=torch.Generator().manual_seed(0))
    expected = fit(points, values, mask).predict(query(BATCH, 1))
    permuted = fit(points[:, order], values[:, order], mask[:, order]).predict(query(BATCH, 1))
    for got, want in zip(permuted, expected, strict=True):
        torch.testing.assert_close(got, want[:, order], rtol=0, atol=1e-12)


def test_threads_and_groups_change_nothing():
    points, values, mask = observations(4, batch=21)
    alone = [fit(points[b], values[b], mask[b]).predict(query(21, 1)[b]) for b in range(21)]
    for num_threads in (1, 2):
        together = fit(points, values, mask, num_threads=num_threads).predict(query(21, 1))
        for k in range(2):
            expected = torch.stack([a[k] for a in alone])
            torch.testing.assert_close(together[k], expected, rtol=0, atol=1e-12)


def test_target_not_believed_in_is_the_prior_and_leaves_others_alone():
    points, values, mask = observations(4)
    expected = fit(points[:, 1:], values[:, 1:], mask[:, 1:]).predict(query(BATCH, 1))
    mask[:, 0] = False
    mean, std = fit(points, values, mask).predict(query(BATCH, 1))
    assert (mean[:, 0] == 0.0).all()
    assert (std[:, 0] == 1.0).all()
    torch.testing.assert_close((mean[:, 1:], std[:, 1:]), expected, rtol=0, atol=1e-12)


def test_without_observations_belief_is_the_prior():
    points, values, mask = observations(2)
    mean, std = fit(points, values, torch.zeros_like(mask)).predict(query(BATCH, 1))
    assert (mean == 0.0).all()
    assert (std == 1.0).all()


def test_observation_is_believed():
    points = torch.tensor([[[0.3, 0.4, 1.0]]], dtype=torch.float64)
    posterior = fit(points, points.new_ones(1, 1), torch.ones(1, 1, dtype=torch.bool))
    mean, std = posterior.predict(points)
    torch.testing.assert_close(mean, torch.ones_like(mean), rtol=0, atol=1e-9)
    assert std.item() < 1e-4


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-6), (torch.float32, 2e-2)])
def test_one_place_observed_for_a_whole_window_can_be_fitted(dtype, tolerance):
    points = torch.full((1, 1, 60, 3), 0.5, dtype=dtype)
    points[..., 2] = 0.1 * torch.arange(60)
    values = torch.ones(1, 1, 60, dtype=dtype)
    mean, _ = fit(points, values, values.bool()).predict(points)
    torch.testing.assert_close(mean, values, rtol=0, atol=tolerance)


def test_single_precision_is_near_double_precision():
    points, values, mask = observations(4)
    expected = fit(points, values, mask).predict(query(BATCH, 1))
    single = fit(points.float(), values.float(), mask).predict(query(BATCH, 1).float())
    assert single[0].dtype == torch.float32
    for got, want in zip(single, expected, strict=True):
        torch.testing.assert_close(got.double(), want, rtol=0, atol=2e-3)


@pytest.mark.parametrize("fault", [torch.nan, torch.inf])
@pytest.mark.parametrize(("target", "count"), [(1, 1), (slice(None), 2)])
def test_observation_that_is_not_finite_is_an_error(fault, target, count):
    points, values, mask = observations(2)
    points[1, target, 7, 0] = fault
    with pytest.raises(BeliefError, match=f"{count} of 6 .* not positive definite"):
        fit(points, values, torch.ones_like(mask))


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    kept=st.integers(0, 29),
    more=st.integers(1, 30),
)
def test_more_data_never_raises_std(seed, kept, more):
    points, values, _ = observations(2, seed=seed, batch=1, num_observations=30)
    number = torch.arange(30).expand_as(values)
    fewer = fit(points, values, number < kept).std(query(1, 1, seed=seed))
    assert (
        fit(points, values, number < kept + more).std(query(1, 1, seed=seed)) <= fewer + 1e-9
    ).all()
