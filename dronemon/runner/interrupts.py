"""What a person may ask of a flight while it lasts: to come home, and then to land at once."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable


class Interrupted(Exception):
    """A person stopped what can be left at once."""


class Interrupts:
    """How often a person asked: once brings the drone home, twice lands it now."""

    def __init__(self) -> None:
        self.count = 0
        self.is_hopeless = False
        self._on_request: Callable[[], None] | None = None

    def request(self) -> None:
        """Ask once more."""
        self.count += 1
        leave, self._on_request = self._on_request, None  # it is left once
        if leave is not None:
            leave()

    def give_up(self) -> None:
        """Say that a vehicle that falls silent will never be heard again."""
        self.is_hopeless = True

    @contextlib.asynccontextmanager
    async def leaving(self, after: int = 0) -> AsyncIterator[None]:
        """Leave the body at the first request after so many. Raises Interrupted then."""
        if self.count > after:
            raise Interrupted
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(None) as scope:
                self._on_request = lambda: scope.reschedule(loop.time())
                yield
        except TimeoutError as exc:
            if scope.expired():
                raise Interrupted from exc
            raise
        finally:
            self._on_request = None
