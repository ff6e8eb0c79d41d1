"""A rangefinder's readings, from plain dictionaries: what is believed of them, and when."""

from __future__ import annotations

import math

import pytest
from messages import pose, posed
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CameraError
from dronemon.types import Pose
from dronemon.vision.project import ground_below_m

DOWN, AHEAD = mavlink.MAV_SENSOR_ROTATION_PITCH_270, mavlink.MAV_SENSOR_ROTATION_NONE


def reading(time_s, range_m, *, orientation=DOWN, number=0, quality=0):
    return {
        "time_boot_ms": round(time_s * 1000.0),
        "min_distance": 20,
        "max_distance": 5000,
        "current_distance": round(100.0 * range_m),
        "orientation": orientation,
        "id": number,
        "signal_quality": quality,
    }


def heard(*readings, until_s=2.0):
    telemetry = posed(1.0, until_s)
    for fields in readings:
        telemetry.take("DISTANCE_SENSOR", fields)
    return telemetry


def test_what_is_between_two_readings_is_between_them():
    track = heard(reading(1.0, 30.0), reading(1.1, 31.0), reading(1.2, 40.0)).rangefinder
    assert track.at(1.05) == pytest.approx(30.5)
    assert track.at(1.1) == pytest.approx(31.0)


def test_only_one_that_looks_down_and_was_heard_first_counts():
    telemetry = heard(
        reading(1.0, 5.0, orientation=AHEAD),
        reading(1.0, 30.0, number=1),
        reading(1.05, 9.0, number=2),
        reading(1.1, 32.0, number=1),
    )
    assert telemetry.rangefinder.at(1.05) == pytest.approx(31.0)
    assert telemetry.state.num_unreadable == 0


def test_each_of_several_sensors_has_its_own_stamps():
    telemetry = posed(1.0, 2.0)
    for tenths in range(10, 20):
        telemetry.take("DISTANCE_SENSOR", reading(tenths / 10.0, 5.0, orientation=AHEAD))
        telemetry.take("DISTANCE_SENSOR", reading(tenths / 10.0 - 0.02, 30.0, number=1))
    assert telemetry.rangefinder.at(1.5) == pytest.approx(30.0)
    assert telemetry.state.range_limits_m == (0.2, 50.0)


def test_another_takes_over_from_one_that_fell_silent():
    telemetry = heard(reading(1.0, 30.0), reading(1.9, 9.0, number=1))
    assert telemetry.rangefinder.newest_s == 1.0
    pose(telemetry, 2.5)
    for time_s in (2.3, 2.4):
        telemetry.take("DISTANCE_SENSOR", reading(time_s, 9.0, number=1))
    assert telemetry.rangefinder.at(2.35) == pytest.approx(9.0)


@pytest.mark.parametrize("late", [reading(1.1, 40.0), reading(1.05, 40.0)])
def test_one_that_comes_late_or_again_says_nothing(late):
    track = heard(reading(1.0, 30.0), reading(1.1, 30.0), late, reading(1.2, 30.0)).rangefinder
    assert track.at(1.1) == pytest.approx(30.0)


@pytest.mark.parametrize(
    "bad",
    [
        reading(1.1, 0.0),
        reading(1.1, 655.35),
        reading(1.1, 30.0, quality=1),
        reading(1.1, 0.0) | {"min_distance": 0},
    ],
)
def test_no_ground_in_reach_is_none(bad):
    track = heard(reading(1.0, 30.0), bad, reading(1.2, 30.0)).rangefinder
    with pytest.raises(CameraError, match=r"finds no ground [\d.]+ to 50 m below the drone"):
        track.at(1.05)
    with pytest.raises(CameraError, match="finds no ground"):
        track.at(1.15)


@pytest.mark.parametrize("time_s", [0.9, 1.3, 1.7, 2.1])
def test_what_was_not_heard_is_not_made_up(time_s):
    track = heard(reading(1.0, 30.0), reading(1.6, 30.0)).rangefinder
    with pytest.raises(CameraError, match=r"was not heard, two within 0\.5 s are needed"):
        track.at(time_s)


@pytest.mark.parametrize(
    "change",
    [
        {"max_distance": 10},
        {"min_distance": -5},
        {"current_distance": None},
        {"time_boot_ms": 3500},  # it is 2 s
    ],
)
def test_a_reading_that_cannot_be_is_left_out(change):
    telemetry = heard(reading(1.0, 30.0) | change)
    assert telemetry.state.num_unreadable == 1
    assert telemetry.rangefinder.newest_s == -math.inf


@pytest.mark.parametrize(
    ("times_s", "limits_m"),
    [((1.8, 1.9), (0.2, 50.0)), ((1.3, 1.9), None), ((0.7, 0.8), None), ((1.9,), None)],
)
def test_it_is_there_if_it_is_heard_twice_a_second(times_s, limits_m):
    telemetry = heard(*(reading(time_s, 30.0) for time_s in times_s))
    assert telemetry.state.range_limits_m == limits_m


def test_a_vehicle_that_starts_again_begins_without():
    telemetry = heard(reading(59.8, 30.0), reading(59.9, 30.0), until_s=60.0)
    for number in range(60):
        pose(telemetry, 2.0 + 0.02 * number)
    assert telemetry.state.range_limits_m is None
    with pytest.raises(CameraError, match="was not heard"):
        telemetry.rangefinder.at(59.85)


def test_a_lean_makes_the_range_longer_and_not_the_ground_lower():
    leaning = Pose(
        time_s=0.0,
        position_ned_m=(3.0, 4.0, -30.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(0.2, -0.1, 2.0),
    )
    range_m = 36.0 / (math.cos(0.2) * math.cos(-0.1))
    assert ground_below_m(leaning, range_m) == pytest.approx(6.0)
