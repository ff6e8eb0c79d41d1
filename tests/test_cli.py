"""The command line: exit codes and messages of everything that fails before the flight."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from dronemon import cli

ANIMALS = (Path(__file__).parents[1] / "missions" / "animals.yaml").read_text()


def _run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: str
) -> tuple[int, str, str]:
    monkeypatch.setattr("sys.argv", ["dronemon", *words])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    output = capsys.readouterr()
    return int(caught.value.code or 0), output.out, output.err


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    return lambda *words: _run(monkeypatch, capsys, *words)


@pytest.fixture
def mission(tmp_path: Path):
    def write(old: str = "", new: str = "") -> str:
        path = tmp_path / "m.yaml"
        path.write_text(ANIMALS.replace(old, new, 1))
        return str(path)

    return write


def test_check_prints_what_would_be_flown(run):
    code, out, _ = run("check", "--mission", "animals")
    assert code == 0
    for words in ("26.7 m", "6000 m", "20.0 min", "22.5", "Bella (cow)", "300"):
        assert words in out


def test_lists(run):
    assert "animals" in run("missions")[1]
    assert "lawnmower" in run("planners")[1]
    assert '"horizon_au"' in run("schema")[1]


def test_bad_mission_is_exit_2_and_one_message(run, mission):
    for command in ("fly", "check"):
        code, _, err = run(command, "--mission", mission("altitude_m: 35", "altitude_m: 3"))
        assert code == 2
        assert err.count("error:") == 1
        assert "m.yaml:7: flight.altitude_m" in err.replace("\n", "")


def test_unknown_planner_names_the_line_and_the_others(run, mission):
    text = mission("kind: stamp", "kind: lawnmover")
    code, _, err = run("check", "--mission", text)
    assert code == 2
    assert "m.yaml:15: planner.kind" in err
    assert "lawnmower" in err


def test_missing_checkpoint(run, mission):
    text = mission("kind: stamp", "kind: stamp\n  checkpoint: no.pt")
    code, _, err = run("check", "--mission", text)
    assert code == 2
    assert "m.yaml:16: planner.checkpoint" in err
    assert "no.pt" in err


def test_a_bound_is_no_planner_to_fly(run, mission):
    text = mission("kind: stamp", "kind: clairvoyant")
    code, _, err = run("fly", "--mission", text)
    assert code == 2
    assert "told the future" in err


def test_real_vehicle_needs_a_camera_or_a_simulator_that_follows(run, mission):
    code, _, err = run("fly", "--mission", mission(), "--vehicle", "udpin://127.0.0.1:14540")
    assert code == 2
    assert "camera.url" in err
    assert "--follow" in err
    code, _, err = run("fly", "--mission", mission(), "--follow", "udpin://127.0.0.1:14550")
    assert code == 2
    assert "--vehicle" in err


def test_no_vehicle_is_exit_3_within_the_time_out(run, mission, tmp_path: Path):
    udp = (socket.AF_INET, socket.SOCK_DGRAM)
    with socket.socket(*udp) as first, socket.socket(*udp) as second:
        first.bind(("127.0.0.1", 0))
        second.bind(("127.0.0.1", 0))
        ports = first.getsockname()[1], second.getsockname()[1]
    text = mission("simulation:", "vehicle:\n  connect_timeout_s: 1.0\nsimulation:")
    vehicle, follow = (f"udpin://127.0.0.1:{port}" for port in ports)
    out = tmp_path / "run"
    code, _, err = run(
        "fly", "-m", text, "--vehicle", vehicle, "--follow", follow, "--out", str(out)
    )
    assert code == 3
    assert f"no autopilot heard on {vehicle} after 1 s" in err
    assert '"outcome": "failed"' in (out / "summary.json").read_text()


def test_a_run_folder_is_not_flown_over(run, mission, tmp_path: Path):
    (tmp_path / "summary.json").write_text("{}")
    code, _, err = run("fly", "-m", mission(), "--out", str(tmp_path))
    assert code == 6
    assert "already holds a run" in err
