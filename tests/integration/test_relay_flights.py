"""Patrols longer than a battery, flown by the program as a user starts it."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from simulated_vehicle import StartProgram, judge_pictures

from dronemon.recorder import RunFolder

MISSION = """
name: relay
area: {side_m: 60}
flight: {altitude_m: 30, cruise_speed_m_s: 5, start_au: [0.5, 0.5], RELAY}
targets:
  - {name: Bella, appearance: cow, prior_au: simulated}
  - {name: Zuri, appearance: zebra, prior_au: simulated}
planner: {kind: search-roadmap}
vehicle: {speed_up: 12}
simulation: {seed: 10000, faults: [FAULTS]}
view: {live: false}
"""
SIDE_S = 60.0 / 5.0
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def _program(
    start_program: StartProgram, folder: Path, relay: str, faults: str
) -> subprocess.Popen[str]:
    text = MISSION.replace("RELAY", relay).replace("FAULTS", faults)
    (folder / "relay.yaml").write_text(text)
    command = [sys.executable, "-m", "dronemon.cli", "fly", "relay.yaml", "--out", "run"]
    return start_program(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def _is_noted(run: Path, text: str) -> bool:
    """Whether an event says so; none does before there is a run."""
    if not (run / "events.jsonl").exists():
        return False
    return any(text in event["text"] for event in RunFolder.open(run).events())


def _ask(command: str, run: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "dronemon.cli", command, str(run)],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def test_ninety_sides_take_three_fresh_batteries_and_beliefs_age_across_each(
    start_program: StartProgram, tmp_path: Path
):
    relay = "horizon_au: 90, endurance_min: 11, relay: automatic"
    program = _program(start_program, tmp_path, relay, "swap=40")
    said, _ = program.communicate()
    assert program.returncode == 0, said
    run = RunFolder.open(tmp_path / "run")
    summary, seen = run.summary(), list(run.observations())
    kinds = [event["kind"] for event in run.events()]
    assert summary["outcome"] == "completed"
    swaps = kinds.count("resumed")
    assert kinds.count("armed") == swaps + 1 >= 4  # a slow machine's flight may need one more
    judge_pictures(summary, seen, due=900)
    assert run.damaged_files() == []
    start_s = seen[0]["time_s"] - SIDE_S * seen[0]["time_au"]
    ages_s = [line["time_s"] - SIDE_S * line["time_au"] - start_s for line in seen]
    assert ages_s == pytest.approx([0.0] * len(seen), abs=1e-6)  # one clock, also on the ground
    steps_s = sorted(b["time_s"] - a["time_s"] for a, b in itertools.pairwise(seen))
    assert min(steps_s[-swaps:]) > 40.0 > steps_s[-swaps - 1]
    truth = (run.path / "truth.jsonl").read_text().splitlines()
    assert len(truth) >= len(seen)
    assert summary["unc"] is not None


def test_a_second_terminal_sees_a_flight_wait_and_sends_it_on(
    start_program: StartProgram, tmp_path: Path
):
    relay = "horizon_au: 9, endurance_min: 3.5, relay: confirmed"
    program = _program(start_program, tmp_path, relay, "swap=40, reboot@400")
    run = tmp_path / "run"

    def wait_until(condition: Callable[[], bool]) -> None:
        while not condition():
            assert program.poll() is None, program.communicate()[0]
            time.sleep(0.1)

    wait_until(lambda: _is_noted(run, "motors are running"))  # early: it flies fast
    assert "does not wait for a word" in _ask("resume", run)
    wait_until(lambda: _is_noted(run, "still waiting: the autopilot rebooted"))
    wait_until(lambda: "waiting:" in _ask("status", run))
    assert "waits on the ground" in _ask("status", run)
    before = [event["kind"] for event in RunFolder.open(run).events()]
    assert "it goes on" in _ask("resume", run)
    said, _ = program.communicate()
    assert program.returncode == 0, said
    events = list(RunFolder.open(run).events())
    assert (before.count("armed"), [event["kind"] for event in events].count("armed")) == (1, 2)
    assert "ended: completed" in _ask("status", run)
    assert "completed: nothing is left to fly" in _ask("resume", run)
