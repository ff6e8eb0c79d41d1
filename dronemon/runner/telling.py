"""What the supervisor tells a person: problems while they last, and what an interrupt brings."""

from __future__ import annotations

import asyncio
import logging
import math

from dronemon.errors import DronemonError, LinkLost
from dronemon.events import EventStream, Level
from dronemon.guard import State

_REPEAT_S = 5.0
"""Wall time after which a problem that lasts is told again."""
_INTERRUPTS = {
    State.PREPARING: "nothing has flown; the program ends",
    State.PILOT: "the pilot flies on; a second Ctrl-C ends the program and leaves it to the pilot",
    State.LANDING: "the drone is landing here already",
}


class Telling:
    """Notes in the stream of events, none of them too often."""

    def __init__(self, events: EventStream) -> None:
        self._events = events
        self._told: tuple[object, float] = (None, -math.inf)  # the problem told last, and when
        self._num_interrupts = 0

    def problem(self, kind: str, problem: DronemonError | None, level: Level = "ERROR") -> None:
        """Tell a problem, and again every few seconds while it lasts."""
        now = asyncio.get_running_loop().time()
        is_same = LinkLost if isinstance(problem, LinkLost) else str(problem)
        told, told_at = self._told
        if is_same != told or now >= told_at + _REPEAT_S:
            self._told = is_same, now
            self._events.note(kind, str(problem), level=level)

    def is_over(self) -> None:
        """A step has gone well: if the problem comes again, it is a new one."""
        self._told = (None, -math.inf)

    def interrupts(self, count: int, state: State) -> None:
        """Tell what a person's newest interrupt brings, once."""
        if count == self._num_interrupts:
            return
        self._num_interrupts, self._events.must_go_on = count, True
        what = "the drone comes home; Ctrl-C again lands it where it is"
        if count > 1:
            what = "the drone lands where it is; a third ends the program if it obeys nothing"
        self._events.note("interrupt", _INTERRUPTS.get(state, what))


def as_told(exc: BaseException) -> DronemonError:
    """What a person is told of it; what is no error of a vehicle is a fault of ours."""
    if isinstance(exc, DronemonError):
        return exc
    logging.getLogger(__name__).error("in a flight", exc_info=exc)
    return DronemonError(f"a fault of this program: {exc!r}")
