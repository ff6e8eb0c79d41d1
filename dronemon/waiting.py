"""What waits for a worker thread, so that whoever hands it over never waits."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class BoundedQueue(Generic[T]):
    """Items for one worker, limited in number and bytes; `dropped` counts what is turned away."""

    def __init__(self, *, max_items: float = math.inf, max_bytes: float = math.inf) -> None:
        self.dropped = 0
        self._max_items, self._max_bytes = max_items, max_bytes
        self._items: deque[tuple[T, int]] = deque()
        self._waiting_bytes = 0
        self._deadline_s: float | None = None
        self._changed = threading.Condition()

    def put(self, item: T, num_bytes: int = 0) -> bool:
        """Add an item, or drop and count it if the queue is full or closed. -> whether added"""
        with self._changed:
            is_full = (
                len(self._items) >= self._max_items
                or self._waiting_bytes + num_bytes > self._max_bytes
            )
            if is_full or self._deadline_s is not None:
                self.dropped += 1
                return False
            self._items.append((item, num_bytes))
            self._waiting_bytes += num_bytes
            self._changed.notify()
            return True

    def wait_empty(self, timeout_s: float) -> None:
        """Wait until the worker has taken all, at the latest for this time."""
        with self._changed:
            self._changed.wait_for(lambda: not self._items, timeout_s)

    def close(self, timeout_s: float) -> None:
        """Let the worker end, at the latest after this time with the item it is at."""
        with self._changed:
            self._deadline_s = time.monotonic() + timeout_s
            self._changed.notify()

    def __iter__(self) -> Iterator[T]:
        """Wait for items and give them until closed; the worker's side."""
        while True:
            with self._changed:
                while not self._items and self._deadline_s is None:
                    self._changed.wait()
                is_late = self._deadline_s is not None and time.monotonic() > self._deadline_s
                if is_late or not self._items:
                    self.dropped += len(self._items)
                    self._items.clear()
                    return
                item, num_bytes = self._items.popleft()
                self._waiting_bytes -= num_bytes
                self._changed.notify_all()
            yield item
