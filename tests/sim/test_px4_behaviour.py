"""What PX4 v1.17 does that an application must survive, line by line, as measured or read there."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
from in_memory import fly, fly_offboard, height_m, ready_vehicle, said, take_off
from pymavlink.dialects.v20 import common as mavlink

from sim.autopilot import Autopilot
from sim.commands import Command, execute
from sim.failsafe import Charge
from sim.flight import HOME_NED_M
from sim.modes import Px4Mode
from sim.streams import STREAMS

NAN = math.nan
ACCEPTED, REJECTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
INCLUSION = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
EXCLUSION = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION


@pytest.fixture
def vehicle() -> Autopilot:
    """Just ready to arm."""
    return ready_vehicle()


@pytest.fixture(scope="module")
def hovering() -> Autopilot:
    vehicle = ready_vehicle()
    take_off(vehicle, 10.0)
    return vehicle


@pytest.fixture
def aloft(hovering: Autopilot) -> Autopilot:
    """In Hold, 10 m up."""
    return copy.deepcopy(hovering)


def command(vehicle: Autopilot, number: int, *params: float) -> int:
    padded = (*params, *[NAN] * (7 - len(params)))
    return execute(vehicle, Command(number=number, params=padded))


def mode(vehicle: Autopilot) -> Px4Mode:
    return vehicle.commander.mode


def message(vehicle: Autopilot, number: int) -> Any:
    return STREAMS[number][0](vehicle)


def fly_until_disarmed(vehicle: Autopilot, limit_s: float = 120.0) -> None:
    for _ in range(round(limit_s)):
        fly(vehicle, 1.0)
        if not vehicle.commander.is_armed:
            return
    raise AssertionError(f"armed after {limit_s:g} s")


def prearm_bit(vehicle: Autopilot) -> bool:
    health = message(vehicle, mavlink.MAVLINK_MSG_ID_SYS_STATUS).onboard_control_sensors_health
    return bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)


def upload_fence(vehicle: Autopilot, *areas: tuple[int, list[tuple[float, float]]]) -> None:
    """Areas of corners in metres from home."""
    items = []
    for number, corners in areas:
        for north, east in corners:
            at = HOME_NED_M[0] + north, HOME_NED_M[1] + east, 0.0
            latitude, longitude, _ = vehicle.map.to_geo(at)
            x, y = round(latitude * 1e7), round(longitude * 1e7)
            rest = (float(len(corners)), 0.0, 0.0, 0.0, x, y, 0.0, FENCE)
            head = (1, 1, len(items), mavlink.MAV_FRAME_GLOBAL_INT, number, 0, 1)
            items.append(mavlink.MAVLink_mission_item_int_message(*head, *rest))
    vehicle.missions.items[FENCE] = items
    fly(vehicle, 0.3)


def square(half_m: float, north: float = 0.0) -> list[tuple[float, float]]:
    near, far = north - half_m, north + half_m
    return [(near, -half_m), (near, half_m), (far, half_m), (far, -half_m)]


# --- arming and modes


def test_after_disarming_the_last_mode_that_can_arm_is_the_mode_to_be(aloft: Autopilot) -> None:
    setpoint = fly_offboard(aloft)
    assert aloft.request_mode(Px4Mode.LAND)
    fly_until_disarmed(aloft)
    fly(aloft, 2.0)
    assert mode(aloft) is Px4Mode.OFFBOARD
    assert not prearm_bit(aloft)
    said(aloft)
    assert command(aloft, mavlink.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
    assert said(aloft) == []  # a mode's own requirements are no texts
    assert not aloft.arm()
    assert said(aloft) == ["Arming denied: Resolve system health failures first"]
    assert aloft.request_mode(Px4Mode.LOITER)
    fly(aloft, 0.1)
    assert prearm_bit(aloft)
    assert aloft.arm()
    assert setpoint.is_flyable


def test_a_takeoff_is_not_the_mode_to_be_after_disarming(vehicle: Autopilot) -> None:
    assert command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF) == ACCEPTED
    assert vehicle.arm()
    vehicle.commander.disarm(is_forced=False)
    fly(vehicle, 0.1)
    assert mode(vehicle) is Px4Mode.LOITER


@pytest.mark.parametrize("wanted", list(Px4Mode))
def test_every_mode_is_accepted_while_disarmed(vehicle: Autopilot, wanted: Px4Mode) -> None:
    number = wanted >> 16 & 0xFF, wanted >> 24
    assert command(vehicle, mavlink.MAV_CMD_DO_SET_MODE, 1.0, *number) == ACCEPTED
    fly(vehicle, 0.1)
    assert mode(vehicle) is wanted
    can_arm = wanted in (Px4Mode.LOITER, Px4Mode.TAKEOFF)
    assert prearm_bit(vehicle) is can_arm
    assert vehicle.arm() is can_arm


@pytest.mark.parametrize(
    "wanted", [Px4Mode.POSCTL, Px4Mode.ALTCTL, Px4Mode.MANUAL, Px4Mode.MISSION]
)
def test_modes_that_lack_something_are_refused_in_the_air(
    aloft: Autopilot, wanted: Px4Mode
) -> None:
    said(aloft)
    assert not aloft.request_mode(wanted)
    assert said(aloft) == [f"Switching to {wanted.label} is currently not available"]
    assert mode(aloft) is Px4Mode.LOITER


def test_a_pilot_with_sticks_gets_position_mode(aloft: Autopilot) -> None:
    aloft.commander.take_over()
    fly(aloft, 0.1)
    assert mode(aloft) is Px4Mode.POSCTL
    assert not aloft.commander.is_in_failsafe


def test_with_sticks_lost_setpoints_fall_back_to_position_mode(aloft: Autopilot) -> None:
    aloft.commander.has_sticks = True
    fly_offboard(aloft)
    fly(aloft, 1.5)
    assert mode(aloft) is Px4Mode.POSCTL
    assert aloft.commander.is_in_failsafe


def test_idle_arming_ends_in_words(vehicle: Autopilot) -> None:
    said(vehicle)
    assert vehicle.arm()
    fly(vehicle, 12.0)
    assert said(vehicle) == [
        "Armed by external command",
        "Disarmed by auto preflight disarming",
    ]


def test_a_failing_check_is_said_once_and_repeated_on_request(vehicle: Autopilot) -> None:
    vehicle.problems = ("Preflight Fail: Compass Sensor 0 missing",)
    said(vehicle)
    fly(vehicle, 10.0)
    assert said(vehicle) == ["Preflight Fail: Compass Sensor 0 missing"]
    assert not prearm_bit(vehicle)
    assert not vehicle.arm()
    assert said(vehicle) == ["Arming denied: Resolve system health failures first"]
    command(vehicle, mavlink.MAV_CMD_RUN_PREARM_CHECKS)
    assert said(vehicle) == ["Preflight Fail: Compass Sensor 0 missing"]


# --- take-off and home


def test_takeoff_height_counts_from_where_it_begins(vehicle: Autopilot) -> None:
    take_off(vehicle, 10.0)
    assert vehicle.request_mode(Px4Mode.TAKEOFF)
    fly(vehicle, 12.0)
    assert height_m(vehicle) == pytest.approx(20.0, abs=1.5)


def test_takeoff_parameter_is_above_sea_level_and_does_not_descend(vehicle: Autopilot) -> None:
    home_m = vehicle.origin.altitude_m - HOME_NED_M[2]
    above = (NAN, NAN, NAN, NAN, NAN, NAN, home_m + 12.0)
    assert command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, *above) == ACCEPTED
    assert vehicle.arm()
    fly(vehicle, 18.0)
    assert height_m(vehicle) == pytest.approx(12.0, abs=1.0)
    said(vehicle)
    below = (*above[:6], home_m + 5.0)
    assert command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, *below) == ACCEPTED
    fly(vehicle, 5.0)
    assert said(vehicle) == ["Already higher than takeoff altitude"]
    assert height_m(vehicle) == pytest.approx(12.0, abs=1.0)
    assert mode(vehicle) is Px4Mode.LOITER


def test_home_moves_to_where_it_lands(aloft: Autopilot) -> None:
    setpoint = fly_offboard(aloft, 5.0)
    fly(aloft, 5.0, setpoint)
    assert aloft.request_mode(Px4Mode.LAND)
    while aloft.commander.is_armed:
        fly(aloft, 0.5)
        if aloft.commander.is_armed:
            assert math.dist(aloft.navigator.home[:2], HOME_NED_M[:2]) < 1.0
    fly(aloft, 0.1)
    home = message(aloft, mavlink.MAVLINK_MSG_ID_HOME_POSITION)
    assert math.dist((home.x, home.y), HOME_NED_M[:2]) > 20.0
    assert math.dist((home.x, home.y), aloft.body.position[:2]) < 1.0


def test_a_home_that_was_set_stays(vehicle: Autopilot) -> None:
    place = vehicle.map.to_geo((HOME_NED_M[0] + 50.0, HOME_NED_M[1], HOME_NED_M[2]))
    assert command(vehicle, mavlink.MAV_CMD_DO_SET_HOME, 0.0, NAN, NAN, NAN, *place) == ACCEPTED
    fly(vehicle, 1.0)
    assert vehicle.arm()
    assert vehicle.navigator.home[0] == pytest.approx(HOME_NED_M[0] + 50.0, abs=0.1)


# --- failsafes


@pytest.mark.parametrize("wait_s", [5.0, 0.0])
def test_a_failsafe_holds_before_it_acts(aloft: Autopilot, wait_s: float) -> None:
    aloft.parameters.set("COM_FAIL_ACT_T", wait_s)
    said(aloft)
    aloft.battery_level = 0.06
    fly(aloft, 0.1)
    if wait_s:
        assert "Failsafe activated: entering Hold for 5 seconds" in said(aloft)
        fly(aloft, wait_s - 0.3)
        beat = message(aloft, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        assert beat.custom_mode == Px4Mode.LOITER
        assert beat.system_status == mavlink.MAV_STATE_CRITICAL
        fly(aloft, 0.4)
    texts = said(aloft)
    assert mode(aloft) is Px4Mode.RTL
    assert any(text.startswith("RTL: start return at") for text in texts)


def test_a_second_failsafe_soon_after_does_not_hold_again(aloft: Autopilot) -> None:
    aloft.battery_level = 0.06
    fly(aloft, 6.0)
    assert mode(aloft) is Px4Mode.RTL
    aloft.battery_level = 0.04
    fly(aloft, 0.1)
    assert aloft.commander.charge is Charge.EMERGENCY
    assert mode(aloft) is Px4Mode.LAND


def test_low_battery_only_warns(aloft: Autopilot) -> None:
    said(aloft)
    aloft.battery_level = 0.1
    fly(aloft, 6.0)
    assert said(aloft) == ["Low battery"]
    assert not aloft.commander.is_in_failsafe


def test_a_battery_that_was_critical_at_arming_is_no_reason_to_return(aloft: Autopilot) -> None:
    aloft.battery_level = 0.06
    aloft.commander._charge_at_arming = Charge.CRITICAL
    fly(aloft, 6.0)
    assert mode(aloft) is Px4Mode.LOITER
    assert not aloft.commander.is_in_failsafe


@pytest.mark.parametrize(
    ("action", "is_emergency", "flown"),
    [
        (0, False, Px4Mode.LOITER),
        (1, True, Px4Mode.RTL),
        (2, False, Px4Mode.LAND),
        (3, False, Px4Mode.RTL),
        (3, True, Px4Mode.LAND),
    ],
)
def test_battery_action_is_a_parameter(
    aloft: Autopilot, action: int, is_emergency: bool, flown: Px4Mode
) -> None:
    aloft.parameters.set("COM_LOW_BAT_ACT", action)
    aloft.battery_level = 0.04 if is_emergency else 0.06
    fly(aloft, 5.5)
    assert mode(aloft) is flown


def test_another_mode_takes_over_from_a_failsafe(aloft: Autopilot) -> None:
    setpoint = fly_offboard(aloft)
    aloft.battery_level = 0.06
    fly(aloft, 2.0, setpoint)
    assert mode(aloft) is Px4Mode.LOITER
    assert aloft.request_mode(Px4Mode.OFFBOARD)
    fly(aloft, 10.0, setpoint)
    assert mode(aloft) is Px4Mode.OFFBOARD
    assert not aloft.commander.is_in_failsafe
    aloft.battery_level = 0.04  # worse: the failsafe has the word again
    fly(aloft, 6.0, setpoint)
    assert mode(aloft) is Px4Mode.LAND


def test_landing_and_return_are_not_begun_anew_by_a_failsafe(vehicle: Autopilot) -> None:
    take_off(vehicle, 20.0)
    assert vehicle.request_mode(Px4Mode.LAND)
    vehicle.battery_level = 0.06
    fly(vehicle, 8.0)
    assert mode(vehicle) is Px4Mode.LAND
    assert not vehicle.commander.is_in_failsafe


@pytest.mark.parametrize(
    ("action", "flown"), [(1, Px4Mode.LOITER), (2, Px4Mode.RTL), (3, Px4Mode.LAND)]
)
def test_without_sticks_lost_setpoints_do_what_lost_sticks_do(
    aloft: Autopilot, action: int, flown: Px4Mode
) -> None:
    aloft.parameters.set("NAV_RCL_ACT", action)
    fly_offboard(aloft)
    fly(aloft, 1.5)
    assert mode(aloft) is flown
    assert aloft.commander.is_in_failsafe


def test_one_late_setpoint_brings_offboard_back_for_as_long_as_it_counts(
    aloft: Autopilot,
) -> None:
    setpoint = fly_offboard(aloft)
    fly(aloft, 3.0)
    assert mode(aloft) is Px4Mode.RTL
    aloft.take_offboard(setpoint)
    fly(aloft, 0.9)
    assert mode(aloft) is Px4Mode.OFFBOARD
    fly(aloft, 0.2)
    assert mode(aloft) is Px4Mode.RTL


@pytest.mark.parametrize(("rate_hz", "holds"), [(2.0, True), (0.7, False)])
def test_rare_setpoints_hold_down_to_a_rate(aloft: Autopilot, rate_hz: float, holds: bool) -> None:
    setpoint = fly_offboard(aloft)
    modes = set()
    for _ in range(10):
        aloft.take_offboard(setpoint)
        for _ in range(10):
            fly(aloft, 0.1 / rate_hz)
            modes.add(mode(aloft))
    assert modes == ({Px4Mode.OFFBOARD} if holds else {Px4Mode.OFFBOARD, Px4Mode.RTL})


# --- GPS


def test_gps_loss_shows_as_a_failsafe_and_in_the_estimator_flags(aloft: Autopilot) -> None:
    def flags() -> int:
        status = message(aloft, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS)
        value: int = status.flags
        return value

    setpoint = fly_offboard(aloft)
    aloft.has_gps = False
    fly(aloft, 5.2, setpoint)
    assert mode(aloft) is Px4Mode.OFFBOARD
    assert flags() & mavlink.ESTIMATOR_POS_HORIZ_ABS
    assert not flags() & mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
    fly(aloft, 0.3, setpoint)
    assert mode(aloft) is Px4Mode.ALTCTL
    assert aloft.commander.is_in_failsafe
    assert flags() & mavlink.ESTIMATOR_POS_HORIZ_ABS  # the failsafe is seen first
    fly(aloft, 1.0, setpoint)
    assert not flags() & mavlink.ESTIMATOR_POS_HORIZ_ABS


def test_without_gps_landing_is_accepted_and_drifts_and_return_is_not(vehicle: Autopilot) -> None:
    take_off(vehicle, 15.0)
    setpoint = fly_offboard(vehicle, 4.0)
    fly(vehicle, 4.0, setpoint)
    vehicle.has_gps = False
    fly(vehicle, 6.0, setpoint)
    begun_at = list(vehicle.body.position)
    assert not vehicle.request_mode(Px4Mode.RTL)
    assert not vehicle.request_mode(Px4Mode.LOITER)
    assert command(vehicle, mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    fly(vehicle, 3.0)
    assert mode(vehicle) is Px4Mode.LAND
    assert vehicle.commander.is_in_failsafe  # though it was asked for: it only descends
    fly_until_disarmed(vehicle)
    assert math.dist(vehicle.body.position[:2], begun_at[:2]) > 5.0


def test_gps_that_comes_back_in_the_descent_allows_to_return(vehicle: Autopilot) -> None:
    take_off(vehicle, 30.0)
    setpoint = fly_offboard(vehicle)
    vehicle.has_gps = False
    fly(vehicle, 7.0, setpoint)
    assert vehicle.request_mode(Px4Mode.LAND)
    fly(vehicle, 2.0)
    vehicle.has_gps = True
    fly(vehicle, 3.0)
    assert mode(vehicle) is Px4Mode.LAND
    assert vehicle.request_mode(Px4Mode.RTL)
    fly(vehicle, 1.0)
    assert mode(vehicle) is Px4Mode.RTL
    assert not vehicle.commander.is_in_failsafe


def test_gps_loss_in_hold_and_return_descends(vehicle: Autopilot) -> None:
    take_off(vehicle, 15.0)
    vehicle.has_gps = False
    fly(vehicle, 6.0)
    assert mode(vehicle) is Px4Mode.LAND
    assert vehicle.commander.is_in_failsafe
    fly_until_disarmed(vehicle)


@pytest.mark.parametrize(("allowed", "texts"), [(1, []), (0, ["Preflight Fail: GPS fix too low"])])
def test_without_gps_it_cannot_be_armed(vehicle: Autopilot, allowed: int, texts: list[str]) -> None:
    vehicle.parameters.set("COM_ARM_WO_GPS", allowed)
    vehicle.has_gps = False
    said(vehicle)
    fly(vehicle, 7.0)
    assert said(vehicle) == texts
    assert not prearm_bit(vehicle)
    assert not vehicle.arm()


def test_a_jump_of_the_estimate_is_counted_and_stays(aloft: Autopilot) -> None:
    before = list(aloft.estimate.position)
    resets = message(aloft, mavlink.MAVLINK_MSG_ID_ODOMETRY).reset_counter
    aloft.jump(12.0)
    assert math.dist(aloft.estimate.position[:2], before[:2]) == pytest.approx(12.0, abs=0.5)
    fly(aloft, 20.0)  # it flies back to where it believes that it was
    assert math.dist(aloft.estimate.position[:2], before[:2]) < 1.0
    assert math.dist(aloft.body.position[:2], before[:2]) == pytest.approx(12.0, abs=1.5)
    assert message(aloft, mavlink.MAVLINK_MSG_ID_ODOMETRY).reset_counter == resets + 1


# --- geofence


@pytest.mark.parametrize(
    ("action", "flown"),
    [
        (0, Px4Mode.OFFBOARD),
        (1, Px4Mode.OFFBOARD),
        (2, Px4Mode.LOITER),
        (3, Px4Mode.RTL),
        (5, Px4Mode.LAND),
    ],
)
def test_fence_action_is_a_parameter(aloft: Autopilot, action: int, flown: Px4Mode) -> None:
    aloft.parameters.set("GF_ACTION", action)
    aloft.parameters.set("GF_MAX_HOR_DIST", 20.0)
    setpoint = fly_offboard(aloft, 5.0)
    said(aloft)
    fly(aloft, 7.0, setpoint)
    assert mode(aloft) is (Px4Mode.LOITER if action > 1 else flown)
    is_said = "Geofence: exceeding maximum distance to Home" in said(aloft)
    assert is_said is (action > 0)
    fly(aloft, 5.0, setpoint)
    assert mode(aloft) is flown


def test_a_fence_failsafe_stays_until_another_mode_is_chosen(aloft: Autopilot) -> None:
    aloft.parameters.set("GF_ACTION", 3)
    aloft.parameters.set("GF_MAX_HOR_DIST", 20.0)
    setpoint = fly_offboard(aloft, 5.0)
    fly(aloft, 12.0, setpoint)
    assert mode(aloft) is Px4Mode.RTL
    while math.dist(aloft.body.position[:2], HOME_NED_M[:2]) > 10.0:
        fly(aloft, 1.0, setpoint)
    assert mode(aloft) is Px4Mode.RTL
    assert aloft.request_mode(Px4Mode.OFFBOARD)
    fly(aloft, 0.1, setpoint)
    assert mode(aloft) is Px4Mode.OFFBOARD


def test_fence_above(aloft: Autopilot) -> None:
    aloft.parameters.set("GF_MAX_VER_DIST", 8.0)
    fly(aloft, 2.5)
    assert "Geofence: exceeding maximum altitude above Home" in said(aloft)
    assert aloft.commander.is_in_failsafe


def test_all_inclusions_and_exclusions_count(vehicle: Autopilot) -> None:
    areas = ((INCLUSION, square(40.0)), (INCLUSION, square(40.0, 20.0)))
    upload_fence(vehicle, *areas, (EXCLUSION, square(5.0, 35.0)))

    def breach(north: float) -> str | None:
        at = (HOME_NED_M[0] + north, HOME_NED_M[1], -20.0)
        return vehicle.fence.breach(at, vehicle.navigator.home)

    assert breach(0.0) is None
    assert breach(-30.0) == "Geofence: approaching or outside geofence"  # in the first one alone
    assert breach(50.0) is not None  # in the second one alone
    assert breach(35.0) is not None  # in the exclusion
    assert breach(25.0) is None


def test_a_fence_without_home_is_left_out(vehicle: Autopilot) -> None:
    said(vehicle)
    upload_fence(vehicle, (INCLUSION, square(10.0, 100.0)))
    assert said(vehicle) == ["Geofence invalid, doesn't contain Home position"]
    assert vehicle.arm()


def test_a_fence_without_the_flying_vehicle_is_left_out(aloft: Autopilot) -> None:
    setpoint = fly_offboard(aloft, 5.0)
    fly(aloft, 6.0, setpoint)
    said(aloft)
    upload_fence(aloft, (INCLUSION, square(10.0)))
    assert said(aloft) == ["Geofence invalid, doesn't contain current vehicle position"]


def test_nothing_is_sent_beyond_the_fence(aloft: Autopilot) -> None:
    aloft.parameters.set("GF_MAX_HOR_DIST", 20.0)
    said(aloft)
    assert aloft.reposition((HOME_NED_M[0] + 50.0, HOME_NED_M[1], NAN), NAN, 0.0)
    fly(aloft, 10.0)
    assert said(aloft) == ["Reposition is outside geofence"]
    assert math.dist(aloft.body.position[:2], HOME_NED_M[:2]) < 2.0


# --- return and defaults


def test_return_says_at_which_height_and_when_it_lands(aloft: Autopilot) -> None:
    setpoint = fly_offboard(aloft, 5.0)
    fly(aloft, 6.0, setpoint)
    said(aloft)
    assert command(aloft, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    fly(aloft, 0.1)
    amsl_m = math.ceil(aloft.origin.altitude_m - aloft.navigator.home[2] + 30.0)
    assert said(aloft) == [
        "Returning to launch",
        f"RTL: start return at {amsl_m} m (30 m above destination)",
    ]
    fly(aloft, 25.0)
    assert said(aloft) == ["RTL: land at destination"]


def test_return_from_near_climbs_less(vehicle: Autopilot) -> None:
    take_off(vehicle, 5.0)
    assert vehicle.request_mode(Px4Mode.RTL)
    fly(vehicle, 5.0)
    assert height_m(vehicle) < 6.0


def test_defaults_are_those_of_a_quadrotor() -> None:
    parameters = ready_vehicle().parameters
    wanted = {"COM_LOW_BAT_ACT": 3, "RTL_DESCEND_ALT": 10, "RTL_RETURN_ALT": 30, "GF_ACTION": 2}
    assert {name: parameters[name] for name in wanted} == wanted


def test_never_disarming_is_a_parameter(vehicle: Autopilot) -> None:
    vehicle.parameters.set("COM_DISARM_LAND", -1.0)
    take_off(vehicle, 5.0)
    assert vehicle.request_mode(Px4Mode.LAND)
    fly(vehicle, 40.0)
    assert vehicle.is_landed
    assert vehicle.commander.is_armed
