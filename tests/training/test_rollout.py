"""Rollouts hold what happened, and the training pass sees what the player saw."""

from __future__ import annotations

import torch

from dronemon.env import Env, Setup
from dronemon.policy import NetworkConfig, PolicyNetwork
from dronemon.training.rollout import Rollout, greedy, play, sampled

SETUPS = [
    Setup(seed=10_000, num_targets=2, num_nodes=25, speed_ratio=0.1),
    Setup(seed=10_001, num_targets=3, num_nodes=30, speed_ratio=0.05),
    Setup(seed=10_002, num_targets=3, num_nodes=30, speed_ratio=0.05, prior="number"),
    Setup(seed=10_003, num_targets=3, num_nodes=30, speed_ratio=0.05, prior="none"),
]


def make_rollout(network: PolicyNetwork, seed: int, num_decisions: int = 20) -> Rollout:
    return play(
        network,
        Env(),
        SETUPS,
        history=8,
        num_decisions=num_decisions,
        choose=sampled(torch.Generator().manual_seed(seed)),
    )


def make_network() -> PolicyNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return PolicyNetwork(
            NetworkConfig(
                width=16, feed_forward=24, newest=True, ways=True, geometry=True, tracks=True
            )
        )


def test_a_training_pass_repeats_the_players_verdicts() -> None:
    network = make_network()
    rollout = make_rollout(network, 0)
    with torch.no_grad():
        verdict = network(rollout.segment, rollout.history)
    torch.testing.assert_close(verdict.logits, rollout.logits, rtol=0.0, atol=1e-5)
    torch.testing.assert_close(verdict.value, rollout.values[:, :-1], rtol=0.0, atol=1e-5)


def test_chosen_neighbours_are_the_nodes_that_follow() -> None:
    rollout = make_rollout(make_network(), 1)
    segment = rollout.segment
    episodes = torch.arange(len(SETUPS))[:, None]
    reached = segment.graphs.neighbours[episodes, segment.nodes, rollout.actions]
    assert torch.equal(reached[:, :-1], segment.nodes[:, 1:])
    assert bool(segment.graphs.neighbour_mask[episodes, segment.nodes, rollout.actions].all())


def test_unc_is_a_mean_over_targets_that_exist() -> None:
    rollout = make_rollout(make_network(), 2)
    assert bool(rollout.area_std[0, :, 2].isnan().all())
    assert bool(((rollout.unc > 0.0) & (rollout.unc < 1.0)).all())


def test_one_seed_is_one_rollout() -> None:
    network = make_network()
    first, second, other = (make_rollout(network, seed, 12) for seed in (0, 0, 1))
    assert torch.equal(first.actions, second.actions)
    assert not torch.equal(first.actions, other.actions)


def test_greedy_takes_the_greatest_logit() -> None:
    network = make_network()
    rollout = play(network, Env(), SETUPS, history=8, num_decisions=6, choose=greedy)
    assert torch.equal(rollout.actions, rollout.logits.argmax(-1))
