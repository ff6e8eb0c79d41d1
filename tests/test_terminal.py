"""What a person sees, whatever the terminal can show."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import threading
from typing import NoReturn
from unicodedata import category

import pytest
from rich.console import Console

from dronemon.events import Moved, Noted, Progressed
from dronemon.terminal import FlightDisplay, LenientConsole, facts_table
from dronemon.types import Pose


def test_a_flight_is_shown_in_any_encoding():
    raw = io.BytesIO()
    console = Console(file=io.TextIOWrapper(raw, encoding="latin-1", errors="replace"))
    with FlightDisplay(console) as display:
        display.take(
            Progressed(phase="patrol", flown_au=1.0, horizon_au=2.0, since_seen_s={"Ζήνα": None})
        )
        display.take(Noted(time_s=1.0, kind="autopilot", text="höher ✈", level="INFO", fields={}))
        at_rest = (0.0, 0.0, 0.0)
        display.take(
            Moved(
                pose=Pose(
                    time_s=1.0,
                    position_ned_m=at_rest,
                    velocity_ned_m_s=at_rest,
                    attitude_rad=at_rest,
                )
            )
        )
    console.file.flush()
    lines = raw.getvalue().decode("latin-1").splitlines()
    assert "============------------  50%" in lines[0]
    assert lines[0].endswith("seen: ???? never")
    assert lines[1:] == ["autopilot: höher ?"]


def test_of_many_targets_those_out_of_sight_for_longest_are_named():
    shown = io.StringIO()
    console = LenientConsole(file=shown, force_terminal=False, width=80)
    since_s = {f"zebra {n}": 10.0 * n for n in range(1, 8)} | {"zebra 8": None}
    with FlightDisplay(console) as display:
        display.take(Progressed(phase="patrol", flown_au=1.0, horizon_au=2.0, since_seen_s=since_s))
    last = shown.getvalue().splitlines()[-1]
    assert last.endswith(
        "longest not seen: zebra 8 never, zebra 7 70 s ago, zebra 6 60 s ago, zebra 5 50 s ago,"
        " zebra 4 40 s ago"
    )


@pytest.mark.parametrize("width", [80, 40])
def test_a_flight_fits_the_terminal(width: int):
    """Only the targets may take more than a row each."""
    console = Console(file=io.StringIO(), force_terminal=True, color_system=None, width=width)
    with FlightDisplay(console) as display:
        display.take(
            Progressed(
                phase="coming home",
                flown_au=123.4,
                horizon_au=300.0,
                left_s=7199.0,
                speed_m_s=12.3,
                battery=1.0,
                battery_needed=0.35,
                since_seen_s={f"animal {number}": 100.0 for number in range(8)},
            )
        )
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    rows = re.sub(r"\x1b\[[?\d]*[a-zA-Z]|\r", "", shown).splitlines()
    bars = [row for row in rows if row.startswith("coming home")]
    assert bars
    assert max(map(len, rows)) <= width
    follow = [rows[i + 1] for i, row in enumerate(rows) if row in bars]
    assert all(row.startswith("123.4/300 au") for row in follow)
    if width == 80:
        assert all(row.endswith("41%  119:59 left") for row in bars)
        assert all(row.endswith("battery 100% (35% home)") for row in follow)


@pytest.mark.lengthy
@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1"}])
def test_what_is_piped_has_no_colours_and_rings_no_bell(environment: dict[str, str]):
    for options in (["missions"], ["check", "animals"]):
        done = subprocess.run(
            [sys.executable, "-m", "dronemon.cli", *options],
            capture_output=True,
            env=os.environ | environment,
            check=True,
            timeout=60,
        )
        assert b"\x1b" not in done.stdout + done.stderr
        assert b"\x07" not in done.stdout + done.stderr


def test_a_full_disk_or_a_closed_pipe_ends_no_display():
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(28, "No space left on device")

    for is_terminal in (False, True):
        console = LenientConsole(file=Full(), force_terminal=is_terminal)
        with FlightDisplay(console) as display:
            display.take(Progressed(phase="patrol", flown_au=1.0, horizon_au=2.0, since_seen_s={}))
            display.take(Noted(time_s=1.0, kind="a", text="b", level="INFO", fields={}))


@pytest.mark.parametrize("is_terminal", [False, True])
def test_what_others_say_commands_no_terminal(is_terminal: bool):
    console = LenientConsole(file=io.StringIO(), force_terminal=is_terminal, color_system=None)
    evil = "a\x1b[2J\x1b]0;b\x07c\x9b31m\u202ed\ud83de\nf"
    with FlightDisplay(console) as display:
        display.take(Noted(time_s=1.0, kind="autopilot", text=evil, level="INFO", fields={}))
        seen = {evil: None}
        display.take(Progressed(phase="patrol", flown_au=1.0, horizon_au=2.0, since_seen_s=seen))
    console.print(facts_table(evil, {evil: evil}))
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    own = {"\x1b[?25l", "\x1b[?25h", "\x1b[2K", "\x1b[1A", "\r"} if is_terminal else set()
    for command in own:
        shown = shown.replace(command, "")
    assert {c for c in shown if category(c) in {"Cc", "Cf", "Cs"}} <= {"\n"}
    assert "autopilot: a\ufffd[2J\ufffd]0;bc\ufffd31m\ufffdd\ufffde f\n" in shown
    assert console.dropped == 0


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_terminal_that_stands_still_holds_up_nobody(
    is_terminal: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("dronemon.terminal._CLOSE_S", 0.0)
    is_stopped, goes_on = threading.Event(), threading.Event()

    class Stopped(io.StringIO):
        def write(self, text: str) -> int:
            is_stopped.set()
            goes_on.wait()
            return len(text)

    console = LenientConsole(file=Stopped(), force_terminal=is_terminal)
    note = Noted(time_s=1.0, kind="a", text="b", level="INFO", fields={})
    with FlightDisplay(console) as display:
        display.take(note)
        assert is_stopped.wait(10.0)
        for _ in range(1002):
            display.take(note)
        assert display.lost in {f"{n} lines that the terminal had no time for" for n in (2, 3)}
    goes_on.set()


def test_what_cannot_be_drawn_is_counted():
    class Broken:
        def __rich_console__(self, console: Console, options: object) -> NoReturn:
            raise ValueError("no")

    console = LenientConsole(file=io.StringIO())
    console.print(Broken())
    console.print("on")
    assert console.dropped == 1
    assert console.file.getvalue() == "on\n"  # type: ignore[attr-defined]


@pytest.mark.lengthy
@pytest.mark.parametrize("options", [["--help"], ["--version"], ["planners"]])
@pytest.mark.parametrize("output", ["/dev/full", "pipe", "closed"])
def test_an_output_that_takes_nothing_ends_no_command(options: list[str], output: str):
    environment = os.environ | {"PYTHONIOENCODING": "latin-1", "LC_ALL": "C", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "dronemon.cli", *options]
    if output == "closed":
        command = ["sh", "-c", '"$@" >&- 2>&-', "sh", *command]
    reading, writing = os.pipe()
    os.close(reading)
    target = os.open(output, os.O_WRONLY) if output == "/dev/full" else writing
    try:
        done = subprocess.run(command, stdout=target, stderr=target, env=environment, timeout=60)
    finally:
        os.close(writing)
    assert done.returncode == 0
