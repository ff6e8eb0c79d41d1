"""The way home in time and effort, and the drain from levels in whole percents."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from dronemon.energy import CALM, RETURN_PARAMETERS, Cost, Drain, Point, Wind, cost_home

ENDURANCE_S = 1800.0
WAY_M = (30.0, -40.0)


def _effort_s(
    parameters: Mapping[str, float],
    way_m: Point = WAY_M,
    height_m: float = 20.0,
    wind: Wind = CALM,
) -> float:
    return cost_home([way_m], height_m, parameters, wind).effort_s


def _drain(true_per_s: float, duration_s: float, noise: float = 0.0, rate: float = 1.0) -> Drain:
    """Of a flight that leans at this rate of effort per time."""
    drain, rng = Drain(ENDURANCE_S), np.random.default_rng(0)
    for time_s in np.arange(0.0, duration_s, 0.2):
        level = 0.953 - true_per_s * time_s + noise * rng.normal()
        drain.take(Cost(time_s, rate * time_s), math.ceil(100.0 * level) / 100.0)
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
        drain.take(Cost(600.0 + step, 600.0 + step), round(0.55 - step / 700.0, 2))
    assert drain.per_s == pytest.approx(1.0 / 700.0, rel=0.1)


def test_of_the_drain_by_time_and_by_effort_the_one_that_takes_more_counts():
    drain, steps = _drain(1.0 / 600.0, 240.0, rate=1.25), 0.011
    assert drain.needed(Cost(60.0, 90.0)) == pytest.approx(90.0 / 750.0, abs=steps)
    assert drain.needed(Cost(60.0, 60.0)) == pytest.approx(60.0 / 600.0, abs=steps)


def test_what_is_used_up_within_a_step_is_reckoned_since_the_last_one():
    drain, now = Drain(600.0), Cost(0.0, 0.0)
    drain.take(now, 0.9)
    assert drain.needed(now) == 0.01  # anywhere within the step
    for time_s in (1.0, 4.0, 60.0):
        drain.take(Cost(time_s, time_s), 0.89)
        assert drain.needed(now) == pytest.approx(min((time_s - 1.0) / 600.0, 0.01))


def test_the_way_home_is_climbed_flown_and_descended():
    p = RETURN_PARAMETERS
    descent_s, settle_s = 20.0 / 1.5 + 5.0 / 1.1 + 5.0 / 0.7, 4.0
    time_s = _effort_s({})
    assert time_s == pytest.approx(10.0 / 3.0 + 10.0 + descent_s + 3 * settle_s)
    assert cost_home([WAY_M], 20.0, {}) == Cost(time_s, time_s)
    assert _effort_s({}, height_m=50.0) > time_s
    assert _effort_s({}, height_m=30.0) == pytest.approx(time_s - 10.0 / 3.0 - settle_s)
    assert _effort_s({"RTL_LAND_DELAY": 20.0}) == pytest.approx(time_s + 20.0)
    assert _effort_s({"MPC_XY_CRUISE": 10.0}) == pytest.approx(time_s - 5.0)
    assert _effort_s(p | {"MPC_LAND_SPEED": 0.0}) < math.inf
    assert _effort_s({}, way_m=(0.0, 0.0)) == pytest.approx(time_s - 10.0 - settle_s)


@pytest.mark.parametrize(
    ("away_m", "height_m", "return_m", "measured_s"),
    [
        (100.8, 44.7, 30.0, 63.3),
        (100.6, 45.2, 60.0, 85.4),
        (100.8, 44.9, 60.0, 80.1),
        (101.1, 20.1, 30.0, 58.8),
    ],
)
def test_the_way_home_takes_as_long_as_px4_does(away_m, height_m, return_m, measured_s):
    """PX4 v1.17.0 SITL, its defaults, no wind: from the command to 0.1 m above where it began."""
    cost = cost_home([(away_m, 0.0)], height_m, {"RTL_RETURN_ALT": return_m})
    assert cost.time_s == pytest.approx(measured_s, abs=4.0)


def test_wind_costs_on_the_way_against_it_and_time_where_it_is_too_strong_for_cruise():
    def effort_s(push_m_s2: float) -> float:
        at_rest = (push_m_s2 * 0.6, push_m_s2 * -0.8)  # away from home where it is negative
        return _effort_s({}, wind=Wind(at_rest_m_s2=at_rest, drag_per_s=0.5))

    efforts_s = [effort_s(push) for push in (-4.0, 0.0, 4.0, 8.0, 9.5)]
    assert efforts_s[1] < efforts_s[0] < efforts_s[2] < efforts_s[3] < efforts_s[4] < math.inf
    assert effort_s(9.9) == math.inf
    assert Drain(ENDURANCE_S).needed(Cost(0.0, math.inf)) == 1.0


def test_a_parameter_that_cannot_be_read_is_no_reason_to_fly_on():
    cost = cost_home([WAY_M], 20.0, {"MPC_LAND_SPEED": math.nan})
    assert Drain(ENDURANCE_S).needed(cost) == 1.0


def test_a_way_around_costs_each_of_its_legs():
    """Two legs of 30 m in a row cost what one of 60 m does, and a turn between them."""
    straight, around = (
        cost_home(legs_m, 20.0, {}) for legs_m in ([(60.0, 0.0)], [(30.0, 0.0)] * 2)
    )
    assert around.time_s == pytest.approx(straight.time_s + 4.0)
