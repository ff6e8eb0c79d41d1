"""A vehicle's time since boot, from stamps that wrap, come late or twice, and begin anew."""

from __future__ import annotations

from collections import deque

LATE_MS = 10_000
"""How late a message may come: redundant routes repeat what was heard before."""
_WRAP_MS = 2**32
_FURTHEST_AHEAD_MS = 3_600_000
_BELIEVED_MS = 1_000
_LEAP_MS = 1_500
_ALTERNATIONS = 20
_RECENT = 200
_FOREIGN_SHARE = 0.4
_FOREIGN_MS = 500
_TWO_FOR_MS = 30_000


class VehicleClock:
    """Follows one stream of stamps, that of ATTITUDE.

    A stamp from the last seconds is late and dropped. Any other that does not follow the newest is
    another clock's: it is believed once it has gone on for a second while the one before stayed
    away, as after a reboot or a long silence. A leap of some seconds, as after a short silence, is
    believed with the next stamp that goes on from it. Two that go on side by side are two
    vehicles'.

    num_reboots: how often time began anew.
    """

    def __init__(self) -> None:
        self.num_reboots = 0
        self._two_at_ms: int | None = None
        self._problem: str | None = None
        self._newest_ms: int | None = None  # unwrapped
        self._leapt_ms: int | None = None  # unwrapped, of the newest stamp if it was too far ahead
        self._other: tuple[int, int] | None = None  # first and newest stamp of another clock
        self._alternations_ms: deque[int] = deque(maxlen=_ALTERNATIONS)
        self._contents: dict[int, object] = {}  # of the last seconds, by stamp
        self._are_foreign: deque[bool] = deque(maxlen=_RECENT)

    def ahead_ms(self, stamp_ms: int) -> int:
        """How far a stamp is ahead of the newest; negative behind it, 0 before the first."""
        if self._newest_ms is None:
            return 0
        difference_ms = stamp_ms - self._newest_ms
        return (difference_ms - _FURTHEST_AHEAD_MS) % _WRAP_MS - _WRAP_MS + _FURTHEST_AHEAD_MS

    def time_s(self, stamp_ms: int) -> float:
        """Vehicle time of a stamp of another stream of the vehicle."""
        newest_ms = stamp_ms if self._newest_ms is None else self._newest_ms
        return (newest_ms + self.ahead_ms(stamp_ms)) / 1000.0

    def take(self, stamp_ms: int, content: object) -> float | None:
        """Take the next stamp heard. -> vehicle time in s, None if the message is to be dropped.

        content: what the message says beside; one that comes again says the same.
        """
        if self._newest_ms is None:
            return self._follow(stamp_ms, content)
        ahead_ms = self.ahead_ms(stamp_ms)
        if abs(ahead_ms) > LATE_MS:
            return self._hear_other(self._newest_ms + ahead_ms, content)
        time_ms, leapt_ms = self._newest_ms + ahead_ms, self._leapt_ms
        self._leapt_ms = None
        goes_on = leapt_ms is not None and 0 < time_ms - leapt_ms <= _LEAP_MS
        if ahead_ms > _LEAP_MS and not goes_on:
            self._leapt_ms = time_ms
            return None
        is_late = ahead_ms <= 0
        is_foreign = ahead_ms < -_FOREIGN_MS and self._contents.get(stamp_ms) != content
        self._are_foreign.append(is_foreign)
        if sum(self._are_foreign) > _FOREIGN_SHARE * _RECENT:
            self._doubt()
        if is_late:
            return None
        if self._other is not None:
            self._other = None
            self._alternations_ms.append(time_ms)
            alternated_ms = time_ms - self._alternations_ms[0]
            if len(self._alternations_ms) == _ALTERNATIONS and alternated_ms < LATE_MS:
                self._doubt()
        return self._follow(time_ms, content)

    @property
    def are_two(self) -> bool:
        """Whether two vehicles were heard of late."""
        if self._two_at_ms is None or self._newest_ms is None:
            return False
        return self._two_at_ms <= self._newest_ms < self._two_at_ms + _TWO_FOR_MS

    def pop_problem(self) -> str | None:
        """What has become wrong with the clock since the last call."""
        problem, self._problem = self._problem, None
        return problem

    def _follow(self, time_ms: int, content: object) -> float:
        self._newest_ms = time_ms
        self._contents[time_ms % _WRAP_MS] = content
        oldest_ms = next(iter(self._contents))
        if self.ahead_ms(oldest_ms) < -LATE_MS:
            del self._contents[oldest_ms]
        return time_ms / 1000.0

    def _hear_other(self, time_ms: int, content: object) -> float | None:
        """Take a stamp of another clock. -> its time once it is believed."""
        assert self._newest_ms is not None
        first_ms, newest_ms = self._other or (time_ms, time_ms)
        if abs(time_ms - newest_ms) > LATE_MS:
            first_ms = newest_ms = time_ms
        newest_ms = max(newest_ms, time_ms)
        self._other = first_ms, newest_ms
        if newest_ms - first_ms < _BELIEVED_MS or time_ms < newest_ms:
            return None
        if time_ms < self._newest_ms:
            self.num_reboots += 1
            self._problem = "the autopilot rebooted: its clock began anew; the flight is over"
            time_ms %= _WRAP_MS
        self._forget()
        return self._follow(time_ms, content)

    def _forget(self) -> None:
        self._other = None
        self._alternations_ms.clear()
        self._contents.clear()
        self._are_foreign.clear()

    def _doubt(self) -> None:
        self._forget()
        self._two_at_ms = self._newest_ms
        self._problem = (
            "two vehicles of one system id are heard, their clocks alternate; give each an id "
            "(PX4's MAV_SYS_ID) or a port of its own"
        )
