"""What sharing costs: `python benchmarks/cluster.py [--instances N] [--planner NAMES]`.

Flies one small sweep by own processes, by a Ray started here and by two nodes of one, and prints
the time of each run from the first result to the last, so that starting is left out, and the
processor time of an episode, which a busy machine changes little. Ways take turns, a round at a
time; what is printed is the median of the rounds. Development seeds.

Then what a task costs those of whom a cluster has one, by tasks that do nothing but give back as
many numbers as an episode. Needs psutil.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

import psutil

from dronemon.cluster import STORE_BYTES, join_cluster
from dronemon.evaluation.evaluate import fly_spec
from dronemon.evaluation.options import EpisodeSpec, Options, PlannerSpec, Sweep
from dronemon.problem import FIRST_DEVELOPMENT_SEED
from dronemon.workers import share_out

NUM_IDLE = 3000


def fly(spec: EpisodeSpec) -> float:
    """Fly an episode. -> processor time that it took: next to nothing is sent back."""
    began_s = time.thread_time()
    fly_spec(spec)
    return time.thread_time() - began_s


def idle(_: int) -> list[float]:
    """As many numbers as the line of an episode of 30 au."""
    return [0.1] * 600


def taken_s(
    specs: list[EpisodeSpec], num_workers: int, cluster: Executor | None
) -> tuple[float, float]:
    """Time from the first result on, per episode that came after it; processor time of one."""
    done_s, spent = [], []
    for spent_s in share_out(fly, specs, num_workers, cluster):
        done_s.append(time.perf_counter())
        spent.append(spent_s)
    return (done_s[-1] - done_s[0]) / (len(done_s) - 1), statistics.median(spent)


@contextmanager
def two_nodes() -> Iterator[Executor]:
    """A cluster of two nodes with one CPU each, on the loopback."""
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # else it listens everywhere
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "node_ip_address": "127.0.0.1", "object_store_memory": STORE_BYTES}
    nodes = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    try:
        nodes.add_node(**node)
        with join_cluster(nodes.address, None) as cluster:
            yield cluster
    finally:
        nodes.shutdown()


def processor_s() -> dict[str, float]:
    """Processor time so far of this process, of Ray's head and of this node's manager."""
    us = psutil.Process()
    found = {p.name(): p for p in us.children(recursive=True)}
    named = {"this process": us, "head": found["gcs_server"], "node": found["raylet"]}
    return {name: sum(p.cpu_times()[:2]) for name, p in named.items()}


def print_cost() -> None:
    """What a task costs besides itself."""
    with join_cluster("local", 2) as cluster:
        list(share_out(idle, range(100), 2, cluster))  # so that workers are there
        before_s, began_s = processor_s(), time.perf_counter()
        list(share_out(idle, range(NUM_IDLE), 2, cluster))
        took_s, after_s = time.perf_counter() - began_s, processor_s()
    print(f"\na task that does nothing, of {NUM_IDLE}: {1e3 * took_s / NUM_IDLE:.2f} ms, of it")
    for name, spent in before_s.items():
        print(f"    {1e3 * (after_s[name] - spent) / NUM_IDLE:.2f} ms of processor, {name}")


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
    times_s: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for _ in range(given.rounds):
        for num_workers in (1, 2):
            alone_s = taken_s(specs, num_workers, None)
            times_s.setdefault(("processes", num_workers), []).append(alone_s)
            with join_cluster("local", num_workers) as cluster:
                shared_s = taken_s(specs, num_workers, cluster)
            times_s.setdefault(("Ray", num_workers), []).append(shared_s)
        with two_nodes() as cluster:
            times_s.setdefault(("Ray, two nodes", 2), []).append(taken_s(specs, 2, cluster))
    print("| by | workers | s an episode | s of processor |")
    print("|---|---|---|---|")
    for (way, num_workers), rounds_s in times_s.items():
        each_s, spent_s = map(statistics.median, zip(*rounds_s, strict=True))
        print(f"| {way} | {num_workers} | {each_s:.3f} | {spent_s:.3f} |")
    print_cost()


if __name__ == "__main__":
    main()
