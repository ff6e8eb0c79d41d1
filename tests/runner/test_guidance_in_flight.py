"""Planner and guidance on a vehicle in memory: what ends a patrol, and what it follows."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from collections.abc import Callable
from dataclasses import asdict
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import virtual_time
from fake_link import FakeLink
from flights import (
    FASTER,
    comes_home,
    hangs,
    leaves,
)

from dronemon.errors import (
    PlannerError,
)
from dronemon.events import Attended, Decided, Noted, Progressed
from dronemon.guard import Reason
from dronemon.json_values import json_line
from dronemon.planner import Snapshot, Waypoint
from dronemon.planner.motion import step_towards, until_measurement_au


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


def _fails() -> Waypoint:
    raise IndexError("beyond the roadmap")


def _gives(
    *place_au: float, node: Any = None, details: Any = MappingProxyType({})
) -> Callable[[], Waypoint]:
    return lambda: Waypoint(position_au=np.array(place_au), node=node, details=details)


def _is_interrupted() -> Waypoint:
    raise KeyboardInterrupt


def _runs_out() -> Waypoint:
    return next(iter(()))


_ENDLESS: dict[str, object] = {}
_ENDLESS["again"] = _ENDLESS


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("answer", "words", "reason"),
    [
        (_fails, "IndexError", Reason.FAILED),
        (hangs, "no waypoint from planner 'shuttle' for 20 s", Reason.PLANNER_LATE),
        (leaves, "SystemExit", Reason.FAILED),
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
    comes_home(flight, result)


def test_what_json_cannot_say_of_a_decision_is_recorded_as_text(flight):
    flight.planner.answer = _gives(0.5, 0.6, details={"lock": threading.Lock(), "half": "\udc80"})
    assert flight.fly().outcome == "completed"
    told = next(e for e in flight.record.events if isinstance(e, Decided) and e.details)
    assert "lock" in asdict(told)["details"]["lock"]
    assert json.loads(json_line(told.details))["half"] == "\udc80"


@pytest.mark.parametrize(("act", "words"), [(hangs, "no answer for 30 s"), (leaves, "SystemExit")])
def test_a_planner_that_does_not_begin_flies_nothing(flight, act, words):
    flight.planner.on_reset = act
    result = flight.fly()
    assert isinstance(result.error, PlannerError)
    assert "planner 'shuttle'" in str(result.error)
    assert words in str(result.error)
    assert flight.link.commands == []


def test_a_drone_that_leaves_its_height_returns(flight):
    def sink() -> None:
        flight.link.vehicle.height_error_m = 8.0

    flight.when("patrol", sink)
    result = flight.fly()
    assert Reason.OFF_PATH in flight.reasons
    comes_home(flight, result)


def test_a_height_that_jumps_is_followed_not_chased(flight):
    flown_m = []

    def jump() -> None:
        flight.link.vehicle.height_error_m = flight.link.jumped_down_m = -4.0
        flight.link.num_resets = 1
        flight.later(6.0, lambda: flown_m.append(-flight.link.vehicle.setpoint.position_ned_m[2]))

    flight.when("patrol", lambda: flight.later(2.0, jump))
    assert flight.fly().outcome == "completed"
    assert flown_m == [pytest.approx(26.0)]


def test_a_planner_that_cannot_say_what_it_looked_at_flies_on(flight):
    asked = []

    def explanation():
        asked.append(flight.link.time_s)
        if len(asked) > 1:  # not in the rehearsal, which no flight in memory has
            raise RuntimeError("no weights")
        return SimpleNamespace(arrays=lambda: {"pointer": np.array([1.0])})

    flight.planner.explanation = explanation
    result = flight.fly()
    assert result.outcome == "completed", result.error
    assert len(asked) > 3
    attended = [event for event in flight.view.events if isinstance(event, Attended)]
    assert [event.weights["pointer"].tolist() for event in attended] == [[1.0]]


def test_while_a_planner_hangs_the_drone_stays_at_its_waypoint_and_then_goes_on(flight):
    choose, hung_s, num_asked, places_m = flight.planner.next_waypoint, 8.0, [], []

    def slow(snapshot: Snapshot) -> Waypoint:
        num_asked.append(flight.link.time_s)
        if len(num_asked) == 4:
            virtual_time.take(loops[0], hung_s)
        return choose(snapshot)

    def look() -> None:
        if len(num_asked) == 4:
            places_m.append((flight.link.time_s, flight.link.pose.position_ned_m))
        flight.later(0.1, look)

    loops: list[asyncio.AbstractEventLoop] = []
    flight.planner.next_waypoint = slow
    flight.when("patrol", lambda: (loops.append(asyncio.get_running_loop()), look()))
    result = flight.fly()
    assert result.outcome == "completed", result.error
    told = next(e for e in flight.record.events if isinstance(e, Noted) and "slow" in e.kind)
    held = [place_m for at_s, place_m in places_m if told.time_s < at_s < num_asked[3] + hung_s]
    assert len(held) > 50
    assert max(math.dist(place_m, held[-1]) for place_m in held[:20]) < 5.0  # it slows down
    assert max(math.dist(place_m, held[-1]) for place_m in held[20:]) < 0.1
    assert len(num_asked) > 5


def test_an_estimator_that_falls_silent_brings_it_home(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "is_estimate_heard", False))
    result = flight.fly()
    assert Reason.ESTIMATE_SILENT in flight.reasons
    assert flight.commands[-1] == "return"
    comes_home(flight, result)


def test_a_drone_that_makes_no_way_returns(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "speed_m_s", 0.0))
    result = flight.fly()
    assert Reason.STUCK in flight.reasons
    comes_home(flight, result)


def test_a_drone_that_is_blown_away_returns_at_once(flight):
    def blow() -> None:
        flight.link.vehicle.speed_m_s, flight.link.vehicle.drift_m_s = 0.0, 4.0

    flight.when("patrol", blow)
    result = flight.fly()
    assert Reason.OFF_PATH in flight.reasons
    assert result.tally.flown_m < 40.0
    comes_home(flight, result)


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


def test_progress_is_told_about_once_a_second(flight):
    result = flight.fly()
    patrol = [e for e in flight.view.events if isinstance(e, Progressed) and e.phase == "patrol"]
    assert len(patrol) == pytest.approx(result.tally.duration_s, abs=2.0)
    assert patrol[-1].flown_au > 0.7
