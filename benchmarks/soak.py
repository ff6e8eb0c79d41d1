"""Hours of patrol with random faults: `python benchmarks/soak.py [--hours H] [--seed S]`.

One `dronemon fly` on the mock, with a fault every two minutes that a patrol must survive. While it
flies, memory, threads, descriptors and children of the program are read once a second. Leaks show
as growth of their medians from the second tenth to the last; limits: memory 5 %, the others none.

A person's interrupt ends it after so many hours of vehicle time. The horizon is a distance, and the
TSP loop turns so often near its targets that it is flown at 3 m/s rather than at 5.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MISSION = """
name: soak
area: {{side_m: 120}}
flight: {{altitude_m: 30, cruise_speed_m_s: 5, horizon_min: {minutes}, endurance_min: 600}}
targets:
  - {{name: Bella, appearance: cow, prior_au: simulated}}
  - {{name: Zuri, appearance: zebra, prior_au: simulated}}
planner: {{kind: tsp}}
vehicle: {{speed_up: {speed_up}}}
record: {{pictures: false}}
simulation: {{seed: {seed}, faults: [{faults}]}}
view: {{live: false}}
"""
FAULTS = (
    *("loss=0.2+10", "delay=0.2+10", "duplicate=1.5+10", "reorder=0.3+10", "corrupt=0.1+10"),
    *("silence+0.5", "ignore+0.5", "gps+3", "jump=5+20", "pilot+8"),
    *("camera+8", "torn+5", "blank+5", "repeat+5", "late=1+5", "misdate=100+5"),
    *("hide=0.5+20", "decoy=0.5+20"),
)
"""None that an autopilot answers with a failsafe, as a silence longer than COM_OF_LOSS_T (1 s)."""
MEMORY_LIMIT = 0.05
_FAULT_EVERY_S = (100.0, 160.0)
_MOST_FAULTS = 100


def main() -> None:
    """Fly, and say what grew. Exit status 1 if a limit is passed, or the flight fails."""
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--hours", type=float, default=4.0, help="of vehicle time on patrol")
    parser.add_argument("--seed", type=int, default=10_000)
    parser.add_argument("--speed-up", type=float, default=20.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        (folder / "soak.yaml").write_text(
            MISSION.format(
                minutes=options.hours * 60.0,
                speed_up=options.speed_up,
                seed=options.seed,
                faults=", ".join(f'"{fault}"' for fault in _faults(options.hours, options.seed)),
            )
        )
        samples = _fly(folder, options.hours * 3600.0)
        summary = json.loads((folder / "run" / "summary.json").read_text())
    print(f"outcome {summary['outcome']}, {summary.get('patrol_s', 0.0) / 3600.0:.2f} h on patrol,")
    print(f"pictures {summary.get('pictures')} of {summary.get('pictures_due')}")
    tenth = len(samples) // 10
    if not tenth:
        sys.exit(f"too short to tell what grows: {summary.get('error')}")
    first, last = _medians(samples[tenth : 2 * tenth]), _medians(samples[-tenth:])
    for name in last:
        print(f"{name}: {first[name]:g} in the second tenth, {last[name]:g} in the last")
    growth = last["memory MiB"] / first["memory MiB"] - 1.0
    grown = [name for name in last if name != "memory MiB" and last[name] > first[name]]
    print(
        f"memory growth {growth:.1%} (limit {MEMORY_LIMIT:.0%}); grown: {grown or 'nothing else'}"
    )
    is_well = summary["outcome"] in {"completed", "interrupted"}
    sys.exit(not is_well or growth > MEMORY_LIMIT or bool(grown))


def _faults(hours: float, seed: int) -> list[str]:
    """A fault now and then: `KIND+DURATION` becomes `KIND@SECONDS+DURATION`."""
    rng, time_s = random.Random(seed), 60.0
    faults: list[str] = []
    while time_s < hours * 3600.0 and len(faults) < _MOST_FAULTS:
        kind, duration = rng.choice(FAULTS).split("+")
        faults.append(f"{kind}@{time_s:.0f}+{duration}")
        time_s += rng.uniform(*_FAULT_EVERY_S)
    return faults


def _fly(folder: Path, duration_s: float) -> list[dict[str, float]]:
    """Fly, and interrupt it after so long. -> what the program used, once a second on patrol"""
    command = [sys.executable, "-m", "dronemon.cli", "fly", "soak.yaml", "--out", "run"]
    child = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    observations, samples = folder / "run" / "observations.jsonl", []
    start_s, is_over = math.inf, False
    while child.poll() is None:
        text = observations.read_text() if observations.exists() else ""
        seen = text.splitlines()[: text.count("\n")]  # the last one may be under way
        if seen and not is_over:
            samples.append(_used(child.pid))
            start_s = min(start_s, json.loads(seen[0])["time_s"])
            is_over = json.loads(seen[-1])["time_s"] > start_s + duration_s
            if is_over:
                child.send_signal(signal.SIGINT)
        time.sleep(1.0)
    return samples


def _medians(samples: list[dict[str, float]]) -> dict[str, float]:
    return {name: statistics.median(sample[name] for sample in samples) for name in samples[0]}


def _used(pid: int) -> dict[str, float]:
    """Memory, threads, descriptors and children of a process."""
    process = Path(f"/proc/{pid}")
    status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
    return {
        "memory MiB": int(status["VmRSS"].split()[0]) / 1024.0,
        "threads": int(status["Threads"]),
        "descriptors": len(list((process / "fd").iterdir())),
        "children": len((process / "task" / str(pid) / "children").read_text().split()),
    }


if __name__ == "__main__":
    main()
