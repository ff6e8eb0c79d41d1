"""Time from stamps as links bring them: late, twice, wrapped, of a new boot, of two vehicles."""

from __future__ import annotations

import numpy as np
import pytest

from dronemon.vehicle.vehicle_clock import VehicleClock

STEP_MS = 20


def stamps(start_ms, duration_ms):
    return range(start_ms, start_ms + duration_ms, STEP_MS)


def heard(clock, stamps_ms):
    """Times that a clock believes. -> list of s"""
    times = [clock.take(stamp_ms % 2**32, stamp_ms) for stamp_ms in stamps_ms]
    return [time_s for time_s in times if time_s is not None]


@pytest.mark.parametrize("late_ms", [40, 400, 1500, 5000, 9900])
def test_what_is_repeated_late_is_dropped(late_ms):
    clock = VehicleClock()
    both = [s for now in stamps(60_000, 30_000) for s in (now, now - late_ms) if s >= 60_000]
    assert heard(clock, both) == [s / 1000.0 for s in stamps(60_000, 30_000)]
    assert clock.pop_problem() is None


def test_late_messages_that_go_on_alone_are_no_reboot():
    clock = VehicleClock()
    heard(clock, stamps(60_000, 10_000))
    assert heard(clock, stamps(60_500, 9_000)) == []  # the fast route fell silent
    assert heard(clock, [70_020]) == [70.02]
    assert clock.pop_problem() is None


def test_a_lossy_route_beside_a_slow_one_is_one_vehicle():
    clock, rng = VehicleClock(), np.random.default_rng(0)
    for now in stamps(60_000, 60_000):
        if rng.random() > 0.2:
            heard(clock, [now])
        if rng.random() > 0.2:
            heard(clock, [now - 1500])
    assert clock.pop_problem() is None


def test_a_single_stamp_from_elsewhere_is_dropped():
    clock = VehicleClock()
    times = heard(clock, [100_000, 100_020, 3_000, 100_040, 4_000_000, 100_060, 7, 100_080])
    assert times == [100.0, 100.02, 100.04, 100.06, 100.08]
    assert clock.pop_problem() is None


@pytest.mark.parametrize("ahead_ms", [2_000, 8_000, 9_900])
def test_a_single_stamp_from_the_future_takes_nothing_away(ahead_ms):
    clock = VehicleClock()
    heard(clock, stamps(100_000, 5_000))
    assert heard(clock, [105_000 + ahead_ms]) == []
    assert len(heard(clock, stamps(105_000, 10_000))) == 500
    assert (clock.pop_problem(), clock.are_two) == (None, False)


@pytest.mark.parametrize("start_ms", [100_000, 2**32 - 6_020])  # the second stamp wraps
def test_after_a_short_silence_time_goes_on_with_the_second_stamp(start_ms):
    clock = VehicleClock()
    heard(clock, [start_ms])
    believed_s = [(start_ms + 6_020) / 1000.0, (start_ms + 6_040) / 1000.0]
    assert heard(clock, stamps(start_ms + 6_000, 60)) == believed_s


@pytest.mark.parametrize("before_ms", [100_000, 40_000])
def test_a_reboot_is_believed_once_new_time_has_gone_on_for_a_second(before_ms):
    clock = VehicleClock()
    heard(clock, stamps(before_ms, 5_000))
    assert heard(clock, stamps(2_000, 1_000)) == []
    assert clock.pop_problem() is None
    assert heard(clock, stamps(3_000, 1_000))[0] == 3.0
    assert clock.num_reboots == 1
    assert "rebooted" in clock.pop_problem()
    assert clock.pop_problem() is None


def test_a_reboot_is_believed_on_a_link_that_repeats():
    clock = VehicleClock()
    heard(clock, stamps(100_000, 5_000))
    both = [s for now in stamps(2_000, 5_000) for s in (now, max(now - 1500, 2_000))]
    assert heard(clock, both)[-1] == 6.98
    assert clock.num_reboots == 1


def test_time_goes_on_after_a_long_silence():
    clock = VehicleClock()
    heard(clock, stamps(100_000, 1_000))
    assert heard(clock, stamps(170_000, 3_000))[0] == 171.0
    assert clock.pop_problem() is None


def test_time_wraps_after_49_days():
    clock = VehicleClock()
    times = heard(clock, stamps(2**32 - 1_000, 3_000))
    assert times == [s / 1000.0 for s in stamps(2**32 - 1_000, 3_000)]
    assert clock.pop_problem() is None


@pytest.mark.parametrize("apart_ms", [1_500, 7_000, 60_010])
def test_two_clocks_that_go_on_side_by_side_are_two_vehicles(apart_ms):
    clock = VehicleClock()
    for now in stamps(100_000, 6_000):
        clock.take(now, "one")
        clock.take(now - apart_ms, "two")
    assert "two vehicles of one system id" in clock.pop_problem()
    assert clock.num_reboots == 0
    assert clock.are_two
    heard(clock, stamps(106_000, 31_000))
    assert not clock.are_two, "the other is gone"
