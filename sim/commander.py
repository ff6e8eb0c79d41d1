"""Which mode flies: arming rules, mode requests and failsafes, as PX4's commander decides them.

The mode asked for (`intent`) and the one that flies (`mode`) differ in a failsafe. When the cause
of the failsafe goes, the intent flies again; asking for another mode replaces the intent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from pymavlink.dialects.v20 import common as mavlink

from sim.modes import Px4Mode
from sim.parameters import Parameters

GPS_LOSS_TOLERATED_S = 5.8
"""How long position is trusted without GPS, as measured."""
_INFO: int = mavlink.MAV_SEVERITY_INFO
_WARNING: int = mavlink.MAV_SEVERITY_WARNING
_CRITICAL: int = mavlink.MAV_SEVERITY_CRITICAL
Say = Callable[[int, str], None]
"""Takes a severity and a text for the operator."""


class Charge(IntEnum):
    """How bad the battery's level is."""

    GOOD = 0
    LOW = 1
    CRITICAL = 2
    EMERGENCY = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class CommanderInputs:
    """What the commander needs to know at an instant."""

    time_s: float = 0.0
    is_landed: bool = True
    is_ready: bool = False
    is_offboard_alive: bool = False
    battery_level: float = 1.0
    gps_lost_s: float = 0.0


class Commander:
    """Arming state and flight mode."""

    def __init__(self, parameters: Parameters, say: Say) -> None:
        self._parameters = parameters
        self._say = say
        self._inputs = CommanderInputs()
        self._battery_action_since_s: float | None = None
        self._has_flown = False
        self._landed_since_s = 0.0
        self.intent = Px4Mode.LOITER
        self.mode = Px4Mode.LOITER
        self.charge = Charge.GOOD
        self.armed_since_s: float | None = None

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn."""
        return self.armed_since_s is not None

    @property
    def is_in_failsafe(self) -> bool:
        """Whether a failsafe decides what flies."""
        return self.is_armed and self._failsafe() is not None

    def update(self, inputs: CommanderInputs) -> None:
        """Take the new inputs: failsafes and automatic disarming."""
        if inputs.is_landed and not self._inputs.is_landed:
            self._landed_since_s = inputs.time_s
            self._say(_INFO, "Landing detected")
        self._inputs = inputs
        self._watch_battery()
        if self.is_armed:
            self._has_flown = self._has_flown or not inputs.is_landed
            self._disarm_when_idle()
        mode = (self._failsafe() if self.is_armed else None) or self.intent
        if mode is not self.mode:
            if mode is not self.intent:
                self._say(_CRITICAL, f"Failsafe activated: {mode.name}")
            self.mode = mode

    def request_mode(self, mode: Px4Mode) -> bool:
        """Ask for a mode. -> whether it may fly; on the ground and disarmed every mode may."""
        if self.is_armed and not self._can_run(mode):
            self._say(_CRITICAL, f"Switching to mode {mode.name} is currently not possible")
            return False
        self.intent = mode
        self._battery_action_since_s = None
        return True

    def take_over(self) -> None:
        """Let the pilot fly: POSCTL, whatever flew before."""
        self.intent = Px4Mode.POSCTL
        self._battery_action_since_s = None

    def complete_takeoff(self) -> None:
        """Hold, after a take-off has reached its height."""
        if self.intent is Px4Mode.TAKEOFF:
            self.intent = Px4Mode.LOITER

    def arm(self) -> bool:
        """Arm, if the checks allow it. -> whether it is armed now."""
        if self.is_armed:
            return True
        inputs = self._inputs
        if not inputs.is_ready or self.charge >= Charge.CRITICAL:
            self._say(_CRITICAL, "Arming denied: Resolve system health failures first")
            return False
        if self.intent in (Px4Mode.RTL, Px4Mode.LAND) or not self._can_run(self.intent):
            self._say(_CRITICAL, f"Arming denied: mode {self.intent.name} not possible")
            return False
        self.armed_since_s = inputs.time_s
        self._has_flown = False
        self._say(_INFO, "Armed by external command")
        return True

    def disarm(self, *, is_forced: bool, reason: str = "external command") -> bool:
        """Disarm; in the air only by force. -> whether it is disarmed now."""
        if self.is_armed and not self._inputs.is_landed and not is_forced:
            self._say(_CRITICAL, "Disarming denied: not landed")
            return False
        if self.is_armed:
            self._say(_INFO, f"Disarmed by {reason}")
        self.armed_since_s = None
        self._battery_action_since_s = None
        return True

    def _can_run(self, mode: Px4Mode) -> bool:
        if mode is Px4Mode.OFFBOARD and not self._inputs.is_offboard_alive:
            return False
        return mode is Px4Mode.ALTCTL or self._inputs.gps_lost_s < GPS_LOSS_TOLERATED_S

    def _failsafe(self) -> Px4Mode | None:
        """Mode that a failsafe imposes; None without one."""
        if self._inputs.gps_lost_s >= GPS_LOSS_TOLERATED_S and self.intent is not Px4Mode.ALTCTL:
            return Px4Mode.ALTCTL
        if self._battery_action_since_s is not None:
            held_s = self._inputs.time_s - self._battery_action_since_s
            if held_s < self._parameters["COM_FAIL_ACT_T"]:
                return Px4Mode.LOITER
            returns = self._parameters["COM_LOW_BAT_ACT"] == 3 and self.charge is Charge.CRITICAL
            return Px4Mode.RTL if returns else Px4Mode.LAND
        if self.intent is Px4Mode.OFFBOARD and not self._inputs.is_offboard_alive:
            return Px4Mode.RTL
        return None

    def _watch_battery(self) -> None:
        """Warn, or begin a failsafe, when the battery's level becomes worse."""
        p, level = self._parameters, self._inputs.battery_level
        limits = (p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
        charge = Charge(sum(level < limit for limit in limits))
        if charge > self.charge:
            self._say(_WARNING, f"Battery level {charge.name.lower()}")
            acts = p["COM_LOW_BAT_ACT"] >= 2 and self.intent is not Px4Mode.LAND
            if charge >= Charge.CRITICAL and self.is_armed and acts:
                self._battery_action_since_s = self._inputs.time_s
        self.charge = charge

    def _disarm_when_idle(self) -> None:
        """Disarm a while after landing, or after arming without a take-off."""
        if not self._inputs.is_landed or self.armed_since_s is None:
            return
        if self._has_flown:
            limit, since, reason = "COM_DISARM_LAND", self._landed_since_s, "landing"
        else:
            limit, since, reason = "COM_DISARM_PRFLT", self.armed_since_s, "auto preflight"
        if 0.0 < self._parameters[limit] < self._inputs.time_s - since:
            self.disarm(is_forced=False, reason=reason)
