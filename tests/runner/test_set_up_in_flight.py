"""What is set up on a vehicle for a flight, and looked at before it."""

from __future__ import annotations

import fake_link
import numpy as np
import pytest
import virtual_time
from fake_link import FakeCamera, FakeLink
from flights import MISSION, Blind, Listener, Shuttle, comes_home

from dronemon.errors import (
    CommandRejected,
    VehicleError,
)
from dronemon.events import Audience
from dronemon.guard import Reason
from dronemon.mission import load_mission
from dronemon.preflight import Finding, Verdict, against
from dronemon.runner.flight import NOT_STARTED
from dronemon.runner.inspection import inspect_vehicle
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.vehicle.changes import state_folder
from dronemon.vehicle.fence_items import FenceItem, polygon_items


def test_an_empty_battery_is_found_on_the_ground(flight):
    flight.on_link = lambda link: setattr(link.vehicle, "battery", 0.16)
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "battery (16%): it lasts 0.3 min down to 15%" in str(result.error)
    assert flight.link.commands == []


def test_a_set_up_that_would_do_harm_is_refused_with_what_mends_it(flight):
    flight.on_link = lambda link: link.vehicle.parameters.update(GF_ACTION=4.0, NAV_DLL_ACT=5.0)
    result = flight.fly()
    assert (result.outcome, result.has_flown) == ("failed", False)
    assert isinstance(result.error, VehicleError)
    assert "fence crossed (GF_ACTION=4): at a fence it stops the motors" in str(result.error)
    told = str(result.error)
    assert told.endswith("the same command with: --set NAV_DLL_ACT=0 --set GF_ACTION=3")
    assert "dronemon fly" not in told  # which vehicle is the user's to say
    assert flight.link.commands == []


@pytest.mark.parametrize("height_m", [0.0, 20.0])
def test_preflight_of_a_vehicle_that_others_fly_is_no_go(tmp_path, height_m):
    path = tmp_path / "small.yaml"
    path.write_text(MISSION)

    state_folder().mkdir(parents=True)  # what a flight before left
    (state_folder() / "fake.json").write_text('{"GF_ACTION": {"old": 2.0, "new": 3.0}}')

    async def inspect() -> list[Finding]:
        async with FakeLink() as link:
            link.vehicle.is_armed, link.vehicle.position[2] = True, -height_m
            setup = FlightSetup(
                file=load_mission(path),
                link=link,
                camera=FakeCamera(link, 640, 480),
                detector=Blind(),
                planner=Shuttle(),
                priors_au=np.array([[0.4, 0.6]]),
                record=Listener(),
                audience=Audience(),
                interrupts=Interrupts(),
            )
            findings = await inspect_vehicle(setup, print, lambda findings: None)
            assert link.commands == []
            return against(findings, Verdict.NO_GO)

    (refused,) = virtual_time.run(inspect())
    assert "others fly it" in str(refused)


def test_a_warning_is_told_and_flown_with(flight):
    flight.on_link = lambda link: link.vehicle.parameters.update(GF_ACTION=2.0)
    assert flight.fly().outcome == "completed"
    assert "fence crossed (GF_ACTION=2)" in flight.record.text("preflight")


@pytest.mark.parametrize("fault", ["", "pilot@12+20", "camera@12"])
def test_a_parameter_for_a_flight_is_put_back_once_the_motors_are_off(flight, fault):
    flight.settings = {"COM_FAIL_ACT_T": 4.0}
    result = flight.fly(*filter(None, [fault]))
    assert result.is_landed
    assert flight.link.vehicle.parameters["COM_FAIL_ACT_T"] == 5.0
    commands = flight.link.commands
    assert commands[0] == "COM_FAIL_ACT_T=4"
    assert commands.index("COM_FAIL_ACT_T=5") > commands.index("return")
    assert flight.record.kinds.index("disarmed") < flight.record.kinds.index("outcome")


def test_a_parameter_stays_while_it_is_not_known_whether_the_motors_run(flight):
    flight.settings = {"COM_FAIL_ACT_T": 4.0}
    assert not flight.fly("silence@12").is_landed
    assert flight.link.vehicle.parameters["COM_FAIL_ACT_T"] == 4.0
    assert "COM_FAIL_ACT_T=4 is still set, and was 5" in flight.record.text("last word")
    kept = [path.name for path in state_folder().iterdir()]
    assert sorted(kept) == ["fake.fence.json", "fake.json"]


def test_the_vehicle_has_the_flights_fence_besides_its_own_until_it_is_down(flight):
    origin, half_deg = fake_link.ORIGIN, 0.005
    own = polygon_items(
        [
            (origin.latitude_deg + north * half_deg, origin.longitude_deg + east * half_deg)
            for north, east in ((-1, -1), (-1, 1), (1, 1), (1, -1))
        ]
    )
    flight.on_link = lambda link: setattr(link.vehicle, "fence", own)
    flown: list[int] = []
    flight.when("patrol", lambda: flown.append(len(flight.link.vehicle.fence)))
    assert flight.fly().outcome == "completed"
    assert flown == [8 + 4]
    assert flight.link.vehicle.fence == own
    assert flight.record.texts("its own fence is back: 4 corners and circles") == 1
    assert list(state_folder().iterdir()) == []


def test_a_fence_of_the_vehicle_that_is_in_the_way_is_refused(flight):
    def lay(link: FakeLink) -> None:
        here = (fake_link.ORIGIN.latitude_deg, fake_link.ORIGIN.longitude_deg)
        circle = FenceItem(
            command=5003, param1=40.0, x=round(here[0] * 1e7), y=round(here[1] * 1e7)
        )
        link.vehicle.fence = (circle,)

    flight.on_link = lay
    result = flight.fly()
    assert "own fence (1 areas): 1 of them are against the mission's area" in str(result.error)
    assert (result.last_word, flight.link.commands) == (NOT_STARTED, [])


def test_a_fence_that_is_refused_ends_the_flight_on_the_ground(flight):
    flight.on_link = lambda link: link.vehicle.refused.add("fence")
    result = flight.fly()
    assert isinstance(result.error, CommandRejected)
    assert (result.last_word, flight.link.commands) == (NOT_STARTED, [])
    assert list(state_folder().iterdir()) == []


def test_a_drone_that_is_about_to_leave_its_fence_returns(flight):
    def move() -> None:
        flight.link.vehicle.position[0] += 85.0
        flight.link.num_resets = 1  # so does the path

    flight.when("patrol", lambda: flight.later(3.0, move))
    result = flight.fly()
    assert Reason.OUTSIDE in flight.reasons
    assert Reason.OFF_PATH not in flight.reasons
    assert "about to leave its fence" in str(result.error)
    comes_home(flight, result)


def test_a_drone_that_leaves_its_heights_returns_at_once(flight):
    flight.when("patrol", lambda: setattr(flight.link.vehicle, "height_error_m", 12.0))
    result = flight.fly()
    assert Reason.OUTSIDE in flight.reasons
    comes_home(flight, result)
