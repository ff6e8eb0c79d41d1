"""Generalised advantage estimation.

Source: Schulman et al. (2016), equations 11 and 16; the paper's section IV-C with lambda = 1.
"""

from __future__ import annotations

import torch
from torch import Tensor


def advantages(
    rewards: Tensor, values: Tensor, terminated: Tensor, discount: float, lam: float
) -> Tensor:
    """How much better each decision turned out than the value before it.

    rewards:    (B, L)
    values:     (B, L + 1)  the last, after the last decision, counts unless that one terminated
    terminated: (B, L) bool true where a decision ended its episode and the next begins a new one
    -> (B, L)
    """
    # Differs from STAMP: what ends at decision i cuts the recursion at i; the release looks at i+1.
    goes_on = (~terminated).to(values.dtype)
    errors = rewards + discount * values[:, 1:] * goes_on - values[:, :-1]
    result = torch.empty_like(errors)
    following = torch.zeros_like(errors[:, 0])
    for step in range(errors.shape[1] - 1, -1, -1):
        following = errors[:, step] + discount * lam * goes_on[:, step] * following
        result[:, step] = following
    return result
