"""Guidance and the simulated autopilot together: speed and cross-track on patrol."""

from __future__ import annotations

import itertools
import math
import random
from collections import deque

import numpy as np
import pytest
from in_memory import hover, ready_vehicle, take_off

from dronemon.fence import Fence
from dronemon.frames import AreaFrame
from dronemon.guidance import Carrot, Drag, Point
from sim.autopilot import STEP_S, Autopilot
from sim.control import TrajectorySetpoint
from sim.modes import Px4Mode

INTERVAL_S = 0.05
TELEMETRY_STEPS = 2


def fly_legs(
    vehicle: Autopilot, carrot: Carrot, leg_m: float, *, loss: float = 0.0, delay_s: float = 0.0
) -> tuple[list[float], list[float]]:
    """Fly random legs of up to this length, with turns to 110 degrees, for 40 s.

    loss, delay_s: of telemetry, and of setpoints.

    -> ground speeds in m/s and cross-track errors in m, once it is under way
    """
    rng, drag = random.Random(4), Drag()
    heading_rad, asked_s, start_s = 0.0, -math.inf, vehicle.time_s
    poses: deque[tuple[float, float, Point]] = deque()
    setpoints: deque[tuple[float, TrajectorySetpoint]] = deque()
    speeds_m_s, cross_track_m = [], []
    for step in range(round(40.0 / STEP_S)):
        now_s, (north_m, east_m, _) = vehicle.time_s, vehicle.estimate.position
        if step % TELEMETRY_STEPS == 0 and rng.random() >= loss:
            poses.append((now_s + delay_s, now_s, (north_m, east_m)))
        while poses and poses[0][0] <= now_s:
            _, heard_s, at_m = poses.popleft()
            if heard_s < asked_s + INTERVAL_S - 1e-6:
                continue
            if carrot.needs_waypoint():
                heading_rad += math.radians(rng.uniform(-110.0, 110.0))
                way_m, (north, east) = rng.uniform(0.4, 1.0) * leg_m, carrot.end_m
                carrot.extend(
                    (north + way_m * math.cos(heading_rad), east + way_m * math.sin(heading_rad))
                )
            drag.take(vehicle.body.pose(heard_s))
            position_m, velocity_m_s, push = carrot.advance(min(heard_s - asked_s, 0.2), at_m)
            push = (
                push[0] + drag.per_s * velocity_m_s[0],
                push[1] + drag.per_s * velocity_m_s[1],
            )
            asked_s = heard_s
            if now_s > start_s + 6.0:
                cross_track_m.append(carrot.cross_track_m(at_m))
            if rng.random() >= loss:
                setpoints.append(
                    (now_s + delay_s, at_height(vehicle, position_m, velocity_m_s, push))
                )
        while setpoints and setpoints[0][0] <= now_s:
            vehicle.take_offboard(setpoints.popleft()[1])
        vehicle.step()
        if now_s > start_s + 6.0:
            speeds_m_s.append(math.hypot(*vehicle.estimate.velocity[:2]))
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    return speeds_m_s, cross_track_m


def at_height(
    vehicle: Autopilot, position_m: Point, velocity_m_s: Point, acceleration_m_s2: Point
) -> TrajectorySetpoint:
    return TrajectorySetpoint(
        position=(*position_m, vehicle.setpoint.position[2]),
        velocity=(*velocity_m_s, 0.0),
        acceleration=(*acceleration_m_s2, 0.0),
        yaw_rad=0.0,
    )


def set_out(speed_m_s: float, wind_m_s: float) -> tuple[Autopilot, Carrot]:
    """A vehicle in OFFBOARD in the air, and a carrot at its place."""
    vehicle = ready_vehicle(simulation={"wind_m_s": wind_m_s})
    take_off(vehicle, 10.0)
    vehicle.take_offboard(hover(vehicle))
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    vehicle.step()
    north_m, east_m, _ = vehicle.estimate.position
    acceleration_m_s2 = max(2.0, speed_m_s / 4.0)
    carrot = Carrot(
        (north_m, east_m),
        speed_m_s=speed_m_s,
        max_speed_m_s=1.1 * speed_m_s,
        max_acceleration_m_s2=acceleration_m_s2,
        window_m=0.5 * speed_m_s**2 / acceleration_m_s2,
    )
    return vehicle, carrot


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("speed_m_s", "leg_m", "side_m"), [(5.0, 25.0, 150.0), (8.0, 25.0, 200.0), (12.0, 60.0, 300.0)]
)
@pytest.mark.parametrize("wind_m_s", [0.0, 5.0])
def test_speed_and_cross_track_keep_their_bounds(
    speed_m_s: float, leg_m: float, side_m: float, wind_m_s: float
) -> None:
    keep_bounds(speed_m_s, leg_m, side_m, wind_m_s)


@pytest.mark.parametrize(("speed_m_s", "side_m"), [(5.0, 150.0), (8.0, 200.0)])
def test_much_drag_is_learned_and_outweighed(
    monkeypatch: pytest.MonkeyPatch, speed_m_s: float, side_m: float
) -> None:
    monkeypatch.setattr("sim.dynamics._DRAG_PER_S", 1.0)
    keep_bounds(speed_m_s, 25.0, side_m, 0.0)


def keep_bounds(speed_m_s: float, leg_m: float, side_m: float, wind_m_s: float) -> None:
    speeds_m_s, cross_track_m = fly_legs(*set_out(speed_m_s, wind_m_s), leg_m)
    assert np.percentile(speeds_m_s, 99) <= 1.1 * speed_m_s
    assert np.mean(speeds_m_s) >= 0.92 * speed_m_s
    assert np.percentile(cross_track_m, 95) <= 0.02 * side_m


@pytest.mark.parametrize("leg_m", [1.0, 3.81, 5.0, 6.25])
def test_legs_to_and_fro_that_are_shorter_than_a_turn_are_flown_through(leg_m: float) -> None:
    vehicle, carrot = set_out(5.0, 0.0)
    north_m, east_m = carrot.end_m
    start_s, asked_s, is_there = vehicle.time_s, vehicle.time_s - INTERVAL_S, True
    while vehicle.time_s < start_s + 20.0:
        if vehicle.time_s >= asked_s + INTERVAL_S - 1e-6:
            while carrot.needs_waypoint():
                is_there = not is_there
                carrot.extend((north_m + leg_m * is_there, east_m))
            asked = carrot.advance(vehicle.time_s - asked_s, vehicle.estimate.position[:2])
            vehicle.take_offboard(at_height(vehicle, *asked))
            asked_s = vehicle.time_s
        vehicle.step()
    assert carrot.travelled_m > 0.8 * 5.0 * 20.0


def test_on_a_late_link_that_loses_a_fifth_it_is_slower_and_as_exact() -> None:
    vehicle, carrot = set_out(5.0, 5.0)
    speeds_m_s, cross_track_m = fly_legs(vehicle, carrot, 25.0, loss=0.2, delay_s=0.2)
    assert np.percentile(speeds_m_s, 99) <= 1.1 * 5.0
    assert np.mean(speeds_m_s) >= 0.65 * 5.0
    assert np.percentile(cross_track_m, 95) <= 0.02 * 150.0


@pytest.mark.lengthy
@pytest.mark.parametrize("speed_m_s", [5.0, 12.0])
def test_a_gusty_patrol_crosses_no_fence(speed_m_s: float) -> None:
    """From corner to corner of the area, and over again, in 8 m/s of gusty wind."""
    vehicle, carrot = set_out(speed_m_s, 8.0)
    frame = AreaFrame(
        centre_ned_m=carrot.end_m,
        ground_down_m=vehicle.estimate.position[2] + 10.0,
        side_m=100.0,
        heading_rad=0.3,
        cruise_speed_m_s=speed_m_s,
    )
    fence = Fence.around(frame, [frame.centre_ned_m], altitude_m=10.0, margin_m=10.0)
    corners = itertools.cycle(frame.au_to_ned(np.array([[0, 0], [1, 0], [1, 1], [0, 1]])))
    end_s, asked_s = vehicle.time_s + 90.0, vehicle.time_s
    while vehicle.time_s < end_s:
        vehicle.step()
        if vehicle.time_s < asked_s + INTERVAL_S - 1e-6:
            continue
        pose = vehicle.body.pose(vehicle.time_s)
        assert fence.stops_inside(pose)
        if carrot.needs_waypoint():
            carrot.extend(tuple(next(corners)))
        at_m = vehicle.estimate.position[0], vehicle.estimate.position[1]
        vehicle.take_offboard(at_height(vehicle, *carrot.advance(vehicle.time_s - asked_s, at_m)))
        asked_s = vehicle.time_s
    assert carrot.travelled_m > 50.0 * speed_m_s
