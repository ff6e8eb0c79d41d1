"""The vehicle's behaviour, without a link."""

from __future__ import annotations

import asyncio
import math

import pytest
from ground_station import make_mission
from in_memory import fly, height_m, hover, ready_vehicle, take_off

from sim.autopilot import Autopilot
from sim.control import TrajectorySetpoint
from sim.flight import HOME_NED_M, MockFlight
from sim.modes import Px4Mode
from sim.world import World


@pytest.fixture
def vehicle() -> Autopilot:
    """Just ready to arm."""
    return ready_vehicle(flight={"endurance_min": 10.0})


def test_arming_waits_for_the_checks() -> None:
    mission = make_mission()
    autopilot = MockFlight(mission, World(mission)).autopilot
    fly(autopilot, 4.0)
    assert not autopilot.arm()
    fly(autopilot, 1.5)
    assert autopilot.arm()


def test_takeoff_ends_in_hold_at_the_set_height(vehicle: Autopilot) -> None:
    take_off(vehicle, 20.0)
    assert vehicle.commander.mode is Px4Mode.LOITER
    assert height_m(vehicle) == pytest.approx(20.0, abs=1.0)


def test_idle_vehicle_disarms_itself(vehicle: Autopilot) -> None:
    assert vehicle.arm()
    fly(vehicle, 10.5)  # COM_DISARM_PRFLT counts from the end of COM_SPOOLUP_TIME
    assert vehicle.commander.is_armed
    fly(vehicle, 1.0)
    assert not vehicle.commander.is_armed


def test_offboard_without_setpoints_prevents_arming(vehicle: Autopilot) -> None:
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    assert not vehicle.arm()
    fly(vehicle, 0.5, hover(vehicle))
    assert vehicle.arm()


def test_offboard_without_setpoints_is_refused_in_the_air(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    assert not vehicle.request_mode(Px4Mode.OFFBOARD)
    assert vehicle.commander.mode is Px4Mode.LOITER


def test_offboard_lifts_off_by_itself(vehicle: Autopilot) -> None:
    up = TrajectorySetpoint(position=(HOME_NED_M[0], HOME_NED_M[1], HOME_NED_M[2] - 8.0))
    fly(vehicle, 0.5, up)
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    assert vehicle.arm()
    fly(vehicle, 15.0, up)
    assert height_m(vehicle) == pytest.approx(8.0, abs=1.0)


def test_lost_setpoints_return_the_vehicle_and_new_ones_bring_it_back(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    target = hover(vehicle)
    fly(vehicle, 0.5, target)
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    fly(vehicle, 2.0, target)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    fly(vehicle, 0.85)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    fly(vehicle, 0.2)
    assert vehicle.commander.mode is Px4Mode.RTL
    assert vehicle.commander.is_in_failsafe
    fly(vehicle, 1.0, target)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    assert not vehicle.commander.is_in_failsafe


def test_late_setpoints_are_awaited_in_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))
    vehicle = simulation.autopilot
    fly(vehicle, 6.0)
    take_off(vehicle, 10.0)
    fly(vehicle, 1.0, hover(vehicle))
    vehicle.take_offboard(hover(vehicle))
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    clock = Clock()
    monkeypatch.setattr("sim.flight.time", clock)

    def run(wall_s: float) -> float:
        """-> vehicle time that passes, while nothing is heard from the other program"""
        begun_at_s = vehicle.time_s
        clock.ends_s = clock.now_s + wall_s
        with pytest.raises(TimeoutError):
            asyncio.run(simulation.run(20.0))
        return vehicle.time_s - begun_at_s

    assert 0.7 < run(0.5) < 0.95  # 0.3 s at once, then 0.5 s as they pass
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    run(0.4)
    assert vehicle.commander.is_in_failsafe
    assert run(0.5) == pytest.approx(10.0, abs=0.3)


def test_on_the_ground_nothing_is_awaited() -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))
    vehicle = simulation.autopilot
    fly(vehicle, 6.0)
    vehicle.take_offboard(hover(vehicle))
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    fly(vehicle, 0.5)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    assert not vehicle.is_setpoint_late


class Clock:
    """A wall clock that goes on by 4 ms whenever it is read, until it ends."""

    def __init__(self) -> None:
        self.now_s, self.ends_s = 0.0, 0.0

    def monotonic(self) -> float:
        if self.now_s >= self.ends_s:
            raise TimeoutError
        self.now_s += 0.004
        return self.now_s


def test_mode_change_in_the_failsafe_ends_it_for_good(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    target = hover(vehicle)
    fly(vehicle, 0.5, target)
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    fly(vehicle, 2.0)
    assert vehicle.commander.mode is Px4Mode.RTL
    assert vehicle.request_mode(Px4Mode.LOITER)
    fly(vehicle, 1.0, target)
    assert vehicle.commander.mode is Px4Mode.LOITER


def test_loss_time_is_a_parameter(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    vehicle.parameters.set("COM_OF_LOSS_T", 4.0)
    fly(vehicle, 0.5, hover(vehicle))
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    fly(vehicle, 3.5)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD


def test_velocity_setpoint_is_flown(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    east = TrajectorySetpoint(velocity=(0.0, 4.0, 0.0), yaw_rad=math.pi / 2.0)
    fly(vehicle, 0.3, east)
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    fly(vehicle, 8.0, east)
    assert vehicle.body.velocity[1] == pytest.approx(4.0, abs=0.3)
    assert vehicle.body.yaw == pytest.approx(math.pi / 2.0, abs=0.05)


def test_return_climbs_comes_home_lands_and_disarms(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    away = (HOME_NED_M[0] + 40.0, HOME_NED_M[1], HOME_NED_M[2] - 10.0)
    assert vehicle.reposition(away, math.nan, 0.0)
    fly(vehicle, 15.0)
    assert vehicle.body.position[0] == pytest.approx(away[0], abs=1.0)
    assert vehicle.request_mode(Px4Mode.RTL)
    fly(vehicle, 15.0)
    assert height_m(vehicle) == pytest.approx(30.0, abs=1.0)
    fly(vehicle, 60.0)
    assert vehicle.is_landed
    assert not vehicle.commander.is_armed
    assert math.dist(vehicle.body.position[:2], HOME_NED_M[:2]) < 1.0


def test_cruise_speed_is_a_parameter(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    vehicle.parameters.set("MPC_XY_CRUISE", 8.0)
    assert vehicle.reposition((HOME_NED_M[0] + 200.0, HOME_NED_M[1], math.nan), math.nan, 0.0)
    fly(vehicle, 10.0)
    assert vehicle.body.velocity[0] == pytest.approx(8.0, abs=0.4)
    assert height_m(vehicle) == pytest.approx(10.0, abs=1.0)


def test_landing_is_slow_near_the_ground(vehicle: Autopilot) -> None:
    take_off(vehicle, 12.0)
    assert vehicle.request_mode(Px4Mode.LAND)
    while height_m(vehicle) > 3.0:
        fly(vehicle, 0.1)
    assert vehicle.body.velocity[2] == pytest.approx(0.7, abs=0.15)
    fly(vehicle, 12.0)
    assert vehicle.is_landed
    assert not vehicle.commander.is_armed


@pytest.mark.parametrize("mode", [Px4Mode.RTL, Px4Mode.LAND])
def test_no_arming_in_a_mode_that_only_ends_flights(vehicle: Autopilot, mode: Px4Mode) -> None:
    assert vehicle.request_mode(mode)
    fly(vehicle, 0.1)
    assert not vehicle.arm()
    assert vehicle.request_mode(Px4Mode.LOITER)
    assert vehicle.arm()


def test_disarming_in_the_air_needs_force_and_drops_it(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    assert not vehicle.commander.disarm(is_forced=False)
    assert vehicle.commander.disarm(is_forced=True)
    fly(vehicle, 4.0)
    assert vehicle.is_landed
    assert height_m(vehicle) == 0.0


def test_battery_lasts_as_long_as_the_mission_says(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    before = vehicle.battery_level
    fly(vehicle, 30.0)
    assert before - vehicle.battery_level == pytest.approx(30.0 / 600.0)


def test_gps_loss_ends_offboard_until_it_returns(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    target = hover(vehicle)
    fly(vehicle, 0.5, target)
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    vehicle.has_gps = False
    fly(vehicle, 5.0, target)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD
    fly(vehicle, 10.0, target)
    assert vehicle.commander.mode is Px4Mode.ALTCTL
    assert height_m(vehicle) == pytest.approx(10.0, abs=1.0)
    assert math.dist(vehicle.estimate.position[:2], vehicle.body.position[:2]) > 5.0
    vehicle.has_gps = True
    fly(vehicle, 2.5, target)
    assert vehicle.commander.mode is Px4Mode.OFFBOARD


def test_pilot_holds_against_setpoints(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    target = hover(vehicle)
    fly(vehicle, 0.5, target)
    assert vehicle.request_mode(Px4Mode.OFFBOARD)
    vehicle.commander.take_over()
    fly(vehicle, 5.0, TrajectorySetpoint(velocity=(5.0, 0.0, 0.0)))
    assert vehicle.commander.mode is Px4Mode.POSCTL
    assert math.dist(vehicle.body.position[:2], target.position[:2]) < 2.0


def test_reboot_in_the_air_starts_again_on_the_ground(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    vehicle.reboot()
    assert vehicle.time_s == 0.0
    assert not vehicle.commander.is_armed
    assert height_m(vehicle) == 0.0
    fly(vehicle, 4.0)
    assert not vehicle.commander.can_arm
    fly(vehicle, 1.5)
    assert vehicle.commander.can_arm


def test_same_seed_flies_the_same(vehicle: Autopilot) -> None:
    mission = make_mission(simulation={"seed": 10_001, "wind_m_s": 5.0})
    ends = []
    for _ in range(2):
        autopilot = MockFlight(mission, World(mission)).autopilot
        fly(autopilot, 6.0)
        take_off(autopilot, 10.0)
        ends.append((*autopilot.body.position, *autopilot.estimate.position))
    assert ends[0] == ends[1]
