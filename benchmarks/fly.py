"""What flying costs: `python benchmarks/fly.py [--planner P] [--horizon-au H] [--speed-up S]`.

Five figures, each beside its limit and as a ratio to it:
- processor time of the application over the patrol, per second of vehicle time, at real-time speed
  (the simulator, a process of its own, apart); limit 0.5 core;
- of that, the thread that draws the recording; limit 0.05 core; and what the recording grows by in
  two hours; limit 200 MB;
- ground speed on that patrol: 99th percentile, limit cruise and 10 %; its mean, at least 92 %;
- belief update plus planning, 99th percentile over 300 measurements of 3 targets with 200 nodes;
  limit 20 ms. A belief update is one measurement added, and the posteriors at all nodes now and
  2 au ahead.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dronemon.belief import Belief
from dronemon.planner import Briefing, Snapshot
from dronemon.planner.registry import create_planner
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.world import Instance
from dronemon.world.sensing import measure

CPU_LIMIT = 0.5
LOGGING_LIMIT = 0.05
RECORDING_LIMIT_MB = 200.0  # in two hours
DECISION_LIMIT_MS = 20.0
SPEED_LIMIT_M_S = 1.1 * 5.0  # of the shipped mission
NUM_TARGETS, NUM_NODES, NUM_NEIGHBOURS, SPEED_RATIO = 3, 200, 10, 0.05


APPLICATION = """
import sys, time
from dronemon import cli
from dronemon.viz.stream import FlightView

work = FlightView._work

def timed(view, recording):
    work(view, recording)
    print(time.thread_time(), file=sys.stderr, flush=True)

FlightView._work = timed
cli.main()
"""
"""The application, which says at last how long it drew."""


def fly(
    planner: str, horizon_au: float, speed_up: float
) -> tuple[dict[str, float], dict[str, Any]]:
    """Fly. -> cores that application and drawing take, MB in two hours of patrol; summary

    The application is measured from patrol to homecoming; drawing over the whole flight, by the
    patrol's seconds, so a little too much.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        options = ["--planner", planner, "--horizon-au", f"{horizon_au}", "--out", str(out)]
        child = subprocess.Popen(
            [sys.executable, "-c", APPLICATION, "fly", "--speed-up", f"{speed_up}", *options],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        rows = []
        for kind in ("patrol", "homecoming"):
            _wait_for(out / "events.jsonl", kind, child)
            row = (_processor_s(child.pid), time.monotonic(), (out / "flight.rrd").stat().st_size)
            rows.append(row)
        _, told = child.communicate()
        summary = json.loads((out / "summary.json").read_text())
    cpu_s, wall_s, size = np.subtract(rows[1], rows[0])
    cost = {
        "application": cpu_s / wall_s,
        "drawing": float(told.split()[-1]) / summary["patrol_s"],
        "recording_mb": size / wall_s * 7200.0 / 1e6 / speed_up,
    }
    return cost, summary


def _wait_for(events: Path, kind: str, child: subprocess.Popen[bytes]) -> None:
    while child.poll() is None:
        if events.exists() and any(
            json.loads(line)["kind"] == kind for line in events.read_text().splitlines()
        ):
            return
        time.sleep(0.05)
    sys.exit(f"the flight ended before {kind}")


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def decision_ms(planner_name: str, seed: int) -> np.ndarray:
    """Time of belief update plus planning at each measurement of one episode. -> (300,) ms."""
    instance = Instance.draw(seed, NUM_TARGETS)
    rng = instance.stream("roadmap")
    roadmap = Roadmap.random(NUM_NODES, NUM_NEIGHBOURS, rng, instance.start_au)
    planner = create_planner(planner_name)
    priors_au = instance.paths.positions_au(0.0)
    belief = Belief(Sightings(priors_au))
    planner.reset(
        Briefing(
            num_targets=NUM_TARGETS,
            priors_au=priors_au,
            start_au=instance.start_au,
            horizon_au=30.0,
            rng=instance.stream("planner"),
        ),
        roadmap,
    )
    position_au, node, times_ms = instance.start_au, 0, []
    waypoint = None
    for step in range(300):
        time_au = 0.1 * (step + 1)
        if waypoint is not None:
            position_au, node = waypoint.position_au, waypoint.node
        measurement = measure(
            time_au, position_au, instance.paths.positions_au(SPEED_RATIO * time_au)
        )
        began = time.perf_counter()
        belief.sightings.add(measurement)
        for ahead_au in (0.0, 2.0):
            when = np.full((roadmap.num_nodes, 1), time_au + ahead_au)
            belief.posterior(np.concatenate([roadmap.nodes_au, when], axis=1))
        waypoint = planner.next_waypoint(
            Snapshot(
                time_au=time_au,
                flown_au=time_au,
                position_au=position_au,
                node=node,
                sightings=belief.sightings,
                belief=belief,
                roadmap=roadmap,
                remaining_au=30.0 - time_au,
            )
        )
        times_ms.append((time.perf_counter() - began) * 1e3)
    return np.array(times_ms)


def main() -> None:
    """Run both and print them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--planner", default="stamp")
    parser.add_argument("--horizon-au", type=float, default=1.5)
    parser.add_argument("--speed-up", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=10_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    times = decision_ms(options.planner, options.seed)
    p50, p99 = np.percentile(times, [50, 99])
    print(
        f"belief update + planning ({options.planner}): p50 {p50:.2f} ms, p99 {p99:.2f} ms, "
        f"limit {DECISION_LIMIT_MS:g} ms, ratio {p99 / DECISION_LIMIT_MS:.2f}"
    )
    cost, summary = fly(options.planner, options.horizon_au, options.speed_up)
    for name, unit, limit in (
        ("application", "cores", CPU_LIMIT),
        ("drawing", "cores", LOGGING_LIMIT),
        ("recording_mb", "MB in two hours", RECORDING_LIMIT_MB),
    ):
        print(
            f"{name} at {options.speed_up:g}x: {cost[name]:.3g} {unit}, limit {limit:g} at 1x, "
            f"ratio {cost[name] / limit:.2f}"
        )
    p99, mean = summary["speed_p99_m_s"], summary["mean_speed_m_s"]
    print(
        f"ground speed: p99 {p99:.2f} m/s, limit {SPEED_LIMIT_M_S:g} m/s, "
        f"ratio {p99 / SPEED_LIMIT_M_S:.2f}; mean {mean:.2f} m/s"
    )


if __name__ == "__main__":
    main()
