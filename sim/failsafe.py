"""PX4's failsafes: a table of conditions and actions, and the rules that choose what flies.

The worst action of all rows that hold is done. First the vehicle holds for COM_FAIL_ACT_T, where a
row waits and it can hold; asking for another mode meanwhile or later takes over from the failsafe.
Source: PX4 v1.17, src/modules/commander/failsafe.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from sim.modes import Px4Mode
from sim.parameters import Parameters


class Action(IntEnum):
    """What a failsafe does; a later one takes precedence."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    HOLD = 4
    RETURN = 5
    LAND = 6


class Charge(IntEnum):
    """How bad the battery's level is."""

    GOOD = 0
    LOW = 1
    CRITICAL = 2
    EMERGENCY = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """What failsafes depend on at an instant.

    intent:              the mode asked for
    is_mode_asked:       whether somebody has just asked for it
    charge:              the worst since arming; charge_at_arming: what it was then
    """

    time_s: float
    is_armed: bool
    intent: Px4Mode
    is_mode_asked: bool
    has_position: bool
    has_sticks: bool
    is_offboard_alive: bool
    is_fence_crossed: bool
    charge: Charge
    charge_at_arming: Charge

    def can_fly(self, mode: Px4Mode) -> bool:
        """Whether the estimate and the setpoints allow a mode; sticks are another matter."""
        if mode is Px4Mode.OFFBOARD:
            return self.is_offboard_alive
        return mode is not Px4Mode.MISSION and (self.has_position or not mode.needs_position)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One failsafe.

    waits:   holds for COM_FAIL_ACT_T first
    is_kept: stays until another mode is asked for, though its cause is gone
    """

    name: str
    action: Callable[[Situation, Parameters], Action]
    waits: bool = True
    is_kept: bool = False


_FENCE = {
    0: Action.NONE,
    1: Action.WARN,
    2: Action.HOLD,
    3: Action.RETURN,
    5: Action.LAND,
}
_CRITICAL = {0: Action.WARN, 1: Action.RETURN, 2: Action.LAND, 3: Action.RETURN}
_EMERGENCY = {0: Action.WARN, 1: Action.RETURN, 2: Action.LAND, 3: Action.LAND}
_SETPOINTS_LOST = {
    0: (Action.POSITION, Px4Mode.POSCTL),
    1: (Action.ALTITUDE, Px4Mode.ALTCTL),
    3: (Action.RETURN, Px4Mode.RTL),
    4: (Action.LAND, Px4Mode.LAND),
    5: (Action.HOLD, Px4Mode.LOITER),
}
_STICKS_LOST = {1: Action.HOLD, 2: Action.RETURN}
"""Landing otherwise; PX4 stops the motors at 5 and 6, which nothing here does."""


def _on_fence(now: Situation, p: Parameters) -> Action:
    return _FENCE.get(int(p["GF_ACTION"]), Action.WARN) if now.is_fence_crossed else Action.NONE


def _on_battery(
    level: Charge, actions: dict[int, Action]
) -> Callable[[Situation, Parameters], Action]:
    def action(now: Situation, p: Parameters) -> Action:
        if now.charge is not level:
            return Action.NONE
        is_worse = now.charge > now.charge_at_arming
        return actions[int(p["COM_LOW_BAT_ACT"])] if is_worse else Action.WARN

    return action


def _on_impossible_mode(now: Situation, p: Parameters) -> Action:
    """Fall back from a mode that cannot fly: without setpoints, or without a position."""
    action, mode = Action.NONE, now.intent
    if mode is Px4Mode.OFFBOARD and not now.is_offboard_alive:
        action, mode = _SETPOINTS_LOST.get(int(p["COM_OBL_RC_ACT"]), _SETPOINTS_LOST[1])
        if action in (Action.POSITION, Action.ALTITUDE) and not now.has_sticks:
            action = _STICKS_LOST.get(int(p["NAV_RCL_ACT"]), Action.LAND)
    if mode is Px4Mode.POSCTL and not now.can_fly(mode):
        return Action.ALTITUDE
    if mode is Px4Mode.LAND and not now.has_position:
        return Action.LAND  # a mere descent, which HEARTBEAT calls LAND in a failsafe
    return action if now.can_fly(mode) else Action.RETURN


TABLE = (
    Row(name="fence", action=_on_fence, is_kept=True),
    Row(name="battery critical", action=_on_battery(Charge.CRITICAL, _CRITICAL)),
    Row(name="battery emergency", action=_on_battery(Charge.EMERGENCY, _EMERGENCY)),
    Row(name="mode", action=_on_impossible_mode, waits=False),
)
_MODES = {
    Action.POSITION: Px4Mode.POSCTL,
    Action.ALTITUDE: Px4Mode.ALTCTL,
    Action.HOLD: Px4Mode.LOITER,
    Action.RETURN: Px4Mode.RTL,
    Action.LAND: Px4Mode.LAND,
}
_INSTEAD = {
    Action.POSITION: Action.ALTITUDE,
    Action.HOLD: Action.RETURN,
    Action.RETURN: Action.LAND,
}
"""What is done where an action's mode cannot fly. Landing always can: it then only descends."""


class Failsafe:
    """Chooses the action, by memory of what holds, how long it waits and who took over.

    action:     the one chosen
    hold_s:     for how long it still only holds
    is_waiting: whether it holds before it does another one
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._rows: dict[str, Action] = {}
        self._failing: set[str] = set()
        self._time_s = 0.0
        self._was_armed = False
        self._start_delay_s = parameters["COM_FAIL_ACT_T"]
        self._is_overruled = False
        self.action = Action.NONE
        self.hold_s = 0.0
        self.is_waiting = False

    @property
    def is_active(self) -> bool:
        """Whether it decides what flies."""
        return self.action > Action.WARN

    def mode(self, intent: Px4Mode) -> Px4Mode:
        """What flies now."""
        return _MODES.get(self.action, intent)

    def update(self, now: Situation) -> bool:
        """Choose the action anew. -> whether the operator is to be told of a worse one."""
        dt_s, self._time_s = now.time_s - self._time_s, now.time_s
        if now.is_armed is not self._was_armed:
            self._was_armed, self._is_overruled = now.is_armed, False
            self._forget_kept()
        elif now.is_mode_asked or self._is_overruled:
            self._forget_kept()
        self.hold_s = max(0.0, self.hold_s - dt_s)
        self._check_rows(now)
        can_hold = now.can_fly(Px4Mode.LOITER)
        if self.action > Action.HOLD or self._is_overruled or not can_hold:
            self.hold_s = 0.0
        before, (self.action, self.is_waiting) = self.action, self._choose(now)
        self._recharge_delay(dt_s)
        return self.action > before and self.is_active

    def _forget_kept(self) -> None:
        for row in TABLE:
            if row.is_kept and row.name not in self._failing:
                self._rows.pop(row.name, None)

    def _check_rows(self, now: Situation) -> None:
        for row in TABLE:
            action = row.action(now, self._parameters)
            if action is Action.NONE:
                self._failing.discard(row.name)
                if not row.is_kept:
                    self._rows.pop(row.name, None)
                continue
            if row.name not in self._rows:
                self._is_overruled = self._is_overruled and action < Action.HOLD
                if row.waits and action is not Action.WARN and self.hold_s == 0.0:
                    self.hold_s = min(self._start_delay_s, self._parameters["COM_FAIL_ACT_T"])
            self._rows[row.name] = action
            self._failing.add(row.name)

    def _choose(self, now: Situation) -> tuple[Action, bool]:
        """Action to do now, and whether it is the hold before another one."""
        action = max(self._rows.values(), default=Action.NONE) if now.is_armed else Action.NONE
        is_waiting = False
        wanted = action
        if self.hold_s > 0.0 and action not in (Action.NONE, Action.HOLD):
            action, is_waiting = Action.HOLD, True
        is_overruling = self._is_overruled or (now.is_mode_asked and self.is_active)
        self._is_overruled = action >= Action.HOLD and is_overruling
        if self._is_overruled:
            action = max(Action.WARN, _on_impossible_mode(now, self._parameters))
            is_waiting = False
        while action in _INSTEAD and not now.can_fly(_MODES[action]):
            action = _INSTEAD[action]
        returns = action is Action.RETURN or (is_waiting and wanted is Action.RETURN)
        if returns and now.intent in (Px4Mode.LAND, Px4Mode.RTL) and now.can_fly(now.intent):
            return Action.WARN, False
        return action, is_waiting

    def _recharge_delay(self, dt_s: float) -> None:
        """A hold uses the delay up; it comes back four times slower."""
        left_s = self._start_delay_s + (-dt_s if self.is_waiting else dt_s / 4.0)
        self._start_delay_s = min(max(left_s, 0.0), self._parameters["COM_FAIL_ACT_T"])
