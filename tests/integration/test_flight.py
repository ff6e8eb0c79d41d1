"""Whole flights: the real program, MAVSDK, UDP, pictures, Rerun; only the drone is simulated."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from simulated_vehicle import StartMockVehicle, StartProgram, free_udp_port, judge_pictures

ROOT = Path(__file__).parents[2]


class Flight:
    """`dronemon fly` as a child process."""

    def __init__(
        self, start: StartProgram, out: Path, *options: str, before: Sequence[str] = ()
    ) -> None:
        self.out = out
        self.process = start(
            [*before, sys.executable, "-m", "dronemon.cli", "fly", "--out", str(out), *options],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def wait_for_event(self, kind: str) -> None:
        deadline = time.monotonic() + 60
        while not any(event["kind"] == kind for event in self.lines("events")):
            assert self.process.poll() is None, self.process.communicate()[0]
            assert time.monotonic() < deadline, f"no event {kind!r}"
            time.sleep(0.02)

    def finish(self) -> tuple[int, str]:
        output, _ = self.process.communicate(timeout=100)
        return self.process.returncode, output

    def lines(self, name: str) -> list[dict]:
        path = self.out / f"{name}.jsonl"
        if not path.exists():
            return []
        return [json.loads(line) for line in path.read_text().splitlines(keepends=True)]

    def summary(self) -> dict:
        return json.loads((self.out / "summary.json").read_text())


@pytest.fixture
def fly(tmp_path: Path, start_program: StartProgram):
    number = itertools.count()

    def start(*options: str, before: Sequence[str] = ()) -> Flight:
        out = tmp_path / f"run{next(number)}"
        return Flight(start_program, out, "--speed-up", "20", *options, before=before)

    return start


def _verify(flight: Flight) -> None:
    rerun = Path(sys.executable).parent / "rerun"
    done = subprocess.run(
        [rerun, "rrd", "verify", flight.out / "flight.rrd"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def _family(pid: int) -> list[int]:
    """A process and all that it started."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *(one for child in children for one in _family(int(child)))]


def _addresses(pid: int) -> set[str]:
    """Where the sockets of a program and its children are bound, as /proc writes it."""
    inodes = {
        link.readlink().name.removeprefix("socket:[").removesuffix("]")
        for one in _family(pid)
        for link in Path(f"/proc/{one}/fd").iterdir()
        if link.is_symlink()
    }
    tables = [Path(f"/proc/net/{name}") for name in ("tcp", "tcp6", "udp", "udp6")]
    rows = [line.split() for table in tables for line in table.read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if row[9] in inodes}


@pytest.mark.slow
def test_a_short_flight_from_take_off_to_landing(fly: Callable[..., Flight]):
    # At twice the speed: a pause of this machine is not to be taken for the flight's error.
    options = ("--horizon-au", "1", "--speed-up", "2", "--view")
    flight = fly("--mission", "missions/animals.yaml", *options)
    flight.wait_for_event("patrol")
    assert _addresses(flight.process.pid) == {"0100007F"}, "all that listens is on 127.0.0.1"
    code, output = flight.finish()
    assert code == 0, output
    summary = flight.summary()
    assert summary["outcome"] == "completed"
    assert summary["is_landed"]
    assert summary["landing_error_m"] < 3.0
    assert summary["distance_au"] == pytest.approx(1.0, abs=0.05)
    assert summary["mean_speed_m_s"] > 0.92 * 5.0
    assert summary["cross_track_p95_au"] < 0.02
    assert summary["picture_spacing_error"] < 0.02
    assert len(flight.lines("observations")) == 10
    assert 0.3 < summary["unc"] < 1.0
    assert 0.0 < summary["jsd"] < 0.7
    kinds = [event["kind"] for event in flight.lines("events")]
    story = ["ready", "armed", "airborne", "patrol", "homecoming", "disarmed", "outcome"]
    assert [kind for kind in kinds if kind in story] == story
    assert "Unc" in output
    assert not any("failsafe" in event["text"].lower() for event in flight.lines("events"))
    for decision in flight.lines("decisions"):  # of the shipped network
        details = decision["details"]
        best = details["neighbours"][int(np.argmax(details["logits"]))]
        assert decision["node"] == best
    assert (summary["pictures"], summary["pictures_due"]) == (10, 10)
    _verify(flight)


@pytest.mark.slow
@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(0.0, 180.0), (89.99, -180.0)])
def test_a_flight_at_the_edge_of_the_map(
    fly: Callable[..., Flight], tmp_path: Path, latitude_deg: float, longitude_deg: float
):
    """Where longitudes jump, and near a pole: the mock once died at the one, and was 49 m off."""
    mission = tmp_path / "edge.yaml"
    place = f"area:\n  latitude_deg: {latitude_deg}\n  longitude_deg: {longitude_deg}"
    text = (ROOT / "missions" / "animals.yaml").read_text(encoding="utf-8")
    mission.write_text(text.replace("area:", place), encoding="utf-8")
    flight = fly("--mission", str(mission), "--horizon-au", "1")
    code, output = flight.finish()
    assert code == 0, output
    summary = flight.summary()
    assert summary["outcome"] == "completed"
    assert summary["landing_error_m"] < 3.0
    judge_pictures(summary, flight.lines("observations"), due=10)


def _errors_m(flight: Flight, side_m: float) -> list[float]:
    """How far each sighting is from where its target was."""
    truth = {round(t["time_s"], 6): t["targets_au"] for t in flight.lines("truth")}
    return [
        side_m * max(abs(a - b) for a, b in zip(target["position_au"], true_au, strict=True))
        for line in flight.lines("observations")
        for target, true_au in zip(
            line["targets"].values(), truth[round(line["time_s"], 6)], strict=True
        )
        if target["seen"]
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "side_m"), [("people", 250.0), ("vehicles", 350.0), ("robots", 80.0)]
)
def test_people_vehicles_and_robots_are_watched_to_the_end(
    fly: Callable[..., Flight], mission: str, side_m: float
):
    flight = fly("--mission", mission, "--horizon-au", "2.5", "--speed-up", "5")
    code, output = flight.finish()
    assert code == 0, output
    summary = flight.summary()
    assert (summary["outcome"], summary["is_landed"]) == ("completed", True)
    assert summary["pictures_due"] == 25
    assert summary["pictures"] >= 22  # at 10 m/s one taken in a sharp turn may show too little
    errors_m = _errors_m(flight, side_m)
    assert len(errors_m) >= 1
    assert max(errors_m) < 4.0


@pytest.mark.slow
def test_a_network_watches_animals_to_the_end(fly: Callable[..., Flight], tmp_path: Path):
    detector = f"detector: {{kind: onnx, file: {ROOT}/models/detector.onnx, min_score: 0.3}}\n"
    mission = tmp_path / "network.yaml"
    mission.write_text((ROOT / "missions" / "animals.yaml").read_text() + detector)
    flight = fly("--mission", str(mission), "--horizon-au", "2.5", "--speed-up", "5")
    code, output = flight.finish()
    assert code == 0, output
    summary = flight.summary()
    assert (summary["outcome"], summary["is_landed"]) == ("completed", True)
    judge_pictures(summary, flight.lines("observations"), due=25)
    errors_m = _errors_m(flight, 200.0)
    assert len(errors_m) >= 5
    assert max(errors_m) < 4.0


GIMBAL = """
camera: {gimbal: true}
simulation: {seed: 3, faults: ["askew=8@15"]}
"""


@pytest.mark.slow
@pytest.mark.parametrize("has_gimbal", [False, True])
def test_observations_are_where_the_animals_are(
    fly: Callable[..., Flight], tmp_path: Path, has_gimbal: bool
):
    """The whole chain of projections: a sign error anywhere puts animals metres away.

    The gimbal is level while the drone banks, and 8 degrees off, which is 6 m here.
    """
    mission = tmp_path / "gimbal.yaml"
    text = (ROOT / "missions" / "animals.yaml").read_text()
    mission.write_text(text.partition("simulation:")[0] + GIMBAL)
    name = str(mission) if has_gimbal else "animals"
    flight = fly("--mission", name, "--planner", "tsp", "--horizon-au", "2", "--seed", "3")
    assert flight.finish()[0] == 0
    judge_pictures(flight.summary(), flight.lines("observations"), due=20)
    errors_m = _errors_m(flight, 200.0)
    assert len(errors_m) >= 3
    assert max(errors_m) < 3.0
    assert sorted(errors_m)[len(errors_m) // 2] < 1.0
    seen = [t for line in flight.lines("observations") for t in line["targets"].values()]
    allowed_m = [target["error_m"] for target in seen if target["seen"]]
    assert max(np.array(errors_m) / allowed_m) < 1.5
    assert np.mean(np.array(errors_m) > allowed_m) <= 0.1


@pytest.mark.slow
def test_ctrl_c_returns_and_lands_and_keeps_the_record(fly: Callable[..., Flight]):
    flight = fly("--planner", "lawnmower")
    flight.wait_for_event("patrol")
    flight.process.send_signal(signal.SIGINT)
    code, output = flight.finish()
    assert code == 130, output
    summary = flight.summary()
    assert summary["outcome"] == "interrupted"
    assert summary["is_landed"]
    assert summary["landing_error_m"] < 3.0
    assert output.count("Ctrl-C again lands it where it is") == 1
    _verify(flight)


@pytest.mark.slow
def test_a_closed_terminal_does_not_keep_the_drone_in_the_air(fly: Callable[..., Flight]):
    flight = fly("--planner", "lawnmower", "--horizon-au", "1")
    flight.wait_for_event("patrol")
    assert flight.process.stdout is not None
    flight.process.stdout.close()
    flight.process.wait(timeout=100)
    assert [e["kind"] for e in flight.lines("events")][-2:] == ["disarmed", "outcome"]
    assert flight.summary()["is_landed"]


@pytest.mark.slow
def test_a_simulator_that_ends_is_told_at_once(fly: Callable[..., Flight]):
    flight = fly("--planner", "tsp")
    flight.wait_for_event("patrol")
    _, *others = _family(flight.process.pid)
    killed_at = time.monotonic()
    for pid in others:
        if b"sim" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"):
            os.kill(pid, signal.SIGKILL)
    code, output = flight.finish()
    assert time.monotonic() < killed_at + 25.0
    assert code == 3
    assert "error: the simulator ended: " in output
    assert "the simulator ended" in flight.summary()["error"]
    assert "it is gone with its simulator" in output.splitlines()[-1]


@pytest.mark.slow
def test_nohup_is_heeded(fly: Callable[..., Flight]):
    flight = fly("--horizon-au", "0.5", "--planner", "tsp", before=["nohup"])
    flight.wait_for_event("patrol")
    flight.process.send_signal(signal.SIGHUP)
    flight.finish()
    assert flight.summary()["outcome"] == "completed"


@pytest.mark.slow
def test_a_sim_in_the_current_folder_is_not_run(tmp_path: Path):
    (tmp_path / "sim.py").write_text("raise SystemExit('this is another sim')")
    out = tmp_path / "run"
    options = ["--horizon-au", "0.5", "--speed-up", "20", "--out", str(out)]
    program = Path(sys.executable).parent / "dronemon"
    done = subprocess.run([program, "fly", *options], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_ctrl_c_twice_lands_on_the_spot(fly: Callable[..., Flight]):
    flight = fly("--planner", "lawnmower")
    flight.wait_for_event("patrol")
    flight.process.send_signal(signal.SIGINT)
    flight.wait_for_event("homecoming")
    flight.process.send_signal(signal.SIGINT)
    code, output = flight.finish()
    assert code == 130, output
    assert flight.summary()["is_landed"]
    assert "landing here" in output
    _verify(flight)


@pytest.mark.slow
def test_a_vehicle_at_a_url_with_animals_that_follow_it(
    fly: Callable[..., Flight], mock_vehicle: StartMockVehicle
):
    """The way a PX4 is flown: one link to fly, another one for the simulated camera."""
    follow_port = free_udp_port()
    vehicle = mock_vehicle(
        "animals", "--speed-up", "10", "--mavlink-out", f"127.0.0.1:{follow_port}"
    )
    flight = fly(
        *("--planner", "tsp", "--horizon-au", "1"),
        *("--vehicle", vehicle.url, "--follow", f"udpin://127.0.0.1:{follow_port}"),
    )
    code, output = flight.finish()
    assert code == 0, output
    summary = flight.summary()
    assert summary["is_landed"]
    judge_pictures(summary, flight.lines("observations"), due=10)
    assert summary["unc"] is not None
    assert vehicle.scenes() == []  # its own camera was not asked
