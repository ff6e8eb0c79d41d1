"""What a person sees, whatever the terminal can show."""

from __future__ import annotations

import io

from rich.console import Console

from dronemon.events import Moved, Noted, Progressed
from dronemon.terminal import FlightDisplay, LenientConsole
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


def test_a_full_disk_or_a_closed_pipe_ends_no_display():
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(28, "No space left on device")

    for is_terminal in (False, True):
        console = LenientConsole(file=Full(), force_terminal=is_terminal)
        with FlightDisplay(console) as display:
            display.take(Progressed(phase="patrol", flown_au=1.0, horizon_au=2.0, since_seen_s={}))
            display.take(Noted(time_s=1.0, kind="a", text="b", level="INFO", fields={}))
