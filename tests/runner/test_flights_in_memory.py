"""Every row of the guard's table, flown by the whole runner on a vehicle in memory."""

from __future__ import annotations

import asyncio
import inspect
import json
import math
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import fake_link
import numpy as np
import pytest
import virtual_time
from fake_link import FakeCamera, FakeLink

from dronemon import guard
from dronemon.errors import (
    CameraError,
    CommandRejected,
    CommandUnconfirmed,
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
from dronemon.planner.motion import step_towards, until_measurement_au
from dronemon.recorder import _json_line
from dronemon.roadmap import Roadmap
from dronemon.runner import FlightResult, FlightSetup, Interrupts, fly_mission, supervisor
from dronemon.runner.flight import DOWN, NOT_STARTED
from dronemon.vehicle import Mode
from dronemon.vehicle.changes import state_folder
from dronemon.vehicle.fence_items import FenceItem, polygon_items

MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 0.8, start_au: [0.5, 0.4]}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
"""


LONGER = MISSION.replace("horizon_au: 0.8", "horizon_au: 4")
FASTER = LONGER.replace("speed_m_s: 5", "speed_m_s: 12")
FLIGHT_LIMIT_S = 3000.0


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
        self.mission_text = MISSION
        self.settings: dict[str, float] = {}
        self.on_link: Callable[[FakeLink], None] = lambda link: None

    def fly(self, *faults: str, **options: Any) -> FlightResult:
        return virtual_time.run(asyncio.wait_for(self._fly(faults, options), FLIGHT_LIMIT_S))

    async def _fly(self, faults: tuple[str, ...], options: dict[str, Any]) -> FlightResult:
        self.path.write_text(self.mission_text)
        self.task = asyncio.current_task()
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
                    settings=self.settings,
                )
            )

    @property
    def commands(self) -> list[str]:
        """Without the hold in which a vehicle of ours is left on the ground."""
        sent = self.link.commands
        return sent[:-1] if sent and sent[-1] == "hold" else sent

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
    assert flight.commands[-1] in {"return", "land", "disarm"}
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


def test_a_planner_that_steps_to_the_next_picture_is_not_asked_for_centimetres(flight):
    corners_au = [np.array(corner) for corner in ([0.2, 0.2], [0.8, 0.3], [0.3, 0.5])]

    def step(snapshot: Snapshot) -> Waypoint:
        here_au = snapshot.position_au
        if math.dist(here_au, corners_au[0]) < 1e-3:
            corners_au.append(corners_au.pop(0))
        step_au = until_measurement_au(snapshot.flown_au)
        return Waypoint(position_au=step_towards(here_au, corners_au[0], step_au))

    flight.planner.next_waypoint = step
    flight.mission_text = FASTER
    assert flight.fly().outcome == "completed"
    legs_au = [
        math.dist(event.position_au, event.waypoint_au)
        for event in flight.record.events
        if isinstance(event, Decided)
    ]
    assert len(legs_au) < 3 * 40
    assert np.median(legs_au) > 0.05


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
    assert flight.commands[-2:] == ["return", "land"]
    assert Reason.LAND_NOW in flight.reasons
    _comes_home(flight, result)


def test_a_refused_take_off_disarms(flight):
    flight.on_link = lambda link: link.vehicle.refused.add("take-off")
    result = flight.fly()
    assert isinstance(result.error, CommandRejected)
    assert flight.commands[-1] == "disarm"
    assert Reason.ON_GROUND in flight.reasons
    _comes_home(flight, result)


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
        (_hangs, "no waypoint from planner 'shuttle' for 20 s", Reason.PLANNER_LATE),
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
    flight.mission_text = LONGER
    result = flight.fly()
    assert isinstance(result.error, CameraError)
    assert "the detector" in flight.record.text("camera")
    assert words in flight.record.text("camera")
    _comes_home(flight, result)


def _takes(duration_s: float) -> Callable[..., tuple[()]]:
    """A detector that finds nothing, and needs so long for it."""

    def detect(*_: object) -> tuple[()]:
        virtual_time.take(loop, duration_s)
        return ()

    loop = asyncio.get_running_loop()
    return detect


def test_a_slow_detector_is_not_blamed_on_the_planner(flight):
    """A waypoint that is due waits for one picture at most, and the planner's time counts then."""
    flight.on_link = lambda link: setattr(flight.detector, "detect", _takes(2.9))
    flight.mission_text = FASTER.replace("au: 4", "au: 2")
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert "detector slow" in flight.record.kinds
    assert "planner slow" not in flight.record.kinds


def test_no_more_pictures_are_taken_than_a_slow_detector_can_look_at(flight):
    def across(snapshot: Snapshot) -> Waypoint:
        return Waypoint(position_au=np.full(2, 0.9 if snapshot.position_au[0] < 0.5 else 0.1))

    flight.planner.next_waypoint = across
    flight.on_link = lambda link: setattr(flight.detector, "detect", _takes(2.9))
    flight.mission_text = FASTER
    assert flight.fly().is_landed
    assert flight.record.texts("8 pictures wait") > 0


def test_a_dead_camera_brings_the_drone_home_after_a_while(flight):
    flight.mission_text = LONGER
    result = flight.fly("camera@12")
    assert isinstance(result.error, CameraError)
    assert "no picture could be taken" in str(result.error)
    assert Reason.BLIND in flight.reasons
    _comes_home(flight, result)


def test_the_patrol_goes_on_while_a_camera_is_silent_for_a_while(flight):
    result = flight.fly("camera@12+4")
    assert (result.outcome, result.error) == ("completed", None)
    assert 0 < len(result.tally.sightings) < 8
    assert flight.record.kinds.count("camera") == 1


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
    _comes_home(flight, result)


def test_a_vehicle_that_disarms_on_patrol_ends_the_flight(flight):
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
    _comes_home(flight, result)


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


def test_a_patrol_given_back_low_climbs_before_it_goes_on(flight):
    def sink() -> None:
        flight.link.vehicle.position[2] = -3.0
        flight.link.vehicle.climb_m_s = 2.0
        flight.later(2.0, lambda: _give_back(flight))

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


def test_a_failsafe_that_only_holds_is_followed_by_a_return(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "failsafe", Mode.HOLD))
    result = flight.fly()
    assert Reason.FAILSAFE_STAYS in flight.reasons
    assert flight.commands[-1] == "return"
    _comes_home(flight, result)


def test_a_pilot_may_take_over_from_a_failsafe_and_give_back(flight):
    def fail() -> None:
        flight.link.vehicle.failsafe = Mode.RETURN
        flight.when("failure", lambda: flight.later(2.0, take))

    def take() -> None:
        flight.when("control taken", lambda: flight.later(3.0, lambda: _give_back(flight)))
        flight.link.vehicle.choose(Mode.POSITION)

    flight.when("patrol", fail)
    result = flight.fly()
    assert {Reason.FAILSAFE_OVER, Reason.GIVEN_BACK} <= flight.reasons
    assert flight.commands[-1] == "return"
    _comes_home(flight, result)


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
    _comes_home(flight, result)


def test_a_fault_of_our_own_ends_nothing_either(flight, monkeypatch):
    def fail(self: FakeLink) -> None:
        monkeypatch.undo()
        raise TypeError("not a number")

    flight.when("patrol", lambda: monkeypatch.setattr(FakeLink, "next_pose", fail))
    result = flight.fly()
    assert "a fault of this program: TypeError" in str(result.error)
    _comes_home(flight, result)


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
    _comes_home(flight, result)


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


@pytest.mark.parametrize("kind", ["ready", "airborne", "patrol", "homecoming", "outcome"])
def test_a_flight_that_is_cancelled_is_seen_through(flight, kind):
    """It is a person's interrupt: the drone comes home, and how it ended is known."""
    flight.when(kind, lambda: flight.task.cancel())
    result = flight.fly()
    is_over = kind in {"homecoming", "outcome"}
    assert result.outcome == ("completed" if is_over else "interrupted")
    assert result.last_word == (NOT_STARTED if kind == "ready" else DOWN)
    assert flight.record.kinds[-1] == "outcome"


def test_a_camera_that_cannot_be_closed_loses_no_result(flight, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError("unplugged")

    monkeypatch.setattr(FakeCamera, "__aexit__", fail)
    result = flight.fly()
    assert (result.outcome, result.last_word) == ("completed", DOWN)
    assert str(result.error) == "after the flight: OSError('unplugged')"


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
    _comes_home(flight, result)


def test_a_vehicle_that_never_disarms_by_itself_is_disarmed(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "disarm_after_s", np.inf)
    result = flight.fly()
    assert flight.commands[-1] == "disarm"
    assert result.outcome == "completed"
    _comes_home(flight, result)


def test_it_is_disarmed_after_a_failsafe_landed_it_too(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "disarm_after_s", np.inf)
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "failsafe", Mode.RETURN))
    result = flight.fly()
    assert Reason.FAILSAFE_FLIES in flight.reasons
    assert flight.commands[-1] == "disarm"
    _comes_home(flight, result)


def test_one_heartbeat_that_says_disarmed_is_not_believed(flight):
    """It may be an old one that came late."""
    flight.when("patrol", lambda: flight.link.mislead(is_armed=False))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)


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


def test_an_empty_battery_is_found_on_the_ground(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "battery", 0.16)
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "battery (16%): it lasts 0.3 min down to 15%" in str(result.error)
    assert flight.link.commands == []


def test_a_set_up_that_would_do_harm_is_refused_with_what_mends_it(flight):
    flight.on_link = lambda link: link.vehicle.parameters.update(GF_ACTION=4.0, NAV_DLL_ACT=5.0)
    result = flight.fly()
    assert (result.outcome, result.has_flown) == ("failed", False)
    assert isinstance(result.error, VehicleError)
    assert "fence crossed (GF_ACTION=4): at a fence it stops the motors" in str(result.error)
    assert "--set NAV_DLL_ACT=0 --set GF_ACTION=3" in str(result.error)
    assert flight.link.commands == []


def test_a_warning_is_told_and_flown_with(flight):
    flight.on_link = lambda link: link.vehicle.parameters.update(GF_ACTION=2.0)
    assert flight.fly().outcome == "completed"
    assert "fence crossed (GF_ACTION=2)" in flight.record.text("preflight")


@pytest.mark.parametrize("fault", ["", "pilot@12+20", "camera@12"])
def test_a_parameter_for_a_flight_is_put_back_once_the_motors_are_off(flight, fault):
    flight.settings = {"COM_FAIL_ACT_T": 4.0}
    result = flight.fly(*filter(None, [fault]))
    assert result.is_landed
    assert flight.link.vehicle.parameters["COM_FAIL_ACT_T"] == 5.0
    commands = flight.link.commands
    assert commands[0] == "COM_FAIL_ACT_T=4"
    assert commands.index("COM_FAIL_ACT_T=5") > commands.index("return")
    assert flight.record.kinds.index("disarmed") < flight.record.kinds.index("outcome")


def test_a_parameter_stays_while_it_is_not_known_whether_the_motors_run(flight):
    flight.settings = {"COM_FAIL_ACT_T": 4.0}
    assert not flight.fly("silence@12").is_landed
    assert flight.link.vehicle.parameters["COM_FAIL_ACT_T"] == 4.0
    assert "COM_FAIL_ACT_T=4 is still set, and was 5" in flight.record.text("last word")
    kept = [path.name for path in state_folder().iterdir()]
    assert sorted(kept) == ["fake.fence.json", "fake.json"]


def test_the_vehicle_has_the_flights_fence_besides_its_own_until_it_is_down(flight):
    origin, half_deg = fake_link.ORIGIN, 0.005
    own = polygon_items(
        [
            (origin.latitude_deg + north * half_deg, origin.longitude_deg + east * half_deg)
            for north, east in ((-1, -1), (-1, 1), (1, 1), (1, -1))
        ]
    )
    flight.on_link = lambda link: setattr(link.vehicle, "fence", own)
    flown: list[int] = []
    flight.when("patrol", lambda: flown.append(len(flight.link.vehicle.fence)))
    assert flight.fly().outcome == "completed"
    assert flown == [8 + 4]
    assert flight.link.vehicle.fence == own
    assert flight.record.texts("its own fence is back: 4 corners and circles") == 1
    assert list(state_folder().iterdir()) == []


def test_a_fence_of_the_vehicle_that_is_in_the_way_is_refused(flight):
    def lay(link: FakeLink) -> None:
        here = (fake_link.ORIGIN.latitude_deg, fake_link.ORIGIN.longitude_deg)
        circle = FenceItem(
            command=5003, param1=40.0, x=round(here[0] * 1e7), y=round(here[1] * 1e7)
        )
        link.vehicle.fence = (circle,)

    flight.on_link = lay
    result = flight.fly()
    assert "own fence (1 areas): 1 of them are against the mission's area" in str(result.error)
    assert (result.last_word, flight.link.commands) == (NOT_STARTED, [])


def test_a_fence_that_is_refused_ends_the_flight_on_the_ground(flight):
    flight.on_link = lambda link: link.vehicle.refused.add("fence")
    result = flight.fly()
    assert isinstance(result.error, CommandRejected)
    assert (result.last_word, flight.link.commands) == (NOT_STARTED, [])
    assert list(state_folder().iterdir()) == []


def test_a_drone_that_is_about_to_leave_its_fence_returns(flight):
    def move() -> None:
        flight.link.vehicle.position[0] += 85.0
        flight.link.num_resets = 1  # so does the path

    flight.when("patrol", lambda: flight.later(3.0, move))
    result = flight.fly()
    assert Reason.OUTSIDE in flight.reasons
    assert Reason.OFF_PATH not in flight.reasons
    assert "about to leave its fence" in str(result.error)
    _comes_home(flight, result)


def test_a_drone_that_leaves_its_heights_returns_at_once(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "height_error_m", 12.0))
    result = flight.fly()
    assert Reason.OUTSIDE in flight.reasons
    _comes_home(flight, result)


def test_a_battery_that_is_not_known_is_said_and_time_counts_instead(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "battery", None)
    flight.mission_text = MISSION.replace("horizon_au: 0.8", "horizon_au: 2, endurance_min: 4")
    flight.when("control taken", lambda: flight.later(200.0, lambda: _give_back(flight)))
    result = flight.fly("pilot@12")
    assert "does not tell its level" in flight.record.text("preflight")
    assert (result.outcome, result.error) == ("battery low", None)
    assert Reason.TIME_UP in flight.reasons
    _comes_home(flight, result)


def test_a_drone_that_leaves_its_height_returns(flight):
    def sink() -> None:
        flight.link.vehicle.height_error_m = 8.0

    flight.when("patrol", sink)
    result = flight.fly()
    assert Reason.OFF_PATH in flight.reasons
    _comes_home(flight, result)


def test_an_estimator_that_falls_silent_brings_it_home(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "is_estimate_heard", False))
    result = flight.fly()
    assert Reason.ESTIMATE_SILENT in flight.reasons
    assert flight.commands[-1] == "return"
    _comes_home(flight, result)


def test_a_drone_that_makes_no_way_returns(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "speed_m_s", 0.0))
    result = flight.fly()
    assert Reason.STUCK in flight.reasons
    _comes_home(flight, result)


def test_a_drone_that_is_blown_away_returns_at_once(flight):
    def blow() -> None:
        flight.link.vehicle.speed_m_s, flight.link.vehicle.drift_m_s = 0.0, 4.0

    flight.when("patrol", blow)
    result = flight.fly()
    assert Reason.OFF_PATH in flight.reasons
    assert result.tally.flown_m < 40.0
    _comes_home(flight, result)


def test_the_path_follows_an_estimate_that_moves(flight):
    def move() -> None:
        flight.link.vehicle.position[0] += 30.0
        flight.link.num_resets = 1
        flight.later(0.1, lambda: leads.append(_lead_m(flight.link)))

    leads: list[float] = []
    flight.when("patrol", lambda: flight.later(3.0, move))
    result = flight.fly()
    assert leads[0] < 5.0, "the setpoint is near the drone again"
    assert "position" in flight.record.kinds
    assert result.outcome == "completed"


def _lead_m(link: FakeLink) -> float:
    return float(
        np.hypot(*np.subtract(link.vehicle.setpoint.position_ned_m, link.vehicle.position)[:2])
    )


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


def test_progress_is_told_about_once_a_second(flight):
    result = flight.fly()
    patrol = [e for e in flight.view.events if isinstance(e, Progressed) and e.phase == "patrol"]
    assert len(patrol) == pytest.approx(result.tally.duration_s, abs=2.0)
    assert patrol[-1].flown_au > 0.7


def test_every_row_of_the_table_is_flown(prepare):
    """What the tests before this one have flown already is not flown again."""
    late = partial(
        test_a_bad_planner_brings_the_drone_home,
        answer=_hangs,
        words="no waypoint",
        reason=Reason.PLANNER_LATE,
    )
    tests = [value for name, value in globals().items() if name.startswith("test_")]
    for fly in [late, *(t for t in tests if list(inspect.signature(t).parameters) == ["flight"])]:
        if len(_flown) < len(TABLE):
            fly(prepare())
    assert [row for number, row in enumerate(TABLE) if number not in _flown] == []
