from __future__ import annotations

import math
import random

import numpy as np
import pytest

from dronemon.frames import body_to_ned
from sim.control import PositionController, TrajectorySetpoint
from sim.dynamics import GRAVITY_M_S2, Quadrotor, Wind
from sim.estimator import Estimator
from sim.parameters import Parameters
from sim.trajectory import Limits, Trajectory, stopping_point

STEP_S = 0.01
LIMITS = Limits(speed=5.0, up=3.0, down=1.5, acceleration=3.0, acceleration_vertical=3.0, jerk=4.0)


def calm() -> Wind:
    return Wind(0.0, 0.0, random.Random(1))


class Flight:
    """A body under the position controller, seen without estimation errors."""

    def __init__(self, wind: Wind | None = None, yaw_rad: float = 0.0) -> None:
        self.body = Quadrotor((0.0, 0.0, 100.0), yaw_rad, wind or calm())
        self.body.position = [0.0, 0.0, 0.0]
        self.control = PositionController(Parameters())
        self.yaw_rad = yaw_rad

    def fly(self, setpoint: TrajectorySetpoint, seconds: float) -> list[tuple[float, ...]]:
        """-> north, east, down, speed, pitch, roll at each step."""
        track = []
        body = self.body
        for _ in range(round(seconds / STEP_S)):
            thrust = self.control.thrust(
                setpoint, body.position, body.velocity, body.acceleration, 3.0, STEP_S
            )
            body.step(thrust, self.yaw_rad, 1.0, STEP_S)
            speed = math.hypot(body.velocity[0], body.velocity[1])
            track.append((*body.position, speed, body.pitch, body.roll))
        return track


def at(north: float, east: float, down: float = 0.0) -> TrajectorySetpoint:
    return TrajectorySetpoint(position=(north, east, down), yaw_rad=0.0)


def test_position_setpoint_is_reached_with_little_overshoot() -> None:
    track = Flight().fly(at(20.0, 0.0), 15.0)
    assert track[-1][0] == pytest.approx(20.0, abs=0.2)
    assert max(p[0] for p in track) < 22.0
    assert abs(track[-1][2]) < 0.1


def test_bare_position_setpoint_flies_as_fast_as_the_parameter_allows() -> None:
    track = Flight().fly(at(300.0, 0.0), 20.0)
    assert max(p[3] for p in track) == pytest.approx(12.0, rel=0.06)


def test_acceleration_needs_tilt_towards_it() -> None:
    track = Flight().fly(at(20.0, 0.0), 0.5)
    assert track[-1][4] < -0.1  # nose down to go forward
    track = Flight().fly(at(0.0, 20.0), 0.5)
    assert track[-1][5] > 0.1  # right side down to go right


def test_tilt_is_relative_to_the_nose() -> None:
    track = Flight(yaw_rad=math.pi / 2.0).fly(at(0.0, 20.0), 0.5)
    assert track[-1][4] < -0.1
    assert abs(track[-1][5]) < 0.02


def test_acceleration_is_what_thrust_along_the_body_gives() -> None:
    flight = Flight(yaw_rad=0.7)
    flight.fly(TrajectorySetpoint(position=(20.0, -9.0, -5.0), yaw_rad=0.7), 0.6)
    body = flight.body
    thrust = body_to_ned((body.roll, body.pitch, body.yaw)) @ [0.0, 0.0, -body.thrust_m_s2]
    drag = -0.15 * np.array(body.velocity)
    expected = thrust + drag + np.array([0.0, 0.0, GRAVITY_M_S2])
    np.testing.assert_allclose(body.acceleration, expected, atol=0.05)


def test_hover_in_wind_leans_into_it_and_stays() -> None:
    wind = Wind(8.0, math.radians(270.0), random.Random(1))  # from the west
    track = Flight(wind).fly(at(0.0, 0.0), 30.0)
    leaning = np.mean([p[5] for p in track[-500:]])
    assert leaning == pytest.approx(-math.atan(0.15 * 8.0 / GRAVITY_M_S2), abs=0.03)
    assert math.hypot(*track[-1][:2]) < 1.0


def test_carrot_with_velocity_feed_forward_keeps_cruise_speed() -> None:
    flight, track = Flight(), []
    for i in range(400):
        carrot = TrajectorySetpoint(position=(5.0 * i * 0.05, 0.0, 0.0), velocity=(5.0, 0.0, 0.0))
        track += flight.fly(carrot, 0.05)
    assert track[-1][3] == pytest.approx(5.0, rel=0.03)


def test_yaw_turns_the_short_way_at_a_limited_rate() -> None:
    body = Quadrotor((0.0, 0.0, 0.0), math.radians(170.0), calm())
    rates = []
    for _ in range(500):
        body.step((0.0, 0.0, -GRAVITY_M_S2), math.radians(-170.0), 0.3, STEP_S)
        rates.append(body.yaw_rate)
    assert max(rates) == pytest.approx(0.3, abs=0.01)
    assert min(rates) >= -0.01
    assert body.yaw == pytest.approx(math.radians(-170.0), abs=0.01)


def test_ground_carries_a_body_without_thrust() -> None:
    body = Quadrotor((3.0, 4.0, 5.0), 0.0, Wind(10.0, 0.0, random.Random(1)))
    for _ in range(200):
        body.step((0.0, 0.0, 0.0), 0.0, 1.0, STEP_S)
    assert body.position == [3.0, 4.0, 5.0]
    assert body.is_on_ground


def test_trajectory_respects_its_limits_and_arrives() -> None:
    trajectory = Trajectory([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    before = 0.0
    for _ in range(3000):
        trajectory.step((60.0, 30.0, -20.0), LIMITS, STEP_S)
        push = math.hypot(trajectory.acceleration[0], trajectory.acceleration[1])
        assert math.hypot(trajectory.velocity[0], trajectory.velocity[1]) <= 5.2
        assert push <= 3.0 + 1e-9
        assert abs(push - before) <= 4.0 * STEP_S + 1e-9
        assert -3.2 <= trajectory.velocity[2] <= 1.6
        before = push
    assert trajectory.position == pytest.approx([60.0, 30.0, -20.0], abs=0.1)


def test_stopping_point_is_where_the_trajectory_stops_without_turning_back() -> None:
    velocity = [5.0, 0.0, 0.0]
    target = stopping_point([0.0, 0.0, 0.0], velocity, LIMITS)
    trajectory = Trajectory([0.0, 0.0, 0.0], velocity)
    for _ in range(1000):
        trajectory.step(target, LIMITS, STEP_S)
        assert trajectory.position[0] < target[0] + 1.0
    assert trajectory.position[0] == pytest.approx(target[0], abs=0.05)


def test_estimate_wanders_around_the_truth_by_its_sigma() -> None:
    body = Quadrotor((10.0, 20.0, -3.0), 0.0, calm())
    estimate = Estimator(body, random.Random(10_002), 0.15)
    errors = []
    for _ in range(400):
        for _ in range(100):  # 20 s later it is nearly independent
            estimate.step(0.2, has_gps=True)
        errors.append([e - t for e, t in zip(estimate.position, body.position, strict=True)])
    sigma = np.std(errors, axis=0)
    np.testing.assert_allclose(sigma, 0.15, rtol=0.35)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.06


def test_estimate_drifts_without_gps_and_recovers() -> None:
    body = Quadrotor((0.0, 0.0, 0.0), 0.0, calm())
    estimate = Estimator(body, random.Random(10_003), 0.15)
    for _ in range(6000):
        estimate.step(STEP_S, has_gps=False)
    assert math.hypot(*estimate.position[:2]) == pytest.approx(16.0, abs=1.0)
    for _ in range(1000):
        estimate.step(STEP_S, has_gps=True)
    assert math.hypot(*estimate.position[:2]) < 1.0
