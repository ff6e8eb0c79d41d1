"""PPO in one file on many episodes in step: `python examples/ppo.py --minutes 10 --out runs/ppo`.

A small network on a small problem: two cores see it learn in minutes. Before and after it flies
held-out seeds, from 10000 on. OUT gets `metrics.csv`, `policy.pt`, and TensorBoard's file where
that is installed. After CleanRL's ppo.py.
"""

import argparse
import contextlib
import csv
import importlib.util
import time
from pathlib import Path

import dronemon.gym  # noqa: F401  # isort: skip  # registers NAME, or says what is missing
import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

METRICS = {
    "decisions": "taken in training so far, over all episodes; each update adds 2048",
    "minutes": "spent in training so far",
    "return": "rewards summed over an episode's 64 decisions, mean over the update's 32 episodes",
    "unc": "sigma_bar, mean over targets and the way flown, in those episodes; lower is better",
    "policy_loss": "PPO's clipped objective, negated, mean over the update's minibatches",
    "value_loss": "squared error of the value against ten times the discounted rewards to come",
    "entropy": "of the policy, in nats, likewise",
}
NAME = "dronemon/Monitoring-v0"
PROBLEM = {"num_targets": 3, "num_nodes": 50, "speed_ratio": 0.1, "max_episode_steps": 64}
EPISODES, EPOCHS, MINIBATCHES, LEARNING_RATE, CLIP, ENTROPY_WEIGHT = 32, 4, 8, 1e-3, 0.2, 0.005
DISCOUNT, LAMBDA, REWARD_SCALE, HELD_OUT_SEED, FIRST_SEED = 0.98, 0.95, 10.0, 10_000, 1_000_000


class Policy(nn.Module):
    """Judges each way to go by each target: what is believed of it there, and where it may be."""

    def __init__(self, width=64):
        super().__init__()
        self.pair, self.score, self.value = (
            nn.Sequential(nn.Linear(size, width), nn.Tanh(), nn.Linear(width, outputs))
            for size, outputs in ((13, width), (width, 1), (width, 1))
        )

    def forward(self, seen):
        """The policy over K ways to go, and the value. -> Categorical of B, (B,)."""
        seen = {name: torch.as_tensor(array) for name, array in seen.items()}
        episode = torch.arange(len(seen["node"]))[:, None]
        ways = seen["neighbours"][episode, seen["node"][:, None]][:, 0]  # (B, K) nodes
        belief, places = seen["belief"][episode, ways], seen["nodes_au"][episode, ways]
        thought = seen["tracks"][:, None, :, 2:4] + 0.5  # (B, 1, N, 2) where each target may be
        offset = thought - places[:, :, None]  # (B, K, N, 2)
        after = offset.norm(dim=-1, keepdim=True)
        now = (thought - seen["position_au"][:, None, None]).norm(dim=-1, keepdim=True)
        sure = seen["tracks"][:, None, :, 6:].expand(*after.shape[:3], -1)  # when seen, how fast
        pairs = self.pair(torch.cat([belief, offset, after, now.expand_as(after), sure], dim=-1))
        judged = (pairs.tanh() * seen["target_mask"][:, None, :, None]).sum(2)  # (B, K, width)
        mask = seen["neighbour_mask"].bool()[..., None]
        logits = self.score(judged).masked_fill(~mask, -torch.inf)[..., 0]
        return Categorical(logits=logits), self.value((judged * mask).sum(1) / mask.sum(1))[:, 0]


@torch.no_grad()
def fly(envs, policy, seen, greedy=False):
    """Play the episodes to their end. -> what came of them, (T, B, ...), and how the next begin."""
    rows = []
    for _ in range(PROBLEM["max_episode_steps"]):
        chances, value = policy(seen)
        action = chances.probs.argmax(-1) if greedy else chances.sample()
        after, reward, _, _, infos = envs.step(action.numpy())  # all are truncated at once
        told = infos.get("final_info", infos)
        did = {"action": action, "log_chance": chances.log_prob(action), "value": value}
        came = {"reward": reward, "leg_au": told["leg_au"], "std": told["area_std"].mean(1)}
        rows.append(seen | did | came)
        seen = after
    flown = {name: torch.as_tensor(np.stack([row[name] for row in rows])) for name in rows[0]}
    # The limit breaks episodes off, which would go on: what was seen last has a value, too.
    last = {name: np.stack([final[name] for final in infos["final_obs"]]) for name in seen}
    flown["value"] = torch.cat([flown["value"], policy(last)[1][None]])
    flown["return"] = flown["reward"].sum(0)
    flown["unc"] = (flown["std"] * flown["leg_au"]).sum(0) / flown["leg_au"].sum(0)
    return flown, seen


def learn(policy, optimizer, flown):
    """Improve the policy by what was flown. -> the metrics of learning."""
    rewards, values = REWARD_SCALE * flown["reward"].float(), flown["value"]
    gains, gain = torch.zeros_like(rewards), torch.zeros(EPISODES)
    for t in reversed(range(len(rewards))):  # generalised advantage estimation
        gains[t] = gain = rewards[t] + DISCOUNT * (values[t + 1] + LAMBDA * gain) - values[t]
    returns, gains = (gains + values[:-1]).flatten(), gains.flatten()
    gains = (gains - gains.mean()) / (gains.std() + 1e-8)
    flat = {name: array.flatten(0, 1) for name, array in flown.items() if array.dim() > 1}
    numbers = []
    for _ in range(EPOCHS):
        for some in torch.randperm(len(gains)).chunk(MINIBATCHES):
            chances, value = policy({name: flat[name][some] for name in flat})
            ratio = (chances.log_prob(flat["action"][some]) - flat["log_chance"][some]).exp()
            gain = gains[some]
            policy_loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            value_loss, entropy = (value - returns[some]).square().mean(), chances.entropy().mean()
            optimizer.zero_grad()
            (policy_loss + 0.5 * value_loss - ENTROPY_WEIGHT * entropy).backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimizer.step()
            numbers.append([x.item() for x in (policy_loss, value_loss, entropy)])
    return dict(zip(list(METRICS)[4:], np.mean(numbers, axis=0), strict=True))


def train(minutes, out, seed=0, held_out=64):
    """Train and log. -> flights of held-out seeds before and after, by the likeliest ways."""
    torch.manual_seed(seed)
    policy, decisions, minutes_spent = Policy(), 0, 0.0
    optimizer = torch.optim.Adam(policy.parameters(), lr=LEARNING_RATE)
    envs, others = (gymnasium.make_vec(NAME, n, **PROBLEM) for n in (EPISODES, held_out))
    before, _ = fly(others, policy, others.reset(seed=HELD_OUT_SEED)[0], greedy=True)
    seen, _ = envs.reset(seed=FIRST_SEED)
    out.mkdir(parents=True, exist_ok=True)
    board = contextlib.nullcontext()
    if importlib.util.find_spec("tensorboard"):
        board = importlib.import_module("torch.utils.tensorboard").SummaryWriter(out)
    began_s = time.monotonic()
    with (out / "metrics.csv").open("w", 1, newline="") as file, board as writer:
        log = csv.DictWriter(file, METRICS)
        log.writeheader()
        while minutes_spent < minutes:
            flown, seen = fly(envs, policy, seen)
            numbers = learn(policy, optimizer, flown)
            numbers |= {name: flown[name].mean().item() for name in ("return", "unc")}
            decisions += flown["action"].numel()
            minutes_spent = (time.monotonic() - began_s) / 60.0
            log.writerow(numbers | {"decisions": decisions, "minutes": minutes_spent})
            for name in numbers if writer else ():
                writer.add_scalar(name, numbers[name], decisions)
    torch.save(policy.state_dict(), out / "policy.pt")
    return before, fly(others, policy, others.reset(seed=HELD_OUT_SEED)[0], greedy=True)[0]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in {"minutes": 10.0, "out": Path("runs/ppo"), "seed": 0}.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    before, after = train(**vars(parser.parse_args()))
    for name in ("return", "unc"):
        scores = before[name], after[name], after[name] - before[name]
        told = (f"{x.mean():.3f} ± {x.std() / len(x) ** 0.5:.3f}" for x in scores)
        print(f"{name} before, after and change:", *told, sep="  ")
