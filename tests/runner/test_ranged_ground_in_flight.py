"""Ground that a rangefinder finds, on a vehicle in memory: pictures are laid on it."""

from __future__ import annotations

import pytest
from flights import LONGER, MISSION, comes_home

from dronemon.errors import CameraError, VehicleError
from dronemon.events import Measured
from dronemon.guard import Reason
from dronemon.types import Detection

RANGED = ("side_m: 100}", "side_m: 100, rangefinder: true}")


class Fixed:
    """A detector that finds a cow in one place of every picture, a little ahead."""

    def __init__(self) -> None:
        self.grounds_m = []

    def detect(self, image, pose, ground_down_m):
        self.grounds_m.append(ground_down_m)
        return (Detection(appearance="cow", pixel_px=(320.0, 200.0), score=1.0),)


def _looks(flight, ground_m, lean_rad=(0.0, 0.0, 0.0)):
    """How far ahead the cow is seen in each picture, in m."""

    def lay(link):
        link.vehicle.ground_m, link.vehicle.attitude_rad = ground_m, lean_rad

    flight.on_link = lay
    flight.detector = Fixed()
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    looks = [event.measurement for event in flight.record.events if isinstance(event, Measured)]
    assert len(looks) == 8
    return [100.0 * (m.target_au[0, 1] - m.agent_au[1]) for m in looks]


@pytest.mark.parametrize(("ground_m", "above_m"), [(0.0, 22.0), (6.0, 28.0)])
def test_pictures_are_laid_on_the_ground_that_is_found(flight, ground_m, above_m):
    flight.mission_text = MISSION.replace(*RANGED)
    ahead_m = _looks(flight, ground_m)
    assert ahead_m == pytest.approx([above_m * 40.0 / 320.0] * 8, rel=0.02)
    assert flight.detector.grounds_m[-1] == pytest.approx(ground_m, abs=0.3)


def test_without_one_the_ground_is_the_take_offs(flight):
    ahead_m = _looks(flight, 6.0)
    assert ahead_m == pytest.approx([22.0 * 40.0 / 320.0] * 8, rel=0.02)


def test_a_lean_does_not_lower_the_ground(flight):
    flight.mission_text = MISSION.replace(*RANGED)
    _looks(flight, 6.0, lean_rad=(0.1, 0.0, 0.0))
    assert flight.detector.grounds_m[-1] == pytest.approx(6.0, abs=0.3)


def test_it_is_not_flown_with_one_that_is_not_heard(flight):
    flight.mission_text = MISSION.replace(*RANGED)
    flight.on_link = lambda link: setattr(link.vehicle, "range_limits_m", None)
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "no-go: rangefinder (not heard)" in str(result.error)
    assert not result.has_flown


@pytest.mark.lengthy
def test_one_that_finds_no_ground_in_flight_makes_it_blind_and_brings_it_home(flight):
    flight.mission_text = LONGER.replace(*RANGED)
    result = flight.fly("range@16")
    assert isinstance(result.error, CameraError)
    assert "finds no ground" in flight.record.text("camera")
    assert Reason.BLIND in flight.reasons
    comes_home(flight, result)
