"""What is remembered, for how long, and for whom."""

import numpy as np
import pytest
import torch

from dronemon.belief import Belief, ObservationStore, fit
from dronemon.errors import BeliefError
from dronemon.types import Measurement

WINDOW_AU = 1.993 * 3.0
QUERY = np.column_stack([np.random.default_rng(0).random((50, 2)), np.full(50, 7.0)])


def measurements(count, num_targets, seed=0, spacing_au=0.1):
    rng = np.random.default_rng(seed)
    for k in range(1, count + 1):
        seen = rng.random(num_targets) < 0.2
        yield Measurement(
            time_au=spacing_au * k,
            agent_au=rng.random(2),
            seen=seen,
            target_au=np.where(seen[:, None], rng.random((num_targets, 2)), np.nan),
        )


def add(store, time_au, active=None):
    batch = store._rows.shape[0]
    store.add(
        torch.full((batch,), time_au, dtype=torch.float64),
        torch.zeros(batch, 2, dtype=torch.float64),
        torch.zeros(batch, store.num_targets, dtype=torch.bool),
        torch.full((batch, store.num_targets, 2), torch.nan, dtype=torch.float64),
        active,
    )


def times(store, episode=0):
    points, _, mask = store.window()
    return sorted(points[episode, 0, mask[episode, 0], 2].tolist())


def test_window_keeps_what_is_younger_than_its_edge():
    store = ObservationStore(1, 1, window_au=WINDOW_AU)
    for time_au in (1.0, 1.0 + 1e-9, 2.0, 1.0 + WINDOW_AU):
        add(store, time_au)
    assert times(store) == [1.0 + 1e-9, 2.0, 1.0 + WINDOW_AU]


def test_regular_measuring_fills_the_window_and_never_grows_the_store():
    store = ObservationStore(1, 2, window_au=WINDOW_AU)
    for k in range(1, 500):
        add(store, 0.1 * k)
    assert store.capacity == 60
    np.testing.assert_allclose(times(store), 0.1 * np.arange(440, 500))


def test_irregular_measuring_loses_nothing():
    store = ObservationStore(2, 1, window_au=WINDOW_AU)
    rng = np.random.default_rng(0)
    given = np.cumsum(rng.uniform(0.0, 0.12, size=600)).tolist()
    for time_au in given:
        add(store, time_au)
    assert store.capacity == 120
    assert times(store) == [t for t in given if given[-1] - t < WINDOW_AU]


def test_prior_counts_until_it_is_too_old():
    store = ObservationStore(1, 2, window_au=WINDOW_AU)
    known = torch.tensor([[True, False]])
    store.add_prior(known, torch.full((1, 2, 2), 0.5, dtype=torch.float64))
    assert times(store) == [0.0]
    assert store.window()[2].sum(-1).tolist() == [[1, 0]]
    add(store, 5.9)
    assert times(store) == [0.0, 5.9]
    add(store, 6.0)
    assert times(store) == [5.9, 6.0]


def test_inactive_and_cleared_episodes():
    store = ObservationStore(3, 1, window_au=WINDOW_AU)
    add(store, 0.1)
    add(store, 0.2, active=torch.tensor([True, False, True]))
    store.clear(torch.tensor([False, False, True]))
    assert [times(store, k) for k in range(3)] == [[0.1, 0.2], [0.1], []]


def test_unseen_target_gives_absence_at_the_agent():
    belief = Belief(2)
    belief.add(
        Measurement(
            time_au=0.1,
            agent_au=np.array([0.5, 0.5]),
            seen=np.array([True, False]),
            target_au=np.array([[0.55, 0.5], [np.nan, np.nan]]),
        )
    )
    mean, std = belief.posterior(np.array([[0.55, 0.5, 0.1], [0.5, 0.5, 0.1]]))
    assert mean[0, 0] == pytest.approx(1.0)
    assert mean[1].tolist() == [0.0, 0.0]
    assert std[0, 0] < 1e-4 < std[1, 0]
    assert std[1, 1] < 1e-4 < std[0, 1]


def test_vehicle_belief_equals_the_batch():
    num_targets, batch = 3, 4
    store = ObservationStore(batch, num_targets, window_au=WINDOW_AU)
    beliefs = [Belief(num_targets) for _ in range(batch)]
    prior_au = np.random.default_rng(5).random((batch, num_targets, 2))
    store.add_prior(torch.ones(batch, num_targets, dtype=torch.bool), torch.as_tensor(prior_au))
    for b, belief in enumerate(beliefs):
        for i in range(num_targets):
            belief.add_prior(i, prior_au[b, i])
    told = [list(measurements(70, num_targets, seed=b)) for b in range(batch)]
    for together in zip(*told, strict=True):
        store.add(
            torch.tensor([m.time_au for m in together], dtype=torch.float64),
            torch.as_tensor(np.stack([m.agent_au for m in together])),
            torch.as_tensor(np.stack([m.seen for m in together])),
            torch.as_tensor(np.stack([m.target_au for m in together])),
        )
        for belief, measurement in zip(beliefs, together, strict=True):
            belief.add(measurement)
    mean, std = fit(*store.window()).predict(torch.as_tensor(QUERY))
    for b, belief in enumerate(beliefs):
        got = belief.posterior(QUERY)
        np.testing.assert_allclose(got[0], mean[b], rtol=0, atol=1e-12)
        np.testing.assert_allclose(got[1], std[b], rtol=0, atol=1e-12)


def test_target_that_joins_was_not_seen_before():
    told = list(measurements(80, 1))
    joined, always = Belief(0), Belief(2)
    nothing = np.zeros((0, 2))
    for m in told[:70]:
        joined.add(
            Measurement(
                time_au=m.time_au, agent_au=m.agent_au, seen=np.zeros(0, bool), target_au=nothing
            )
        )
        unseen = Measurement(
            time_au=m.time_au,
            agent_au=m.agent_au,
            seen=np.zeros(2, bool),
            target_au=np.full((2, 2), np.nan),
        )
        always.add(unseen)
    assert joined.posterior(QUERY)[0].shape == (0, len(QUERY))
    assert (joined.add_target(), joined.add_target()) == (0, 1)
    for m in told[70:]:
        both = Measurement(
            time_au=m.time_au,
            agent_au=m.agent_au,
            seen=np.repeat(m.seen, 2),
            target_au=np.repeat(m.target_au, 2, axis=0),
        )
        joined.add(both)
        always.add(both)
    for got, want in zip(joined.posterior(QUERY), always.posterior(QUERY), strict=True):
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)


def test_belief_refuses_what_it_cannot_take():
    belief = Belief(2)
    first, second = measurements(2, 2)
    belief.add(second)
    with pytest.raises(BeliefError, match="in the order of their time"):
        belief.add(first)
    with pytest.raises(BeliefError, match="add_target"):
        belief.add(next(measurements(1, 3)))
    for agent, target in ((np.nan, 0.5), (0.5, np.nan)):
        with pytest.raises(BeliefError, match="not finite"):
            belief.add(
                Measurement(
                    time_au=0.3,
                    agent_au=np.array([0.5, agent]),
                    seen=np.array([True, False]),
                    target_au=np.array([[target, 0.5], [np.nan, np.nan]]),
                )
            )
