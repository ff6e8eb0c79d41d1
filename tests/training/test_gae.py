"""The advantage recursion against a loop that sums it up from the definition."""

from __future__ import annotations

import pytest
import torch

from dronemon.training.gae import advantages


def by_definition(
    rewards: list[float], values: list[float], terminated: list[bool], discount: float, lam: float
) -> list[float]:
    result = []
    for start in range(len(rewards)):
        total, weight = 0.0, 1.0
        for i in range(start, len(rewards)):
            following = 0.0 if terminated[i] else discount * values[i + 1]
            total += weight * (rewards[i] + following - values[i])
            weight *= discount * lam
            if terminated[i]:
                break
        result.append(total)
    return result


@pytest.mark.parametrize("lam", [0.0, 0.5, 0.95, 1.0])
def test_advantages_match_their_definition(lam: float) -> None:
    rng = torch.Generator().manual_seed(0)
    rewards = torch.randn(4, 12, generator=rng, dtype=torch.float64)
    values = torch.randn(4, 13, generator=rng, dtype=torch.float64)
    terminated = torch.rand(4, 12, generator=rng) < 0.2
    terminated[3] = False
    terminated[2, -1] = True
    expected = [
        by_definition(r, v, t, 0.9, lam)
        for r, v, t in zip(rewards.tolist(), values.tolist(), terminated.tolist(), strict=True)
    ]
    result = advantages(rewards, values, terminated, 0.9, lam)
    torch.testing.assert_close(result, torch.tensor(expected, dtype=torch.float64))


def test_an_episode_that_ends_at_a_decision_owes_nothing_to_the_next() -> None:
    rewards, values = torch.zeros(1, 3), torch.zeros(1, 4)
    rewards[0, 2] = 100.0
    terminated = torch.tensor([[False, True, False]])
    assert advantages(rewards, values, terminated, 0.9, 0.9).tolist() == [[0.0, 0.0, 100.0]]


def test_a_truncated_episode_counts_the_value_after_it() -> None:
    values = torch.tensor([[0.0, 10.0]])
    going_on = torch.tensor([[False]])
    assert advantages(torch.zeros(1, 1), values, going_on, 0.9, 0.0).item() == pytest.approx(9.0)
    assert advantages(torch.zeros(1, 1), values, ~going_on, 0.9, 0.0).item() == 0.0
