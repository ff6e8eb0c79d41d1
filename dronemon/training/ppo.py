"""Proximal policy optimisation by the paper's recipe: play, weigh, and improve, top to bottom.

Source: paper, section IV-C; Schulman et al. (2017). Environment and network are batched on one
device; several processes each play and learn from their own episodes and average gradients.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import AfterValidator, Field
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from dronemon.env import Env, Setup
from dronemon.policy import PolicyNetwork, Segment, Verdict
from dronemon.problem import FIRST_TRAINING_SEED, Prior
from dronemon.training.gae import advantages
from dronemon.training.peers import Peers
from dronemon.training.rollout import Rollout, play, sampled

Precision = Literal["auto", "float32", "bfloat16"]
"""What matrix products are computed in while learning; weights and logits are always float32.

`auto` is bfloat16 where the device has instructions for it; elsewhere it takes 1.7 times as long.
"""

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]


def _rising(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError(f"is {list(bounds)}; the lower bound comes first")
    return bounds


Counts = Annotated[tuple[Count, Count], AfterValidator(_rising)]
Speeds = Annotated[tuple[Share, Share], AfterValidator(_rising)]
Priors = Annotated[tuple[Prior, ...], Field(min_length=1)]
"""What may be known at the start; each episode draws one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PpoConfig:
    """The paper's settings. Ranges are inclusive; episodes and iterations count over all processes.

    averaging:           share of the weights' moving average that an update leaves
    curriculum_episodes: over which the greatest target speed rises from 0 to max_speed_ratio
    objective:           `fall` is the paper's reward, `unc` minus the mean of sigma_bar on the leg
    """

    episodes_per_iteration: Count = 32
    decisions: Annotated[int, Field(ge=2)] = 256
    epochs: Count = 4
    minibatch_episodes: Count = 2
    discount: Share = 0.99
    # Differs from STAMP: lambda is 0 in the release and 1 in the paper's text.
    lam: Share = 0.95
    # Differs from STAMP: neither paper nor release does this.
    normalise_advantages: bool = True
    # Differs from STAMP: what is judged and kept is an average, which wavers less; 0 ends that.
    averaging: Share = 0.998
    clip: Positive = 0.2
    value_weight: float = 0.2
    entropy_weight: float = 0.0
    max_gradient: Positive = 5.0
    learning_rate: Positive = 1e-4
    decay: Share = 0.96
    # Differs from STAMP: every 64 episodes, as the paper says, would stop learning after 10 000;
    # the release decays every 64 iterations.
    decay_iterations: Count = 64
    curriculum_episodes: Annotated[int, Field(ge=0)] = 10_000
    max_speed_ratio: Share = 0.1
    num_nodes: Counts = (100, 200)
    history: Counts = (50, 100)
    num_targets: Counts = (2, 5)
    priors: Priors = ("full",)
    objective: Literal["fall", "unc"] = "fall"
    reward_scale: float = 5.0
    decision_cost: float = 0.1
    precision: Precision = "float32"


class Ppo:
    """Reinforcement learning from scratch, or from given weights."""

    def __init__(self, network: PolicyNetwork, config: PpoConfig, peers: Peers, seed: int) -> None:
        self.network = network
        self.average = AveragedModel(network, avg_fn=partial(_averaged, config.averaging))
        self.config = config
        self._peers = peers
        self._seed = seed
        self._num_iterations = 0
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)

    def state(self) -> dict[str, Any]:
        """All that the next iteration depends on, besides the weights."""
        return {
            "iterations": self._num_iterations,
            "optimizer": self._optimizer.state_dict(),
            "average": self.average.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where `state` was taken."""
        self._num_iterations = state["iterations"]
        self._optimizer.load_state_dict(state["optimizer"])
        self.average.load_state_dict(state["average"])

    def iterate(self, progress: float) -> dict[str, float]:
        """Play a batch of episodes, then learn from it. progress: unused, the paper's is fixed."""
        del progress
        config, began = self.config, time.perf_counter()
        for group in self._optimizer.param_groups:
            decays = self._num_iterations // config.decay_iterations
            group["lr"] = config.learning_rate * config.decay**decays
        rollout = self.play()
        played = time.perf_counter()
        metrics = self.learn(rollout)
        self._num_iterations += 1
        metrics["learning_rate"] = self._optimizer.param_groups[0]["lr"]
        return metrics | progress_of([rollout], self._peers, began, played)

    def play(self) -> Rollout:
        """Play the share of the iteration's episodes that falls to this process."""
        config = self.config
        # All randomness follows from seed and iteration, so a resumed run plays the same episodes.
        common = np.random.default_rng([self._seed, self._num_iterations])
        own = torch.Generator(self._peers.device)
        own.manual_seed(int(common.integers(2**48)) * self._peers.size + self._peers.rank)
        first = self._num_iterations * config.episodes_per_iteration
        share = max(1, config.episodes_per_iteration // self._peers.size)
        risen = min(1.0, (first + 1) / (config.curriculum_episodes + 1))
        num_nodes, history, num_targets = (
            int(common.integers(low, high + 1))
            for low, high in (config.num_nodes, config.history, config.num_targets)
        )
        setups = [
            Setup(
                seed=FIRST_TRAINING_SEED + self._seed + first + self._peers.rank * share + i,
                num_targets=num_targets,
                num_nodes=num_nodes,
                speed_ratio=float(common.uniform(0.0, config.max_speed_ratio * risen)),
                prior=config.priors[int(common.integers(len(config.priors)))],
            )
            for i in range(share)
        ]
        return play(
            self.network,
            Env(device=self._peers.device),
            setups,
            history=history,
            num_decisions=config.decisions,
            choose=sampled(own),
        )

    def learn(self, rollout: Rollout) -> dict[str, float]:
        """Several passes over the episodes, a few of them at a time."""
        config, device = self.config, self._peers.device
        gains = rollout_advantages(rollout, config, config.lam)
        returns = gains + rollout.values[:, :-1]
        if config.normalise_advantages:
            gains = (gains - gains.mean()) / (gains.std() + 1e-6)
        old = _log_chance(rollout.logits, rollout.actions)
        order = torch.Generator().manual_seed(self._num_iterations)
        updates: list[dict[str, Tensor]] = []
        batches = max(1, len(gains) // config.minibatch_episodes)
        for _ in range(config.epochs):
            shuffled = torch.randperm(len(gains), generator=order).to(device)
            for episodes in torch.tensor_split(shuffled, batches):
                segment: Segment = rollout.segment.select(episodes)
                with in_precision(config.precision, device):
                    verdict: Verdict = self.network(segment, rollout.history)
                log_chance = _log_chance(verdict.logits, rollout.actions[episodes])
                log_ratio = log_chance - old[episodes]
                ratio, gain = log_ratio.exp(), gains[episodes]
                clipped = ratio.clamp(1.0 - config.clip, 1.0 + config.clip)
                policy_loss = -torch.minimum(ratio * gain, clipped * gain).mean()
                value_loss = (verdict.value - returns[episodes]).square().mean()
                spread = entropy(verdict.logits).mean()
                loss = (
                    policy_loss + config.value_weight * value_loss - config.entropy_weight * spread
                )
                self._optimizer.zero_grad()
                torch.autograd.backward(loss)
                self._peers.average_gradients(self.network)
                gradient = nn.utils.clip_grad_norm_(self.network.parameters(), config.max_gradient)
                self._optimizer.step()
                self.average.update_parameters(self.network)
                numbers = {
                    "policy_loss": policy_loss,
                    "value_loss": value_loss,
                    "entropy": spread,
                    "gradient": gradient,
                    "kl": (ratio - 1.0 - log_ratio).mean(),
                    "clipped": (ratio != clipped).float().mean(),
                }
                updates.append({name: value.detach() for name, value in numbers.items()})
        return mean_over(updates)


def mean_over(updates: Sequence[Mapping[str, Tensor]]) -> dict[str, float]:
    """The mean of each number over updates that all tell it."""
    return {name: float(sum(u[name] for u in updates)) / len(updates) for name in updates[0]}


def progress_of(
    rollouts: Sequence[Rollout], peers: Peers, began_s: float, played_s: float
) -> dict[str, float]:
    """What an iteration played and how long it took, which ends now."""
    learned_s = time.perf_counter()
    count = sum(r.actions.numel() for r in rollouts) * peers.size
    return {
        "unc": float(torch.cat([r.unc for r in rollouts]).mean()),
        "reward": float(torch.cat([r.rewards for r in rollouts]).mean()),
        "decisions": float(count),
        "play_s": played_s - began_s,
        "learn_s": learned_s - played_s,
        "decisions_per_s": count / (learned_s - began_s),
    }


def rollout_advantages(rollout: Rollout, config: PpoConfig, lam: float) -> Tensor:
    """How much better each decision turned out. -> (B, L)."""
    return advantages(scaled_rewards(rollout, config), rollout.values, config.discount, lam)


def scaled_rewards(rollout: Rollout, config: PpoConfig) -> Tensor:
    """What decisions earn, on the scale that the value learns. -> (B, L)."""
    if config.objective == "fall":
        return config.reward_scale * rollout.rewards - config.decision_cost
    # Differs from STAMP: minus what Table I measures, for each leg as long as it took.
    excess = rollout.area_std.nanmean(dim=2) - 0.75
    return -config.reward_scale * excess * rollout.legs_au / 0.1


def in_precision(precision: Precision, device: torch.device) -> torch.autocast:
    """Context in which the network computes its products in a precision."""
    is_narrow = precision == "bfloat16" or (precision == "auto" and _has_bfloat16(device))
    return torch.autocast(device.type, dtype=torch.bfloat16, enabled=is_narrow)


def _has_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    features = torch.cpu.get_capabilities()
    return any(bool(features.get(name)) for name in ("amx_bf16", "avx512_bf16", "bf16"))


def _averaged(most: float, mean: Tensor, weight: Tensor, count: Tensor | int) -> Tensor:
    """Moving average of a weight, over fewer updates while they are few. most: share it keeps."""
    decay = min(most, (1.0 + float(count)) / (10.0 + float(count)))
    return torch.lerp(weight, mean, decay)


def _log_chance(logits: Tensor, actions: Tensor) -> Tensor:
    """Log-probability of actions. logits: (B, L, k); actions: (B, L) -> (B, L)."""
    return logits.log_softmax(-1).gather(2, actions[..., None])[..., 0]


def entropy(logits: Tensor) -> Tensor:
    """Entropy of the policy, in nats. (B, L, k) -> (B, L)."""
    log_chances = logits.log_softmax(-1)
    return -(log_chances.exp() * log_chances.masked_fill(logits.isinf(), 0.0)).sum(-1)
