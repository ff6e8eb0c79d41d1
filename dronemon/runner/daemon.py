"""Calls that may hang, out of the way of everything else."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import ClassVar, TypeVar

from dronemon.errors import DronemonError

T = TypeVar("T")
BUSY, IDLE = "foreign", "foreign, idle"
"""Names of the threads."""


class _Thread(threading.Thread):
    """Does one call after the other: a new thread each time costs time and memory.

    One that hangs is never asked again.
    """

    _idle: ClassVar[list[_Thread]] = []

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._calls = SimpleQueue[Callable[[], None]]()
        self.start()

    @classmethod
    def do(cls, call: Callable[[], None]) -> None:
        """Have an idle thread do it, or a new one."""
        try:
            thread = cls._idle.pop()
        except IndexError:
            thread = cls()
        thread.name = BUSY
        thread._calls.put(call)

    def run(self) -> None:
        while True:
            self._calls.get()()
            self.name = IDLE
            self._idle.append(self)


async def in_daemon_thread(
    call: Callable[[], T], who: str, error: type[DronemonError], limit_s: float | None = None
) -> T:
    """Run foreign code where it can hang without keeping the program from ending.

    Raises `error`, which names `who`, for whatever it raises, and after `limit_s` of wall time.
    """
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[T] = loop.create_future()

    def work() -> None:
        try:
            settle = partial(answer.set_result, call())
        except error as exc:
            settle = partial(answer.set_exception, exc)
        except BaseException as exc:  # noqa: BLE001 - sys.exit too; the drone returns
            settle = partial(answer.set_exception, error(f"{who} failed: {exc!r}"))
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(lambda: answer.cancelled() or settle())

    _Thread.do(work)
    try:
        async with asyncio.timeout(limit_s):
            return await answer
    except TimeoutError:
        raise error(f"{who} gave no answer for {limit_s:g} s") from None
