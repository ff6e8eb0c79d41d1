"""The command line: exit codes and messages of everything that fails before the flight."""

from __future__ import annotations

import json
import os
import pty
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from dronemon import cli

MISSIONS = Path(__file__).parents[1] / "missions"
ANIMALS = (MISSIONS / "animals.yaml").read_text()
ALTITUDE = next(line.strip() for line in ANIMALS.splitlines() if "altitude_m" in line)
SLOW = ("torch", "numba", "scipy", "mavsdk", "cv2", "rerun", "matplotlib")


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
    for words in ("42.2 m", "7.1 pixels", "6000 m", "20.0 min", "25.5", "Bella (cow)", "300"):
        assert words in out


def test_the_mission_is_an_argument_or_an_option(run, mission):
    path = mission("kind: stamp", "kind: tsp")
    for words in ((path,), ("--mission", path), ("-m", path)):
        code, out, _ = run("check", *words)
        assert code == 0
        assert "m.yaml: can be flown" in " ".join(out.split())
    code, _, err = run("check", path, "--mission", "animals")
    assert code == 2
    assert "given twice" in err


def test_check_takes_the_options_of_fly(run, mission):
    path = mission()
    code, out, _ = run("check", path, "--planner", "tsp", "--horizon-au", "3", "--no-view")
    assert code == 0
    assert "600 m" in out
    assert "tsp" in out
    code, _, err = run("check", path, "--planner", "tsp", "--horizon-au", "60", "--speed-up", "99")
    assert code == 2
    assert err.startswith("error: --speed-up: ")
    code, _, err = run("check", path, "--planner", "lawnmover", "--horizon-au", "60")
    assert code == 2
    told = sorted(line.split(": ")[1] for line in err.splitlines())
    assert told == ["--horizon-au", "--planner"]


def test_what_answers_at_once_imports_nothing_slow(mission):
    """In a process of its own: here all of it is imported already."""
    program = f"""
import sys
from dronemon import cli
for words in (["--help"], ["fly", "-h"], ["planners"], ["schema"], ["missions"],
              ["check", {mission("kind: stamp", "kind: search")!r}], ["check", "animals"]):
    sys.argv = ["dronemon", *words]
    try:
        cli.main()
    except SystemExit as end:
        assert not end.code, (words, end.code)
    slow = [name for name in {SLOW} if name in sys.modules]
    if words[-1] in ("--help", "-h"):
        slow += [name for name in ("numpy", "yaml") if name in sys.modules]
    assert not slow, (words, slow)
"""
    subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize("command", [(), ("fly",), ("check",), ("evaluate",), ("train",)])
def test_help_has_a_short_form_everywhere(run, command):
    code, out, _ = run(*command, "-h")
    assert code == 0
    assert f"dronemon {' '.join(command)}".strip() in out
    assert "--help" in out


def test_facts_are_json_for_scripts(run):
    code, out, _ = run("check", "animals", "--json")
    assert code == 0
    assert json.loads(out)["targets"] == "Bella (cow), Zuri (zebra), Rusty (fox)"


def test_options_reach_the_commands_that_are_defined_elsewhere(run, tmp_path: Path):
    code, _, err = run("evaluate", "--out", str(tmp_path), "--planner", "tsp", "--prior", "some")
    assert code == 2
    assert "--prior some is none of" in err


def test_a_mission_to_start_from_passes_the_check_and_is_never_written_over(run, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    assert run("init", str(path))[0] == 0
    assert run("check", str(path))[0] == 0
    path.write_text("mine")
    code, _, err = run("init", str(path))
    assert code == 2
    assert "mine.yaml" in err
    assert path.read_text() == "mine"


def test_lists(run):
    assert "animals" in run("missions")[1]
    assert "lawnmower: parallel lanes" in run("planners")[1]


def test_the_shipped_schema_is_what_the_command_prints(run):
    printed = json.loads(run("schema")[1])
    assert printed == json.loads((MISSIONS / "mission.schema.json").read_text())
    kind = printed["$defs"]["Planner"]["properties"]["kind"]
    assert kind["default"] == "search"
    assert {"search", "stamp", "tsp"} <= set(kind["anyOf"][0]["enum"])
    assert "clairvoyant" not in kind["anyOf"][0]["enum"]


def test_what_the_detector_cannot_see_is_refused_with_the_numbers(run, mission):
    code, _, err = run("check", mission(ALTITUDE, "altitude_m: 100"), "--planner", "tsp")
    assert code == 2
    assert "m.yaml:7: flight.altitude_m: 100 m is too high" in err
    assert "3.2 pixels" in err
    assert "fly at 42.3 to 58.1 m" in err
    wide = mission("side_m: 200", "side_m: 600")
    code, _, err = run("fly", wide, "--planner", "tsp")
    assert code == 2
    assert "m.yaml:5: area.side_m: 600 m is too large for the camera" in err
    assert "126.7 m" in err
    assert "make it 274.6 m or less" in err


def test_bad_mission_is_exit_2_and_one_message(run, mission):
    for command in ("fly", "check"):
        code, _, err = run(command, "--mission", mission(ALTITUDE, "altitude_m: 3"))
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


def test_what_the_network_was_not_trained_for_is_told(run, mission):
    code, _, err = run("check", mission("speed_ratio: 0.05", "speed_ratio: 0.5"))
    assert code == 0
    assert err.startswith("warning: planner stamp: 0.5 times the drone's speed")
    for known in ("fox, prior_au: simulated", "fox"):
        assert run("check", mission("fox, prior_au: simulated", known))[2] == ""


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
    for follow in ("udp://127.0.0.1:14550", "udpin://127.0.0.1", "tcpin://127.0.0.1:14550"):
        code, _, err = run("check", "--follow", follow)
        assert code == 2
        assert err.startswith("error: --follow: ")
    same = "udpin://127.0.0.1:14540"
    code, _, err = run("check", "--vehicle", same, "--follow", same)
    assert code == 2
    assert err.startswith(f"error: --vehicle: {same} is --follow's too")
    code, _, err = run(
        "check", mission(ALTITUDE, "altitude_m: 3"), "--follow", "udpin://localhost:14550"
    )
    assert code == 2
    assert "--follow: " in err
    assert "flight.altitude_m" in err
    path = mission("simulation:", "camera: {gimbal: true}\nsimulation:")
    options = ("--vehicle", same, "--follow", "udpin://127.0.0.1:14550")
    code, _, err = run("check", path, *options)
    assert code == 2
    assert "camera.gimbal: is of a real camera or of the mock's" in err


@pytest.mark.parametrize("words", [("",), ("--mission", "")])
def test_no_name_is_no_mission(run, words):
    for command in ("check", "fly"):
        code, _, err = run(command, *words)
        assert code == 2
        assert "no such mission, neither a .yaml file nor shipped" in err


@pytest.mark.lengthy
def test_output_that_cannot_be_written_ends_nothing(mission):
    command = [sys.executable, "-m", "dronemon.cli", "check", mission()]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")
    reader, writer = os.pipe()
    os.close(reader)
    ended = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--device", "tpu"), 2, "--device tpu: there is none; give auto, cpu or cuda"),
        (("--device", "cpu"), 6, "choose another --out"),
    ],
)
def test_where_training_cannot_run_is_told_first(run, tmp_path: Path, words, code, said):
    (tmp_path / "file").touch()
    found, _, err = run("train", "--out", str(tmp_path / "file"), *words)
    assert found == code
    assert said in err


def _silent_urls() -> list[str]:
    """Where nobody sends and nobody else listens."""
    udp = (socket.AF_INET, socket.SOCK_DGRAM)
    with socket.socket(*udp) as first, socket.socket(*udp) as second:
        first.bind(("127.0.0.1", 0))
        second.bind(("127.0.0.1", 0))
        return [f"udpin://127.0.0.1:{one.getsockname()[1]}" for one in (first, second)]


@pytest.mark.parametrize("has_follower", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_no_vehicle_is_exit_3_within_the_time_out(run, mission, tmp_path: Path, has_follower: bool):
    vehicle, follow = _silent_urls()
    path = Path(mission("simulation:", "vehicle:\n  connect_timeout_s: 1.0\nsimulation:"))
    options = ["--vehicle", vehicle]
    if has_follower:
        options += ["--follow", follow]
    else:
        text = path.read_text().replace(", prior_au: simulated", "")
        path.write_text(text + "camera:\n  url: rtsp://127.0.0.1/\n")
    out = tmp_path / "run"
    code, _, err = run("fly", "-m", str(path), *options, "--out", str(out))
    assert code == 3, err
    assert f"no autopilot heard on {vehicle} after 1 s" in err
    assert err.count("no autopilot heard") == 1
    assert not out.exists()


def test_a_run_folder_is_not_flown_over(run, mission, tmp_path: Path):
    (tmp_path / "summary.json").write_text("{}")
    code, _, err = run("fly", "-m", mission(), "--out", str(tmp_path))
    assert code == 6
    assert "already holds a run" in err


@pytest.mark.parametrize("value", ["1_0", "010", "0x10", "nan", "1e999", " 1", "٣", ""])
def test_a_parameter_is_set_to_what_a_mission_takes_as_a_number(run, mission, value: str):
    code, _, err = run("preflight", "-m", mission(), "--set", f"GF_ACTION={value}", "--yes")
    assert code == 2
    assert "with a plain number, such as COM_OBL_RC_ACT=3" in err


@pytest.mark.lengthy
@pytest.mark.parametrize(("answer", "code"), [("n", 2), ("y", 3)])
def test_a_parameter_is_set_once_a_person_says_so(mission, tmp_path: Path, answer: str, code: int):
    vehicle, follow = _silent_urls()
    path = mission("simulation:", "vehicle:\n  connect_timeout_s: 1.0\nsimulation:")
    command = [sys.executable, "-m", "dronemon.cli", "fly", path, "--set", "GF_ACTION=3"]
    person, terminal = pty.openpty()
    os.write(person, f"{answer}\n".encode())
    done = subprocess.run(
        [*command, "--vehicle", vehicle, "--follow", follow, "--out", str(tmp_path / "run")],
        stdin=terminal,
        capture_output=True,
        text=True,
        check=False,
    )
    os.close(person)
    os.close(terminal)
    assert done.returncode == code, done.stderr
    assert "Set GF_ACTION=3 on the vehicle, and put it back afterwards?" in done.stdout
    assert ("not confirmed; nothing was done" in done.stderr) == (answer == "n")
