"""The carrot keeps to its legs, bounds its acceleration and waits for the vehicle."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronemon.guidance import Carrot

SPEED, ACCELERATION, STEP_S = 5.0, 4.0, 0.02


def _carrot() -> Carrot:
    return Carrot((0.0, 0.0), speed_m_s=SPEED, max_acceleration_m_s2=ACCELERATION)


def test_keeps_cruise_speed_on_a_straight_leg():
    carrot = _carrot()
    carrot.extend((100.0, 0.0))
    position, velocity = carrot.advance(STEP_S, (0.0, 0.0))
    for _ in range(199):
        position, velocity = carrot.advance(STEP_S, position)
    assert position == pytest.approx((200 * STEP_S * SPEED, 0.0))
    assert velocity == pytest.approx((SPEED, 0.0))


def test_asks_for_the_next_leg_before_the_end():
    carrot = _carrot()
    assert carrot.needs_waypoint
    carrot.extend((20.0, 0.0))
    assert not carrot.needs_waypoint
    position = (0.0, 0.0)
    while not carrot.needs_waypoint:
        position, _ = carrot.advance(STEP_S, position)
    assert carrot.remaining_m == pytest.approx(carrot.window_m, abs=SPEED * STEP_S)


@given(st.floats(-170, 170))
def test_corner_is_round_and_bounded_in_acceleration(turn_deg: float):
    carrot = _carrot()
    carrot.extend((30.0, 0.0))
    carrot.extend(
        (
            30.0 + 30.0 * math.cos(math.radians(turn_deg)),
            30.0 * math.sin(math.radians(turn_deg)),
        )
    )
    position, velocities = (0.0, 0.0), []
    for _ in range(int(9.0 / STEP_S)):
        position, velocity = carrot.advance(STEP_S, position)
        velocities.append(velocity)
        assert carrot.cross_track_m(position) <= carrot.window_m
    largest = max(math.dist(a, b) / STEP_S for a, b in itertools.pairwise(velocities))
    assert largest <= 2.0 * ACCELERATION * 1.05  # |d2 - d1| is at most 2


def test_waits_for_a_vehicle_that_stays_behind():
    carrot = _carrot()
    carrot.extend((100.0, 0.0))
    for _ in range(1000):
        position, velocity = carrot.advance(STEP_S, (0.0, 0.0))
    assert position[0] < 2.6 * SPEED
    assert math.hypot(*velocity) < 0.1


def test_stops_at_the_last_waypoint():
    carrot = _carrot()
    carrot.extend((10.0, 0.0))
    position = (0.0, 0.0)
    for _ in range(400):
        position, velocity = carrot.advance(STEP_S, position)
    assert position == pytest.approx((10.0, 0.0))
    assert velocity == pytest.approx((0.0, 0.0))


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
