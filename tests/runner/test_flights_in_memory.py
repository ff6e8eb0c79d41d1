"""Every row of the guard's table, flown by the whole runner on a vehicle in memory."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import virtual_time
from fake_link import FakeCamera, FakeLink

from dronemon import guard
from dronemon.errors import (
    CameraError,
    CommandRejected,
    ControlTaken,
    LinkLost,
    PlannerError,
    RecordError,
    VehicleError,
)
from dronemon.events import Decided, Event, Measured, Noted, Pictured, Progressed
from dronemon.guard import TABLE, Advice, Reason, Situation
from dronemon.mission import load_mission
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.recorder import _json_line
from dronemon.roadmap import Roadmap
from dronemon.runner import FlightResult, FlightSetup, Interrupts, fly_mission, supervisor
from dronemon.vehicle import Mode

MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 0.8, start_au: [0.5, 0.4]}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
"""


class Shuttle:
    """Flies to and fro; `answer` may replace its third waypoint."""

    name = "shuttle"

    def __init__(self) -> None:
        self.asked = 0
        self.answer: Callable[[], Waypoint] | None = None
        self.on_reset: Callable[[], object] = lambda: None

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self.asked = 0
        self.on_reset()

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.asked += 1
        snapshot.position_au[:] = np.nan  # its own copy
        if self.asked == 3 and self.answer is not None:
            return self.answer()
        return Waypoint(position_au=np.array([0.5, 0.6 if self.asked % 2 else 0.4]))


class Blind:
    """A detector that finds nothing."""

    def detect(self, *_: object) -> tuple[()]:
        return ()


class Listener:
    """Keeps what it is told; `on_note` may act on it."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.on_note: Callable[[str], None] = lambda kind: None

    def take(self, event: Event) -> None:
        self.events.append(event)
        if isinstance(event, Noted):
            self.on_note(event.kind)

    @property
    def kinds(self) -> list[str]:
        return [event.kind for event in self.events if isinstance(event, Noted)]

    def texts(self, words: str) -> int:
        return sum(isinstance(event, Noted) and words in event.text for event in self.events)

    def text(self, kind: str) -> str:
        return next(e.text for e in self.events if isinstance(e, Noted) and e.kind == kind)


class Flight:
    """One flight, its parts open to what a test does to them."""

    def __init__(self, path: Path, reasons: set[Reason]) -> None:
        self.path, self.reasons = path, reasons
        self.record, self.view = Listener(), Listener()
        self.interrupts = Interrupts()
        self.planner = Shuttle()
        self.detector: Any = Blind()
        self.picture_px = (640, 480)
        self.on_link: Callable[[FakeLink], None] = lambda link: None

    def fly(self, *faults: str, **options: Any) -> FlightResult:
        return virtual_time.run(self._fly(faults, options))

    async def _fly(self, faults: tuple[str, ...], options: dict[str, Any]) -> FlightResult:
        self.path.write_text(MISSION)
        async with FakeLink(faults=faults, **options) as self.link:
            self.on_link(self.link)
            return await fly_mission(
                FlightSetup(
                    file=load_mission(self.path),
                    link=self.link,
                    camera=FakeCamera(self.link, *self.picture_px),
                    detector=self.detector,
                    planner=self.planner,
                    priors_au=np.array([[0.4, 0.6]]),
                    record=self.record,
                    watchers=(self.view,),
                    interrupts=self.interrupts,
                )
            )

    def ask(self, times: int = 1) -> None:
        for _ in range(times):
            self.interrupts.request()

    def when(self, kind: str, act: Callable[[], object]) -> None:
        """Act once, when something of this kind is noted."""

        def hear(noted: str) -> None:
            if noted == kind:
                self.record.on_note = lambda kind: None
                act()

        self.record.on_note = hear

    def later(self, duration_s: float, act: Callable[[], object]) -> None:
        asyncio.get_running_loop().call_later(duration_s, act)


_flown: set[int] = set()
"""Numbers of the table's rows that decided something in a flight of this process."""


@pytest.fixture
def prepare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Flight]:
    """Makes a flight whose `reasons` are those that the guard gave last."""
    reasons: set[Reason] = set()

    def advise(situation: Situation) -> Advice:
        _flown.add(TABLE.index(guard.deciding_row(situation)))
        advice = guard.advise(situation)
        reasons.add(advice.reason)
        return advice

    def make() -> Flight:
        reasons.clear()
        return Flight(tmp_path / "small.yaml", reasons)

    monkeypatch.setattr(supervisor, "advise", advise)
    return make


@pytest.fixture
def flight(prepare: Callable[[], Flight]) -> Flight:
    return prepare()


def _comes_home(flight: Flight, result: FlightResult) -> None:
    assert result.is_landed
    assert flight.link.commands[-1] in {"return", "land", "disarm"}
    assert flight.record.kinds[-2:] == ["disarmed", "outcome"]


def test_the_whole_story(flight):
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert result.landing_error_m == pytest.approx(0.0, abs=0.1)
    story = ["ready", "armed", "airborne", "patrol", "homecoming", "disarmed", "outcome"]
    assert flight.record.kinds == story
    assert flight.view.events == flight.record.events
    assert {Reason.GO_ON, Reason.HORIZON, Reason.HOME} <= flight.reasons


def test_every_picture_of_a_horizon_is_taken(flight):
    result = flight.fly()
    assert result.tally.num_pictures_due == 8
    for kind in (Measured, Pictured):
        assert sum(isinstance(event, kind) for event in flight.record.events) == 8
    assert result.tally.flown_m == pytest.approx(80.0, abs=1.0)
    assert any(isinstance(event, Decided) for event in flight.record.events)


def test_pictures_of_another_size_are_refused_on_the_ground(flight):
    flight.picture_px = (640, 360)
    result = flight.fly()
    assert isinstance(result.error, CameraError)
    assert "640 x 360 pixels, the mission says 640 x 480" in str(result.error)
    assert flight.link.commands == []


def test_a_camera_may_still_wake_up_on_the_ground(flight):
    def sleep_a_little(link: FakeLink) -> None:
        link.is_camera_silent = True
        flight.later(2.0, lambda: setattr(link, "is_camera_silent", False))

    flight.on_link = sleep_a_little
    assert flight.fly().outcome == "completed"


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
    _comes_home(flight, result)


def test_the_first_interrupt_says_what_a_second_one_does(flight):
    flight.when("patrol", flight.ask)
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert "again lands it where it is" in flight.record.text("interrupt")
    _comes_home(flight, result)


def test_a_second_interrupt_lands_here(flight):
    def once_more(kind: str) -> None:
        if kind in {"patrol", "homecoming"}:
            flight.interrupts.request()

    flight.record.on_note = once_more
    result = flight.fly()
    assert flight.link.commands[-2:] == ["return", "land"]
    assert Reason.LAND_NOW in flight.reasons
    _comes_home(flight, result)


def test_a_refused_take_off_disarms(flight):
    flight.on_link = lambda link: link.vehicle.refused.add("take-off")
    result = flight.fly()
    assert isinstance(result.error, CommandRejected)
    assert flight.link.commands[-1] == "disarm"
    assert Reason.ON_GROUND in flight.reasons
    _comes_home(flight, result)


def test_a_vehicle_that_arms_unheard_is_looked_at_again(flight):
    """Arming is given up after a heartbeat that was too slow; the next one shows it armed."""
    result = flight.fly(heartbeat_s=11.0)
    assert isinstance(result.error, CommandRejected)
    assert Reason.UNSURE in flight.reasons
    _comes_home(flight, result)


def _fails() -> Waypoint:
    raise IndexError("beyond the roadmap")


def _hangs() -> Waypoint:
    virtual_time.let_time_pass()
    threading.Event().wait()
    raise AssertionError


def _gives(
    *place_au: float, node: Any = None, details: Any = MappingProxyType({})
) -> Callable[[], Waypoint]:
    return lambda: Waypoint(position_au=np.array(place_au), node=node, details=details)


def _leaves() -> Waypoint:
    sys.exit(3)


def _is_interrupted() -> Waypoint:
    raise KeyboardInterrupt


def _runs_out() -> Waypoint:
    return next(iter(()))


_ENDLESS: dict[str, object] = {}
_ENDLESS["again"] = _ENDLESS


@pytest.mark.parametrize(
    ("answer", "words", "reason"),
    [
        (_fails, "IndexError", Reason.FAILED),
        (_hangs, "no waypoint from planner 'shuttle' for 4 s", Reason.PLANNER_LATE),
        (_leaves, "SystemExit", Reason.FAILED),
        (_is_interrupted, "KeyboardInterrupt", Reason.FAILED),
        (_runs_out, "StopIteration", Reason.FAILED),
        (_gives(np.nan, 0.5), "no place", Reason.FAILED),
        (_gives(0.5, 0.5, 0.5), "not two numbers", Reason.FAILED),
        (_gives(0.5, 0.5, node="a"), "no number of a node", Reason.FAILED),
        (_gives(0.5, 0.5, details=_ENDLESS), "RecursionError", Reason.FAILED),
        (_gives(0.5, 0.5, details=3), "AttributeError", Reason.FAILED),
        (lambda: None, "None, which is no Waypoint", Reason.FAILED),
    ],
)
def test_a_bad_planner_brings_the_drone_home(flight, answer, words, reason):
    flight.planner.answer = answer
    result = flight.fly()
    assert isinstance(result.error, PlannerError)
    assert words in str(result.error)
    assert result.outcome == "failed"
    assert reason in flight.reasons
    _comes_home(flight, result)


def test_what_json_cannot_say_of_a_decision_is_recorded_as_text(flight):
    flight.planner.answer = _gives(0.5, 0.6, details={"lock": threading.Lock(), "half": "\udc80"})
    assert flight.fly().outcome == "completed"
    told = next(e for e in flight.record.events if isinstance(e, Decided) and e.details)
    assert "lock" in asdict(told)["details"]["lock"]
    assert json.loads(_json_line(told.details))["half"] == "\udc80"


@pytest.mark.parametrize(
    ("act", "words"), [(_hangs, "no answer for 30 s"), (_leaves, "SystemExit")]
)
def test_a_planner_that_does_not_begin_flies_nothing(flight, act, words):
    flight.planner.on_reset = act
    result = flight.fly()
    assert isinstance(result.error, PlannerError)
    assert "planner 'shuttle'" in str(result.error)
    assert words in str(result.error)
    assert flight.link.commands == []


@pytest.mark.parametrize(
    ("detect", "words"),
    [
        (lambda *_: 1 // 0, "ZeroDivisionError"),
        (lambda *_: None, "'NoneType' object is not iterable"),
        (lambda *_: [3], "'int' object has no attribute"),
        (lambda *_: _leaves(), "SystemExit"),
        (lambda *_: _hangs(), "no answer for 3 s"),
    ],
)
def test_a_bad_detector_brings_the_drone_home(flight, detect, words):
    flight.detector.detect = detect
    result = flight.fly()
    assert isinstance(result.error, CameraError)
    assert "the detector" in str(result.error)
    assert words in str(result.error)
    _comes_home(flight, result)


def test_a_dead_camera_brings_the_drone_home(flight):
    result = flight.fly("camera@12")
    assert isinstance(result.error, CameraError)
    _comes_home(flight, result)


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
    result = flight.fly("battery=0.24@12")
    assert (result.outcome, result.error) == ("battery low", None)
    _comes_home(flight, result)


def test_a_vehicle_that_disarms_on_patrol_ends_the_flight(flight):
    flight.when("patrol", lambda: flight.link._set_armed(False))
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "disarmed during the patrol" in str(result.error)
    assert "return" not in flight.link.commands


def test_lost_gps_ends_the_patrol(flight):
    """Without it the vehicle hovers; landing and returning are asked for in turn."""
    result = flight.fly("gps@12+40")
    assert "lost its absolute position" in str(result.error)
    assert {"land", "return"} <= set(flight.link.commands)
    assert {
        *(Reason.NO_POSITION, Reason.FAILSAFE_HOVERS),
        *(Reason.DOWN_HERE, Reason.REFUSED),
    } <= flight.reasons
    _comes_home(flight, result)


def test_commands_that_are_never_obeyed_are_given_up(flight):
    result = flight.fly("gps@12")
    assert "lost its absolute position" in str(result.error)
    assert not result.is_landed
    assert Reason.REFUSED_FOR_GOOD in flight.reasons


def test_a_failsafe_is_left_to_land(flight):
    """Commands that are not heard: setpoints stop for the vehicle, which flies home by itself."""
    result = flight.fly("deaf@12")
    assert isinstance(result.error, ControlTaken)
    assert result.error.by_failsafe
    assert result.is_landed
    assert "homecoming" not in flight.record.kinds
    assert flight.record.texts("a failsafe") == 1
    assert {Reason.FAILSAFE_FLIES, Reason.COMING_DOWN, Reason.MOTORS_OFF} <= flight.reasons


def test_a_lost_link_is_waited_for(flight):
    """The autopilot's own failsafe flies home meanwhile."""
    result = flight.fly("silence@12+60")
    assert isinstance(result.error, LinkLost)
    assert result.is_landed
    assert flight.record.texts("nothing heard") == 1
    assert Reason.LOST in flight.reasons


def test_a_link_lost_once_more_is_told_once_more(flight):
    flight.when("patrol", flight.ask)
    flight.fly("silence@10+3", "silence@14.5+3")
    assert flight.record.texts("nothing heard") == 2


def test_an_interrupt_is_answered_while_the_link_is_silent(flight):
    """At once, not after the link counts as lost; two fast ones as well."""
    told: list[float] = []

    def lose() -> None:
        flight.link.is_silent = True
        flight.later(16.0, lambda: flight.ask(2))  # the return is asked for until then
        flight.later(16.1, lambda: told.append(flight.record.kinds.count("interrupt")))
        flight.later(40.0, lambda: setattr(flight.link, "is_silent", False))

    flight.when("patrol", lose)
    result = flight.fly(link_loss_timeout_s=7.0)
    assert told == [1]
    assert "land" in flight.link.commands
    assert result.is_landed


def test_a_link_that_stays_lost_ends_the_flight(flight):
    result = flight.fly("silence@12")
    assert isinstance(result.error, LinkLost)
    assert not result.is_landed
    assert Reason.LOST_FOR_GOOD in flight.reasons


def test_a_reboot_on_the_way_home_ends_the_flight(flight):
    flight.when("homecoming", lambda: setattr(flight.link, "_has_rebooted", True))
    result = flight.fly()
    assert "rebooted" in str(result.error)
    assert Reason.BROKEN in flight.reasons


# The pilot


def _give_back(flight: Flight) -> None:
    flight.link.vehicle.choose(Mode.OFFBOARD)


def test_the_pilot_takes_over_and_gives_back(flight):
    flight.when("control taken", lambda: flight.later(5.0, lambda: _give_back(flight)))
    result = flight.fly("pilot@12")
    assert (result.outcome, result.error) == ("completed", None)
    kinds = flight.record.kinds
    assert kinds.index("control taken") < kinds.index("control given back")
    assert Reason.GIVEN_BACK in flight.reasons
    _comes_home(flight, result)


def test_control_given_back_before_the_patrol_is_too_early(flight):
    flight.when("control taken", lambda: flight.later(5.0, lambda: _give_back(flight)))
    result = flight.fly("pilot@3")
    assert isinstance(result.error, ControlTaken)
    assert Reason.GIVEN_BACK in flight.reasons
    _comes_home(flight, result)


@pytest.mark.parametrize("is_without_gps", [False, True])
def test_the_pilot_wins_on_the_way_home(flight, is_without_gps):
    """Given back, the way down goes on as it was: home, or here where there was no GPS."""

    def take() -> None:
        flight.when("control taken", lambda: flight.later(3.0, lambda: _give_back(flight)))
        flight.link.vehicle.has_gps = True
        flight.link.vehicle.choose(Mode.POSITION)

    def end_patrol() -> None:
        flight.when("homecoming", lambda: flight.later(1.5, take))
        flight.link.vehicle.has_gps = not is_without_gps
        if not is_without_gps:
            flight.interrupts.request()

    flight.when("patrol", end_patrol)
    result = flight.fly()
    assert Reason.GIVEN_BACK in flight.reasons
    assert flight.link.commands[-1] == ("land" if is_without_gps else "return")
    _comes_home(flight, result)


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


def test_a_reboot_while_the_pilot_flies_ends_the_flight(flight):
    flight.when(
        "control taken",
        lambda: flight.later(1.0, lambda: setattr(flight.link, "_has_rebooted", True)),
    )
    result = flight.fly("pilot@12")
    assert "rebooted" in str(result.error)
    assert Reason.BROKEN in flight.reasons


def test_progress_is_told_about_once_a_second(flight):
    result = flight.fly()
    patrol = [e for e in flight.view.events if isinstance(e, Progressed) and e.phase == "patrol"]
    assert len(patrol) == pytest.approx(result.tally.duration_s, abs=2.0)
    assert patrol[-1].flown_au > 0.7


FLIGHTS_OF_EVERY_ROW = (
    test_an_interrupt_in_the_climb_comes_home,
    test_a_second_interrupt_lands_here,
    test_a_refused_take_off_disarms,
    test_a_vehicle_that_arms_unheard_is_looked_at_again,
    partial(
        test_a_bad_planner_brings_the_drone_home,
        answer=_hangs,
        words="no waypoint",
        reason=Reason.PLANNER_LATE,
    ),
    test_a_dead_camera_brings_the_drone_home,
    test_a_low_battery_brings_the_drone_home,
    test_a_vehicle_that_disarms_on_patrol_ends_the_flight,
    test_lost_gps_ends_the_patrol,
    test_commands_that_are_never_obeyed_are_given_up,
    test_a_failsafe_is_left_to_land,
    test_a_link_that_stays_lost_ends_the_flight,
    test_a_reboot_on_the_way_home_ends_the_flight,
    test_the_pilot_takes_over_and_gives_back,
    test_control_given_back_before_the_patrol_is_too_early,
    partial(test_the_pilot_wins_on_the_way_home, is_without_gps=True),
    test_a_pilot_who_lands_ends_the_flight,
    test_nothing_is_commanded_while_the_pilot_flies,
    test_no_setpoint_flows_while_a_failsafe_flies_for_the_pilot,
    test_a_pilot_whose_link_stays_silent_is_left,
    test_a_reboot_while_the_pilot_flies_ends_the_flight,
)


def test_every_row_of_the_table_is_flown(prepare):
    """What the tests before this one have flown already is not flown again."""
    for fly in FLIGHTS_OF_EVERY_ROW:
        if len(_flown) < len(TABLE):
            fly(prepare())
    assert [row for number, row in enumerate(TABLE) if number not in _flown] == []
