"""The whole PPO pipeline at the paper's network size, in decisions per second, with its time split.

Usage: python benchmarks/training.py [--iterations 2] [--episodes 8] [--device auto]. An iteration
plays 256 decisions per episode with rewards and learns from them in four epochs. On a CPU it fails
below 15 decisions a second; on a GPU it extrapolates the paper's 12.8 million decisions.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace

import torch

from dronemon.env import Env, Setup
from dronemon.policy import NetworkConfig, PolicyNetwork
from dronemon.training.peers import Peers, own_device
from dronemon.training.ppo import Ppo, PpoConfig

MIN_RATE = 15.0
PAPER_DECISIONS = 50_000 * 256


def main() -> int:
    """Measure and judge. -> exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--decisions", type=int, default=256)
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    device = own_device(options.device)
    torch.manual_seed(0)
    network = PolicyNetwork(NetworkConfig(width=options.width, feed_forward=4 * options.width)).to(
        device
    )
    config = replace(
        PpoConfig(), episodes_per_iteration=options.episodes, decisions=options.decisions
    )
    ppo = Ppo(network, config, Peers(device=device), 0)
    rows = [ppo.iterate(0.0) for _ in range(options.iterations)]
    total = sum(row["decisions"] for row in rows)
    play_s, learn_s = (sum(row[name] for row in rows) for name in ("play_s", "learn_s"))
    env_s = _env_seconds(config, device) * options.iterations
    rate = total / (play_s + learn_s)
    parameters = sum(p.numel() for p in network.parameters())
    print(
        f"d = {options.width} ({parameters} weights), {options.episodes} episodes x"
        f" {options.decisions} decisions x {options.iterations} iterations on {device},"
        f" {torch.get_num_threads()} threads on {os.cpu_count()} cores"
    )
    print(f"play    {play_s:7.1f} s  {play_s / (play_s + learn_s):4.0%}")
    print(f"  of it environment about {env_s:.1f} s, the network's decisions the rest")
    print(f"learn   {learn_s:7.1f} s  {learn_s / (play_s + learn_s):4.0%}  (4 epochs)")
    print(f"end to end {rate:.1f} decisions/s   (target on two cores {MIN_RATE:g})")
    hours = PAPER_DECISIONS / rate / 3600.0
    print(f"the paper's {PAPER_DECISIONS / 1e6:.1f} M decisions would take {hours:.1f} h")
    return 0 if device.type != "cpu" or rate >= MIN_RATE else 1


def _env_seconds(config: PpoConfig, device: torch.device) -> float:
    """Time of the environment alone for one iteration of average size, by random choices."""
    num_nodes, num_targets = (sum(pair) // 2 for pair in (config.num_nodes, config.num_targets))
    setups = [
        Setup(seed=10_000 + i, num_targets=num_targets, num_nodes=num_nodes)
        for i in range(config.episodes_per_iteration)
    ]
    env = Env(device=device)
    began = time.perf_counter()
    observation = env.reset(setups)
    for _ in range(config.decisions):
        column = torch.multinomial(observation.neighbour_mask.float(), 1)
        observation = env.step(observation.neighbours.gather(1, column)[:, 0]).observation
    return time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
