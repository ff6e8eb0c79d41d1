"""Every row of the guard's table is flown by the whole runner."""

from __future__ import annotations

import inspect
from functools import partial

import pytest
import test_camera_in_flight
import test_field_in_flight
import test_flights_in_memory
import test_guidance_in_flight
import test_pilot_in_flight
import test_resume
import test_set_up_in_flight
from flights import flown, hangs
from test_guidance_in_flight import test_a_bad_planner_brings_the_drone_home as bad_planner
from test_pilot_in_flight import test_a_vehicle_that_others_fly_is_not_touched as others_fly
from test_pilot_in_flight import test_the_pilot_wins_on_the_way_home as pilot_wins

from dronemon.guard import TABLE, Reason

MODULES = (
    test_flights_in_memory,
    test_camera_in_flight,
    test_field_in_flight,
    test_guidance_in_flight,
    test_pilot_in_flight,
    test_set_up_in_flight,
    test_resume,
)


@pytest.mark.lengthy
@pytest.mark.timeout(300)  # alone it flies a hundred flights
def test_every_row_of_the_table_is_flown(prepare):
    """What the tests before this one have flown already is not flown again."""
    late = partial(bad_planner, answer=hangs, words="no waypoint", reason=Reason.PLANNER_LATE)
    others = partial(others_fly, height_m=35.0)
    given_back = partial(pilot_wins, is_without_gps=True)
    tests = [
        test
        for module in MODULES
        for name, test in vars(module).items()
        if name.startswith("test_") and list(inspect.signature(test).parameters) == ["flight"]
    ]
    for fly in [late, others, given_back, *tests]:
        if len(flown) < len(TABLE):
            fly(prepare())
    assert [row for number, row in enumerate(TABLE) if number not in flown] == []
