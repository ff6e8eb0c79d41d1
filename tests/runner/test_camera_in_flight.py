"""Camera and detector on a vehicle in memory: what they do to the flight."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

import numpy as np
import pytest
import virtual_time
from fake_link import FakeCamera, FakeLink
from flights import (
    FASTER,
    LONGER,
    comes_home,
    hangs,
    leaves,
)

from dronemon.errors import (
    CameraError,
)
from dronemon.events import Decided, Measured, Pictured
from dronemon.guard import Reason
from dronemon.planner import Snapshot, Waypoint
from dronemon.runner.flight import DOWN


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


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("detect", "words"),
    [
        (lambda *_: 1 // 0, "ZeroDivisionError"),
        (lambda *_: None, "'NoneType' object is not iterable"),
        (lambda *_: [3], "the detector gave 3"),
        (lambda *_: leaves(), "SystemExit"),
        (lambda *_: hangs(), "no answer for 3 s"),
    ],
)
def test_a_bad_detector_brings_the_drone_home(flight, detect, words):
    flight.detector.detect = detect
    flight.mission_text = LONGER
    result = flight.fly()
    assert isinstance(result.error, CameraError)
    assert "the detector" in flight.record.text("camera")
    assert words in flight.record.text("camera")
    comes_home(flight, result)


def _takes(duration_s: float) -> Callable[..., tuple[()]]:
    """A detector that finds nothing, and needs so long for it."""

    def detect(*_: object) -> tuple[()]:
        virtual_time.take(loop, duration_s)
        return ()

    loop = asyncio.get_running_loop()
    return detect


@pytest.mark.lengthy
def test_a_slow_detector_is_not_blamed_on_the_planner(flight):
    """A waypoint that is due waits for one picture at most, and the planner's time counts then."""
    flight.on_link = lambda link: setattr(flight.detector, "detect", _takes(2.9))
    flight.mission_text = FASTER.replace("au: 4", "au: 2")
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert "detector slow" in flight.record.kinds
    assert "planner slow" not in flight.record.kinds


@pytest.mark.lengthy
def test_no_more_pictures_are_taken_than_a_slow_detector_can_look_at(flight):
    def across(snapshot: Snapshot) -> Waypoint:
        return Waypoint(position_au=np.full(2, 0.9 if snapshot.position_au[0] < 0.5 else 0.1))

    flight.planner.next_waypoint = across
    flight.on_link = lambda link: setattr(flight.detector, "detect", _takes(2.9))
    flight.mission_text = FASTER
    assert flight.fly().is_landed
    assert flight.record.texts("8 pictures wait") > 0


@pytest.mark.lengthy
def test_a_dead_camera_brings_the_drone_home_after_a_while(flight):
    flight.mission_text = LONGER
    result = flight.fly("camera@12")
    assert isinstance(result.error, CameraError)
    assert "no picture could be taken" in str(result.error)
    assert Reason.BLIND in flight.reasons
    comes_home(flight, result)


@pytest.mark.lengthy
def test_a_frozen_view_is_no_measurement_and_brings_the_drone_home(flight):
    flight.mission_text = LONGER
    result = flight.fly("freeze@12")
    assert isinstance(result.error, CameraError)
    assert "is it frozen?" in flight.record.text("camera")
    assert Reason.BLIND in flight.reasons
    measured_s = [e.time_s for e in flight.record.events if isinstance(e, Measured)]
    noted_s = next(e.time_s for e in flight.record.events if getattr(e, "kind", "") == "camera")
    assert max(measured_s) < noted_s
    comes_home(flight, result)


def _in_turn(share: int) -> Callable[..., tuple[()]]:
    """A detector that answers one picture of so many, and fails at the others."""
    count = itertools.count()

    def detect(*_: object) -> tuple[()]:
        if next(count) % share:
            raise ValueError("cannot tell")
        return ()

    return detect


@pytest.mark.lengthy
@pytest.mark.parametrize(("share", "is_enough"), [(2, True), (3, True), (6, False), (12, False)])
def test_few_pictures_that_say_something_are_not_enough(flight, share, is_enough):
    flight.mission_text = LONGER
    flight.detector.detect = _in_turn(share)
    result = flight.fly()
    assert (result.outcome == "completed") == is_enough
    assert 1 <= flight.record.kinds.count("camera") < 10
    comes_home(flight, result)


@pytest.mark.lengthy
def test_the_patrol_goes_on_while_a_camera_is_silent_for_a_while(flight):
    result = flight.fly("camera@12+4")
    assert (result.outcome, result.error) == ("completed", None)
    assert 0 < len(result.tally.sightings) < 8
    assert flight.record.kinds.count("camera") == 1


def test_a_camera_that_cannot_be_closed_loses_no_result(flight, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError("unplugged")

    monkeypatch.setattr(FakeCamera, "__aexit__", fail)
    result = flight.fly()
    assert (result.outcome, result.last_word) == ("completed", DOWN)
    assert str(result.error) == "after the flight: OSError('unplugged')"
