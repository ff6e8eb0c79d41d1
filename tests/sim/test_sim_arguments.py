from __future__ import annotations

import pytest

from sim.__main__ import main

OUT = ("--mavlink-out", "127.0.0.1:14540")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["animals", *OUT, "--speed-up", "50"], "1 to 20"),
        (["animals", *OUT, "--speed-up", "nan"], "1 to 20"),
        (["animals", "--mavlink-out", "14540"], "IP:PORT"),
        (["animals", *OUT, "--fault", "storm@3"], "storm@3"),
        (["animals", "--follow", "tcp://127.0.0.1:3"], "udpin"),
        (["animals"], "--mavlink-out"),
        (["animals", "--follow", "udpin://127.0.0.1:4000", "--speed-up", "5"], "--follow"),
    ],
)
def test_bad_argument_ends_with_status_2(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert says in capsys.readouterr().err


def test_missing_mission_ends_with_status_2(caplog: pytest.LogCaptureFixture) -> None:
    assert main(["nowhere.yaml", *OUT]) == 2
    assert "nowhere.yaml" in caplog.text
