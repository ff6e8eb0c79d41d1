"""A whole flight that follows the ground: the real program, MAVSDK, UDP and the simulator."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hills import hill, write_hills
from simulated_vehicle import StartProgram, judge_pictures

from dronemon.frames import GeoPoint
from dronemon.vision.heights import read_heights
from dronemon.vision.terrain import Terrain
from sim.flight import HOME_NED_M
from sim.world import DEFAULT_PLACE

ROOT = Path(__file__).parents[2]
MISSION = """
name: hills
area: {side_m: 200, terrain: ground.asc}
flight: {altitude_m: 45, follow_terrain: true, horizon_au: 5}
targets:
  - {name: Bella, appearance: cow, count: 8}
planner: {kind: lawnmower}
"""
ON_HILL_M, IN_HOLLOW_M = (60.0, 60.0), (-60.0, -50.0)


def lines(run: Path, name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / f"{name}.jsonl").read_text().splitlines()]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("ranged", "off_m"),
    [("", 1.5), ("rangefinder: true, ", 2.5)],  # which takes slopes for level
    ids=["terrain", "rangefinder"],
)
def test_a_flight_over_a_hill_and_a_hollow(
    ranged: str, off_m: float, tmp_path: Path, start_program: StartProgram
) -> None:
    """It is 45 m above the ground wherever that can be followed, and finds who stands on it."""
    up, down = hill(18.0, 50.0, ON_HILL_M), hill(-25.0, 60.0, IN_HOLLOW_M)
    ground = tmp_path / "ground.asc"
    write_hills(ground, DEFAULT_PLACE, lambda n, e: up(n, e) + down(n, e), cells=80)
    mission = MISSION.replace("side_m: 200, ", f"side_m: 200, {ranged}")
    (tmp_path / "hills.yaml").write_text(mission)
    run = tmp_path / "run"
    command = [sys.executable, "-m", "dronemon.cli", "fly", "--mission", tmp_path / "hills.yaml"]
    options = ["--speed-up", "8", "--set", "RTL_RETURN_ALT=40", "--yes", "--out", run]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    process = start_program([*map(str, command + options)], cwd=ROOT, **pipes)
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 0, output

    ready = next(event for event in lines(run, "events") if event["kind"] == "ready")
    home_m, home_down_m = np.array(HOME_NED_M[:2]), HOME_NED_M[2]
    terrain = Terrain(read_heights(str(ground)), GeoPoint(**ready["origin"]), home_m, home_down_m)
    observations = lines(run, "observations")
    summary = json.loads((run / "summary.json").read_text())
    judge_pictures(summary, observations, due=50)
    truths = {round(line["time_s"], 2): line for line in lines(run, "truth")}
    pairs = [(seen, truths[round(seen["time_s"], 2)]) for seen in observations]
    places_m = np.array([truth["position_ned_m"] for _, truth in pairs])
    over_m = terrain.down_m(places_m[:, :2]) - places_m[:, 2]
    assert over_m.min() > 44.0
    assert np.percentile(over_m, 20) < 46.0
    assert over_m.max() < 58.0
    assert np.ptp(places_m[:, 2]) > 25.0
    off_au = [
        np.linalg.norm(np.subtract(truth["targets_au"], target["position_au"]), axis=-1).min()
        for seen, truth in pairs
        for target in seen["targets"].values()
        if target["seen"]
    ]
    assert len(off_au) > 10
    assert 200.0 * np.percentile(off_au, 90) < off_m
