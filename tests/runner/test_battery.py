"""The way home begins just in time to land with what is to be left, also against the wind."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import virtual_time
from fake_link import ORIGIN, FakeCamera, FakeLink
from flights import Blind, Listener
from windy_vehicle import WindyVehicle

from dronemon.energy import cost_home
from dronemon.events import Audience, Measured, Progressed
from dronemon.mission import load_mission
from dronemon.mission.schema import Flight
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.roadmap import Roadmap
from dronemon.runner.battery import Battery
from dronemon.runner.flight import FlightResult, fly_mission
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.types import Pose
from dronemon.vehicle import Landed, VehicleState

CORNERS_AU = tuple(itertools.product((0.02, 0.98), repeat=2))
RESERVE, PX4_KEEPS = 0.15, 0.07
ENDURANCE_MIN, WEAK_MIN = 10.0, 7.0
"""What the mission says, and what a battery lasts that drains faster."""
MISSION = """
name: corner
area: {{side_m: 200}}
flight: {{altitude_m: 45, horizon_au: 4, start_au: {start_au}, endurance_min: 10}}
targets:
  - {{name: Bella, appearance: cow}}
"""


class AtCorner:
    """Flies to and fro at a corner."""

    name = "at corner"

    def __init__(self, corner_au: Sequence[float]) -> None:
        self._corner_au = np.array(corner_au)
        self._asked = 0

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        pass

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self._asked += 1
        inward_au = np.sign(0.5 - self._corner_au) * [0.1, 0.05]
        return Waypoint(position_au=self._corner_au + self._asked % 2 * inward_au)


def _fly(
    path: Path, corner_au: Sequence[float], vehicle: WindyVehicle
) -> tuple[FlightResult, Listener]:
    path.write_text(MISSION.format(start_au=list(corner_au)))
    listener = Listener()

    async def fly() -> FlightResult:
        async with FakeLink() as link:
            link.vehicle = vehicle
            return await fly_mission(
                FlightSetup(
                    file=load_mission(path),
                    link=link,
                    camera=FakeCamera(link, 640, 480),
                    detector=Blind(),
                    planner=AtCorner(corner_au),
                    priors_au=np.full((1, 2), np.nan),
                    record=listener,
                    audience=Audience(),
                    interrupts=Interrupts(),
                )
            )

    return virtual_time.run(fly()), listener


def _lands_with(
    path: Path,
    corner_au: Sequence[float],
    charge: float,
    wind_m_s: tuple[float, float] = (0.0, 0.0),
    *,
    return_m: float = 30.0,
    lasts_min: float = ENDURANCE_MIN,
) -> tuple[float, Listener]:
    """The level at touch-down of a battery that hovers for so long if it is full."""
    vehicle = WindyVehicle(wind_m_s, charge, 60.0 * lasts_min)
    vehicle.parameters["RTL_RETURN_ALT"] = return_m
    result, listener = _fly(path, corner_au, vehicle)
    assert (result.outcome, result.error, result.is_landed) == ("battery low", None, True)
    told = 0.01 + 0.01  # a whole percent, and what the motors use until they stop on the ground
    assert result.landing_battery == pytest.approx(vehicle.charge, abs=told)
    return vehicle.charge, listener


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("charge", "return_m", "lasts_min", "wind_m_s"),
    [(0.5, 30.0, ENDURANCE_MIN, (0.0, 8.0)), (0.6, 60.0, WEAK_MIN, (8.0, 0.0))],
)
@pytest.mark.parametrize("corner_au", CORNERS_AU)
def test_against_the_wind_it_lands_with_what_is_to_be_left(
    tmp_path: Path, corner_au, charge: float, return_m: float, lasts_min: float, wind_m_s
):
    how = {"return_m": return_m, "lasts_min": lasts_min}
    left, _ = _lands_with(tmp_path / "corner.yaml", corner_au, charge, wind_m_s, **how)
    assert left >= RESERVE


@pytest.mark.lengthy
def test_a_weak_battery_half_empty_at_take_off_in_wind_lands_with_less_but_above_what_px4_keeps(
    tmp_path: Path,
):
    """The one case that does not hold: the return is due before 40 s of flight tell the drain."""
    path, wind_m_s = tmp_path / "corner.yaml", (8.0, 0.0)
    how = {"return_m": 60.0, "lasts_min": WEAK_MIN}
    left, _ = _lands_with(path, CORNERS_AU[3], 0.5, wind_m_s, **how)
    assert PX4_KEEPS < left < RESERVE


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("corner", "charge", "return_m", "lasts_min"),
    [
        (1, 0.5, 45.0, ENDURANCE_MIN),
        (2, 0.5, 60.0, ENDURANCE_MIN),
        (3, 0.5, 60.0, WEAK_MIN),
        (0, 0.6, 30.0, WEAK_MIN),
        (1, 0.6, 60.0, WEAK_MIN),
        (2, 0.9, 60.0, WEAK_MIN),
    ],
)
def test_without_wind_it_returns_no_earlier_than_it_must(
    tmp_path: Path, corner: int, charge: float, return_m: float, lasts_min: float
):
    how = {"return_m": return_m, "lasts_min": lasts_min}
    left, _ = _lands_with(tmp_path / "corner.yaml", CORNERS_AU[corner], charge, **how)
    assert RESERVE <= left <= RESERVE + 0.05


@pytest.mark.lengthy
def test_what_the_way_home_takes_is_told(tmp_path: Path):
    left, listener = _lands_with(tmp_path / "corner.yaml", CORNERS_AU[0], 0.42)
    assert RESERVE <= left <= RESERVE + 0.05
    assert "% needed to get home, 15% to land with" in listener.text("battery")
    told = [e for e in listener.events if isinstance(e, Measured | Progressed)]
    assert max(event.battery_needed for event in told) == pytest.approx(0.15, abs=0.03)


class _Link:
    """Hovers 100 m from home."""

    def __init__(self) -> None:
        self.state = VehicleState(is_armed=True, landed=Landed.IN_AIR, home=ORIGIN, origin=ORIGIN)
        self.pose = Pose(
            time_s=0.0,
            position_ned_m=(100.0, 0.0, -50.0),
            velocity_ned_m_s=(0.0, 0.0, 0.0),
            attitude_rad=(0.0, 0.0, 0.0),
        )

    def hover(self, follower: Battery, duration_s: float, **said: Any) -> None:
        self.state = replace(self.state, **said)
        for _ in range(round(duration_s)):
            self.pose = replace(self.pose, time_s=self.pose.time_s + 1.0)
            follower.take()


def test_a_level_that_is_told_no_more_is_used_up_until_it_must_return():
    link = _Link()
    battery = Battery(link, Flight(endurance_min=10.0))
    link.hover(battery, 1.0, battery=0.5)
    link.hover(battery, 60.0, battery=None)
    assert battery.level == pytest.approx(0.4)
    assert not battery.is_low
    assert not battery.is_time_up
    link.hover(battery, 80.0)
    assert battery.is_low


def test_a_level_that_stands_still_does_not_keep_it_in_the_air():
    link = _Link()
    battery = Battery(link, Flight(endurance_min=10.0))
    link.hover(battery, 380.0, battery=1.0)
    assert not battery.is_time_up
    link.hover(battery, 60.0)
    assert battery.is_time_up
    assert not battery.is_low
    link.hover(battery, 1.0, landed=Landed.ON_GROUND, is_armed=False)
    assert not battery.is_time_up


def test_a_battery_that_recovers_on_the_ground_was_flown_to_what_it_had_in_the_air():
    """As PX4's simulation has it, whose heartbeat tells a second later that it has disarmed."""
    link = _Link()
    battery = Battery(link, Flight(endurance_min=10.0))
    link.hover(battery, 5.0, battery=0.51)
    link.hover(battery, 3.0, landed=Landed.ON_GROUND)
    link.hover(battery, 1.0, battery=0.9)
    link.hover(battery, 1.0, is_armed=False)
    assert battery.flown_to == 0.51


@pytest.mark.parametrize("down_m", [-90.0, -45.0, 20.0])
def test_a_way_home_that_follows_the_ground_ends_as_high_as_that_is_there(down_m: float):
    """From there the autopilot climbs to the height of its return, and comes down."""
    link = _Link()
    battery = Battery(link, Flight(endurance_min=30.0))
    battery.parameters = {"RTL_RETURN_ALT": 80.0}
    battery.legs_home, battery.end_m = lambda _: [(100.0, 0.0), (0.0, 50.0)], 45.0
    link.pose = replace(link.pose, position_ned_m=(0.0, 0.0, down_m))
    link.hover(battery, 1.0, battery=1.0)
    cost = cost_home([(100.0, 0.0), (0.0, 50.0)], 45.0, battery.parameters)
    untold = 0.01  # levels come in whole percents
    assert battery.needed == pytest.approx(cost.time_s / 1800.0 + untold, abs=1e-6)
    high, low = (cost_home([(100.0, 0.0)], m, battery.parameters).time_s for m in (90.0, -20.0))
    assert high != pytest.approx(low, abs=5.0), "it would matter"
