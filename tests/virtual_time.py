"""An event loop whose time jumps to the next timer, so that hours of waiting take milliseconds.

Time stands still while a planner or detector thinks: its thread is real. What else would run in
a thread runs at once.
"""

from __future__ import annotations

import asyncio
import selectors
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from dronemon.runner.daemon import BUSY

T = TypeVar("T")
_hanging: set[threading.Thread] = set()


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine in virtual time. -> its result"""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(main)


def let_time_pass() -> None:
    """Called by a planner that hangs: time goes on without its thread."""
    _hanging.add(threading.current_thread())


def take(loop: asyncio.AbstractEventLoop, duration_s: float) -> None:
    """Called by a detector that is slow: it needs so long, and no more."""
    is_over, thread = threading.Event(), threading.current_thread()

    def end() -> None:
        _hanging.discard(thread)
        is_over.set()

    loop.call_soon_threadsafe(loop.call_later, duration_s, end)
    let_time_pass()
    is_over.wait()


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """Jumps to the next timer as soon as nothing else is to be done."""

    def __init__(self) -> None:
        self._now_s = 0.0
        super().__init__(_JumpingSelector(self))
        self.set_default_executor(_AtOnce(1))

    def time(self) -> float:
        return self._now_s

    def jump(self, duration_s: float) -> None:
        self._now_s += duration_s


class _JumpingSelector(selectors.DefaultSelector):
    def __init__(self, loop: VirtualTimeLoop) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None:  # only while the loop closes
            return super().select(1.0)
        busy = {thread for thread in threading.enumerate() if thread.name == BUSY}
        _hanging.intersection_update(busy)
        is_thinking = bool(busy - _hanging)
        ready = super().select(0.0)
        if ready or timeout <= 0.0:
            return ready
        if is_thinking:
            return super().select(0.001)
        self._loop.jump(timeout)
        return []


class _AtOnce(ThreadPoolExecutor):
    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        done: Future[T] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as exc:  # noqa: BLE001 - it is the one who waits that must see it
            done.set_exception(exc)
        return done
