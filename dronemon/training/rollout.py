"""Episodes played by a network in the vectorised environment, ready for a training pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dronemon.env import Env, Observation, Setup
from dronemon.policy import History, PolicyNetwork, Segment, Verdict
from dronemon.problem import WINDOW_AU

Chooser = Callable[[Verdict, Observation], Tensor]
"""Picks neighbours: the network's verdict and what is observed -> (B,) columns of `neighbours`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """B episodes of L decisions each, from their start.

    history:  T, the frames each decision saw
    segment:  what the network saw
    actions:  (B, L)     column of the neighbour chosen
    logits:   (B, L, k)  when it was
    values:   (B, L + 1) the last one after the last decision
    rewards:  (B, L)     as the environment gives them
    area_std: (B, L, N)  around each target after each decision, NaN where there is none
    legs_au:  (B, L)     length of each leg
    """

    history: int
    segment: Segment
    actions: Tensor
    logits: Tensor
    values: Tensor
    rewards: Tensor
    area_std: Tensor
    legs_au: Tensor

    @property
    def unc(self) -> Tensor:
        """(B,) mean of sigma_bar over targets and the way flown."""
        return (self.area_std.nanmean(dim=2) * self.legs_au).sum(1) / self.legs_au.sum(1)


def play(
    network: PolicyNetwork,
    env: Env,
    setups: Sequence[Setup],
    *,
    history: int,
    num_decisions: int,
    choose: Chooser,
) -> Rollout:
    """Play the first decisions of one episode per setup."""
    seen = [env.reset(setups)]
    memory = History(network, env.graphs, history)
    verdicts = [_judge(memory, seen[0])]
    actions, steps = [], []
    for _ in range(num_decisions):
        actions.append(choose(verdicts[-1], seen[-1]))
        steps.append(env.step(seen[-1].neighbours.gather(1, actions[-1][:, None])[:, 0]))
        seen.append(steps[-1].observation)
        verdicts.append(_judge(memory, seen[-1]))
    lengths_au = torch.stack([o.length_au for o in seen], dim=1)
    frames = torch.stack([o.frames for o in seen[:-1]], dim=1)
    return Rollout(
        history=history,
        segment=Segment(
            graphs=env.graphs,
            frames=frames,
            target_mask=torch.stack([o.target_mask for o in seen[:-1]], dim=1),
            flown=(lengths_au[:, :-1] / WINDOW_AU).to(frames.dtype),
            nodes=torch.stack([o.node for o in seen[:-1]], dim=1),
            tracks=torch.stack([o.tracks for o in seen[:-1]], dim=1),
        ),
        actions=torch.stack(actions, dim=1),
        logits=torch.cat([v.logits for v in verdicts[:-1]], dim=1),
        values=torch.cat([v.value for v in verdicts], dim=1),
        rewards=torch.stack([s.reward for s in steps], dim=1).float(),
        area_std=torch.stack([s.area_std for s in steps], dim=1).float(),
        legs_au=lengths_au.diff(dim=1).float(),
    )


def sampled(rng: torch.Generator) -> Chooser:
    """Choose by the policy's probabilities."""

    def choose(verdict: Verdict, observation: Observation) -> Tensor:
        del observation
        chances = verdict.logits[:, 0].softmax(-1)
        return torch.multinomial(chances, 1, generator=rng)[:, 0]

    return choose


def greedy(verdict: Verdict, observation: Observation) -> Tensor:
    """Choose the greatest logit, as in flight."""
    del observation
    return verdict.logits[:, 0].argmax(-1)


def _judge(memory: History, observation: Observation) -> Verdict:
    return memory.decide(
        observation.frames,
        observation.target_mask,
        observation.length_au,
        observation.node,
        observation.tracks,
    )
