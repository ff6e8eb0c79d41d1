"""Faults on purpose, of the simulated vehicle, its link and its camera.

`KIND[=VALUE][@SECONDS][+DURATION]`: what, from when, in vehicle seconds after arming (at once, on
the ground too, without it), and for how long (until the end without it).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKind:
    """What a kind does, its value's range (none: it takes no value), and whether it can end."""

    what: str
    values: tuple[float, float] | None = None
    is_lasting: bool = True


_SHARE = (0.0, 1.0)
_SECONDS = (0.0, 60.0)
KINDS = {
    "silence": FaultKind(what="the autopilot sends nothing"),
    "deaf": FaultKind(what="the autopilot hears nothing"),
    "loss": FaultKind(what="a share VALUE of datagrams is lost, both ways", values=_SHARE),
    "delay": FaultKind(what="datagrams arrive VALUE seconds late", values=_SECONDS),
    "duplicate": FaultKind(what="datagrams come again VALUE seconds later", values=_SECONDS),
    "reorder": FaultKind(what="a share VALUE of datagrams is overtaken", values=_SHARE),
    "corrupt": FaultKind(what="a share VALUE of datagrams has a wrong byte", values=_SHARE),
    "ignore": FaultKind(what="setpoints are ignored"),
    "reject": FaultKind(what="every command is refused"),
    "unarmable": FaultKind(what="an arming check fails"),
    "pilot": FaultKind(what="a pilot takes over (POSCTL) and at the end chooses OFFBOARD"),
    "battery": FaultKind(what="the level falls to VALUE", values=_SHARE, is_lasting=False),
    "swap": FaultKind(what="VALUE seconds after a landing the battery is fresh", values=_SECONDS),
    "gps": FaultKind(what="no satellites"),
    "jump": FaultKind(what="the estimated position is off by VALUE metres", values=(0.0, 1000.0)),
    "fence": FaultKind(what="the geofence counts as crossed"),
    "reboot": FaultKind(what="the autopilot starts again", is_lasting=False),
    "gimbal": FaultKind(what="the gimbal does not tell its attitude"),
    "askew": FaultKind(
        what="the gimbal looks VALUE degrees above where it should", values=(0.0, 90.0)
    ),
    "range": FaultKind(what="the rangefinder finds no ground"),
    "camera": FaultKind(what="no pictures"),
    "late": FaultKind(what="pictures arrive VALUE seconds late", values=_SECONDS),
    "torn": FaultKind(what="pictures end half-way"),
    "blank": FaultKind(what="pictures are black"),
    "repeat": FaultKind(what="the last picture comes again and again, with its time"),
    "freeze": FaultKind(what="pictures show the same view again and again"),
    "misdate": FaultKind(what="pictures are stamped VALUE seconds off", values=(-1000.0, 1000.0)),
    "hide": FaultKind(what="a share VALUE of animals is out of sight in pictures", values=_SHARE),
    "decoy": FaultKind(what="a share VALUE of pictures shows an animal too many", values=_SHARE),
    "mistake": FaultKind(what="a share VALUE of animals looks like another one", values=_SHARE),
    "misplace": FaultKind(
        what="animals are off by VALUE metres in pictures, one sigma per axis", values=(0.0, 100.0)
    ),
}
_PARAMETER = FaultKind(
    what="the autopilot's parameter is VALUE", values=(-math.inf, math.inf), is_lasting=False
)
_GRAMMAR = re.compile(
    r"(?P<kind>[a-z]+|[A-Z][A-Z0-9_]{1,15})(=(?P<value>-?\d+(\.\d+)?))?"
    r"(@(?P<at>\d+(\.\d+)?))?(\+(?P<duration>\d+(\.\d+)?))?"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault: what, when after arming (None: at once) and for how long (None: until the end).

    kind: one of KINDS, or the name of a parameter in capitals
    """

    kind: str
    at_s: float | None = None
    duration_s: float | None = None
    value: float = 1.0

    @property
    def is_parameter(self) -> bool:
        """Whether it sets a parameter."""
        return self.kind.isupper()


def parse_fault(text: str) -> Fault:
    """Fault of a text. Raises ValueError that says what is allowed."""
    match = _GRAMMAR.fullmatch(text)
    kind = None
    if match is not None:
        kind = _PARAMETER if match["kind"].isupper() else KINDS.get(match["kind"])
    if match is None or kind is None:
        raise ValueError(
            f"{text!r} is not KIND[=VALUE][@SECONDS][+DURATION] with KIND a parameter's name or "
            f"one of {', '.join(KINDS)}; for example silence@60+10, battery=0.1@120 or gps+30"
        )
    value, low_high = match["value"], kind.values
    if (value is None) != (low_high is None):
        takes = "no value" if low_high is None else f"a value: {kind.what}"
        raise ValueError(f"{text!r}: {match['kind']} takes {takes}")
    if (
        value is not None
        and low_high is not None
        and not low_high[0] <= float(value) <= low_high[1]
    ):
        raise ValueError(f"{text!r}: {value} is not from {low_high[0]:g} to {low_high[1]:g}")
    if match["duration"] and not kind.is_lasting:
        raise ValueError(f"{text!r}: {match['kind']} happens at once and takes no duration")
    return Fault(
        kind=match["kind"],
        at_s=float(match["at"]) if match["at"] else None,
        duration_s=float(match["duration"]) if match["duration"] else None,
        value=float(value) if value is not None else 1.0,
    )
