"""What the outside may ask of a flight, and what it is told while it lasts."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

Level = Literal["INFO", "WARN", "ERROR"]
REPORT_INTERVAL_S = 1.0
"""Vehicle time between two lines of progress."""


class Interrupted(Exception):
    """A person stopped what can be left at once."""


class Interrupts:
    """What a person asked for: the first request brings the drone home, the second lands it now."""

    def __init__(self) -> None:
        self._count = 0
        self.on_request: Callable[[], None] | None = None
        """Called at every request; a step that can be left at once sets it."""

    def request(self) -> None:
        """Ask once more."""
        self._count += 1
        if self.on_request is not None:
            self.on_request()

    @contextlib.asynccontextmanager
    async def leaving(self) -> AsyncIterator[None]:
        """Leave the body at the first request. Raises Interrupted then."""
        if self.return_home:
            raise Interrupted
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(None) as scope:
                self.on_request = lambda: scope.reschedule(loop.time())
                yield
        except TimeoutError as exc:
            if scope.expired():
                raise Interrupted from exc
            raise
        finally:
            self.on_request = None

    @property
    def return_home(self) -> bool:
        """Whether to return and land."""
        return self._count >= 1

    @property
    def land_now(self) -> bool:
        """Whether to land where the drone is."""
        return self._count >= 2


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightStatus:
    """A line of progress. since_seen_s: seconds since each target was seen; None: never."""

    phase: str
    flown_au: float = 0.0
    horizon_au: float = 0.0
    left_s: float = 0.0
    speed_m_s: float = 0.0
    battery: float | None = None
    since_seen_s: Mapping[str, float | None]


class Audience(Protocol):
    """Whoever watches the flight from outside."""

    def status(self, status: FlightStatus) -> None:
        """Take a line of progress; comes about once a second of vehicle time."""
        ...

    def event(self, kind: str, text: str, level: Level) -> None:
        """Take something that happened."""
        ...
