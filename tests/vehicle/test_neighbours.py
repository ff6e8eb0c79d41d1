"""Which of those that are heard is the vehicle, and who is refused."""

from __future__ import annotations

import pytest
from messages import HEARTBEAT

from dronemon.errors import WrongVehicle
from dronemon.vehicle.neighbours import autopilots, choose

OWN = (245, 190)
PX4 = {(1, 1): HEARTBEAT}
OTHERS = {
    (1, 154): {"type": 26, "autopilot": 8},
    (1, 191): {"type": 18, "autopilot": 12},
    (255, 190): {"type": 6, "autopilot": 8},
    (3, 1): {"type": 6, "autopilot": 8},
}


def chosen(heard, wanted=None):
    return choose(heard, wanted, OWN, "udpin://127.0.0.1:14540")


def test_gimbals_companions_and_people_are_no_vehicles():
    assert list(autopilots(PX4 | OTHERS)) == [1]
    assert chosen(PX4 | OTHERS) == 1


def test_the_mission_chooses_among_several():
    both = {(1, 1): HEARTBEAT, (42, 1): HEARTBEAT}
    assert chosen(both, wanted=42) == 42
    with pytest.raises(WrongVehicle, match=r"systems 1, 42; choose one by vehicle\.system_id"):
        chosen(both)
    with pytest.raises(WrongVehicle, match=r"no autopilot of system 7 .* only of 1, 42"):
        chosen(both, wanted=7)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"autopilot": 3}, r"system 1 .* is ArduPilot \(autopilot 3\), not PX4"),
        ({"autopilot": 9}, r"is another autopilot \(autopilot 9\)"),
        ({"type": 1}, r"is no rotorcraft \(type 1\)"),
    ],
)
def test_what_is_no_px4_rotorcraft_is_refused(fields, words):
    with pytest.raises(WrongVehicle, match=words):
        chosen({(1, 1): HEARTBEAT | fields})


def test_another_program_with_our_ids_is_named():
    with pytest.raises(WrongVehicle, match=r"another program speaks .* system 245, component 190"):
        chosen(PX4 | {OWN: {"type": 6, "autopilot": 8}})
