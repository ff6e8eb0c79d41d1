"""Whose mode it is."""

from __future__ import annotations

import pytest

from dronemon.errors import ControlTaken
from dronemon.vehicle import Mode, VehicleState
from dronemon.vehicle.mode_watch import ModeWatch


def test_any_mode_is_welcome_until_one_is_expected_and_after_release():
    watch = ModeWatch()
    watch.check(VehicleState(is_armed=True, mode=Mode.POSITION))
    watch.expect(Mode.OFFBOARD)
    with pytest.raises(ControlTaken, match="the pilot chose mode 'position' where 'offboard'"):
        watch.check(VehicleState(is_armed=True, mode=Mode.POSITION))
    watch.release()
    watch.check(VehicleState(is_armed=True, mode=Mode.POSITION))


def test_while_a_command_is_under_way_old_and_new_mode_are_ours():
    watch = ModeWatch()
    watch.expect(Mode.OFFBOARD)
    watch.expect_also(Mode.HOLD, Mode.OFFBOARD)
    for mode in (Mode.OFFBOARD, Mode.HOLD):
        watch.check(VehicleState(is_armed=True, mode=mode))
    with pytest.raises(ControlTaken, match=r"a failsafe .* 'hold or offboard' was ours") as caught:
        watch.check(VehicleState(is_armed=True, mode=Mode.RETURN, is_failsafe=True))
    assert caught.value.by_failsafe


def test_from_a_command_on_the_mode_is_watched_though_any_was_welcome():
    """After a failsafe, say: a pilot who takes over meanwhile must not be commanded."""
    watch = ModeWatch()
    watch.expect_also(Mode.LAND, Mode.ALTITUDE)
    for mode in (Mode.ALTITUDE, Mode.LAND):
        watch.check(VehicleState(is_armed=True, mode=mode))
    with pytest.raises(ControlTaken, match="the pilot chose mode 'position'"):
        watch.check(VehicleState(is_armed=True, mode=Mode.POSITION))


def test_with_motors_off_no_mode_flies():
    watch = ModeWatch()
    watch.expect(Mode.TAKEOFF)
    watch.check(VehicleState(mode=Mode.POSITION))
