"""The guard's table over every situation that a flight can be in."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import replace

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
    State.HEADING_HOME: {Action.GO_ON},
    State.RETURNING: {Action.LEAVE, Action.LISTEN, Action.RETURN, Action.WATCH, Action.DISARM},
    State.LANDING: {Action.LEAVE, Action.LISTEN, Action.LAND, Action.WATCH, Action.DISARM},
    State.FAILSAFE: {Action.LISTEN, Action.WATCH, Action.DISARM},
    State.PILOT: {Action.OFFER, Action.WAIT, Action.LISTEN},
    State.ENDED: {Action.END},
}
"""What may be done in the state that the advice leads to."""
LEFT_ARMED = {Reason.LOST_FOR_GOOD, Reason.LEFT, Reason.PILOT_KEEPS}
"""Where a drone of ours is left armed: to a person, or because nothing is heard."""
COMMANDS = {Action.RETURN, Action.LAND, Action.DISARM}
MISSION_FACTS = (
    *("is_sure", "is_on_ground", "is_position_good", "is_battery_low", "is_time_up"),
    *(
        "is_estimate_silent",
        "is_outside",
        "may_attach",
        "is_off_path",
        "is_stuck",
        "is_blind",
        "is_horizon_flown",
        "is_planner_late",
        "is_home_around",
    ),
)
MODES = (
    {},
    {"is_offboard": True},
    {"is_holding": True},
    {"is_overridden": True},
    {"is_coming_down": True},
)
GROUND = ({}, {"is_on_ground": True}, {"is_on_ground": True, "is_on_ground_long": True})
FAILSAFES = ({}, {"is_failsafe": True}, {"is_failsafe": True, "is_failsafe_long": True})
HOME_FLAGS = ("is_sure", "is_position_good", "is_position_back", "is_down_under_way")
BEFORE = {
    State.PILOT: (State.LAUNCHING, State.PATROLLING, State.HEADING_HOME, *HOMEWARD),
    State.FAILSAFE: (State.RETURNING, State.LANDING),
}
"""Where a pilot, or a failsafe on the way home, can break in."""


def _facts(state: State) -> Iterator[dict[str, bool]]:
    """What telemetry may say in a state: all combinations, on the mission of two that are odd."""
    if state in MISSION:
        good = {"is_sure", "is_on_ground", "is_position_good"}
        usual = {name: name in good for name in MISSION_FACTS}
        for odd in itertools.chain.from_iterable(
            itertools.combinations(MISSION_FACTS, number) for number in range(3)
        ):
            yield usual | {name: not usual[name] for name in odd}
        return
    flags = [({flag: False}, {flag: True}) for flag in HOME_FLAGS]
    ground = GROUND if state in HOMEWARD else GROUND[:1]
    for parts in itertools.product(MODES, ground, FAILSAFES, *flags):
        yield {name: value for part in parts for name, value in part.items()}


def _situations(state: State) -> Iterator[Situation]:
    """Every situation that a state can be in."""
    setbacks = [(setback, False) for setback in Setback] + [(Setback.LINK_LOST, True)]
    for facts in _facts(state):
        for before, (setback, is_lost), is_armed, times in itertools.product(
            BEFORE.get(state, (state,)),
            setbacks,
            (False, True),
            (0, 1, 2) if state in MISSION else (0, 2, 3),
        ):
            yield Situation(
                state=state,
                before=before,
                setback=setback,
                is_lost_for_long=is_lost,
                is_armed=is_armed,
                times_interrupted=times,
                **facts,
            )


@functools.cache
def _advices() -> list[tuple[Situation, Advice]]:
    states = [state for state in State if state is not State.ENDED]  # nothing is asked any more
    return [(situation, advise(situation)) for state in states for situation in _situations(state)]


@pytest.mark.lengthy
def test_every_situation_gets_an_action_that_its_state_allows():
    for situation, advice in _advices():
        assert advice.action in ALLOWED[advice.state] | {Action.LEAVE}, (situation, advice)
        if advice.action is Action.LEAVE:
            assert advice.state in HOMEWARD, (situation, advice)
        assert (advice.action is Action.END) == (advice.state is State.ENDED)


@pytest.mark.lengthy
def test_a_drone_of_ours_is_left_armed_only_to_a_person_or_to_silence():
    left = {
        advice.reason
        for situation, advice in _advices()
        if advice.action is Action.END
        and (situation.is_armed or not situation.is_sure)
        and situation.state is not State.PREPARING
    }
    assert left == LEFT_ARMED


@pytest.mark.lengthy
def test_of_two_vehicles_none_is_taken_for_down_and_a_person_may_leave():
    for situation, _ in _advices():
        if situation.state in {*HOMEWARD, State.PILOT, State.PATROLLING}:
            two = replace(situation, is_armed=False, is_sure=False, are_two=True)
            advice = advise(two)
            if advice.action is Action.END:
                assert advice.reason in LEFT_ARMED
                assert two.times_interrupted >= 2 or two.is_lost_for_long
            elif two.state in HOMEWARD:
                assert advice.action is Action.LISTEN
                assert two.times_interrupted < 3


def test_on_the_ground_a_vehicle_of_others_is_not_touched():
    for situation, advice in _advices():
        if situation.state is State.PREPARING:
            assert advice.action in {Action.GO_ON, Action.END}
            is_others = situation.is_armed or not situation.is_on_ground
            if is_others and not situation.may_attach:
                assert advice.action is Action.END


def test_the_pilot_always_wins_and_nothing_is_commanded_then():
    for situation, advice in _advices():
        is_taken = situation.setback is Setback.PILOT and situation.is_armed
        if is_taken and situation.state in {*MISSION[1:], *HOMEWARD}:
            assert advice.state is State.PILOT
        if situation.state is State.PILOT:
            assert advice.action not in COMMANDS
            if advice.action is Action.OFFER:
                assert not situation.is_failsafe, "a setpoint would end the failsafe"


def test_control_comes_back_only_with_offboard():
    for situation, advice in _advices():
        if situation.state is State.PILOT and advice.state not in {State.PILOT, State.ENDED}:
            assert situation.is_offboard
            assert situation.is_armed or not situation.is_sure
            assert situation.times_interrupted < 2


def test_the_patrol_goes_on_only_while_nothing_is_against_it():
    for situation, advice in _advices():
        if situation.state is State.PATROLLING and advice.state is State.PATROLLING:
            assert situation.is_armed or not situation.is_sure
            assert situation.is_position_good
            assert not situation.is_battery_low
            assert not situation.is_time_up
            assert not situation.is_estimate_silent
            assert not situation.is_outside
            assert not situation.is_off_path
            assert not situation.is_stuck
            assert not situation.is_blind
            assert not situation.times_interrupted
            assert situation.setback is Setback.NONE


def test_a_second_interrupt_lands_here():
    for situation, advice in _advices():
        if situation.state is State.RETURNING and situation.times_interrupted >= 2:
            assert advice.action is not Action.RETURN


def test_a_failsafe_is_never_commanded_while_it_acts():
    for situation, advice in _advices():
        is_acting = situation.setback is Setback.FAILSAFE and situation.is_coming_down
        if is_acting and situation.state in HOMEWARD and not situation.is_on_ground_long:
            assert advice.action not in COMMANDS


def test_land_is_asked_for_only_without_a_position_or_a_way_home():
    """Where there is a position, home is better than the field."""
    for situation, advice in _advices():
        if situation.state in {State.RETURNING, State.FAILSAFE} and advice.state is State.LANDING:
            is_refused = situation.setback is Setback.REFUSED
            is_asked = situation.times_interrupted >= 2
            assert not situation.is_position_good or is_asked or is_refused, situation


def test_nothing_is_commanded_into_silence():
    for situation, advice in _advices():
        if situation.setback is Setback.LINK_LOST:
            assert advice.action not in COMMANDS, situation


def test_an_unarmed_drone_on_its_way_home_ends_the_flight():
    for situation, advice in _advices():
        if situation.state in HOMEWARD and not situation.is_armed:
            assert advice.action in {Action.END, Action.LISTEN}


@pytest.mark.parametrize("state", [State.RETURNING, State.LANDING])
def test_what_is_refused_here_is_asked_for_there(state: State):
    refused = Situation(state=state, before=state, setback=Setback.REFUSED, is_armed=True)
    other = State.LANDING if state is State.RETURNING else State.RETURNING
    assert advise(refused) == Advice(other, Action.LEAVE, Reason.REFUSED)


def test_every_row_is_reached_and_every_reason_used():
    reached = {id(deciding_row(situation)) for situation, _ in _advices()}
    assert [row for row in TABLE if id(row) not in reached] == []
    assert {row.reason for row in TABLE} == set(Reason)


def test_the_way_home_is_its_own_where_it_has_one_and_there_is_no_haste():
    haste = ("is_outside", "is_off_path", "is_stuck", "is_estimate_silent")
    for situation, advice in _advices():
        is_hasty = (
            any(getattr(situation, fact) for fact in haste)
            or situation.setback is not Setback.NONE
            or situation.times_interrupted >= 2
            or not situation.is_position_good
            or (situation.is_sure and not situation.is_armed)
        )
        if situation.state is State.PATROLLING and advice.state is State.HEADING_HOME:
            assert situation.is_home_around
            assert not is_hasty
            straight = advise(replace(situation, is_home_around=False))
            assert (straight.state, straight.reason) == (State.RETURNING, advice.reason)
        if situation.state is State.HEADING_HOME:
            assert advice.state is not State.PATROLLING
            if not is_hasty:
                goes_on = situation.is_home_around
                assert (advice.action is Action.GO_ON) == goes_on, (situation, advice)
                assert advice.state is (State.HEADING_HOME if goes_on else State.RETURNING)
