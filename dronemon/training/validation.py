"""How well a network monitors when it flies as it would: greedily, on development seeds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice, product

import torch

from dronemon.env import Env, Setup
from dronemon.policy import PolicyNetwork
from dronemon.problem import DEFAULT_HISTORY, FIRST_DEVELOPMENT_SEED, Prior
from dronemon.training.rollout import greedy, play

CELLS = tuple(product((1 / 20, 1 / 10, 1 / 30, 1 / 7), (4, 2, 6, 8)))
"""Speed ratios and numbers of targets of the paper's Table I."""


def validate(
    network: PolicyNetwork,
    *,
    episodes: int,
    decisions: int,
    device: torch.device,
    priors: Sequence[Prior],
) -> dict[str, float]:
    """Mean scores over episodes that go round the cells of Table I, and round what is known.

    -> `val_unc`, the mean of sigma_bar over targets and the way flown; `val_reward`, the paper's
    reward per decision; `val_lost`, the share of targets with sigma_bar > 0.9.
    """
    cells = islice((cell for _ in range(episodes) for cell in CELLS), episodes)
    setups = [
        Setup(
            seed=FIRST_DEVELOPMENT_SEED + index,
            num_targets=num_targets,
            speed_ratio=speed_ratio,
            prior=priors[(index + index // len(CELLS)) % len(priors)],
        )
        for index, (speed_ratio, num_targets) in enumerate(cells)
    ]
    rollout = play(
        network,
        Env(device=device),
        setups,
        history=DEFAULT_HISTORY,
        num_decisions=decisions,
        choose=greedy,
    )
    is_lost = torch.where(rollout.area_std.isnan(), rollout.area_std, rollout.area_std > 0.9)
    return {
        "val_unc": float(rollout.unc.mean()),
        "val_reward": float(rollout.rewards.mean()),
        "val_lost": float(is_lost.nanmean()),
    }
