"""Calls that may hang, out of the way of everything else."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from functools import partial
from typing import TypeVar

T = TypeVar("T")


async def in_daemon_thread(call: Callable[[], T]) -> T:
    """Run a planner where it can hang without keeping the program from ending."""
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[T] = loop.create_future()

    def work() -> None:
        try:
            result = call()
        except Exception as exc:  # noqa: BLE001 - a planner may fail in any way; the drone returns
            settle = partial(answer.set_exception, exc)
        else:
            settle = partial(answer.set_result, result)
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(lambda: answer.cancelled() or settle())

    threading.Thread(target=work, name="planner", daemon=True).start()
    return await answer
