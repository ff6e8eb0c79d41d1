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
    assert track.limits_m == (0.2, 50.0)


def test_only_one_that_looks_down_and_was_heard_first_counts():
    telemetry = heard(
        reading(1.0, 5.0, orientation=AHEAD),
        reading(1.0, 30.0, number=1),
        reading(1.05, 9.0, number=2),
        reading(1.1, 32.0, number=1),
    )
    assert telemetry.rangefinder.at(1.05) == pytest.approx(31.0)
    assert telemetry.state.num_unreadable == 0


@pytest.mark.parametrize(
    "bad", [reading(1.1, 0.0), reading(1.1, 655.35), reading(1.1, 30.0, quality=1)]
)
def test_no_ground_in_reach_is_none(bad):
    track = heard(reading(1.0, 30.0), bad, reading(1.2, 30.0)).rangefinder
    with pytest.raises(CameraError, match=r"finds no ground 0\.2 to 50 m below the drone"):
        track.at(1.05)
    with pytest.raises(CameraError, match="finds no ground"):
        track.at(1.15)


@pytest.mark.parametrize("time_s", [0.9, 1.3, 1.7, 2.1])
def test_what_was_not_heard_is_not_made_up(time_s):
    track = heard(reading(1.0, 30.0), reading(1.6, 30.0)).rangefinder
    with pytest.raises(CameraError, match=r"was not heard, two within 0\.5 s are needed"):
        track.at(time_s)


@pytest.mark.parametrize(
    "change", [{"max_distance": 10}, {"min_distance": -5}, {"current_distance": None}]
)
def test_a_reading_that_cannot_be_is_left_out(change):
    telemetry = heard(reading(1.0, 30.0) | change)
    assert telemetry.state.num_unreadable == 1
    assert telemetry.state.range_limits_m is None


def test_one_that_falls_silent_is_not_there_any_more():
    telemetry = heard(reading(1.0, 30.0))
    assert telemetry.state.range_limits_m == (0.2, 50.0)
    for tenths in range(21, 131):
        pose(telemetry, tenths / 10.0)
    assert telemetry.state.range_limits_m is None


def test_a_lean_makes_the_range_longer_and_not_the_ground_lower():
    leaning = Pose(
        time_s=0.0,
        position_ned_m=(3.0, 4.0, -30.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(0.2, -0.1, 2.0),
    )
    range_m = 36.0 / (math.cos(0.2) * math.cos(-0.1))
    assert ground_below_m(leaning, range_m) == pytest.approx(6.0)
