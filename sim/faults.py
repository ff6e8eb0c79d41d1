"""Faults on purpose: `KIND[=VALUE]@SECONDS[+DURATION]`, in vehicle time after arming.

silence   the autopilot sends nothing
deaf      the autopilot hears nothing
pilot     a pilot takes over: POSCTL (no duration: the pilot keeps it)
battery   the level falls to VALUE, 0 to 1 (no duration)
gps       no satellites
reboot    the autopilot starts again (no duration)
reject    every command is refused
camera    no pictures
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

LASTING = ("silence", "deaf", "gps", "reject", "camera")
SUDDEN = ("pilot", "battery", "reboot")
_GRAMMAR = re.compile(
    r"(?P<kind>[a-z]+)(=(?P<value>[0-9.]+))?@(?P<at>[0-9.]+)(\+(?P<duration>[0-9.]+))?"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault: what, when after arming, and for how long (None: until the end)."""

    kind: str
    at_s: float
    duration_s: float | None = None
    value: float | None = None


def parse_fault(text: str) -> Fault:
    """Fault of a command-line argument. Raises ValueError that says what is allowed."""
    match = _GRAMMAR.fullmatch(text)
    if match is None or match["kind"] not in LASTING + SUDDEN:
        raise ValueError(
            f"{text!r} is not KIND[=VALUE]@SECONDS[+DURATION] with KIND one of "
            f"{', '.join(LASTING + SUDDEN)}; for example silence@60+10 or battery=0.1@120"
        )
    value = float(match["value"]) if match["value"] else None
    duration_s = float(match["duration"]) if match["duration"] else None
    kind = match["kind"]
    if (kind == "battery") != (value is not None) or (value is not None and value > 1.0):
        raise ValueError(f"{text!r}: battery alone takes a level, 0 to 1: battery=0.1@120")
    if kind in SUDDEN and duration_s is not None:
        raise ValueError(f"{text!r}: {kind} happens at once and takes no duration")
    return Fault(kind=kind, at_s=float(match["at"]), duration_s=duration_s, value=value)


class FaultSchedule:
    """Switches faults on and off as time goes by.

    switches: of lasting kinds, called with True at the beginning and with False at the end
    events:   of sudden kinds, called once with the fault's value
    """

    def __init__(
        self,
        faults: tuple[Fault, ...],
        switches: Mapping[str, Callable[[bool], None]],
        events: Mapping[str, Callable[[float | None], None]],
    ) -> None:
        self._due: list[tuple[float, Callable[[], None]]] = []
        for fault in faults:
            if fault.kind in SUDDEN:
                self._due.append((fault.at_s, partial(events[fault.kind], fault.value)))
                continue
            switch = switches[fault.kind]
            self._due.append((fault.at_s, partial(switch, True)))
            if fault.duration_s is not None:
                self._due.append((fault.at_s + fault.duration_s, partial(switch, False)))
        self._due.sort(key=lambda due: due[0])

    def advance(self, since_arming_s: float) -> None:
        """Do everything that is due."""
        while self._due and self._due[0][0] <= since_arming_s:
            self._due.pop(0)[1]()
