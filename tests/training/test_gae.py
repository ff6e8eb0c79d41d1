"""The advantage recursion against a loop that sums it up from the definition."""

from __future__ import annotations

import pytest
import torch

from dronemon.training.gae import advantages


def by_definition(
    rewards: list[float], values: list[float], discount: float, lam: float
) -> list[float]:
    result = []
    for start in range(len(rewards)):
        total, weight = 0.0, 1.0
        for i in range(start, len(rewards)):
            total += weight * (rewards[i] + discount * values[i + 1] - values[i])
            weight *= discount * lam
        result.append(total)
    return result


@pytest.mark.parametrize("lam", [0.0, 0.5, 0.95, 1.0])
def test_advantages_match_their_definition(lam: float) -> None:
    rng = torch.Generator().manual_seed(0)
    rewards = torch.randn(4, 12, generator=rng, dtype=torch.float64)
    values = torch.randn(4, 13, generator=rng, dtype=torch.float64)
    expected = [
        by_definition(r, v, 0.9, lam)
        for r, v in zip(rewards.tolist(), values.tolist(), strict=True)
    ]
    result = advantages(rewards, values, 0.9, lam)
    torch.testing.assert_close(result, torch.tensor(expected, dtype=torch.float64))


def test_the_value_after_the_last_decision_counts() -> None:
    values = torch.tensor([[0.0, 10.0]])
    assert advantages(torch.zeros(1, 1), values, 0.9, 0.0).item() == pytest.approx(9.0)
