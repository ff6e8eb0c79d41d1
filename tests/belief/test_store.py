"""What is remembered, for how long, and for whom."""

import numpy as np
import pytest
import torch

from dronemon.belief import Belief, ObservationStore, fit
from dronemon.sightings import Sightings
from dronemon.types import Measurement

WINDOW_AU = 1.993 * 3.0
QUERY = np.column_stack([np.random.default_rng(0).random((50, 2)), np.full(50, 7.0)])


def measurements(count, num_targets, seed=0):
    rng = np.random.default_rng(seed)
    for k in range(1, count + 1):
        seen = rng.random(num_targets) < 0.2
        yield Measurement(
            time_au=0.1 * k,
            agent_au=rng.random(2),
            seen=seen,
            target_au=np.where(seen[:, None], rng.random((num_targets, 2)), np.nan),
        )


def add(store, time_au, active=(True,)):
    batch, num_targets = store.window()[1].shape[:2]
    store.add(
        torch.full((batch,), time_au, dtype=torch.float64),
        torch.zeros(batch, 2, dtype=torch.float64),
        torch.zeros(batch, num_targets, dtype=torch.bool),
        torch.full((batch, num_targets, 2), torch.nan, dtype=torch.float64),
        torch.tensor(active).expand(batch),
    )


def times(store, episode=0):
    points, _, mask = store.window()
    return sorted(points[episode, 0, mask[episode, 0], 2].tolist())


def test_window_keeps_what_is_younger_than_its_edge():
    store = ObservationStore(1, 1)
    for time_au in (1.0, 1.0 + 1e-9, 2.0, 1.0 + WINDOW_AU):
        add(store, time_au)
    assert times(store) == [1.0 + 1e-9, 2.0, 1.0 + WINDOW_AU]


def test_regular_measuring_fills_the_window():
    store = ObservationStore(1, 2)
    for k in range(1, 500):
        add(store, 0.1 * k)
    np.testing.assert_allclose(times(store), 0.1 * np.arange(440, 500))


def test_prior_counts_until_it_is_too_old():
    store = ObservationStore(1, 2)
    known = torch.tensor([[True, False]])
    store.add_prior(known, torch.full((1, 2, 2), 0.5, dtype=torch.float64))
    assert times(store) == [0.0]
    assert store.window()[2].sum(-1).tolist() == [[1, 0]]
    add(store, 5.9)
    assert times(store) == [0.0, 5.9]
    add(store, 6.0)
    assert times(store) == [5.9, 6.0]


def test_inactive_episodes_are_left_alone():
    store = ObservationStore(2, 1)
    add(store, 0.1)
    add(store, 0.2, active=[True, False])
    assert [times(store, k) for k in range(2)] == [[0.1, 0.2], [0.1]]


def test_unseen_target_gives_absence_at_the_agent():
    sightings = Sightings(np.full((2, 2), np.nan))
    sightings.add(
        Measurement(
            time_au=0.1,
            agent_au=np.array([0.5, 0.5]),
            seen=np.array([True, False]),
            target_au=np.array([[0.55, 0.5], [np.nan, np.nan]]),
        )
    )
    mean, std = Belief(sightings).posterior(np.array([[0.55, 0.5, 0.1], [0.5, 0.5, 0.1]]))
    assert mean[0, 0] == pytest.approx(1.0)
    assert mean[1].tolist() == [0.0, 0.0]
    assert std[0, 0] < 1e-4 < std[1, 0]
    assert std[1, 1] < 1e-4 < std[0, 1]


def test_the_fit_is_kept_until_the_log_grows():
    sightings = Sightings(np.full((1, 2), 0.5))
    belief = Belief(sightings)
    first = belief.process
    assert belief.process is first
    sightings.add(next(measurements(1, 1)))
    assert belief.process is not first


def sorted_window(points, values, mask):
    """Observations of each target that count, in the order of their time."""
    rows = [np.column_stack([p[m], v[m]]) for p, v, m in zip(points, values, mask, strict=True)]
    return [row[np.argsort(row[:, 2], kind="stable")] for row in rows]


def test_window_of_the_batch_is_that_of_the_log():
    num_targets, batch = 3, 4
    rng = np.random.default_rng(5)
    store = ObservationStore(batch, num_targets)
    is_known = torch.as_tensor(rng.random((batch, num_targets)) < 0.5)
    prior_au = rng.random((batch, num_targets, 2))
    store.add_prior(is_known, torch.as_tensor(prior_au))
    logs = [Sightings(np.where(is_known[b, :, None], prior_au[b], np.nan)) for b in range(batch)]
    told = [list(measurements(90, num_targets, b)) for b in range(batch)]
    for together in zip(*told, strict=True):
        store.add(
            torch.tensor([m.time_au for m in together], dtype=torch.float64),
            torch.as_tensor(np.stack([m.agent_au for m in together])),
            torch.as_tensor(np.stack([m.seen for m in together])),
            torch.as_tensor(np.stack([m.target_au for m in together])),
            torch.ones(batch, dtype=torch.bool),
        )
        for log, measurement in zip(logs, together, strict=True):
            log.add(measurement)
        batched = [tensor.numpy() for tensor in store.window()]
        for b, log in enumerate(logs):
            got = sorted_window(*log.window(WINDOW_AU))
            for ours, theirs in zip(got, sorted_window(*(a[b] for a in batched)), strict=True):
                np.testing.assert_array_equal(ours, theirs)
    mean, std = fit(*store.window()).predict(torch.as_tensor(QUERY))
    for b, log in enumerate(logs):
        got = Belief(log).posterior(QUERY)
        np.testing.assert_allclose(got[0], mean[b], rtol=0, atol=1e-12)
        np.testing.assert_allclose(got[1], std[b], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(Belief(log).mean(QUERY), got[0])
