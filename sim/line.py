"""A line that loses, delays, repeats, swaps and garbles datagrams, as the active faults say."""

from __future__ import annotations

import heapq
import random
from collections.abc import Mapping
from itertools import count

_OVERTAKEN_S = 0.2


class FaultyLine:
    """One direction of a link; without a fault everything is out at once.

    faults: kinds that are active now -> value
    """

    def __init__(self, faults: Mapping[str, float], rng: random.Random) -> None:
        self._faults = faults
        self._rng = rng
        self._queue: list[tuple[float, int, bytes]] = []
        self._number = count()

    def put(self, datagram: bytes, time_s: float) -> None:
        """Send a datagram at a time."""
        faults = self._faults
        if self._happens("loss"):
            return
        if self._happens("corrupt"):
            index = self._rng.randrange(len(datagram))
            wrong = datagram[index] ^ self._rng.randrange(1, 256)
            datagram = datagram[:index] + bytes((wrong,)) + datagram[index + 1 :]
        due_s = time_s + faults.get("delay", 0.0)
        if self._happens("reorder"):
            due_s += _OVERTAKEN_S
        heapq.heappush(self._queue, (due_s, next(self._number), datagram))
        if "duplicate" in faults:
            again_s = due_s + faults["duplicate"]
            heapq.heappush(self._queue, (again_s, next(self._number), datagram))

    def take(self, time_s: float) -> list[bytes]:
        """Datagrams that have arrived by a time."""
        arrived = []
        while self._queue and self._queue[0][0] <= time_s:
            arrived.append(heapq.heappop(self._queue)[2])
        return arrived

    def clear(self) -> None:
        """Forget what is under way, as when the time starts again."""
        self._queue.clear()

    def _happens(self, kind: str) -> bool:
        return kind in self._faults and self._rng.random() < self._faults[kind]
