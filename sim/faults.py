"""Which faults apply, and when they begin and end."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from dronemon.errors import MissionFileError
from dronemon.mission import Mission
from dronemon.mission.faults import Fault, parse_fault
from sim.parameters import INDEX

_PICTURED_KINDS = ("hide", "decoy", "mistake", "misplace")
CAMERA_KINDS = ("camera", "late", "torn", "blank", "repeat", "freeze", "misdate", *_PICTURED_KINDS)
Switch = Callable[[str, float | None], None]
"""Takes a fault's kind, and its value when it begins or None when it ends."""


def parse_vehicle_fault(text: str) -> Fault:
    """Fault of the simulated vehicle. Raises ValueError."""
    fault = parse_fault(text)
    if fault.is_parameter and fault.kind not in INDEX:
        raise ValueError(f"{text!r}: the simulated autopilot has no parameter {fault.kind}")
    return fault


def parse_camera_fault(text: str) -> Fault:
    """Fault of the simulated camera alone. Raises ValueError."""
    fault = parse_fault(text)
    if fault.kind not in CAMERA_KINDS:
        raise ValueError(
            f"{text!r}: beside a vehicle that is followed only the camera is simulated; its "
            f"faults are {', '.join(CAMERA_KINDS)}"
        )
    return fault


def mission_faults(mission: Mission, parse: Callable[[str], Fault]) -> list[Fault]:
    """Faults that a mission lists. Raises MissionFileError where one does not apply."""
    try:
        return [parse(text) for text in mission.simulation.faults]
    except ValueError as exc:
        raise MissionFileError(f"simulation.faults: {exc}") from exc


class FaultSchedule:
    """Switches faults on and off as time goes by; more may be added meanwhile.

    active: kinds that are on now -> value
    """

    def __init__(self, faults: Iterable[Fault], switch: Switch = lambda *_: None) -> None:
        self._on_switch = switch
        self._waiting = list(faults)
        self._armed_at_s: float | None = None
        self._ending: list[tuple[float, str]] = []
        self.active: dict[str, float] = {}

    def add(self, fault: Fault) -> None:
        """Have one more."""
        self._waiting.append(fault)

    def advance(self, time_s: float, is_armed: bool) -> None:
        """Do everything that is due at a time; some counts from when it was first armed."""
        if self._armed_at_s is None and is_armed:
            self._armed_at_s = time_s
        for fault in list(self._waiting):
            begins_s = time_s
            if fault.at_s is not None:
                begins_s = math.inf if self._armed_at_s is None else self._armed_at_s + fault.at_s
            if begins_s <= time_s:
                self._waiting.remove(fault)
                self._switch(fault.kind, fault.value)
                if fault.duration_s is not None:
                    self._ending.append((begins_s + fault.duration_s, fault.kind))
        for ending in list(self._ending):
            if ending[0] <= time_s:
                self._ending.remove(ending)
                self._switch(ending[1], None)

    def _switch(self, kind: str, value: float | None) -> None:
        if value is None:
            self.active.pop(kind, None)
        else:
            self.active[kind] = value
        self._on_switch(kind, value)
