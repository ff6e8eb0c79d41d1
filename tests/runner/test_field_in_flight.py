"""Flights in fields: to the start, on patrol and home over no zone, unless there is haste."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from fake_link import FakeLink
from flights import Flight, comes_home, give_back, hangs

from dronemon.errors import CameraError, LinkLost, PlannerError
from dronemon.events import Moved
from dronemon.frames import AreaFrame
from dronemon.guard import Reason
from dronemon.planner import Snapshot, Waypoint
from dronemon.runner.routes import Routes
from dronemon.vehicle import Mode

BORDER = [[-60, -60], [80, -60], [80, 60], [-60, 60]]
WALL = [[15, -30], [25, -30], [25, 45], [15, 45]]
FIELD = f"""
name: walled
area:
  sensor_radius_m: 10
  polygon_m: {BORDER}
  no_fly: [{{name: wall, polygon_m: {WALL}}}]
flight: {{altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 0.8, start_au: [0.9, 0.4]}}
targets:
  - {{name: Bella, appearance: cow, prior_au: [0.4, 0.6]}}
"""
"""Home is west of a wall, the patrol east of it; east and north in metres of home."""
LONGER = FIELD.replace("horizon_au: 0.8", "horizon_au: 4")


def beyond(flight: Flight) -> None:
    """Have the planner fly to and fro beyond the wall."""

    def next_waypoint(snapshot: Snapshot) -> Waypoint:
        flight.planner.asked += 1
        if flight.planner.asked == 3 and flight.planner.answer is not None:
            return flight.planner.answer()
        return Waypoint(position_au=np.array([0.9, 0.6 if flight.planner.asked % 2 else 0.4]))

    flight.planner.next_waypoint = next_waypoint
    flight.mission_text = FIELD


def keeps_to_the_field(flight: Flight) -> None:
    """Every place from take-off to landing, and that it was beyond the wall."""
    flown = np.array([e.pose.position_ned_m for e in flight.record.events if isinstance(e, Moved)])
    east_north_m = flown[:, 1::-1]
    track = shapely.LineString(east_north_m)
    assert shapely.Polygon(BORDER).contains(track)
    assert track.distance(shapely.Polygon(WALL)) > 1.0
    assert east_north_m[:, 0].max() > 30.0


@pytest.mark.lengthy
def test_home_goes_around(flight: Flight) -> None:
    beyond(flight)
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert result.landing_error_m == pytest.approx(0.0, abs=0.5)
    assert {Reason.HORIZON, Reason.THERE, Reason.HOME} <= flight.reasons
    assert result.tally is not None
    assert result.tally.flown_m == pytest.approx(80.0, abs=2.0)  # the way home is no patrol
    keeps_to_the_field(flight)
    comes_home(flight, result)


@pytest.mark.lengthy
def test_an_interrupt_brings_it_home_around_too(flight: Flight) -> None:
    beyond(flight)
    flight.when("patrol", lambda: flight.later(3.0, flight.ask))
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert Reason.THERE in flight.reasons
    keeps_to_the_field(flight)
    comes_home(flight, result)


def test_a_second_interrupt_on_that_way_is_haste(flight: Flight) -> None:
    beyond(flight)
    flight.when("patrol", lambda: [flight.later(s, flight.ask) for s in (3.0, 6.0)])
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert Reason.THERE not in flight.reasons
    assert "land" in flight.commands
    comes_home(flight, result)


def test_a_low_battery_has_the_way_around_in_its_price(flight: Flight) -> None:
    beyond(flight)
    flight.mission_text = LONGER
    result = flight.fly("battery=0.17@25")
    assert result.outcome == "battery low"
    assert {Reason.BATTERY_LOW, Reason.THERE} <= flight.reasons
    keeps_to_the_field(flight)
    comes_home(flight, result)


@pytest.mark.lengthy
def test_time_that_is_up_is_known_early_enough(flight: Flight) -> None:
    beyond(flight)
    flight.on_link = lambda link: setattr(link.vehicle, "battery", None)
    flight.mission_text = FIELD.replace("horizon_au: 0.8", "horizon_au: 2, endurance_min: 4")
    flight.when("control taken", lambda: flight.later(150.0, lambda: give_back(flight)))
    result = flight.fly("pilot@30")
    assert result.outcome == "battery low"
    assert Reason.TIME_UP in flight.reasons
    comes_home(flight, result)


@pytest.mark.lengthy
def test_a_blind_drone_comes_home_around(flight: Flight) -> None:
    beyond(flight)
    flight.mission_text = LONGER
    result = flight.fly("camera@25")
    assert isinstance(result.error, CameraError)
    assert {Reason.BLIND, Reason.THERE} <= flight.reasons
    keeps_to_the_field(flight)
    comes_home(flight, result)


@pytest.mark.lengthy
def test_a_late_planner_too_and_what_it_says_at_last_is_not_flown(flight: Flight) -> None:
    beyond(flight)
    flight.planner.answer = hangs
    result = flight.fly()
    assert isinstance(result.error, PlannerError)
    assert {Reason.PLANNER_LATE, Reason.THERE} <= flight.reasons
    keeps_to_the_field(flight)
    comes_home(flight, result)


@pytest.mark.lengthy
def test_a_pilot_on_that_way_wins_and_then_it_goes_on_home(flight: Flight) -> None:
    beyond(flight)

    def take() -> None:
        flight.link.vehicle.choose(Mode.POSITION)
        flight.later(5.0, lambda: give_back(flight))

    flight.when("patrol", lambda: [flight.later(3.0, flight.ask), flight.later(8.0, take)])
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert {Reason.TAKEN, Reason.GIVEN_BACK, Reason.THERE} <= flight.reasons
    keeps_to_the_field(flight)
    comes_home(flight, result)


@pytest.mark.lengthy
def test_a_pilot_who_gives_it_back_at_another_height_does_not_send_it_straight(
    flight: Flight,
) -> None:
    beyond(flight)

    def lower() -> None:
        flight.link.vehicle.position[2] += 8.0
        give_back(flight)

    def take() -> None:
        flight.link.vehicle.choose(Mode.POSITION)
        flight.later(5.0, lower)

    flight.when("patrol", lambda: [flight.later(3.0, flight.ask), flight.later(8.0, take)])
    result = flight.fly()
    assert result.outcome == "interrupted"
    assert {Reason.GIVEN_BACK, Reason.THERE} <= flight.reasons
    keeps_to_the_field(flight)
    comes_home(flight, result)


def test_from_a_square_it_returns_straight_wherever_home_is() -> None:
    frame = AreaFrame(
        centre_ned_m=(0.0, 300.0),
        ground_down_m=0.0,
        side_m=100.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )
    routes = Routes(frame, (0.0, 0.0))
    assert routes.are_straight
    assert routes.to((0.0, 0.0), (10.0, 310.0)) == [(10.0, 310.0)]


@pytest.mark.lengthy
def test_what_fails_on_that_way_sends_it_home_straight(flight: Flight) -> None:
    """And the patrol is as complete as it was."""
    beyond(flight)

    def on_link(link: FakeLink) -> None:
        send = link.send_setpoint

        async def refuse(setpoint: object) -> None:
            if Reason.HORIZON in flight.reasons:
                raise LinkLost("for a test")
            await send(setpoint)

        link.send_setpoint = refuse

    flight.on_link = on_link
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert Reason.LOST in flight.reasons
    assert Reason.THERE not in flight.reasons
    assert flight.record.texts("for a test") > 0
    assert result.is_landed
