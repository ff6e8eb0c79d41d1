"""A camera on a gimbal, on a vehicle in memory: pointed down first, and followed in flight."""

from __future__ import annotations

import math

import pytest
from flights import LONGER, MISSION, comes_home, give_back

from dronemon.errors import CameraError, VehicleError
from dronemon.events import Measured, Pictured
from dronemon.guard import Reason

GIMBAL = "\ncamera: {gimbal: true}\n"


def _poses(flight):
    return [event.pose for event in flight.record.events if isinstance(event, Pictured)]


def _lean(link):
    link.vehicle.attitude_rad = (0.17, -0.1, 0.6)


def test_pictures_are_placed_by_the_gimbals_attitude(flight):
    flight.mission_text, flight.on_link = MISSION + GIMBAL, _lean
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert flight.link.commands[:2] == ["point down", "arm"]
    assert len(_poses(flight)) == 8
    for pose in _poses(flight):
        assert pose.attitude_rad == pytest.approx((0.0, 0.0, 0.6), abs=1e-9)


def test_without_one_they_are_placed_by_the_bodys(flight):
    flight.on_link = _lean
    assert flight.fly().outcome == "completed"
    assert "point down" not in flight.link.commands
    assert {pose.attitude_rad for pose in _poses(flight)} == {(0.17, -0.1, 0.6)}


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("gimbal", "no-go: gimbal (failed): no attitude of a gimbal is heard"),
        ("askew=30", "no-go: gimbal (failed): it looks 30 degrees off"),
        ("reject", "no-go: gimbal (failed): the gimbal, taking control: asked 3 times (denied)"),
    ],
)
def test_it_is_not_flown_with_a_gimbal_that_is_silent_or_looks_elsewhere(flight, fault, words):
    flight.mission_text = MISSION + GIMBAL
    result = flight.fly(fault)
    assert isinstance(result.error, VehicleError)
    assert words in str(result.error)
    assert not result.has_flown
    assert flight.link.commands == ["point down"]


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("fault", "words"), [("gimbal@16", "was not heard"), ("askew=25@16", "looks 25 degrees off")]
)
def test_a_gimbal_that_fails_in_flight_makes_it_blind_and_brings_it_home(flight, fault, words):
    flight.mission_text = LONGER + GIMBAL
    result = flight.fly(fault)
    assert isinstance(result.error, CameraError)
    assert words in flight.record.text("camera")
    assert Reason.BLIND in flight.reasons
    noted_s = next(e.time_s for e in flight.record.events if getattr(e, "kind", "") == "camera")
    assert max(e.time_s for e in flight.record.events if isinstance(e, Measured)) < noted_s
    comes_home(flight, result)


@pytest.mark.lengthy
@pytest.mark.parametrize("fault", ["gimbal@12+4", "askew=10@12"])
def test_a_pause_and_a_gimbal_a_little_off_are_flown_with(flight, fault):
    flight.mission_text = MISSION + GIMBAL
    result = flight.fly(fault)
    assert (result.outcome, result.error) == ("completed", None)
    if fault.startswith("askew"):
        assert _poses(flight)[-1].attitude_rad[1] == pytest.approx(math.radians(10.0))
    else:
        assert 0 < len(_poses(flight)) < 8


def test_the_gimbal_of_a_vehicle_that_others_fly_is_left_alone(flight):
    flight.mission_text = MISSION + GIMBAL
    flight.on_link = lambda link: setattr(link.vehicle, "is_armed", True)
    assert not flight.fly().has_flown
    assert flight.link.commands == []


def test_it_is_pointed_down_again_where_a_pilot_gives_control_back(flight):
    """PX4 turns a gimbal ahead, and takes control of it, when it returns or lands."""
    flight.mission_text = MISSION + GIMBAL
    flight.when("control taken", lambda: flight.later(3.0, lambda: give_back(flight)))
    result = flight.fly("pilot@12")
    assert (result.outcome, result.error) == ("completed", None)
    assert flight.link.commands.count("point down") == 3  # before arming, and at each beginning
