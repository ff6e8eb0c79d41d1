"""PPO makes decisions that paid likelier, and its numbers mean what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from dronemon.env import Env, Setup
from dronemon.policy import NetworkConfig, PolicyNetwork
from dronemon.problem import FIRST_DEVELOPMENT_SEED, Prior
from dronemon.training import ppo as ppo_module
from dronemon.training.gae import advantages
from dronemon.training.peers import Peers
from dronemon.training.ppo import Ppo, PpoConfig, entropy, scaled_rewards
from dronemon.training.recipe import load_recipe
from dronemon.training.rollout import greedy, play

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


@pytest.mark.lengthy
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


def test_without_averaging_the_last_weights_are_kept() -> None:
    ppo = make_ppo(replace(CONFIG, averaging=0.0, epochs=1))
    ppo.learn(ppo.play())
    kept = ppo.average.module.state_dict()
    assert all(torch.equal(kept[name], w) for name, w in ppo.network.state_dict().items())


@pytest.mark.lengthy
def test_advantages_are_normalised_unless_told_otherwise() -> None:
    def gradient(scale: float, *, is_normalised: bool) -> float:
        config = replace(CONFIG, normalise_advantages=is_normalised, reward_scale=scale, epochs=1)
        ppo = make_ppo(replace(config, minibatch_episodes=4, discount=0.0, value_weight=0.0))
        return ppo.learn(ppo.play())["gradient"]

    assert gradient(1e4, is_normalised=False) > 50.0 * gradient(1e2, is_normalised=False)
    few, many = (gradient(scale, is_normalised=True) for scale in (1e2, 1e4))
    assert many == pytest.approx(few, rel=0.1)


def test_the_curriculum_raises_the_targets_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    setups: list[Setup] = []
    monkeypatch.setattr(ppo_module, "play", lambda *args, **_: setups.extend(args[2]))
    ppo = make_ppo(replace(CONFIG, curriculum_episodes=4000, max_speed_ratio=0.1))
    for ppo._num_iterations in range(1200):
        ppo.play()
    speeds = np.array([setup.speed_ratio for setup in setups])
    episodes = np.arange(len(speeds)) // 4 * 4
    shares = speeds / (0.1 * np.minimum(1.0, (episodes + 1) / 4001))
    assert speeds[:40].max() < 0.001
    assert shares.max() <= 1.0
    early, late = shares[:4000], shares[4000:]
    assert early.mean() == pytest.approx(0.5, abs=0.03)  # uniform up to what the curriculum allows
    assert late.mean() == pytest.approx(0.5, abs=0.05)


def test_episodes_draw_what_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    setups: list[Setup] = []
    monkeypatch.setattr(ppo_module, "play", lambda *args, **_: setups.extend(args[2]))
    priors: tuple[Prior, ...] = ("full", "number", "none")
    ppo = make_ppo(replace(CONFIG, priors=priors))
    for ppo._num_iterations in range(60):
        ppo.play()
    drawn = [setup.prior for setup in setups]
    assert all(drawn.count(prior) > len(drawn) / 5 for prior in priors)


@pytest.mark.parametrize("lam", [0.0, 0.5, 1.0])
def test_the_value_learns_what_was_earned_as_far_ahead_as_lambda_says(lam: float) -> None:
    config = replace(CONFIG, lam=lam, epochs=1, minibatch_episodes=4)
    ppo = make_ppo(config)
    rollout = ppo.play()
    off = advantages(scaled_rewards(rollout, config), rollout.values, config.discount, lam)
    told = ppo.learn(rollout)["value_loss"]  # before the first update: of the values that played
    assert told == pytest.approx(float(off.square().mean()), rel=1e-3)


def test_entropy_is_raised_by_its_weight() -> None:
    after = []
    for weight in (3.0, -3.0):
        ppo = make_ppo(replace(CONFIG, entropy_weight=weight, value_weight=0.0))
        after.append(ppo.learn(ppo.play())["entropy"])
    assert after[0] > after[1] + 0.05


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_papers_recipe_learns_from_scratch() -> None:
    """In a small world, where its targets are as fast as they get from the beginning on."""
    world = replace(load_recipe("paper").settings, num_nodes=(30, 40), history=(8, 12))
    config = replace(world, curriculum_episodes=0, decisions=64, learning_rate=1e-3)
    assert isinstance(config, PpoConfig)
    ppo = make_ppo(config)
    unc = [flown_unc(ppo.network)]
    for _ in range(20):
        ppo.iterate(0.0)
    unc.append(flown_unc(ppo.average.module))
    gain = unc[0] - unc[1]
    assert gain.mean() > 4.0 * gain.std() / len(gain) ** 0.5


def flown_unc(network: nn.Module) -> np.ndarray:
    """Of development episodes in that world."""
    assert isinstance(network, PolicyNetwork)
    seeds = range(FIRST_DEVELOPMENT_SEED, FIRST_DEVELOPMENT_SEED + 48)
    setups = [Setup(seed=seed, num_targets=3, num_nodes=35) for seed in seeds]
    rollout = play(network, Env(), setups, history=10, num_decisions=64, choose=greedy)
    return rollout.unc.numpy()


@pytest.mark.lengthy
def test_the_learning_rate_decays() -> None:
    config = replace(CONFIG, decisions=4, epochs=1, decay_iterations=2, decay=0.5)
    ppo = make_ppo(config)
    rates = [ppo.iterate(0.0)["learning_rate"] for _ in range(5)]
    assert rates == pytest.approx([3e-3, 3e-3, 1.5e-3, 1.5e-3, 7.5e-4])
    assert ppo._optimizer.param_groups[0]["lr"] == rates[-1]


@pytest.mark.lengthy
def test_a_policy_goes_no_further_than_it_may_in_one_iteration() -> None:
    def divergence(clip: float) -> float:
        ppo = make_ppo(replace(CONFIG, epochs=40, value_weight=0.0, clip=clip))
        return ppo.learn(ppo.play())["kl"]

    assert divergence(0.05) < 0.3 * divergence(1e9)


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
