"""What messages without a stamp say, where copies of them may come late."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, TypeVar

from dronemon.vehicle.vehicle_clock import LATE_MS

T = TypeVar("T")
_UNCONTRADICTED_S = 3.0
"""Longer than two heartbeats in a row are lost for: until then a late one may seem the newest."""


class Unstamped(Generic[T]):
    """Follows one value.

    A copy that comes late says what was: a value that was left within the last seconds is believed
    only once nothing has said otherwise for a while. What is grave is believed only when two
    messages in a row are so: one may be another's.

    value:   what is believed
    doubted: what the newest message says against it
    """

    def __init__(self, value: T, is_grave: Callable[[T, T], bool] = lambda _, __: False) -> None:
        """is_grave: whether to go from the one value to the other is."""
        self.value = value
        self.doubted: T | None = None
        self._is_grave = is_grave
        self._since_s = 0.0  # vehicle time from which nothing has said what is believed
        self._left_s: dict[T, float] = {}

    def take(self, said: T, time_s: float) -> bool:
        """Take what the next message says, at a vehicle time. -> whether the value is a new one."""
        before, self.doubted = self.doubted, None
        if said == self.value:
            return False
        if before is None:
            self._since_s = time_s
        if time_s < self._left_s.get(said, -math.inf) + LATE_MS / 1000.0:
            is_sure = time_s >= self._since_s + _UNCONTRADICTED_S
        else:
            is_sure = not self._is_grave(self.value, said) or (
                before is not None and self._is_grave(self.value, before)
            )
        if not is_sure:
            self.doubted = said
            return False
        self._left_s[self.value] = time_s
        self.value = said
        return True

    def forget(self) -> None:
        """Time begins anew: what was left may come back at once."""
        self._left_s.clear()
        self.doubted = None
