"""What a person sees in the terminal: one line of progress while flying, a table at the end."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from dronemon.events import Event, Level, Noted, Progressed


class LenientConsole(Console):
    """Falls silent when its output is closed or full: what nobody reads ends nothing."""

    def _write_buffer(self) -> None:
        try:
            super()._write_buffer()
        except OSError:
            self.quiet = True
            with contextlib.suppress(OSError), Path(os.devnull).open("wb") as nowhere:
                os.dup2(nowhere.fileno(), self.file.fileno())  # what the stream still holds


console = LenientConsole()
_errors = LenientConsole(stderr=True)
_STYLES: dict[Level, str] = {"INFO": "cyan", "WARN": "yellow", "ERROR": "bold red"}
_PLAIN_STEP = 0.1
_BAR_WIDTH = 24


def write_in_any_encoding() -> None:
    """What the output's encoding lacks is written as `?` rather than ending the program."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


class FlightDisplay:
    """Shows a flight while it lasts. Without a terminal it prints a line every tenth of the way."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=4, transient=True)
        self._phase = ""
        self._next_share = _PLAIN_STEP

    def __enter__(self) -> FlightDisplay:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def take(self, event: Event) -> None:
        """Show what a person wants to know of it; errors go to standard error."""
        match event:
            case Progressed():
                self._show(event)
            case Noted():
                console = _errors if event.level == "ERROR" else self._console
                kind = (f"{event.kind}: ", _STYLES[event.level])
                console.print(Text.assemble(kind, event.text), soft_wrap=True)

    def _show(self, status: Progressed) -> None:
        if self._console.is_terminal:
            self._live.update(self._line(status))
            return
        share = status.flown_au / status.horizon_au if status.horizon_au else 0.0
        if status.phase != self._phase or share >= self._next_share:
            self._phase = status.phase
            self._next_share = (int(share / _PLAIN_STEP) + 1) * _PLAIN_STEP
            self._console.print(self._line(status), soft_wrap=True)

    def _line(self, status: Progressed) -> Text:
        done, to_do = "━─" if self._console.encoding.lower().startswith("utf") else "=-"
        share = min(status.flown_au / status.horizon_au, 1.0) if status.horizon_au else 0.0
        filled = round(share * _BAR_WIDTH)
        parts = [
            f"{status.phase:<14}",
            f"{done * filled}{to_do * (_BAR_WIDTH - filled)} {share:4.0%}",
            f"{status.flown_au:.1f}/{status.horizon_au:g} au",
            f"{_minutes(status.left_s)} left",
            f"{status.speed_m_s:.1f} m/s",
            "battery ?" if status.battery is None else f"battery {status.battery:.0%}",
        ]
        seen = [
            f"{name} {'never' if ago_s is None else f'{ago_s:.0f} s ago'}"
            for name, ago_s in status.since_seen_s.items()
        ]
        return Text("  ".join(parts) + "  seen: " + ", ".join(seen))


def _minutes(seconds_s: float) -> str:
    return f"{int(seconds_s // 60)}:{int(seconds_s % 60):02d}"


def facts_table(title: str, facts: Mapping[str, str]) -> Table:
    """A two-column table of named facts."""
    table = Table(title=Text(title), show_header=False, title_justify="left")
    table.add_column(style="cyan")
    table.add_column()
    for name, value in facts.items():
        table.add_row(Text(name), Text(value))
    return table


def print_error(message: str) -> None:
    """Say what went wrong, on stderr, a line each."""
    for line in message.splitlines():
        _errors.print(f"error: {line}", style="bold red", soft_wrap=True, markup=False)


def print_warning(message: str) -> None:
    """Say what may go less well than hoped, on stderr."""
    _errors.print(f"warning: {message}", style="yellow", soft_wrap=True, markup=False)
