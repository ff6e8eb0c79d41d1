"""The whole runner on a vehicle in memory: whatever happens, the drone comes home."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from fake_link import FakeLink
from flights import (
    MISSION,
    comes_home,
    give_back,
)

from dronemon import guard
from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    LinkLost,
    RecordError,
    VehicleError,
)
from dronemon.events import Event, Measured, Noted
from dronemon.guard import Advice, Reason, Situation
from dronemon.runner import supervisor
from dronemon.runner.flight import DOWN, NOT_STARTED
from dronemon.sensor import Sensor
from dronemon.vehicle import Mode


def test_the_whole_story(flight):
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert result.landing_error_m == pytest.approx(0.0, abs=0.1)
    story = ["ready", "armed", "airborne", "patrol", "homecoming", "disarmed", "outcome"]
    assert flight.record.kinds == story
    assert flight.view.events == flight.record.events
    assert {Reason.GO_ON, Reason.HORIZON, Reason.HOME} <= flight.reasons


def test_beliefs_know_how_the_eye_errs(flight):
    flight.mission_text += "sensor: {miss: 0.1, false_alarms: 0.05}\n"
    tally = flight.fly().tally
    assert tally.sightings.sensor == Sensor(miss=0.1, false_alarms=0.05)


def test_an_interrupt_before_take_off_flies_nothing(flight):
    flight.ask()
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert flight.link.commands == []


def test_an_interrupt_in_the_climb_comes_home(flight):
    flight.when("armed", lambda: flight.later(2.0, flight.ask))
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert "airborne" not in flight.record.kinds
    comes_home(flight, result)


def test_the_first_interrupt_says_what_a_second_one_does(flight):
    flight.when("patrol", flight.ask)
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert "again lands it where it is" in flight.record.text("interrupt")
    comes_home(flight, result)


def test_a_second_interrupt_lands_here(flight):
    def once_more(kind: str) -> None:
        if kind in {"patrol", "homecoming"}:
            flight.interrupts.request()

    flight.record.on_note = once_more
    result = flight.fly()
    assert flight.commands[-2:] == ["return", "land"]
    assert Reason.LAND_NOW in flight.reasons
    comes_home(flight, result)


def test_a_refused_take_off_disarms(flight):
    flight.on_link = lambda link: link.vehicle.refused.add("take-off")
    result = flight.fly()
    assert isinstance(result.error, CommandRejected)
    assert flight.commands[-1] == "disarm"
    assert Reason.ON_GROUND in flight.reasons
    comes_home(flight, result)


def test_motors_that_stop_in_the_climb_were_started(flight):
    flight.when("armed", lambda: flight.later(1.0, lambda: flight.link._set_armed(False)))
    result = flight.fly()
    assert isinstance(result.error, CommandUnconfirmed)
    assert result.last_word == "the drone is down, and its motors are off"
    assert flight.record.kinds[-2:] == ["disarmed", "outcome"]


def test_a_vehicle_that_arms_unheard_is_looked_at_again(flight):
    """Arming is given up after a heartbeat that was too slow; the next one shows it armed."""
    result = flight.fly(heartbeat_s=11.0)
    assert isinstance(result.error, CommandRejected)
    assert Reason.UNSURE in flight.reasons
    comes_home(flight, result)


def test_a_record_that_cannot_be_written_brings_the_drone_home(flight, monkeypatch):
    def take(event: Event) -> None:
        if isinstance(event, Measured | Noted) and event.time_s and event.time_s > 15.0:
            raise RecordError("cannot write: no space left on device")

    monkeypatch.setattr(flight.record, "take", take)
    result = flight.fly()
    assert isinstance(result.error, RecordError)
    assert result.is_landed
    assert flight.view.kinds[-2:] == ["disarmed", "outcome"]


def test_a_view_that_fails_is_counted_and_not_heard(flight, monkeypatch):
    def take(event: Event) -> None:
        raise SystemExit  # as rich makes of a closed pipe

    monkeypatch.setattr(flight.view, "take", take)
    assert flight.fly().outcome == "completed"


def test_a_low_battery_brings_the_drone_home(flight):
    result = flight.fly("battery=0.18@12")
    assert (result.outcome, result.error) == ("battery low", None)
    comes_home(flight, result)


def test_a_vehicle_that_disarms_on_patrol_ends_the_flight(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "fall_m_s", 0.0)
    flight.when("patrol", lambda: flight.link._set_armed(False))
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "disarmed during the patrol" in str(result.error)
    assert "return" not in flight.link.commands


def test_lost_gps_lands_here(flight):
    """The failsafe can only hover, and a return is refused."""
    result = flight.fly("gps@12")
    assert isinstance(result.error, VehicleError)
    assert {Reason.FAILSAFE_HOVERS, Reason.DOWN_HERE} <= flight.reasons
    assert flight.commands[-1] == "land"
    assert result.landing_error_m is None, "where it is, is not known"
    comes_home(flight, result)


def test_gps_that_comes_back_in_the_descent_brings_it_home(flight):
    result = flight.fly("gps@12+5")
    assert Reason.POSITION_BACK in flight.reasons
    assert flight.commands[-2:] == ["land", "return"]
    assert result.landing_error_m == pytest.approx(0.0, abs=0.1)


def test_a_position_that_is_no_good_lands_here(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "is_position_good", False))
    result = flight.fly()
    assert "lost its absolute position" in str(result.error)
    assert Reason.NO_POSITION in flight.reasons
    assert flight.commands[-1] == "land"


@pytest.mark.lengthy
def test_what_is_never_obeyed_is_asked_for_until_a_person_ends_it(flight):
    """A drone of ours is not left while it is heard, unless a person wants it so."""

    def give_up() -> None:
        flight.later(400.0, lambda: flight.ask(3))

    flight.when("airborne", give_up)
    flight.on_link = lambda link: setattr(link.vehicle, "setpoint_limit_s", np.inf)
    result = flight.fly("reject@12")
    assert len(flight.link.commands) > 20
    assert {"land", "return"} <= set(flight.link.commands)
    assert not result.is_landed
    assert Reason.LEFT in flight.reasons
    assert result.last_seen.latitude_deg == pytest.approx(47.4, abs=0.01)
    assert "mode 'offboard'" in result.last_seen.words


def test_a_failsafe_is_left_to_act(flight):
    """Commands that are not heard: setpoints stop for the vehicle, which holds and flies home."""
    result = flight.fly("deaf@12")
    assert isinstance(result.error, ControlTaken)
    assert result.error.by_failsafe
    assert result.is_landed
    assert "homecoming" not in flight.record.kinds
    assert flight.record.texts("a failsafe") == 1
    reasons = {Reason.FAILSAFE_HOLDS, Reason.FAILSAFE_FLIES, Reason.MOTORS_OFF}
    assert reasons <= flight.reasons


def test_nothing_is_sent_into_silence(flight):
    def lose() -> None:
        flight.link.is_silent = True
        flight.link.vehicle.choose(Mode.POSITION)  # a pilot, whom nobody hears
        counts.append(len(flight.link.commands))
        flight.later(5.0, flight.ask)
        flight.later(20.0, lambda: counts.append(len(flight.link.commands)))
        flight.later(20.0, lambda: setattr(flight.link, "is_silent", False))
        flight.when("control taken", lambda: flight.later(3.0, lambda: flight.ask(1)))

    counts: list[int] = []
    flight.when("patrol", lambda: flight.later(4.0, lose))
    result = flight.fly()
    assert counts[0] == counts[1]
    assert "control taken" in flight.record.kinds
    assert not {"return", "land", "disarm"} & set(flight.link.commands)
    assert not result.is_landed


def test_a_failsafe_that_only_holds_is_followed_by_a_return(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "failsafe", Mode.HOLD))
    result = flight.fly()
    assert Reason.FAILSAFE_STAYS in flight.reasons
    assert flight.commands[-1] == "return"
    comes_home(flight, result)


def test_a_lost_link_is_waited_for(flight):
    """The autopilot's own failsafe flies home meanwhile; every few seconds a word is said."""
    result = flight.fly("silence@12+60")
    assert isinstance(result.error, LinkLost)
    assert result.is_landed
    assert 8 <= flight.record.texts("nothing heard") <= 15
    assert Reason.LOST in flight.reasons


def test_an_interrupt_is_answered_while_the_link_is_silent(flight):
    """At once, not after the link counts as lost; two fast ones as well."""
    told: list[float] = []

    def lose() -> None:
        flight.link.is_silent = True
        flight.later(9.0, lambda: flight.ask(2))  # it listens since 7 s
        flight.later(9.1, lambda: told.append(flight.record.kinds.count("interrupt")))
        flight.later(10.0, lambda: setattr(flight.link, "is_silent", False))

    flight.when("patrol", lose)
    result = flight.fly(link_loss_timeout_s=7.0)
    assert told == [1]
    assert "lands where it is" in flight.record.text("interrupt")
    assert "land" in flight.link.commands
    assert result.is_landed


def test_a_link_that_stays_lost_ends_the_flight_and_says_where(flight):
    result = flight.fly("silence@12")
    assert isinstance(result.error, LinkLost)
    assert not result.is_landed
    assert Reason.LOST_FOR_GOOD in flight.reasons
    assert "47.39" in result.last_seen.words
    assert "failsafe acts within seconds" in result.last_seen.words


def test_a_reboot_on_the_way_home_ends_nothing(flight):
    flight.when("homecoming", lambda: setattr(flight.link, "_has_rebooted", True))
    result = flight.fly()
    assert flight.record.texts("rebooted") == 1
    assert result.outcome == "completed"
    comes_home(flight, result)


def test_a_fault_of_our_own_ends_nothing_either(flight, monkeypatch):
    def fail(self: FakeLink) -> None:
        monkeypatch.undo()
        raise TypeError("not a number")

    flight.when("patrol", lambda: monkeypatch.setattr(FakeLink, "next_pose", fail))
    result = flight.fly()
    assert "a fault of this program: TypeError" in str(result.error)
    comes_home(flight, result)


@pytest.mark.parametrize("kind", ["ready", "airborne", "patrol", "homecoming"])
def test_a_guard_that_cannot_be_asked_once_ends_nothing(flight, monkeypatch, kind):
    def fail(situation: Situation) -> Advice:
        monkeypatch.setattr(supervisor, "advise", guard.advise)
        raise TypeError("no situation")

    flight.when(kind, lambda: monkeypatch.setattr(supervisor, "advise", fail))
    result = flight.fly()
    if kind == "ready":
        assert (result.last_word, flight.commands) == (NOT_STARTED, [])
        return
    assert flight.record.texts("a fault of this program: TypeError") == 1
    assert result.outcome == ("completed" if kind == "homecoming" else "failed")
    comes_home(flight, result)


def test_without_a_guard_it_comes_home_until_a_person_ends_the_program(flight, monkeypatch):
    def fail(situation: Situation) -> Advice:
        raise TypeError("no situation")

    def begin() -> None:
        monkeypatch.setattr(supervisor, "advise", fail)
        flight.later(60.0, lambda: flight.ask(times=3))

    flight.when("patrol", begin)
    result = flight.fly()
    assert flight.link.vehicle.is_on_ground
    assert set(flight.commands[flight.commands.index("return") :]) == {"return"}
    assert flight.record.texts("a fault of this program: TypeError") > 5
    assert "the motors may be running" in result.last_word


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", ["ready", "airborne", "patrol", "homecoming", "outcome"])
def test_a_flight_that_is_cancelled_is_seen_through(flight, kind):
    """It is a person's interrupt: the drone comes home, and how it ended is known."""
    flight.when(kind, lambda: flight.task.cancel())
    result = flight.fly()
    is_over = kind in {"homecoming", "outcome"}
    assert result.outcome == ("completed" if is_over else "interrupted")
    assert result.last_word == (NOT_STARTED if kind == "ready" else DOWN)
    assert flight.record.kinds[-1] == "outcome"


def test_what_goes_on_beside_a_flight_ends_nothing(flight, monkeypatch):
    async def fail(self: FakeLink) -> None:
        await self.wait_until(lambda: self.state.mode is Mode.OFFBOARD, "patrol", 100.0)
        raise TypeError("not a text")

    monkeypatch.setattr(FakeLink, "next_texts", fail)
    result = flight.fly()
    assert flight.record.texts("TypeError") == 1
    assert (result.outcome, result.error) == ("completed", None)


def test_a_step_that_is_cancelled_from_within_is_a_fault_of_our_own(flight, monkeypatch):
    def fail(self: FakeLink) -> None:
        monkeypatch.undo()
        raise asyncio.CancelledError

    flight.when("patrol", lambda: monkeypatch.setattr(FakeLink, "next_pose", fail))
    result = flight.fly()
    assert "a fault of this program: CancelledError" in str(result.error)
    comes_home(flight, result)


def test_a_vehicle_that_never_disarms_by_itself_is_disarmed(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "disarm_after_s", np.inf)
    result = flight.fly()
    assert flight.commands[-1] == "disarm"
    assert result.outcome == "completed"
    comes_home(flight, result)


def test_it_is_disarmed_after_a_failsafe_landed_it_too(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "disarm_after_s", np.inf)
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "failsafe", Mode.RETURN))
    result = flight.fly()
    assert Reason.FAILSAFE_FLIES in flight.reasons
    assert flight.commands[-1] == "disarm"
    comes_home(flight, result)


def test_one_heartbeat_that_says_disarmed_is_not_believed(flight):
    """It may be an old one that came late."""
    flight.when("patrol", lambda: flight.link.mislead(is_armed=False))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)


@pytest.mark.lengthy
def test_a_battery_that_is_not_known_is_said_and_time_counts_instead(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "battery", None)
    flight.mission_text = MISSION.replace("horizon_au: 0.8", "horizon_au: 2, endurance_min: 4")
    flight.when("control taken", lambda: flight.later(200.0, lambda: give_back(flight)))
    result = flight.fly("pilot@12")
    assert "does not tell its level" in flight.record.text("preflight")
    assert (result.outcome, result.error) == ("battery low", None)
    assert Reason.TIME_UP in flight.reasons
    comes_home(flight, result)
