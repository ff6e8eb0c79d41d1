"""Time of one decision of the policy network with its memory, against the plain reference.

Usage: python benchmarks/policy.py [--width 128] [--decisions 400] [--ours]. Fails if the 99th
percentile is above 15 ms or the reference less than 10 times slower.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np
import torch

from dronemon.policy import Graphs, History, NetworkConfig, PolicyNetwork
from dronemon.roadmap import Roadmap, laplacian_encoding

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "policy"))
from instances import random_frames, random_tracks, random_walk
from naive_network import naive_verdict

MAX_P99_MS = 15.0
MIN_SPEED_UP = 10.0
NUM_NODES, NUM_TARGETS, HISTORY = 200, 4, 100


def main() -> int:
    """Measure and judge. -> exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--decisions", type=int, default=400)
    parser.add_argument(
        "--ours", action="store_true", help="with newest, ways, geometry and tracks"
    )
    options = parser.parse_args()
    if options.decisions <= HISTORY:
        parser.error(f"--decisions: more than {HISTORY}, the first of which are not counted")
    torch.manual_seed(0)
    config = NetworkConfig(
        width=options.width,
        feed_forward=4 * options.width,
        newest=options.ours,
        ways=options.ours,
        geometry=options.ours,
        tracks=options.ours,
    )
    network = PolicyNetwork(config).eval()
    rng = np.random.default_rng(0)
    roadmap = Roadmap.random(NUM_NODES, 10, rng, rng.random(2))
    graphs = Graphs.of(
        roadmap.nodes_au, laplacian_encoding(roadmap), roadmap.neighbours, roadmap.distance_au
    )
    generator = torch.Generator().manual_seed(0)
    frames = random_frames(1, options.decisions, graphs.num_nodes, NUM_TARGETS, generator)
    tracks = random_tracks(1, options.decisions, NUM_TARGETS, generator)
    nodes, lengths_au = random_walk(graphs, options.decisions, generator)
    mask = torch.ones(1, NUM_TARGETS, dtype=torch.bool)

    memory = History(network, graphs, HISTORY)
    ours_ms, logits = [], []
    for t in range(options.decisions):
        began = time.perf_counter()
        verdict = memory.decide(frames[:, t], mask, lengths_au[:, t], nodes[:, t], tracks[:, t])
        ours_ms.append(1e3 * (time.perf_counter() - began))
        logits.append(verdict.logits[0, 0])

    plain_ms, error = [], 0.0
    for t in range(options.decisions - 12, options.decisions):
        began = time.perf_counter()
        with torch.no_grad():
            plain, _ = naive_verdict(
                network,
                graphs,
                frames[0, : t + 1],
                mask[0],
                lengths_au[0, : t + 1],
                (int(nodes[0, t]), int(nodes[0, t - 1])),
                HISTORY,
                tracks[0, t],
            )
        plain_ms.append(1e3 * (time.perf_counter() - began))
        finite = plain.isfinite()
        error = max(error, float((plain - logits[t])[finite].abs().max()))

    full = np.array(ours_ms[HISTORY:])  # once the history is full
    p50, p99 = np.percentile(full, [50, 99])
    speed_up = float(np.median(plain_ms[2:]) / p50)
    print(
        f"|V| = {NUM_NODES}, T = {HISTORY}, N = {NUM_TARGETS}, d = {options.width},"
        f" {torch.get_num_threads()} threads on {os.cpu_count()} cores"
    )
    print(f"with memory   p50 {p50:.2f} ms   p99 {p99:.2f} ms   (limit {MAX_P99_MS:g} ms)")
    print(f"plain         p50 {np.median(plain_ms[2:]):.1f} ms")
    print(f"speed-up      {speed_up:.1f} x   (limit {MIN_SPEED_UP:g} x)")
    print(f"largest difference of a logit {error:.1e}")
    is_good = p99 <= MAX_P99_MS and speed_up >= MIN_SPEED_UP and error <= 1e-4
    print("pass" if is_good else "FAIL")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
