"""What is safe now: a table from the situation of a flight to what is done, and why.

Pure: no clock, no waiting, no vehicle. The runner gathers situations, asks at every pose and after
every step, and does what the first row that holds says. A vehicle is ours from when we ask it to
arm; while its motors may run, only a person, or a link that is silent for long, ends the program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypedDict


class State(StrEnum):
    """Who flies, and where to."""

    PREPARING = "preparing"
    LAUNCHING = "launching"
    PATROLLING = "patrolling"
    HEADING_HOME = "flying home around no-fly zones"
    RETURNING = "returning"
    LANDING = "landing here"
    FAILSAFE = "failsafe flies"
    PILOT = "the pilot flies"
    ENDED = "ended"


MISSION = (State.PREPARING, State.LAUNCHING, State.PATROLLING, State.HEADING_HOME)
HOMEWARD = (State.RETURNING, State.LANDING, State.FAILSAFE)


class Action(StrEnum):
    """What the runner does next."""

    GO_ON = "go on with the mission"
    LEAVE = "leave what is being done, and ask again"
    LISTEN = "wait for a heartbeat"
    RETURN = "ask for the return home"
    LAND = "ask to land here"
    DISARM = "stop the motors"
    WATCH = "wait for the landing"
    OFFER = "send a setpoint for the present place: PX4 lets the pilot choose offboard only then"
    WAIT = "wait for a pose"
    END = "do nothing more"


class Setback(StrEnum):
    """What went wrong with the last step."""

    NONE = "none"
    PILOT = "the pilot chose a mode"
    FAILSAFE = "a failsafe of the autopilot chose a mode"
    LINK_LOST = "the link is silent"
    REFUSED = "the autopilot did not do what was asked"
    FAILED = "anything else"


class Reason(StrEnum):
    """Why; whole sentences where a person reads them."""

    GO_ON = "nothing is against it"
    TAKEN = "the pilot flies"
    NOT_OURS = (
        "the vehicle is armed, or not on the ground: others fly it, or a flight before this one "
        "did not end; nothing was commanded; land and disarm it first, or in Hold go on with that "
        "flight: --resume RUN"
    )
    FAILED = "the vehicle, or what it is flown with, failed"
    DISARMED = "the vehicle disarmed during the patrol; see what it says"
    NO_POSITION = (
        "the vehicle lost its absolute position (GPS?): where it is, and what it sees where, "
        "cannot be trusted; it comes down"
    )
    INTERRUPTED = "a person asked for the return"
    BATTERY_LOW = "the battery brings it home, and no further"
    TIME_UP = "it has been in the air for as long as its battery is said to last until the return"
    ESTIMATE_SILENT = (
        "nothing was heard of the estimator for long, though other signs of a good position are "
        "there; it returns while they are"
    )
    OUTSIDE = "the drone is about to leave its fence, or its heights; it returns"
    OFF_PATH = "the drone left its path or its height by more than wind explains; it returns"
    STUCK = "the drone makes no way, as against too strong a wind; it returns"
    BLIND = "no picture could be taken and read for too long; the drone returns"
    HORIZON = "the horizon is flown"
    PLANNER_LATE = "the planner gave no waypoint in time"
    THERE = "it has flown home as far as the autopilot must not fly straight"
    UNSURE = "it may be armed: two heartbeats in a row must say that it is not, of one vehicle"
    MOTORS_OFF = "the motors are off"
    LEFT = "a person ended the program while nothing could be commanded"
    LOST_FOR_GOOD = "the link did not come back"
    LOST = "the link is silent"
    REFUSED = "what is refused here may go there"
    FAILSAFE_FLIES = "a failsafe flies home or lands"
    FAILSAFE_HOLDS = "a failsafe holds, as it does before it acts"
    FAILSAFE_STAYS = "a failsafe has held for long, and the position is good: home"
    FAILSAFE_STICKS = "a failsafe left it to the pilot's sticks"
    FAILSAFE_HOVERS = "a failsafe without a position can only hover: only down is left"
    FAILSAFE_OVER = "the failsafe is over, and the mode is none that we asked for"
    LAND_NOW = "a person wants it to land here"
    POSITION_BACK = "the position is good again: home rather than down here"
    COMING_DOWN = "it is on its way down"
    ON_GROUND = "it stands on the ground"
    DOWN_HERE = "it lands here"
    HOME = "it returns"
    PILOT_LANDED = "the pilot stopped the motors"
    PILOT_KEEPS = "a person ended the program while the pilot flew"
    GIVEN_BACK = "the pilot chose offboard"
    PILOT_FAILSAFE = "a setpoint would end the failsafe"


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """All that the table looks at.

    before: the state that the pilot or a failsafe broke into.
    may_attach: whether it flies as the flight that goes on may have left it.
    is_sure: whether two heartbeats in a row, none of them older than our last request to arm, say
    what `is_armed` says, and there is one vehicle to say so; is_offboard needs two as well.
    are_two: whether another vehicle of the same system id is heard.
    is_position_good: whether there is an absolute position.
    is_outside: whether it could not stop within the fence any more, or is too high or too low.
    is_holding, is_coming_down: whether the mode is hold; whether it is return or land.
    is_failsafe_long: whether a failsafe has held for longer than it does before it acts.
    is_position_back: whether it was lost on this flight, and no return was refused since.
    is_home_around: whether it is to fly home along its own way, which does not end here: straight,
    as the autopilot returns, may be over a no-fly zone or outside of the field.
    is_overridden: whether we have landed it before on this flight, and a pilot's sticks are heard.
    is_down_under_way: whether the way down was confirmed, and nothing has broken it since.
    is_on_ground_long: whether it should have disarmed by itself.
    times_interrupted: how often a person asked: to return, to land here, to end the program.
    """

    state: State
    before: State
    setback: Setback = Setback.NONE
    is_armed: bool
    may_attach: bool = False
    is_sure: bool = True
    are_two: bool = False
    is_on_ground: bool = False
    is_on_ground_long: bool = False
    is_position_good: bool = True
    is_battery_low: bool = False
    is_time_up: bool = False
    is_estimate_silent: bool = False
    is_outside: bool = False
    is_off_path: bool = False
    is_stuck: bool = False
    is_blind: bool = False
    is_offboard: bool = False
    is_holding: bool = False
    is_failsafe: bool = False
    is_failsafe_long: bool = False
    is_coming_down: bool = False
    is_position_back: bool = False
    is_down_under_way: bool = False
    is_overridden: bool = False
    times_interrupted: int = 0
    is_horizon_flown: bool = False
    is_planner_late: bool = False
    is_home_around: bool = False
    is_lost_for_long: bool = False


class PatrolFacts(TypedDict, total=False):
    """What only the patrol can tell the guard; see Situation."""

    is_horizon_flown: bool
    is_planner_late: bool
    is_home_around: bool
    is_estimate_silent: bool
    is_outside: bool
    is_off_path: bool
    is_stuck: bool
    is_blind: bool


@dataclass(frozen=True, slots=True)
class Advice:
    """What to do, why, and the state that follows."""

    state: State
    action: Action
    reason: Reason


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table; `after` is the next state, None where it stays."""

    states: tuple[State, ...]
    holds: Callable[[Situation], bool]
    after: State | None
    action: Action
    reason: Reason


def advise(situation: Situation) -> Advice:
    """What the table says; nothing is asked once the flight has ended."""
    row = deciding_row(situation)
    return Advice(row.after or situation.state, row.action, row.reason)


def deciding_row(situation: Situation) -> Row:
    """The first row of the situation's state that holds."""
    return next(row for row in _ROWS[situation.state] if row.holds(situation))


_PREPARING, _LAUNCHING, _PATROLLING, _HEADING_HOME = ((state,) for state in MISSION)
_ON_THE_WAY = _PATROLLING + _HEADING_HOME
_RETURNING, _LANDING, _FAILSAFE = ((state,) for state in HOMEWARD)
_PILOT = (State.PILOT,)
_STUCK = {Setback.REFUSED, Setback.LINK_LOST, Setback.FAILED}
"""Setbacks in which no command has an effect."""


def _always(_: Situation) -> bool:
    return True


def _has(setback: Setback) -> Callable[[Situation], bool]:
    return lambda s: s.setback is setback


def _given_back(*before: State) -> Callable[[Situation], bool]:
    return lambda s: s.is_offboard and s.before in before


def _ends_of_patrol(holds: Callable[[Situation], bool], reason: Reason) -> tuple[Row, Row]:
    """What ends a patrol without need of haste: home by its own way, if it has one, or straight."""
    return (
        Row(
            _PATROLLING,
            lambda s: holds(s) and s.is_home_around,
            State.HEADING_HOME,
            Action.GO_ON,
            reason,
        ),
        Row(_PATROLLING, holds, State.RETURNING, Action.LEAVE, reason),
    )


# fmt: off
TABLE = (
    # On the ground the vehicle is not ours yet: nothing is commanded.
    Row(_PREPARING, lambda s: s.setback is not Setback.NONE,
        State.ENDED, Action.END, Reason.FAILED),
    Row(_PREPARING, lambda s: s.times_interrupted >= 1,
        State.ENDED, Action.END, Reason.INTERRUPTED),
    Row(_PREPARING, lambda s: (s.is_armed or not s.is_on_ground) and not s.may_attach,
        State.ENDED, Action.END, Reason.NOT_OURS),
    Row(_PREPARING, lambda s: s.is_horizon_flown, State.ENDED, Action.END, Reason.HORIZON),

    # The mission, until something ends it.
    Row(_LAUNCHING + _ON_THE_WAY, _has(Setback.PILOT), State.PILOT, Action.OFFER, Reason.TAKEN),
    Row(_LAUNCHING + _ON_THE_WAY, _has(Setback.LINK_LOST),
        State.RETURNING, Action.LISTEN, Reason.LOST),
    Row(_LAUNCHING + _ON_THE_WAY, lambda s: s.setback is not Setback.NONE,
        State.RETURNING, Action.LEAVE, Reason.FAILED),
    Row(_ON_THE_WAY, lambda s: not s.is_armed and s.is_sure,
        State.RETURNING, Action.LEAVE, Reason.DISARMED),
    Row(_ON_THE_WAY, lambda s: not s.is_position_good,
        State.LANDING, Action.LEAVE, Reason.NO_POSITION),
    Row(_LAUNCHING, lambda s: s.times_interrupted >= 1,
        State.RETURNING, Action.LEAVE, Reason.INTERRUPTED),
    Row(_ON_THE_WAY, lambda s: s.times_interrupted >= 2,
        State.RETURNING, Action.LEAVE, Reason.INTERRUPTED),
    Row(_ON_THE_WAY, lambda s: s.is_outside, State.RETURNING, Action.LEAVE, Reason.OUTSIDE),
    Row(_ON_THE_WAY, lambda s: s.is_estimate_silent,
        State.RETURNING, Action.LEAVE, Reason.ESTIMATE_SILENT),
    Row(_ON_THE_WAY, lambda s: s.is_off_path, State.RETURNING, Action.LEAVE, Reason.OFF_PATH),
    Row(_ON_THE_WAY, lambda s: s.is_stuck, State.RETURNING, Action.LEAVE, Reason.STUCK),
    *_ends_of_patrol(lambda s: s.times_interrupted >= 1, Reason.INTERRUPTED),
    *_ends_of_patrol(lambda s: s.is_battery_low, Reason.BATTERY_LOW),
    *_ends_of_patrol(lambda s: s.is_horizon_flown, Reason.HORIZON),
    *_ends_of_patrol(lambda s: s.is_time_up, Reason.TIME_UP),
    *_ends_of_patrol(lambda s: s.is_blind, Reason.BLIND),
    *_ends_of_patrol(lambda s: s.is_planner_late, Reason.PLANNER_LATE),
    Row(_HEADING_HOME, lambda s: not s.is_home_around,
        State.RETURNING, Action.LEAVE, Reason.THERE),
    Row(MISSION, _always, None, Action.GO_ON, Reason.GO_ON),

    # The way home: who may still be heard?
    Row(HOMEWARD, lambda s: s.times_interrupted >= 3
        and (s.setback in _STUCK or (s.are_two and not s.is_armed)),
        State.ENDED, Action.END, Reason.LEFT),
    Row(HOMEWARD, lambda s: s.setback is Setback.LINK_LOST and s.is_lost_for_long,
        State.ENDED, Action.END, Reason.LOST_FOR_GOOD),
    Row(HOMEWARD, _has(Setback.LINK_LOST), None, Action.LISTEN, Reason.LOST),
    Row(HOMEWARD, lambda s: not s.is_armed and not s.is_sure, None, Action.LISTEN, Reason.UNSURE),
    Row(HOMEWARD, lambda s: not s.is_armed, State.ENDED, Action.END, Reason.MOTORS_OFF),
    # Who flies?
    Row(HOMEWARD, _has(Setback.PILOT), State.PILOT, Action.OFFER, Reason.TAKEN),
    Row(_RETURNING + _FAILSAFE, lambda s: s.setback is Setback.NONE and s.is_down_under_way
        and s.times_interrupted >= 2 and s.before is not State.LANDING,
        State.LANDING, Action.LEAVE, Reason.LAND_NOW),
    Row(HOMEWARD, lambda s: _is_failsafe_in(s) and s.is_on_ground_long,
        None, Action.DISARM, Reason.ON_GROUND),
    Row(HOMEWARD, lambda s: _is_failsafe_in(s) and s.is_coming_down,
        State.FAILSAFE, Action.WATCH, Reason.FAILSAFE_FLIES),
    Row(_FAILSAFE, lambda s: not s.is_failsafe, State.PILOT, Action.OFFER, Reason.FAILSAFE_OVER),
    # Without a position PX4 calls what a pilot flies by sticks a failsafe, too.
    Row(HOMEWARD, lambda s: _is_failsafe_in(s) and s.is_overridden and not s.is_holding,
        State.PILOT, Action.WAIT, Reason.FAILSAFE_STICKS),
    Row(HOMEWARD, lambda s: _is_failsafe_in(s) and not s.is_position_good,
        State.LANDING, Action.LEAVE, Reason.FAILSAFE_HOVERS),
    Row(HOMEWARD, lambda s: _is_failsafe_in(s) and not s.is_failsafe_long,
        State.FAILSAFE, Action.WATCH, Reason.FAILSAFE_HOLDS),
    Row(HOMEWARD, lambda s: _is_failsafe_in(s) and s.is_holding,
        State.RETURNING, Action.LEAVE, Reason.FAILSAFE_STAYS),
    Row(HOMEWARD, lambda s: _is_failsafe_in(s), State.PILOT, Action.WAIT, Reason.FAILSAFE_STICKS),
    # We do.
    Row(_RETURNING, _has(Setback.REFUSED), State.LANDING, Action.LEAVE, Reason.REFUSED),
    Row(_LANDING, lambda s: s.setback is Setback.REFUSED and s.times_interrupted < 2,
        State.RETURNING, Action.LEAVE, Reason.REFUSED),
    Row(_RETURNING + _LANDING, lambda s: s.is_on_ground_long
        or (s.is_on_ground and not s.is_down_under_way), None, Action.DISARM, Reason.ON_GROUND),
    Row(_LANDING, lambda s: s.is_down_under_way and s.is_position_back and s.times_interrupted < 2,
        State.RETURNING, Action.LEAVE, Reason.POSITION_BACK),
    Row(_RETURNING + _LANDING, lambda s: s.is_down_under_way,
        None, Action.WATCH, Reason.COMING_DOWN),
    Row(_RETURNING, lambda s: not s.is_position_good or s.times_interrupted >= 2,
        State.LANDING, Action.LEAVE, Reason.DOWN_HERE),
    Row(_LANDING, _always, None, Action.LAND, Reason.DOWN_HERE),
    Row(_RETURNING, _always, None, Action.RETURN, Reason.HOME),

    # The pilot, who always wins: nothing is commanded.
    Row(_PILOT, lambda s: not s.is_armed and s.is_sure,
        State.ENDED, Action.END, Reason.PILOT_LANDED),
    Row(_PILOT, lambda s: s.times_interrupted >= 2, State.ENDED, Action.END, Reason.PILOT_KEEPS),
    Row(_PILOT, lambda s: s.setback is Setback.LINK_LOST and s.is_lost_for_long,
        State.ENDED, Action.END, Reason.LOST_FOR_GOOD),
    Row(_PILOT, lambda s: s.setback is not Setback.NONE, None, Action.LISTEN, Reason.LOST),
    Row(_PILOT, _given_back(State.PATROLLING, State.HEADING_HOME),
        State.PATROLLING, Action.GO_ON, Reason.GIVEN_BACK),
    Row(_PILOT, _given_back(State.LANDING), State.LANDING, Action.LEAVE, Reason.GIVEN_BACK),
    Row(_PILOT, _given_back(State.LAUNCHING, State.RETURNING, State.FAILSAFE),
        State.RETURNING, Action.LEAVE, Reason.GIVEN_BACK),  # before the patrol: too early to go on
    Row(_PILOT, lambda s: s.is_failsafe, None, Action.WAIT, Reason.PILOT_FAILSAFE),
    Row(_PILOT, _always, None, Action.OFFER, Reason.TAKEN),
)
# fmt: on
_ROWS = {state: [row for row in TABLE if state in row.states] for state in State}


def _is_failsafe_in(s: Situation) -> bool:
    """Whether a failsafe flies, or did before something else was looked at."""
    return s.setback is Setback.FAILSAFE or s.state is State.FAILSAFE
