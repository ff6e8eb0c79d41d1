"""What a person sees in the terminal: one line of progress while flying, a table at the end."""

from __future__ import annotations

import contextlib
import io
import json
import math
import sys
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from unicodedata import category

from rich.console import Console, Group
from rich.live import Live
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from dronemon.events import Event, Level, Noted, Progressed
from dronemon.waiting import BoundedQueue


class LenientConsole(Console):
    """Shows what it can; what fails is counted in `dropped`, and ends nothing.

    What others say (autopilots, missions) is shown without the characters that command a terminal.
    """

    dropped = 0

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, if it can."""
        try:
            super().print(*objects, **options)
        except Exception:  # noqa: BLE001 - no display is worth a flight
            self.dropped += 1

    def _write_buffer(self) -> None:
        try:
            super()._write_buffer()
        except Exception:  # noqa: BLE001
            self.dropped += 1
            self._buffer.clear()

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        shown = (Segment(harmless(s.text), s.style) if not s.control else s for s in buffer)
        return super()._render_buffer(shown)


def harmless(text: str) -> str:
    """The text without control characters, marks of direction and halves of characters."""
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if category(c) in _COMMANDING and c != "\n" else c for c in text
    )


console = LenientConsole()
_errors = LenientConsole(stderr=True)
_STYLES: dict[Level, str] = {"INFO": "cyan", "WARN": "yellow", "ERROR": "bold red"}
_COMMANDING = {"Cc", "Cf", "Cs", "Zl", "Zp"}
_PLAIN_STEP = 0.1
_MOST_NAMED = 5
_BAR_WIDTH = 24
_MAX_WAITING = 1000
_CLOSE_S = 3.0


class _Forgiving(io.FileIO):
    """An output that drops what a closed pipe or a full disk does not take."""

    def write(self, data: Any) -> int:
        with contextlib.suppress(OSError):
            if (written := super().write(data)) is not None:
                return written
        return len(data)


def forgive_outputs() -> None:
    """From now on no output ends the program; what its encoding lacks is written as `?`."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if type(stream) is io.TextIOWrapper:
            raw = _Forgiving(stream.fileno(), "w", closefd=False)
            forgiving = io.TextIOWrapper(
                io.BufferedWriter(raw),
                encoding=stream.encoding,
                errors="replace",
                line_buffering=stream.line_buffering,
            )
            setattr(sys, name, forgiving)


class FlightDisplay:
    """Shows a flight while it lasts. Without a terminal it prints a line every tenth of the way.

    A thread does it: a terminal may be stopped (Ctrl-S) while the drone flies.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=4, transient=True)
        self._phase = ""
        self._next_share = _PLAIN_STEP
        self._queue = BoundedQueue[Event](max_items=_MAX_WAITING)
        self._thread = threading.Thread(target=self._work, name="terminal", daemon=True)

    def __enter__(self) -> FlightDisplay:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.close(_CLOSE_S)
        self._thread.join(_CLOSE_S)

    def take(self, event: Event) -> None:
        """Show what a person wants to know of it; errors go to standard error."""
        if isinstance(event, Progressed | Noted):
            self._queue.put(event)

    @property
    def lost(self) -> str:
        """How many lines a terminal that stood still did not take."""
        number = self._queue.dropped
        return f"{number} lines that the terminal had no time for" if number else ""

    def _work(self) -> None:
        if self._console.is_terminal:
            self._live.start()
        for event in self._queue:
            match event:
                case Progressed():
                    self._show(event)
                case Noted():
                    console = _errors if event.level == "ERROR" else self._console
                    kind = (f"{event.kind}: ", _STYLES[event.level])
                    text = " ".join(event.text.splitlines())
                    console.print(Text.assemble(kind, text), soft_wrap=True)
        self._live.stop()

    def _show(self, status: Progressed) -> None:
        rows = self._rows(status)
        if self._console.is_terminal:
            *first, seen = (Text(row) for row in rows)
            for row in first:
                row.no_wrap, row.overflow = True, "ellipsis"
            self._live.update(Group(*first, seen))
            return
        share = status.flown_au / status.horizon_au if status.horizon_au else 0.0
        if status.phase != self._phase or share >= self._next_share:
            self._phase = status.phase
            self._next_share = (int(share / _PLAIN_STEP) + 1) * _PLAIN_STEP
            self._console.print(Text("  ".join(rows)), soft_wrap=True)

    def _rows(self, status: Progressed) -> tuple[str, str, str]:
        """How far it is, how the vehicle is, and who was seen when."""
        done, to_do = "━─" if self._console.encoding.lower().startswith("utf") else "=-"
        share = min(status.flown_au / status.horizon_au, 1.0) if status.horizon_au else 0.0
        filled = round(share * _BAR_WIDTH)
        level = "?" if status.battery is None else f"{status.battery:.0%}"
        battery = f"  battery {level} ({status.battery_needed:.0%} home)"
        is_flown = status.battery is not None or status.battery_needed > 0.0
        return (
            f"{status.phase:<14}  {done * filled}{to_do * (_BAR_WIDTH - filled)} {share:4.0%}"
            f"  {_minutes(status.left_s)} left",
            f"{status.flown_au:.1f}/{status.horizon_au:g} au  {status.speed_m_s:.1f} m/s"
            + (battery if is_flown else ""),
            _seen(status.since_seen_s),
        )


def _seen(since_seen_s: Mapping[str, float | None]) -> str:
    """When targets were seen; of many only those that have been out of sight for longest."""
    ago = {name: math.inf if ago_s is None else ago_s for name, ago_s in since_seen_s.items()}
    shown = sorted(ago, key=ago.__getitem__, reverse=True)[:_MOST_NAMED]
    named = shown if len(ago) > _MOST_NAMED else list(ago)
    told = (
        f"{name} {'never' if ago[name] == math.inf else f'{ago[name]:.0f} s ago'}" for name in named
    )
    return f"{'longest not ' if named is shown else ''}seen: {', '.join(told)}"


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


def print_facts(title: str, facts: Mapping[str, str], as_json: bool) -> None:
    """Named facts as a table for people, or without the title for scripts."""
    if as_json:
        sys.stdout.write(json.dumps(facts, indent=2, ensure_ascii=False) + "\n")
    else:
        console.print(facts_table(title, facts))


def print_path(path: Path) -> None:
    """Say where something was written, as it can be copied."""
    console.print(path, soft_wrap=True, markup=False, highlight=False)


def print_error(message: str) -> None:
    """Say what went wrong, on stderr, a line each."""
    for line in message.splitlines():
        _errors.print(f"error: {line}", style="bold red", soft_wrap=True, markup=False)


def print_warning(message: str) -> None:
    """Say what may go less well than hoped, on stderr."""
    _errors.print(f"warning: {message}", style="yellow", soft_wrap=True, markup=False)
