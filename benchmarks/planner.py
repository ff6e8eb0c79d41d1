"""How long a decision of the search takes: `python benchmarks/planner.py [--length L]`.

Flies one episode at N = 8 on one thread and prints the decision times, first and second half apart,
and the memory: with a long episode these tell that nothing grows. Processor time of the thread is
what counts, so that a busy machine does not slow the figures.
"""

from __future__ import annotations

import argparse
import gc
import resource
import time

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # has no types

from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.planner.search import RoadmapSearchPlanner, SearchPlanner
from dronemon.roadmap import Roadmap
from dronemon.world import Instance

SEED = 10_000


class Timed:
    """A planner whose decisions are timed. decisions_ms: processor time of each."""

    def __init__(self, planner: SearchPlanner) -> None:
        self.planner = planner
        self.name = planner.name
        self.decisions_ms: list[float] = []

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Begin, untimed: this is where code is compiled. Garbage is left alone, as in flight."""
        self.planner.reset(briefing, roadmap)
        gc.collect()
        gc.freeze()

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """Decide, timed."""
        began_ns = time.thread_time_ns()
        waypoint = self.planner.next_waypoint(snapshot)
        self.decisions_ms.append((time.thread_time_ns() - began_ns) / 1e6)
        return waypoint


def main() -> None:
    """Time the free search and the roadmap's, for slow and for fast targets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--length", type=float, default=30.0, help="episode length in au")
    parser.add_argument("--targets", type=int, default=8)
    arguments = parser.parse_args()
    for planner in (SearchPlanner(), RoadmapSearchPlanner()):
        for speed_ratio in (1 / 30, 1 / 20, 1 / 10, 1 / 7):
            timed = Timed(planner)
            with threadpool_limits(1):
                fly_episode(
                    timed,
                    Instance.draw(SEED, arguments.targets),
                    Conditions(speed_ratio=speed_ratio, horizon_au=arguments.length),
                )
            halves = np.array_split(np.array(timed.decisions_ms), 2)
            for half, times_ms in zip(("first", "second"), halves, strict=True):
                print(
                    f"{planner.name:14s} r_v {speed_ratio:.3f} {half:6s} half: "
                    f"mean {times_ms.mean():5.2f} ms, p99 {np.percentile(times_ms, 99):5.2f} ms, "
                    f"most {times_ms.max():5.2f} ms"
                )
            peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"{'':14s} peak memory so far {peak_mib:.0f} MiB")


if __name__ == "__main__":
    main()
