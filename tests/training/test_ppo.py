"""PPO makes decisions that paid likelier, and its numbers mean what they say."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from dronemon.policy import NetworkConfig, PolicyNetwork
from dronemon.training.peers import Peers
from dronemon.training.ppo import Ppo, PpoConfig, entropy, scaled_rewards

CONFIG = PpoConfig(
    episodes_per_iteration=4,
    decisions=24,
    learning_rate=3e-3,
    decision_cost=0.0,
    discount=0.5,
    num_nodes=(20, 25),
    history=(8, 12),
)


def make_ppo(config: PpoConfig = CONFIG) -> Ppo:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PolicyNetwork(NetworkConfig(width=16, num_heads=2, feed_forward=32))
    return Ppo(network, config, Peers(device=torch.device("cpu")), 0)


@pytest.mark.slow
def test_what_pays_becomes_likelier() -> None:
    ppo = make_ppo()
    shares = []
    for _ in range(7):
        rollout = ppo.play()
        segment = rollout.segment
        reached = torch.cat([segment.nodes[:, 1:], segment.nodes[:, -1:]], dim=1)
        paid = (segment.graphs.coordinates[..., 0].gather(1, reached) < 0.5).float()
        shares.append(float(paid.mean()))
        ppo.learn(replace(rollout, rewards=paid))
    assert 1.0 - min(shares[-2:]) < 0.6 * (1.0 - shares[0])


def test_the_first_pass_is_still_the_policy_that_played() -> None:
    ppo = make_ppo(replace(CONFIG, epochs=1, minibatch_episodes=4))
    metrics = ppo.learn(ppo.play())
    assert metrics["kl"] == pytest.approx(0.0, abs=1e-6)
    assert metrics["clipped"] == 0.0


def test_the_average_follows_the_weights_and_comes_back() -> None:
    ppo = make_ppo(replace(CONFIG, epochs=1, minibatch_episodes=1))
    rollout = ppo.play()
    values = []
    for _ in range(3):
        ppo.learn(rollout)
        values.append(ppo.network.decoder.value.weight.detach().clone())
    mean = ppo.average.module.decoder.value.weight.detach()
    assert float((mean - values[2]).abs().max()) > 0.0
    assert float((mean - values[2]).norm()) < float((mean - values[0]).norm())
    again = make_ppo()
    again.restore(ppo.state())
    assert torch.equal(again.average.module.decoder.value.weight, mean)


def test_the_curriculum_raises_the_targets_speed() -> None:
    still = make_ppo(replace(CONFIG, curriculum_episodes=10**9)).play()
    moving = make_ppo(replace(CONFIG, curriculum_episodes=0)).play()
    assert float(still.rewards.sum()) != float(moving.rewards.sum())


def test_rewards_of_both_objectives() -> None:
    rollout = make_ppo().play()
    fall = scaled_rewards(rollout, replace(CONFIG, decision_cost=0.1))
    torch.testing.assert_close(fall, 5.0 * rollout.rewards - 0.1)
    unc = scaled_rewards(rollout, replace(CONFIG, objective="unc"))
    flown_au = rollout.legs_au.sum(1)
    expected = -5.0 * (rollout.unc - 0.75) * flown_au / 0.1
    torch.testing.assert_close(unc.sum(1), expected, rtol=1e-4, atol=1e-4)


def test_entropy_ignores_neighbours_that_do_not_exist() -> None:
    logits = torch.tensor([[[0.0, 0.0, -torch.inf]]])
    assert float(entropy(logits)) == pytest.approx(0.6931, abs=1e-4)
