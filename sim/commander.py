"""Which mode flies: arming checks, mode requests and failsafes, as PX4's commander decides them.

The mode asked for (`intent`) and the one that flies (`mode`) differ in a failsafe. When the cause
of the failsafe goes, the intent flies again; asking for another mode replaces the intent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from sim.failsafe import Charge, Failsafe, Situation
from sim.modes import Px4Mode
from sim.parameters import Parameters

_INFO: int = mavlink.MAV_SEVERITY_INFO
_CRITICAL: int = mavlink.MAV_SEVERITY_CRITICAL
_REPORT_INTERVAL_S = 2.0
_REFUSAL_INTERVAL_S = 1.0
Say = Callable[[int, str], None]
"""Takes a severity and a text for the operator. PX4 ends those with a tab that are events too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommanderInputs:
    """What the commander needs to know at an instant.

    problems: texts of the arming checks that fail, as PX4 says them; breach: that of the fence
    """

    time_s: float = 0.0
    is_landed: bool = True
    problems: tuple[str, ...] = ()
    has_position: bool = False
    is_offboard_alive: bool = False
    battery_level: float = 1.0
    breach: str | None = None


class Commander:
    """Arming state and flight mode.

    intent:     mode asked for
    mode:       mode that flies
    has_sticks: whether a pilot's sticks are heard
    """

    def __init__(self, parameters: Parameters, say: Say) -> None:
        self._parameters = parameters
        self._say = say
        self._inputs = CommanderInputs()
        self._failsafe = Failsafe(parameters)
        self._after_disarming = Px4Mode.LOITER
        self._is_mode_asked = False
        self._charge_at_arming = Charge.GOOD
        self._has_flown = False
        self._landed_since_s = 0.0
        self._reported: tuple[str, ...] = ()
        self._reported_at_s = -math.inf
        self._refused_at_s = -math.inf
        self.intent = Px4Mode.LOITER
        self.mode = Px4Mode.LOITER
        self.has_sticks = False
        self.charge = Charge.GOOD
        self.armed_since_s: float | None = None

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn."""
        return self.armed_since_s is not None

    @property
    def is_in_failsafe(self) -> bool:
        """Whether a failsafe decides what flies."""
        return self._failsafe.is_active

    @property
    def can_arm(self) -> bool:
        """Whether the arming checks pass in the mode that is shown: PREARM_CHECK."""
        has_problem = bool(self._inputs.problems) or self.charge >= Charge.CRITICAL
        has_breach = self._inputs.breach is not None
        return (
            not (has_problem or has_breach) and self.mode.allows_arming and self._can_run(self.mode)
        )

    def update(self, inputs: CommanderInputs) -> None:
        """Take the new inputs: failsafes, automatic disarming and what there is to say of them."""
        if self.is_armed and inputs.is_landed != self._inputs.is_landed:
            self._say(_INFO, "Landing detected\t" if inputs.is_landed else "Takeoff detected\t")
            self._landed_since_s = inputs.time_s
        self._inputs = inputs
        p, level = self._parameters, inputs.battery_level
        limits = (p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
        charge = Charge(sum(level < limit for limit in limits))
        self.charge = max(self.charge, charge) if self.is_armed else charge
        if self.is_armed:
            self._has_flown = self._has_flown or not inputs.is_landed
            self._disarm_when_idle()
        self._decide()
        self._report_changes()

    def request_mode(self, mode: Px4Mode) -> bool:
        """Ask for a mode. -> whether it may fly.

        Every mode may while disarmed, and landing always, though only as a descent where it must.
        """
        if self.is_armed and mode is not Px4Mode.LAND and not self._can_run(mode):
            if self._inputs.time_s - self._refused_at_s > _REFUSAL_INTERVAL_S:
                self._say(_CRITICAL, f"Switching to {mode.label} is currently not available\t")
                self._refused_at_s = self._inputs.time_s
            return False
        self._choose(mode)
        return True

    def take_over(self) -> None:
        """Let a pilot with sticks choose POSCTL, which flies as ALTCTL without a position."""
        self.has_sticks = True
        self._choose(Px4Mode.POSCTL)

    def complete_takeoff(self) -> None:
        """Hold, after a take-off has reached its height."""
        if self.intent is Px4Mode.TAKEOFF:
            self._choose(Px4Mode.LOITER)

    def arm(self) -> bool:
        """Arm, if the checks allow it. -> whether it is armed now."""
        if self.is_armed:
            return True
        if not self.can_arm:
            self._say(_CRITICAL, "Arming denied: Resolve system health failures first\t")
            return False
        self.armed_since_s = self._inputs.time_s
        self._charge_at_arming = self.charge
        self._has_flown = False
        self._say(_INFO, "Armed by external command\t")
        return True

    def disarm(self, *, is_forced: bool, reason: str = "external command") -> bool:
        """Disarm; in the air only by force. -> whether it is disarmed now.

        The last mode that allows arming is chosen again, often OFFBOARD, in which arming is then
        not possible.
        """
        if self.is_armed and not self._inputs.is_landed and not is_forced:
            self._say(_CRITICAL, "Disarming denied: not landed\t")
            return False
        if self.is_armed:
            self.intent = self._after_disarming
            self._say(_INFO, f"Disarmed by {reason}\t")
        self.armed_since_s = None
        return True

    def report_problems(self) -> None:
        """Say which arming checks fail; requirements of the mode are not among the texts."""
        self._reported_at_s = self._inputs.time_s
        self._reported = self._problems()
        for text in self._reported:
            self._say(_CRITICAL, text)

    def _problems(self) -> tuple[str, ...]:
        battery = f"{self.charge.name.capitalize()} battery\t" if self.charge else None
        others = (battery, self._inputs.breach)
        return (*self._inputs.problems, *(text for text in others if text is not None))

    def _report_changes(self) -> None:
        is_due = self._inputs.time_s - self._reported_at_s >= _REPORT_INTERVAL_S
        if is_due and self._problems() != self._reported:
            self.report_problems()

    def _choose(self, mode: Px4Mode) -> None:
        self.intent, self._is_mode_asked = mode, True
        if mode.allows_arming and mode is not Px4Mode.TAKEOFF:
            self._after_disarming = mode

    def _can_run(self, mode: Px4Mode) -> bool:
        return self._situation().can_fly(mode) and (self.has_sticks or not mode.is_manual)

    def _situation(self) -> Situation:
        inputs = self._inputs
        return Situation(
            time_s=inputs.time_s,
            is_armed=self.is_armed,
            intent=self.intent,
            is_mode_asked=self._is_mode_asked,
            has_position=inputs.has_position,
            has_sticks=self.has_sticks,
            is_offboard_alive=inputs.is_offboard_alive,
            is_fence_crossed=inputs.breach is not None,
            charge=self.charge,
            charge_at_arming=self._charge_at_arming,
        )

    def _decide(self) -> None:
        is_worse = self._failsafe.update(self._situation())
        self._is_mode_asked = False
        self.mode = self._failsafe.mode(self.intent)
        if is_worse:
            hold_s = round(self._failsafe.hold_s)
            entering = f": entering Hold for {hold_s} seconds" if self._failsafe.is_waiting else ""
            self._say(_CRITICAL, f"Failsafe activated{entering}\t")

    def _disarm_when_idle(self) -> None:
        """Disarm a while after landing, or after arming without a take-off."""
        p = self._parameters
        if not self._inputs.is_landed or self.armed_since_s is None:
            return
        if self._has_flown:
            limit_s, since_s, reason = p["COM_DISARM_LAND"], self._landed_since_s, "landing"
        else:
            limit_s, since_s = p["COM_DISARM_PRFLT"], self.armed_since_s + p["COM_SPOOLUP_TIME"]
            reason = "auto preflight disarming"
        if 0.0 < limit_s < self._inputs.time_s - since_s:
            self.disarm(is_forced=False, reason=reason)
