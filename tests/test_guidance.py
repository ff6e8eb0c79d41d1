"""The carrot keeps to its legs, bounds speed and acceleration and waits for the vehicle."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dronemon.guidance import POSITION_GAIN_PER_S, Carrot, Drag
from dronemon.types import Pose

SPEED, ACCELERATION, STEP_S = 5.0, 4.0, 0.02


def _carrot(max_speed: float = 1.1 * SPEED) -> Carrot:
    return Carrot(
        (0.0, 0.0),
        speed_m_s=SPEED,
        max_speed_m_s=max_speed,
        max_acceleration_m_s2=ACCELERATION,
        window_m=0.5 * SPEED**2 / ACCELERATION,
    )


def test_keeps_cruise_speed_on_a_straight_leg():
    carrot = _carrot()
    carrot.extend((100.0, 0.0))
    position = (0.0, 0.0)
    speeds = []
    for _ in range(400):
        position, velocity, acceleration = carrot.advance(STEP_S, position)
        speeds.append(velocity[0])
    assert np.diff(speeds).max() <= ACCELERATION * STEP_S * 1.001
    way_m = 400 * STEP_S * SPEED - 0.5 * SPEED**2 / ACCELERATION
    assert position == pytest.approx((way_m, 0.0), abs=0.1)
    assert velocity == pytest.approx((SPEED, 0.0))
    assert acceleration == pytest.approx((0.0, 0.0))


def test_asks_for_the_next_leg_before_the_end():
    carrot = _carrot()
    assert carrot.needs_waypoint()
    carrot.extend((20.0, 0.0))
    assert not carrot.needs_waypoint()
    position = (0.0, 0.0)
    while not carrot.needs_waypoint():
        position, _, _ = carrot.advance(STEP_S, position)
    ahead_m = carrot.remaining_m - carrot.window_m
    assert ahead_m == pytest.approx(0.25 * SPEED, abs=SPEED * STEP_S)


@settings(max_examples=50)
@given(st.floats(-180, 180))
def test_corner_is_round_and_bounded_in_acceleration(turn_deg: float):
    carrot = _carrot()
    carrot.extend((20.0, 0.0))
    turn_rad = math.radians(turn_deg)
    carrot.extend((20.0 + 20.0 * math.cos(turn_rad), 20.0 * math.sin(turn_rad)))
    position, velocities, accelerations = (0.0, 0.0), [], []
    for _ in range(int(7.0 / 0.05)):
        position, velocity, acceleration = carrot.advance(0.05, position)
        velocities.append(velocity)
        accelerations.append(math.hypot(*acceleration))
        assert math.hypot(*velocity) <= SPEED * 1.001
        assert carrot.cross_track_m(position) <= carrot.window_m / 4.0 + 0.01
    changes = [math.dist(a, b) / 0.05 for a, b in itertools.pairwise(velocities)]
    if abs(turn_deg) <= 60.0:
        assert max(changes) <= 1.35 * ACCELERATION
    assert max(*changes, *accelerations) <= 3.6 * ACCELERATION


def test_waits_for_a_vehicle_that_stays_behind():
    carrot = _carrot()
    carrot.extend((100.0, 0.0))
    for _ in range(1000):
        position, velocity, _ = carrot.advance(STEP_S, (0.0, 0.0))
    assert position[0] <= 0.1 * SPEED / POSITION_GAIN_PER_S
    assert velocity[0] + POSITION_GAIN_PER_S * position[0] == pytest.approx(1.08 * SPEED)


@pytest.mark.lengthy
@settings(max_examples=40)
@example((5.3, 0.0), 30)
@given(st.tuples(st.floats(-30, 30), st.floats(-30, 30)), st.integers(0, 300))
def test_a_vehicle_that_was_pushed_anywhere_comes_to_the_end(
    push_m: tuple[float, float], num_steps: int
):
    carrot = _carrot()
    carrot.extend((20.0, 0.0))
    carrot.extend((20.0, 20.0))
    vehicle = (0.0, 0.0)
    for step in range(int(40.0 / STEP_S)):
        position, velocity, _ = carrot.advance(STEP_S, vehicle)
        wanted = [
            v + POSITION_GAIN_PER_S * (p - at)
            for v, p, at in zip(velocity, position, vehicle, strict=True)
        ]
        vehicle = (vehicle[0] + wanted[0] * STEP_S, vehicle[1] + wanted[1] * STEP_S)
        if step == num_steps:
            vehicle = (vehicle[0] + push_m[0], vehicle[1] + push_m[1])
    assert carrot.remaining_m == 0.0
    assert vehicle == pytest.approx((20.0, 20.0), abs=0.1)


@pytest.mark.lengthy
@settings(max_examples=50)
@given(st.lists(st.floats(0.001, 30.0), min_size=1, max_size=5), st.floats(0.01, 0.2))
def test_stays_at_the_end_of_any_path(legs_m: list[float], step_s: float):
    carrot = _carrot()
    for index, leg_m in enumerate(legs_m):
        north, east = carrot.end_m
        carrot.extend((north + leg_m, east) if index % 2 else (north, east + leg_m))
    position = (0.0, 0.0)
    for _ in range(int((sum(legs_m) / SPEED + 4.0 * len(legs_m)) / step_s)):
        position, _, _ = carrot.advance(step_s, position)
    assert position == pytest.approx(carrot.end_m, abs=0.05)
    assert carrot.remaining_m >= 0.0


def test_stops_at_the_last_waypoint():
    carrot = _carrot()
    carrot.extend((20.0, 0.0))
    position = (0.0, 0.0)
    speeds = []
    for _ in range(800):
        position, velocity, _ = carrot.advance(STEP_S, position)
        speeds.append(velocity[0])
    assert max(speeds) == pytest.approx(SPEED)
    assert np.abs(np.diff(speeds)).max() <= ACCELERATION * STEP_S * 1.5
    assert position == pytest.approx((20.0, 0.0), abs=0.01)
    assert velocity == pytest.approx((0.0, 0.0), abs=0.1)


@settings(max_examples=50)
@given(
    st.tuples(st.floats(-20, 60), st.floats(-20, 20)),
    st.floats(1.0, 2.0),
    st.integers(1, 300),
)
def test_what_is_asked_for_is_never_faster_than_the_bound(
    vehicle: tuple[float, float], share: float, num_steps: int
):
    carrot = _carrot(share * SPEED)
    carrot.extend((20.0, 0.0))
    carrot.extend((20.0, 20.0))
    position = (0.0, 0.0)
    for _ in range(num_steps):
        position, _, _ = carrot.advance(STEP_S, position)
    position, velocity, _ = carrot.advance(STEP_S, vehicle)
    wanted = (
        v + POSITION_GAIN_PER_S * (p - at)
        for v, p, at in zip(velocity, position, vehicle, strict=True)
    )
    assert math.hypot(*wanted) <= share * SPEED * 1.000001


def test_a_leg_of_no_length_adds_nothing():
    carrot = _carrot()
    carrot.extend((0.0, 0.0))
    assert carrot.remaining_m == 0.0
    assert carrot.cross_track_m((3.0, 4.0)) == 0.0


def test_cross_track_is_the_distance_to_the_legs():
    carrot = _carrot()
    carrot.extend((20.0, 0.0))
    carrot.extend((20.0, 20.0))
    assert carrot.cross_track_m((10.0, -3.0)) == pytest.approx(3.0)
    assert carrot.cross_track_m((22.0, 10.0)) == pytest.approx(2.0)
    assert carrot.cross_track_m((-3.0, -4.0)) == pytest.approx(5.0)


@settings(max_examples=50)
@given(st.floats(0.0, 1.0), st.floats(-3.0, 3.0), st.floats(-math.pi, math.pi))
def test_drag_is_told_from_wind(drag_per_s: float, wind_m_s: float, yaw_rad: float):
    drag = Drag()
    assert drag.per_s == 0.0
    for step in range(400):
        angle = 0.05 * step  # round in a circle of 0.5 rad/s, at 8 m/s
        north, east = 8.0 * math.cos(angle), 8.0 * math.sin(angle)
        push = (drag_per_s * (north - wind_m_s) - 0.5 * east, drag_per_s * east + 0.5 * north)
        forward = (push[0] * math.cos(yaw_rad) + push[1] * math.sin(yaw_rad)) / 9.80665
        right = (push[1] * math.cos(yaw_rad) - push[0] * math.sin(yaw_rad)) / 9.80665
        pitch = -math.atan(forward)
        drag.take(
            Pose(
                time_s=0.1 * step,
                position_ned_m=(0.0, 0.0, -10.0),
                velocity_ned_m_s=(north, east, 0.0),
                attitude_rad=(math.atan(right * math.cos(pitch)), pitch, yaw_rad),
            )
        )
    assert drag.per_s == pytest.approx(drag_per_s, rel=0.1, abs=0.02)
