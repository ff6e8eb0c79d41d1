"""Waypoints that every planner chose on development seeds, to the last digit.

    NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES= python tests/golden/decisions.py --write-anew

First written before the restructuring that this file is to hold still; a commit that writes them
anew says why. Machine code for one processor rounds otherwise than for another, hence `generic`,
which `tests/conftest.py` sets.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import torch

from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.planner import create_planner
from dronemon.world import Instance

FILE = Path(__file__).with_name("decisions.json")
PLANNERS = ("search", "search-roadmap", "clairvoyant-search", "stamp", "tsp", "lawnmower")
NUM_TARGETS = 3
Flown = dict[str, list[list[float]]]


def episodes() -> Iterator[tuple[str, str, int, str]]:
    """Name, planner, seed and prior of each episode."""
    for planner in PLANNERS:
        for seed, prior in ((10000, "full"), (10001, "full"), (10002, "full"), (10000, "none")):
            yield f"{planner} {seed} {prior}", planner, seed, prior


def waypoints(planner_name: str, seed: int, prior: str) -> list[list[float]]:
    """Fly 10 au with targets of a tenth of the agent's speed. -> waypoints (D, 2) au."""
    torch.set_num_threads(1)
    planner = create_planner(planner_name)
    chosen: list[list[float]] = []
    choose = planner.next_waypoint

    def noted(snapshot):
        waypoint = choose(snapshot)
        chosen.append(waypoint.position_au.tolist())
        return waypoint

    planner.next_waypoint = noted
    conditions = Conditions(speed_ratio=0.1, prior=prior, horizon_au=10.0)
    fly_episode(planner, Instance.draw(seed, NUM_TARGETS), conditions)
    return chosen


def load() -> Flown:
    """What is on file. -> episode's name -> waypoints"""
    flown: Flown = json.loads(FILE.read_text())
    return flown


if __name__ == "__main__":
    if sys.argv[1:] != ["--write-anew"] or os.environ.get("NUMBA_CPU_NAME") != "generic":
        sys.exit(__doc__)
    rows = [
        f"{json.dumps(name)}: {json.dumps(waypoints(*episode))}" for name, *episode in episodes()
    ]
    FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n")
