"""What sharing costs: `python benchmarks/cluster.py [--instances N] [--planner NAMES]`.

Flies one small sweep by own processes and by a Ray started here, with one worker and with two, and
prints the time of each run from the first result to the last, so that starting either is left out,
and how many times faster two are than one. The machine may be busy: ways take turns, a round at a
time, and what is printed is the median of the rounds. Development seeds.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from concurrent.futures import Executor
from pathlib import Path

from dronemon.cluster import join_cluster
from dronemon.evaluation.evaluate import fly_spec
from dronemon.evaluation.options import EpisodeSpec, Options, PlannerSpec, Sweep
from dronemon.problem import FIRST_DEVELOPMENT_SEED
from dronemon.workers import share_out


def fly(spec: EpisodeSpec) -> int:
    """Fly an episode. -> measurements taken: next to nothing is sent back."""
    return len(fly_spec(spec).agent_au)


def taken_s(specs: list[EpisodeSpec], num_workers: int, cluster: Executor | None) -> float:
    """Time from the first result on, per episode that came after it."""
    done_s = [time.perf_counter() for _ in share_out(fly, specs, num_workers, cluster)]
    return (done_s[-1] - done_s[0]) / (len(done_s) - 1)


def main() -> None:
    """Take turns, and print a row for each way."""
    parser = argparse.ArgumentParser(description="Own processes and Ray, one worker and two")
    parser.add_argument("--instances", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--planner", default="tsp")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        asked = Options(
            planners=tuple(map(PlannerSpec.parse, given.planner.split(","))),
            out=Path(folder),
            sweep=Sweep(),
            instances=given.instances,
            first_seed=FIRST_DEVELOPMENT_SEED,
        )
        specs = list(asked.episodes())
    times_s: dict[tuple[str, int], list[float]] = {}
    for _ in range(given.rounds):
        for num_workers in (1, 2):
            alone_s = taken_s(specs, num_workers, None)
            times_s.setdefault(("processes", num_workers), []).append(alone_s)
            with join_cluster("local", num_workers) as cluster:
                shared_s = taken_s(specs, num_workers, cluster)
            times_s.setdefault(("Ray", num_workers), []).append(shared_s)
    median_s = {key: statistics.median(values) for key, values in times_s.items()}
    print("| by | workers | s an episode | of one process | of itself with one |")
    print("|---|---|---|---|---|")
    for (way, num_workers), each_s in median_s.items():
        against, alone = median_s["processes", 1] / each_s, median_s[way, 1] / each_s
        print(f"| {way} | {num_workers} | {each_s:.3f} | {against:.2f} | {alone:.2f} |")


if __name__ == "__main__":
    main()
