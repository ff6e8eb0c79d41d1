from __future__ import annotations

from pathlib import Path

import pytest

from dronemon.mission.faults import Fault
from sim.__main__ import _parse, main

OUT = ("--mavlink-out", "127.0.0.1:14540")
FOLLOW = ("animals", "--follow", "udpin://127.0.0.1:4000")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["animals", *OUT, "--speed-up", "50"], "1 to 20"),
        (["animals", *OUT, "--speed-up", "nan"], "1 to 20"),
        (["animals", "--mavlink-out", "14540"], "IP:PORT"),
        (["animals", *OUT, "--fault", "storm@3"], "storm@3"),
        (["animals", "--follow", "tcp://127.0.0.1:3"], "udpin"),
        (["animals"], "--mavlink-out"),
        ([*FOLLOW, "--speed-up", "5"], "--follow"),
        ([*FOLLOW, "--fault", "torn@5", "--fault", "gps@5"], "only the camera is simulated"),
    ],
)
def test_bad_argument_ends_with_status_2(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert says in capsys.readouterr().err


def test_who_follows_takes_faults_of_the_camera_and_no_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = _parse([*FOLLOW, "--fault", "torn@5"])
    assert options.fault == [Fault(kind="torn", at_s=5.0)]
    key = tmp_path / "key"
    key.write_bytes(bytes(32))
    with pytest.raises(SystemExit):
        _parse([*FOLLOW, "--signing-key", str(key)])
    assert "--signing-key, --clock do not apply" in capsys.readouterr().err


def test_missing_mission_ends_with_status_2(caplog: pytest.LogCaptureFixture) -> None:
    assert main(["nowhere.yaml", *OUT]) == 2
    assert "nowhere.yaml" in caplog.text
