"""A pilot takes over, and gives back, or does not."""

from __future__ import annotations

from dataclasses import replace

import pytest
from fake_link import FakeLink
from flights import (
    comes_home,
    give_back,
)

from dronemon.errors import (
    ControlTaken,
    LinkLost,
    VehicleError,
)
from dronemon.guard import Reason
from dronemon.vehicle import Mode


def test_a_pilot_may_take_over_a_landing_without_gps(flight):
    """PX4 flies POSITION as ALTITUDE then, and calls it a failsafe."""
    commands: list[str] = []

    def take_over() -> None:
        flight.link.vehicle.choose(Mode.POSITION)
        commands.extend(flight.link.commands)
        flight.later(30.0, lambda: flight.ask(2))

    flight.when("homecoming", lambda: flight.later(2.0, take_over))
    result = flight.fly("gps@12")
    assert commands[-1] == "land"
    assert flight.link.commands == commands
    assert not result.is_landed


def test_a_failsafe_that_leaves_it_to_sticks_is_the_pilots(flight):
    """A radio that is on: PX4 falls back to POSCTL, with a good position."""

    def fall_back() -> None:
        flight.link.vehicle.failsafe = Mode.POSITION
        flight.when("control taken", lambda: flight.later(3.0, lambda: flight.ask(2)))

    flight.when("patrol", fall_back)
    result = flight.fly()
    assert Reason.FAILSAFE_STICKS in flight.reasons
    assert not {"return", "land", "disarm"} & set(flight.link.commands)
    assert "its failsafe acts" in result.last_word


def test_a_pilot_wins_while_a_command_is_under_way_after_a_failsafe(flight):
    """The mode is watched from the command on, though any was welcome before."""

    def take() -> None:
        if "land" not in flight.link.commands:
            flight.later(0.1, take)
            return
        flight.link.vehicle.refused.add("land")
        flight.link.vehicle.has_gps = True
        flight.link.vehicle.choose(Mode.POSITION)
        flight.later(8.0, lambda: flight.ask(2))

    flight.when("failure", take)
    flight.fly("gps@12+20")
    assert flight.link.commands.count("land") == 1
    assert "control taken" in flight.record.kinds


@pytest.mark.parametrize("moment", ["homecoming", "patrol"])
def test_a_pilot_on_the_way_home_is_remembered(flight, moment):
    def take() -> None:
        flight.link.vehicle.choose(Mode.POSITION)
        flight.later(5.0, lambda: give_back(flight))

    flight.when(moment, lambda: flight.later(1.0, take))
    result = flight.fly("battery=0.17@20")
    assert (result.outcome, result.is_landed) == ("battery low", True)
    assert "control given back" in flight.record.kinds
    assert result.was_taken_home is (moment == "homecoming")


def test_a_patrol_given_back_low_climbs_before_it_goes_on(flight):
    def sink() -> None:
        flight.link.vehicle.position[2] = -3.0
        flight.link.vehicle.climb_m_s = 2.0
        flight.later(2.0, lambda: give_back(flight))

    def look(kind: str) -> None:
        if kind == "control taken":
            flight.later(0.5, sink)
        elif kind == "control given back":
            start = list(flight.link.vehicle.position)
            flight.later(4.0, lambda: ways.append((start, list(flight.link.vehicle.position))))

    ways: list[tuple[list[float], list[float]]] = []
    flight.record.on_note = look
    result = flight.fly("pilot@12")
    (start, after) = ways[0]
    assert after[2] < start[2] - 5.0
    assert after[:2] == pytest.approx(start[:2], abs=0.1)
    assert (result.outcome, result.error) == ("completed", None)


def test_a_pilot_may_take_over_from_a_failsafe_and_give_back(flight):
    def fail() -> None:
        flight.link.vehicle.failsafe = Mode.RETURN
        flight.when("failure", lambda: flight.later(2.0, take))

    def take() -> None:
        flight.when("control taken", lambda: flight.later(3.0, lambda: give_back(flight)))
        flight.link.vehicle.choose(Mode.POSITION)

    flight.when("patrol", fail)
    result = flight.fly()
    assert {Reason.FAILSAFE_OVER, Reason.GIVEN_BACK} <= flight.reasons
    assert flight.commands[-1] == "return"
    comes_home(flight, result)


@pytest.mark.parametrize("height_m", [0.0, 35.0])
def test_a_vehicle_that_others_fly_is_not_touched(flight, height_m):
    def fly(link: FakeLink) -> None:
        link.vehicle.is_armed = True
        link.vehicle.position[2] = -height_m
        link.vehicle.choose(Mode.POSITION)

    flight.on_link = fly
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "land and disarm it first" in str(result.error)
    assert "mode 'position'" in result.last_seen.words
    assert flight.link.commands == []


def test_the_pilot_takes_over_and_gives_back(flight):
    flight.when("control taken", lambda: flight.later(5.0, lambda: give_back(flight)))
    result = flight.fly("pilot@12")
    assert (result.outcome, result.error) == ("completed", None)
    kinds = flight.record.kinds
    assert kinds.index("control taken") < kinds.index("control given back")
    assert Reason.GIVEN_BACK in flight.reasons
    comes_home(flight, result)


def test_control_given_back_before_the_patrol_is_too_early(flight):
    flight.when("control taken", lambda: flight.later(5.0, lambda: give_back(flight)))
    result = flight.fly("pilot@3")
    assert isinstance(result.error, ControlTaken)
    assert Reason.GIVEN_BACK in flight.reasons
    comes_home(flight, result)


@pytest.mark.parametrize("is_without_gps", [False, True])
def test_the_pilot_wins_on_the_way_home(flight, is_without_gps):
    """Given back, the way down goes on as it was: home, or here where there was no GPS."""

    def take() -> None:
        flight.when("control taken", lambda: flight.later(3.0, lambda: give_back(flight)))
        flight.link.vehicle.has_gps = flight.link.vehicle.is_position_good = True
        flight.link.vehicle.choose(Mode.POSITION)

    def end_patrol() -> None:
        flight.when("homecoming", lambda: flight.later(1.5, take))
        flight.link.vehicle.has_gps = not is_without_gps
        flight.link.vehicle.is_position_good = not is_without_gps
        if not is_without_gps:
            flight.interrupts.request()

    flight.when("patrol", end_patrol)
    result = flight.fly()
    assert Reason.GIVEN_BACK in flight.reasons
    assert flight.commands[-1] == "return"
    comes_home(flight, result)


def test_a_pilot_who_lands_ends_the_flight(flight):
    flight.when(
        "control taken", lambda: flight.later(3.0, lambda: flight.link.vehicle.choose(Mode.LAND))
    )
    result = flight.fly("pilot@12")
    assert (result.outcome, result.is_landed) == ("pilot", True)
    assert not {"return", "land", "disarm"} & set(flight.link.commands)


def test_nothing_is_commanded_while_the_pilot_flies(flight):
    flight.when("control taken", lambda: flight.ask(2))
    result = flight.fly("pilot@12")
    assert (result.outcome, result.is_landed) == ("pilot", False)
    assert "homecoming" not in flight.record.kinds
    assert not {"return", "land", "disarm"} & set(flight.link.commands)


def test_no_setpoint_flows_while_a_failsafe_flies_for_the_pilot(flight):
    def fail() -> None:
        flight.link.vehicle.failsafe = Mode.RETURN
        counts.append(flight.link.num_setpoints)
        flight.later(2.0, lambda: counts.append(flight.link.num_setpoints))

    counts: list[int] = []
    flight.when("control taken", lambda: flight.later(3.0, fail))
    result = flight.fly("pilot@12")
    assert result.is_landed
    assert Reason.PILOT_FAILSAFE in flight.reasons
    assert counts[1] - counts[0] <= 51  # until the heartbeat that shows the failsafe


def test_a_pilot_whose_link_is_silent_for_a_while_is_not_fought(flight):
    flight.when("control taken", lambda: flight.later(30.0, lambda: flight.ask(2)))
    result = flight.fly("pilot@12", "silence@15+20")
    assert result.outcome == "pilot"
    assert "homecoming" not in flight.record.kinds
    assert Reason.LOST in flight.reasons


def test_a_pilot_whose_link_stays_silent_is_left(flight):
    result = flight.fly("pilot@12", "silence@15")
    assert isinstance(result.error, LinkLost)
    assert Reason.LOST_FOR_GOOD in flight.reasons
    assert not {"return", "land", "disarm"} & set(flight.link.commands)


def test_a_reboot_while_the_pilot_flies_ends_nothing(flight):
    flight.when(
        "control taken",
        lambda: flight.later(1.0, lambda: setattr(flight.link, "_has_rebooted", True)),
    )
    flight.view.on_note = lambda kind: (
        kind == "failure" and flight.later(3.0, lambda: flight.ask(2))
    )
    result = flight.fly("pilot@12")
    assert flight.record.texts("rebooted") == 1
    assert result.outcome == "pilot"


def test_one_heartbeat_that_says_offboard_gives_nothing_back(flight):
    """It may be an old one that came late: only the pilot's own choice counts."""

    def mislead() -> None:
        flight.link.mislead(mode=Mode.OFFBOARD)
        flight.later(10.0, lambda: flight.ask(2))

    flight.when("control taken", lambda: flight.later(2.5, mislead))
    result = flight.fly("pilot@12")
    assert "control given back" not in flight.record.kinds
    assert result.outcome == "pilot"


def test_a_flight_that_a_pilot_lands_on_its_way_home_is_the_pilots(flight):
    """A low battery sent it home; a relay must not take off again out of the pilot's hands."""

    def land() -> None:
        flight.link.vehicle.position[2] = 0.0
        flight.later(1.5, lambda: setattr(flight.link.vehicle, "is_armed", False))

    def take() -> None:
        flight.link.vehicle.choose(Mode.POSITION)
        flight.later(3.0, land)

    flight.when("homecoming", lambda: flight.later(1.0, take))
    result = flight.fly("battery=0.18@12")
    assert Reason.BATTERY_LOW in flight.reasons
    assert (result.outcome, result.is_landed) == ("pilot", True)


@pytest.mark.lengthy
@pytest.mark.parametrize("after_s", [1.0, 1.3, 1.6, 1.9])
@pytest.mark.parametrize("moment", ["armed", "patrol", "homecoming"])
def test_motors_that_stop_in_the_air_are_no_landing(flight, moment, after_s):
    def kill() -> None:
        flight.link.vehicle.is_armed = False

    flight.when(moment, lambda: flight.later(after_s + 4.0 * (moment == "armed"), kill))
    result = flight.fly()
    assert (result.outcome, result.is_landed, result.landing_error_m) == ("failed", False, None)
    assert "the motors stopped in the air" in result.last_word
    assert "at 47." in result.last_word
    assert isinstance(result.error, VehicleError)
    assert flight.record.text("disarmed") == result.last_word


def test_a_killed_drone_has_fallen_though_it_disarms_on_the_ground(flight):
    """PX4 leaves it armed for 5 s."""

    def kill() -> None:
        vehicle = flight.link.vehicle
        vehicle.failsafe = Mode.TERMINATION
        flight.later(5.0, lambda: setattr(vehicle, "is_armed", False))

    flight.when("homecoming", lambda: flight.later(1.0, kill))
    result = flight.fly()
    assert (result.outcome, result.is_landed) == ("failed", False)
    assert "it has fallen" in result.last_word


@pytest.mark.lengthy
@pytest.mark.parametrize("disarm_after_s", [0.1, 0.5, 2.0])
def test_a_landing_on_higher_ground_is_no_fall(flight, disarm_after_s):
    def land() -> None:
        vehicle = flight.link.vehicle
        vehicle.is_armed = vehicle.position[2] < -8.0 - 3.0 * disarm_after_s
        if vehicle.is_armed:
            flight.later(0.1, land)
        else:
            vehicle.fall_m_s = 0.0

    flight.when("homecoming", land)
    result = flight.fly()
    assert (result.outcome, result.is_landed) == ("completed", True)


def test_a_terminated_flight_is_no_failsafe_that_flies_home(flight):
    def terminate() -> None:
        flight.link.vehicle.failsafe = Mode.TERMINATION
        flight.link.vehicle.fall_m_s = 0.0  # it is still heard in the air
        flight.later(30.0, lambda: flight.ask(2))

    flight.when("patrol", lambda: flight.later(1.0, terminate))
    result = flight.fly()
    assert not result.is_landed
    assert "has stopped the motors for good" in result.last_word
    assert not {"return", "land", "disarm"} & set(flight.link.commands)


@pytest.mark.lengthy
def test_of_two_vehicles_of_one_id_none_is_told_as_down(flight):
    def mix() -> None:
        flight.link.hear_another()
        flight.link.vehicle.is_armed = False
        flight.later(60.0, lambda: flight.ask(3))

    flight.when("homecoming", lambda: flight.later(1.0, mix))
    result = flight.fly()
    assert not result.is_landed
    assert "the motors may be running" in result.last_word
    assert Reason.UNSURE in flight.reasons
    assert flight.record.kinds.count("disarmed") == 0


def test_a_local_frame_that_moves_ends_the_patrol(flight):
    def move() -> None:
        origin = flight.link.origin
        flight.link.origin = replace(origin, latitude_deg=origin.latitude_deg + 25e-5)

    flight.when("patrol", lambda: flight.later(2.0, move))
    result = flight.fly()
    assert "the origin of its local frame moved" in str(result.error)
    assert (result.is_landed, result.landing_error_m) == (True, None)
    assert "return" in flight.commands
