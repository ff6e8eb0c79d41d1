"""What a person sees in the terminal: one line of progress while flying, a table at the end."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:  # the runner is slow to import, and most commands do not fly
    from dronemon.runner import FlightStatus
    from dronemon.runner.status import Level

console = Console()
_errors = Console(stderr=True)
_STYLES: dict[Level, str] = {"INFO": "cyan", "WARN": "yellow", "ERROR": "bold red"}
_PLAIN_STEP = 0.1
_BAR_WIDTH = 24


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
        with self._quietly():
            self._live.stop()

    def status(self, status: FlightStatus) -> None:
        """Show progress."""
        with self._quietly():
            self._show(status)

    def _show(self, status: FlightStatus) -> None:
        if self._console.is_terminal:
            self._live.update(self._line(status))
            return
        share = status.flown_au / status.horizon_au if status.horizon_au else 0.0
        if status.phase != self._phase or share >= self._next_share:
            self._phase = status.phase
            self._next_share = (int(share / _PLAIN_STEP) + 1) * _PLAIN_STEP
            self._console.print(self._line(status), soft_wrap=True)

    def event(self, kind: str, text: str, level: Level) -> None:
        """Show something that happened."""
        with self._quietly():
            self._console.print(Text.assemble((f"{kind}: ", _STYLES[level]), text), soft_wrap=True)

    @contextlib.contextmanager
    def _quietly(self) -> Iterator[None]:
        """Nobody looks any more: the flight goes on (rich turns a closed pipe into SystemExit)."""
        with contextlib.suppress(OSError, SystemExit):
            yield

    def _line(self, status: FlightStatus) -> Text:
        share = min(status.flown_au / status.horizon_au, 1.0) if status.horizon_au else 0.0
        filled = round(share * _BAR_WIDTH)
        parts = [
            f"{status.phase:<14}",
            f"{'━' * filled}{'─' * (_BAR_WIDTH - filled)} {share:4.0%}",
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
