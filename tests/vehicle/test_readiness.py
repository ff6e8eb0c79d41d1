"""What is against a take-off."""

from __future__ import annotations

import pytest
from messages import ACCURACY, HOME, PLACE, READY, ready

from dronemon.vehicle.readiness import problems

QUICK = [0.02, 0.4, 0.02]
CHECKS_FAIL = READY["SYS_STATUS"] | {"onboard_control_sensors_health": 0}
NO_NUMBER = (
    "its board does not say its own number (AUTOPILOT_VERSION, uid2 or uid), by which is kept what "
    "a flight changes on it: give it firmware that does, such as PX4 v1.17's"
)


def test_nothing_is_against_a_vehicle_that_is_ready():
    assert problems(ready(), QUICK) == []


@pytest.mark.parametrize(
    ("messages", "problem"),
    [
        ({"SYS_STATUS": CHECKS_FAIL}, "arming checks not passed"),
        (
            {"ESTIMATOR_STATUS": {"flags": 0, **ACCURACY}},
            "no good absolute position (GPS?)",
        ),
        ({"ESTIMATOR_STATUS": None}, "no good absolute position (GPS?)"),
        ({"HOME_POSITION": None}, "no home position"),
        ({"AUTOPILOT_VERSION": None}, NO_NUMBER),
        ({"AUTOPILOT_VERSION": {"uid": 0, "uid2": [0] * 18}}, NO_NUMBER),
        ({"GPS_GLOBAL_ORIGIN": None}, "no origin of the local frame"),
        ({"GLOBAL_POSITION_INT": None}, "no global position"),
        ({"GLOBAL_POSITION_INT": PLACE | {"lat": 0, "lon": 0}}, "no global position"),
        (
            {"HOME_POSITION": HOME | {"latitude": 0, "longitude": 0}},
            "the home position is at latitude 0, longitude 0: not yet set",
        ),
        (
            {"HOME_POSITION": HOME | {"latitude": 483977420}},
            "the home position is 111 km away from the vehicle",
        ),
    ],
)
def test_what_is_missing_is_named(messages, problem):
    assert problems(ready(**messages), QUICK) == [problem]


def test_few_poses_are_named_with_their_numbers():
    (problem,) = problems(ready(rate_hz=1.0, duration_s=6.0), QUICK)
    assert problem.startswith("poses come at 1.0 Hz with gaps of up to 1.0 s, 5 Hz and 1 s are")


def test_poses_must_have_come_for_a_while():
    assert problems(ready(duration_s=2.0), QUICK) == ["poses not heard for long enough"]


def test_a_link_that_is_slow_or_mute_is_named():
    assert problems(ready(), []) == ["no answer to a ping"]
    (problem,) = problems(ready(), [0.2, 1.4, 1.5])
    assert problem.startswith("an answer takes 1.4 s, 1 s is the limit")
