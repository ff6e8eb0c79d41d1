"""Generalised advantage estimation.

Source: Schulman et al. (2016), equations 11 and 16; the paper's section IV-C with lambda = 1.
"""

from __future__ import annotations

import torch
from torch import Tensor


def advantages(rewards: Tensor, values: Tensor, discount: float, lam: float) -> Tensor:
    """How much better each decision of episodes that go on turned out than the value before it.

    rewards: (B, L)
    values:  (B, L + 1) the last one after the last decision
    -> (B, L)
    """
    errors = rewards + discount * values[:, 1:] - values[:, :-1]
    result = torch.empty_like(errors)
    following = torch.zeros_like(errors[:, 0])
    for step in range(errors.shape[1] - 1, -1, -1):
        following = errors[:, step] + discount * lam * following
        result[:, step] = following
    return result
