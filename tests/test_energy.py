"""The way home in time and effort, and the drain from levels in whole percents."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dronemon.energy import CALM, RETURN_PARAMETERS, Drain, Wind, effort_home_s

ENDURANCE_S = 1800.0
WAY_M = (30.0, -40.0)


def _drain(true_per_s: float, duration_s: float, noise: float = 0.0) -> Drain:
    drain, rng = Drain(ENDURANCE_S), np.random.default_rng(0)
    for time_s in np.arange(0.0, duration_s, 0.2):
        level = 0.953 - true_per_s * time_s + noise * rng.normal()
        drain.take(float(time_s), math.ceil(100.0 * level) / 100.0)
    return drain


def test_at_first_the_mission_says_how_fast_the_battery_drains():
    assert Drain(ENDURANCE_S).per_s == 1.0 / ENDURANCE_S
    assert _drain(1.0 / 100.0, 30.0).per_s == 1.0 / ENDURANCE_S


@pytest.mark.parametrize("noise", [0.0, 0.002])
@pytest.mark.parametrize("minutes", [10.0, 20.0])
def test_a_drain_is_measured_through_steps_and_noise(minutes: float, noise: float):
    drain = _drain(1.0 / (60.0 * minutes), 240.0, noise)
    assert drain.per_s == pytest.approx(1.0 / (60.0 * minutes), rel=0.12)


def test_a_battery_is_not_believed_to_last_longer_than_the_mission_says():
    assert _drain(1.0 / 6000.0, 1200.0).per_s == 1.0 / ENDURANCE_S


def test_a_drain_that_rises_shows_within_minutes():
    drain = _drain(1.0 / 1500.0, 600.0)
    for step in range(300):
        drain.take(600.0 + step, round(0.55 - step / 700.0, 2))
    assert drain.per_s == pytest.approx(1.0 / 700.0, rel=0.1)


def test_the_way_home_is_climbed_flown_and_descended():
    p = RETURN_PARAMETERS
    effort_s = effort_home_s(WAY_M, 20.0, {})
    assert effort_s == pytest.approx(10.0 / 3.0 + 10.0 + 20.0 / 1.5 + 10.0 / 0.7 + 20.0)
    assert effort_home_s(WAY_M, 50.0, {}) > effort_s
    assert effort_home_s(WAY_M, 20.0, {"RTL_LAND_DELAY": 20.0}) == pytest.approx(effort_s + 20.0)
    assert effort_home_s(WAY_M, 20.0, {"MPC_XY_CRUISE": 10.0}) == pytest.approx(effort_s - 5.0)
    assert effort_home_s(WAY_M, 20.0, p | {"MPC_LAND_SPEED": 0.0}) < math.inf
    assert effort_home_s((0.0, 0.0), 20.0, {}, CALM) == pytest.approx(effort_s - 10.0)


def test_wind_costs_on_the_way_against_it_and_time_where_it_is_too_strong_for_cruise():
    def effort_s(push_m_s2: float, drag_per_s: float = 0.5) -> float:
        at_rest = (push_m_s2 * 0.6, push_m_s2 * -0.8)  # away from home where it is negative
        wind = Wind(at_rest_m_s2=at_rest, drag_per_s=drag_per_s)
        return effort_home_s(WAY_M, 20.0, {}, wind)

    efforts_s = [effort_s(push) for push in (-4.0, 0.0, 4.0, 8.0, 9.5)]
    assert efforts_s[1] < efforts_s[0] < efforts_s[2] < efforts_s[3] < efforts_s[4] < math.inf
    assert effort_s(9.9) == math.inf
    assert Drain(ENDURANCE_S).needed(effort_s(9.9)) == 1.0


def test_a_parameter_that_cannot_be_read_is_no_reason_to_fly_on():
    effort_s = effort_home_s(WAY_M, 20.0, {"MPC_LAND_SPEED": math.nan})
    assert Drain(ENDURANCE_S).needed(effort_s) == 1.0
