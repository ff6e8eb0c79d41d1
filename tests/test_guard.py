"""The guard's table over every situation that a flight can be in."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator

import pytest

from dronemon.guard import (
    HOMEWARD,
    MISSION,
    TABLE,
    Action,
    Advice,
    Reason,
    Setback,
    Situation,
    State,
    advise,
    deciding_row,
)

ALLOWED = {
    State.PREPARING: {Action.GO_ON},
    State.LAUNCHING: {Action.GO_ON},
    State.PATROLLING: {Action.GO_ON},
    State.RETURNING: {Action.LEAVE, Action.LISTEN, Action.RETURN, Action.WATCH, Action.DISARM},
    State.LANDING: {Action.LEAVE, Action.LISTEN, Action.LAND, Action.WATCH, Action.DISARM},
    State.FAILSAFE: {Action.LISTEN, Action.WATCH},
    State.PILOT: {Action.OFFER, Action.WAIT},
    State.ENDED: {Action.END},
}
"""What may be done in the state that the advice leads to."""
LEFT_ARMED = {
    Reason.BROKEN,
    Reason.LOST_FOR_GOOD,
    Reason.REFUSED_FOR_GOOD,
    Reason.PILOT_KEEPS,
}
"""Where an armed drone is left: all but the last are marked `F:` in the table, to be mended."""
MISSION_FACTS = ("is_position_good", "is_battery_low", "is_horizon_flown", "is_planner_late")
HOME_FACTS = (
    *("is_sure", "is_on_ground", "is_coming_down", "is_down_under_way"),
    *("is_lost_for_long", "is_refused_for_long", "is_offboard", "is_failsafe"),
)


BEFORE = {
    State.PILOT: (State.LAUNCHING, State.PATROLLING, State.RETURNING, State.LANDING),
    State.FAILSAFE: (State.RETURNING, State.LANDING),
}
"""Where a pilot, or a failsafe on the way home, can break in."""


def _situations(state: State) -> Iterator[Situation]:
    """Every combination of what the table may look at in a state."""
    facts = MISSION_FACTS if state in MISSION else HOME_FACTS
    befores = BEFORE.get(state, (state,))
    for before, setback, is_armed, times in itertools.product(befores, Setback, (0, 1), range(3)):
        for values in itertools.product((False, True), repeat=len(facts)):
            yield Situation(
                state=state,
                before=before,
                setback=setback,
                is_armed=bool(is_armed),
                times_interrupted=times,
                **dict(zip(facts, values, strict=True)),
            )


@functools.cache
def _advices() -> list[tuple[Situation, Advice]]:
    states = [state for state in State if state is not State.ENDED]  # nothing is asked any more
    return [(situation, advise(situation)) for state in states for situation in _situations(state)]


def test_every_situation_gets_an_action_that_its_state_allows():
    for situation, advice in _advices():
        assert advice.action in ALLOWED[advice.state] | {Action.LEAVE}, (situation, advice)
        if advice.action is Action.LEAVE:
            assert advice.state in HOMEWARD, (situation, advice)
        if advice.state is not State.ENDED:
            assert advice.action is not Action.END


def test_an_armed_drone_is_left_only_where_the_table_says_so():
    left = {
        advice.reason
        for situation, advice in _advices()
        if advice.action is Action.END and situation.is_armed
    }
    assert left == LEFT_ARMED


def test_the_pilot_always_wins_and_nothing_is_commanded_then():
    for situation, advice in _advices():
        is_taken = situation.setback is Setback.PILOT and situation.is_armed
        if is_taken and situation.state in {State.LAUNCHING, State.PATROLLING, *HOMEWARD}:
            assert advice.state is State.PILOT
        if situation.state is State.PILOT:
            assert advice.action not in {Action.RETURN, Action.LAND, Action.DISARM}
            if advice.action is Action.OFFER:
                assert not situation.is_failsafe, "a setpoint would end the failsafe"


def test_control_comes_back_only_with_offboard():
    for situation, advice in _advices():
        if situation.state is State.PILOT and advice.state not in {State.PILOT, State.ENDED}:
            assert situation.is_offboard
            assert situation.is_armed
            assert situation.times_interrupted < 2


def test_the_patrol_goes_on_only_while_nothing_is_against_it():
    for situation, advice in _advices():
        if situation.state is State.PATROLLING and advice.action is Action.GO_ON:
            assert situation.is_armed
            assert situation.is_position_good
            assert not situation.is_battery_low
            assert not situation.times_interrupted
            assert situation.setback is Setback.NONE


def test_a_second_interrupt_lands_here():
    for situation, advice in _advices():
        if situation.state is State.RETURNING and situation.times_interrupted >= 2:
            assert advice.action is not Action.RETURN


def test_an_unarmed_drone_on_its_way_home_ends_the_flight():
    for situation, advice in _advices():
        if situation.state in HOMEWARD and not situation.is_armed:
            assert advice.action is (
                Action.END if advice.reason != Reason.UNSURE else Action.LISTEN
            )


@pytest.mark.parametrize("state", [State.RETURNING, State.LANDING])
def test_what_is_refused_here_is_asked_for_there(state: State):
    refused = Situation(state=state, before=state, setback=Setback.REFUSED, is_armed=True)
    other = State.LANDING if state is State.RETURNING else State.RETURNING
    assert advise(refused) == Advice(other, Action.LEAVE, Reason.REFUSED)


def test_every_row_is_reached_and_every_reason_used():
    reached = {id(deciding_row(situation)) for situation, _ in _advices()}
    assert [row for row in TABLE if id(row) not in reached] == []
    assert {row.reason for row in TABLE} == set(Reason)
