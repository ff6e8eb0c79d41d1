"""Every row of the preflight table: go, warning and no-go, and that what mends a row mends it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from dronemon.errors import CameraError
from dronemon.mission import Mission
from dronemon.mission.area import Area
from dronemon.preflight import (
    Facts,
    Finding,
    OwnFence,
    Relief,
    Sight,
    Verdict,
    against,
    judge,
    mending_options,
)
from dronemon.preflight.findings import Judgement
from dronemon.preflight.table import TABLE
from dronemon.types import GpsFix
from sim.parameters import TABLE as MOCK

GO, WARNING, NO_GO = Verdict
MISSION = Mission.model_validate(
    {
        "area": {"side_m": 200, "rangefinder": True},
        "flight": {"horizon_au": 20},
        "camera": {"gimbal": True},
        "targets": [{"name": "Bella", "appearance": "cow"}],
    }
)
BARE = {p.name: float(p.default) for p in MOCK} | {"COM_LOW_BAT_ACT": 0.0, "RTL_RETURN_ALT": 60.0}
"""PX4 v1.17's own defaults; the mock's are those of its simulation."""
GOOD = BARE | {"COM_OBL_RC_ACT": 3, "COM_RC_OVERRIDE": 3, "GF_ACTION": 3, "COM_LOW_BAT_ACT": 3}
FACTS = Facts(
    parameters=GOOD,
    away_m=0.0,
    own_fence=OwnFence(num_areas=0, num_against=0, num_near=0),
    has_sticks=True,
    battery=1.0,
    estimate_doubts=(),
    gps=GpsFix(is_3d=True, num_satellites=14, dilution=0.8),
    remote_id=None,
    range_limits_m=(0.1, 60.0),
    sight=Sight(wait_s=0.1, age_s=0.1),
    free_bytes=200,
    needed_bytes=100,
    hold_limit_s=8.0,
)
OWN = "vehicle's own fence"
FENCE, BATTERY = "fence around home", "battery levels"
STICKS, LINK = "remote control lost", "ground station lost"


def _found(name: str, facts: Facts) -> Finding:
    return next(finding for finding in judge(facts, MISSION) if finding.name == name)


def _gps(**changes: Any) -> dict[str, Any]:
    return {"gps": replace(FACTS.gps, **changes)}


def test_a_vehicle_that_nothing_is_against_is_go_in_every_row():
    findings = judge(FACTS, MISSION)
    assert [finding.name for finding in findings] == [row.name for row in TABLE]
    assert {finding.judgement.verdict for finding in findings} == {GO}
    assert mending_options(findings) == ""


def _hills(highest_m: float = 10.0, lowest_m: float = -5.0, px: float = 5.0) -> Relief:
    """Below a flight at one height."""
    altitude_m = MISSION.flight.altitude_m
    return Relief(
        highest_m=highest_m,
        lowest_m=lowest_m,
        least_m=altitude_m - highest_m,
        most_m=altitude_m - lowest_m,
        top_m=altitude_m,
        px_m=400.0,
        needed_m=30.0,
        needed_px_per_m=px,
    )


@pytest.mark.parametrize(
    ("changes", "verdict", "words"),
    [
        ({}, GO, "35 to 50 m below the flight: 8.0 to 11.4 pixels a metre"),
        ({"highest_m": 15.1}, NO_GO, "does not show all that is to be looked at: that takes 30 m"),
        (
            {"highest_m": 38.0},
            NO_GO,
            "is 7 m below the flight, not 10; set flight.altitude_m to 48 or more",
        ),
        ({"lowest_m": -36.0}, NO_GO, "over the lowest the detector does not have the 5 that it"),
        ({"lowest_m": -36.0, "px": 0.0}, GO, "35 to 81 m below the flight"),
    ],
)
def test_hills_stay_below_the_flight_and_the_camera_sees_enough_over_hill_and_dale(
    changes: dict[str, float], verdict: Verdict, words: str
):
    found = _found("ground below", replace(FACTS, relief=_hills(**changes)))
    assert found.judgement.verdict is verdict
    assert words in found.judgement.meaning
    assert found.value == (
        f"{changes.get('lowest_m', -5.0):+.0f} to {changes.get('highest_m', 10.0):+.0f} m from the"
        " take-off's"
    )


FOLLOWING = MISSION.model_copy(
    update={"flight": MISSION.flight.model_copy(update={"follow_terrain": True})}
)
FOLLOWED = Relief(
    highest_m=40.0,
    lowest_m=-30.0,
    least_m=45.0,
    most_m=62.0,
    top_m=85.0,
    px_m=400.0,
    needed_m=30.0,
    needed_px_per_m=5.0,
)


@pytest.mark.parametrize(
    ("name", "relief", "parameters", "verdict", "words"),
    [
        (
            "ground below",
            {},
            {},
            GO,
            "45 to 62 m below the flight, which follows it: 6.5 to 8.9 px",
        ),
        ("ground below", {"least_m": 8.0}, {}, NO_GO, "set flight.altitude_m to 47 or more"),
        ("ground below", {"most_m": 81.0}, {}, NO_GO, "fly lower, or slower, which follows steep"),
        ("ground below", {"most_m": 121.0, "needed_px_per_m": 0.0}, {}, WARNING, "the 120 m of"),
        (
            "ground below",
            {},
            {"MPC_Z_VEL_MAX_DN": 1.0},
            NO_GO,
            "takes 1.2 m/s up and down, and MPC",
        ),
        ("ground below", {}, {"MPC_Z_VEL_MAX_UP": math.nan}, NO_GO, "and MPC_Z_VEL_MAX_UP allow"),
        ("height of the return", {}, {}, GO, "returns at 60 to 85 m above home"),
        ("height of the return", {}, {"RTL_RETURN_ALT": 49.0}, NO_GO, "_m need 50 m"),
        ("height of the return", {"top_m": 130.0}, {"RTL_RETURN_ALT": 131.0}, WARNING, "131 m"),
        (
            "height of the return",
            {"top_m": 1600.0},
            {"RTL_RETURN_ALT": 1600.0},
            NO_GO,
            "min endurance",
        ),
        (FENCE, {}, {"GF_MAX_VER_DIST": 84.0}, NO_GO, "the patrol is at 85 m: outside"),
        (FENCE, {}, {"GF_MAX_VER_DIST": 86.0}, GO, "within"),
    ],
)
def test_a_flight_that_follows_the_ground_is_judged_by_its_hills(
    name: str,
    relief: dict[str, float],
    parameters: dict[str, float],
    verdict: Verdict,
    words: str,
):
    facts = replace(FACTS, relief=replace(FOLLOWED, **relief), parameters=GOOD | parameters)

    def found(facts: Facts) -> Finding:
        return next(finding for finding in judge(facts, FOLLOWING) if finding.name == name)

    finding = found(facts)
    assert finding.judgement.verdict is verdict
    assert words.replace("px", "pixels") in finding.judgement.meaning
    if mends := finding.judgement.mends:
        mended = found(replace(facts, parameters=facts.parameters | mends))
        assert mended.judgement.verdict in {GO, WARNING}


def _return_over(height_m: float, facts: Facts, mission: Mission) -> Judgement:
    tower = {"name": "tower", "height_m": height_m, "polygon_m": [[50, 50], [60, 50], [60, 60]]}
    area = Area.model_validate({"side_m": 200.0, "no_fly": [tower]})
    findings = judge(facts, mission.model_copy(update={"area": area}))
    return next(f.judgement for f in findings if f.name == "height of the return")


def test_a_tower_on_the_straight_return_is_told():
    found = _return_over(80.0, FACTS, MISSION)
    assert found.verdict is WARNING
    assert found.mends == {"RTL_RETURN_ALT": 90}
    far = _return_over(80.0, replace(FACTS, away_m=20e3), MISSION)
    assert far.verdict is NO_GO, "a warning hides no no-go"


def test_a_following_flights_return_clears_what_stands_on_the_highest_hill():
    found = _return_over(12.0, replace(FACTS, relief=FOLLOWED, parameters=GOOD), FOLLOWING)
    assert found.verdict is NO_GO
    assert "what stands there and flight.st" in found.meaning
    assert found.mends == {"RTL_RETURN_ALT": 62}


def _under(ceiling_m: float) -> Mission:
    flight = MISSION.flight.model_copy(update={"ceiling_m": ceiling_m})
    return MISSION.model_copy(update={"flight": flight})


@pytest.mark.parametrize(("ceiling_m", "verdict"), [(49.0, NO_GO), (51.0, GO)])
def test_the_lowest_ground_is_below_the_ceiling(ceiling_m: float, verdict: Verdict):
    findings = judge(replace(FACTS, relief=_hills()), _under(ceiling_m))  # 50 m below the flight
    found = next(finding for finding in findings if finding.name == "ground below")
    assert found.judgement.verdict is verdict


@pytest.mark.parametrize(("ceiling_m", "verdict"), [(59.0, WARNING), (60.0, GO)])
def test_a_return_above_the_ceiling_is_told(ceiling_m: float, verdict: Verdict):
    findings = judge(FACTS, _under(ceiling_m))  # it returns at 60 m
    found = next(finding for finding in findings if finding.name == "height of the return")
    assert found.judgement.verdict is verdict
    assert ("flight.ceiling_m, 59" in found.judgement.meaning) == (verdict is WARNING)


def test_no_height_of_the_return_mends_an_area_too_far_away():
    finding = _found("height of the return", replace(FACTS, away_m=20e3))
    assert finding.judgement.verdict is NO_GO
    assert finding.judgement.mends == {}


@pytest.mark.parametrize("has_sticks", [True, False])
def test_the_autopilots_own_defaults_may_fly_once_a_low_battery_ends_a_hover(has_sticks: bool):
    facts = replace(FACTS, parameters=BARE, has_sticks=has_sticks)
    (refused,) = against(judge(facts, MISSION), NO_GO)
    assert refused.name == BATTERY
    assert mending_options([refused]) == "--set COM_LOW_BAT_ACT=3"
    facts = replace(facts, parameters=BARE | refused.judgement.mends)
    assert against(judge(facts, MISSION), NO_GO) == []


@pytest.mark.parametrize(
    ("name", "parameters", "verdict"),
    [
        *(("setpoints lost", {"COM_OBL_RC_ACT": n}, WARNING) for n in (0, 1, 2, 4, 5)),
        *(("setpoints lost", {"COM_OBL_RC_ACT": n}, NO_GO) for n in (6, 7, 8, -1, 0.5)),
        ("setpoints lost", {"COM_OBL_RC_ACT": 5, "COM_LOW_BAT_ACT": 0}, NO_GO),
        ("setpoints late", {"COM_OF_LOSS_T": 0.3}, NO_GO),
        ("setpoints late", {"COM_OF_LOSS_T": 0.5}, WARNING),
        ("setpoints late", {"COM_OF_LOSS_T": 3}, WARNING),
        ("setpoints late", {"COM_OF_LOSS_T": 60}, NO_GO),
        (STICKS, {"NAV_RCL_ACT": 1}, WARNING),
        (STICKS, {"NAV_RCL_ACT": 1, "COM_LOW_BAT_ACT": 0}, NO_GO),
        (STICKS, {"NAV_RCL_ACT": 3}, WARNING),
        *((STICKS, {"NAV_RCL_ACT": n}, NO_GO) for n in (4, 5, 6)),
        (STICKS, {"NAV_RCL_ACT": 1, "COM_LOW_BAT_ACT": 0, "COM_RCL_EXCEPT": 4}, GO),
        (STICKS, {"NAV_RCL_ACT": 6, "COM_RCL_EXCEPT": 4}, NO_GO),
        (STICKS, {"NAV_RCL_ACT": 6, "COM_RC_IN_MODE": 4}, GO),
        ("pilot takes over", {"COM_RC_OVERRIDE": 1}, WARNING),
        ("pilot takes over", {"COM_RC_IN_MODE": 4}, WARNING),
        (LINK, {"NAV_DLL_ACT": 1}, WARNING),
        (LINK, {"NAV_DLL_ACT": 1, "COM_LOW_BAT_ACT": 0}, NO_GO),
        (LINK, {"NAV_DLL_ACT": 2}, GO),
        (LINK, {"NAV_DLL_ACT": 3}, WARNING),
        *((LINK, {"NAV_DLL_ACT": n}, NO_GO) for n in (5, 6)),
        ("height of the return", {"RTL_RETURN_ALT": 0}, GO),
        ("height of the return", {"RTL_RETURN_ALT": 150}, WARNING),
        ("height of the return", {"RTL_RETURN_ALT": 900}, NO_GO),
        ("height of the return", {"RTL_RETURN_ALT": 60, "GF_MAX_VER_DIST": 55}, NO_GO),
        ("height of the return", {"RTL_RETURN_ALT": 60, "GF_MAX_VER_DIST": 40}, NO_GO),
        *(("place of the return", {"RTL_TYPE": n}, NO_GO) for n in (1, 2, 3, 5)),
        ("landing after it", {"RTL_LAND_DELAY": -1}, NO_GO),
        ("landing after it", {"RTL_LAND_DELAY": 90}, WARNING),
        *(("fence crossed", {"GF_ACTION": n}, WARNING) for n in (1, 2, 5)),
        *(("fence crossed", {"GF_ACTION": n}, NO_GO) for n in (0, 4, 6)),
        (FENCE, {"GF_MAX_HOR_DIST": 141}, NO_GO),
        (FENCE, {"GF_MAX_HOR_DIST": 142}, GO),
        (FENCE, {"GF_MAX_VER_DIST": 45}, NO_GO),
        (FENCE, {"GF_MAX_HOR_DIST": 141, "GF_ACTION": 0}, NO_GO),
        (BATTERY, {"COM_LOW_BAT_ACT": 0}, NO_GO),
        *((BATTERY, {"COM_LOW_BAT_ACT": 0, "NAV_DLL_ACT": n}, NO_GO) for n in (1, 5, 6, 7)),
        *((BATTERY, {"COM_LOW_BAT_ACT": 0, "NAV_DLL_ACT": n}, WARNING) for n in (2, 3)),
        (BATTERY, {"COM_LOW_BAT_ACT": 2}, WARNING),
        (BATTERY, {"BAT_CRIT_THR": 0.25, "BAT_LOW_THR": 0.3}, NO_GO),
        (BATTERY, {"BAT_EMERGEN_THR": 0.3, "BAT_LOW_THR": 0.3}, NO_GO),
        (BATTERY, {"BAT_CRIT_THR": 0.14, "BAT_LOW_THR": 0.12}, WARNING),
        ("motors idle", {"COM_DISARM_PRFLT": 2}, NO_GO),
        ("motors idle", {"COM_DISARM_PRFLT": -1}, GO),
        ("failsafe's delay", {"COM_FAIL_ACT_T": 0}, GO),
        ("failsafe's delay", {"COM_FAIL_ACT_T": 25}, NO_GO),
    ],
)
def test_a_set_up_is_judged_and_what_mends_it_mends_it(
    name: str, parameters: dict[str, float], verdict: Verdict
):
    facts = replace(FACTS, parameters=GOOD | parameters)
    finding = _found(name, facts)
    assert finding.judgement.verdict is verdict, finding
    mends = finding.judgement.mends
    if verdict is NO_GO:
        assert mends, "no-go names what mends it"
    if mends:
        mended = replace(FACTS, parameters=GOOD | parameters | mends)
        assert _found(name, mended).judgement.verdict is GO


@pytest.mark.parametrize(("reserve", "has_mend"), [(0.15, True), (0.06, True), (0.05, False)])
def test_levels_that_mend_are_below_the_reserve(reserve: float, has_mend: bool):
    flight = MISSION.flight.model_copy(update={"reserve_battery": reserve})
    mission = MISSION.model_copy(update={"flight": flight})

    def found(levels: dict[str, float]) -> Finding:
        facts = replace(FACTS, parameters=GOOD | levels)
        return next(f for f in judge(facts, mission) if f.name == BATTERY)

    refused = found({"BAT_CRIT_THR": 0.3, "BAT_LOW_THR": 0.3}).judgement
    assert refused.verdict is NO_GO
    assert bool(refused.mends) is has_mend is not ("raise that" in refused.meaning)
    assert not has_mend or found(dict(refused.mends)).judgement.verdict is GO


def test_a_ceiling_stays_where_a_lower_return_is_below_it():
    facts = replace(FACTS, parameters=GOOD | {"RTL_RETURN_ALT": 150, "GF_MAX_VER_DIST": 100})
    assert mending_options(against(judge(facts, MISSION), NO_GO)) == "--set RTL_RETURN_ALT=45"


@pytest.mark.parametrize(
    ("name", "changes", "verdict"),
    [
        ("arming checks", {"unready": "no good absolute position"}, NO_GO),
        ("estimate", {"estimate_doubts": ("no height",)}, NO_GO),
        ("GPS", _gps(is_3d=False), NO_GO),
        ("GPS", _gps(num_satellites=5), NO_GO),
        ("GPS", _gps(num_satellites=7), WARNING),
        ("GPS", _gps(num_satellites=None, dilution=None), GO),
        ("GPS", _gps(dilution=2.2), WARNING),
        ("GPS", _gps(dilution=9.9), NO_GO),
        ("GPS", {"gps": None}, WARNING),
        (OWN, {"own_fence": None}, WARNING),
        (OWN, {"own_fence": OwnFence(num_areas=2, num_against=0, num_near=0)}, GO),
        (OWN, {"own_fence": OwnFence(num_areas=2, num_against=0, num_near=1)}, WARNING),
        (OWN, {"own_fence": OwnFence(num_areas=2, num_against=1, num_near=1)}, NO_GO),
        ("battery", {"battery": None}, WARNING),
        ("battery", {"battery": 0.2}, NO_GO),
        ("battery", {"battery": 0.4}, WARNING),
        ("pilot takes over", {"has_sticks": False}, WARNING),
        ("remote ID", {"remote_id": ""}, GO),
        ("remote ID", {"remote_id": "no operator"}, NO_GO),
        ("gimbal", {}, GO),
        ("gimbal", {"gimbal": "no attitude is heard"}, NO_GO),
        ("rangefinder", {}, GO),
        ("rangefinder", {"range_limits_m": None}, NO_GO),
        ("rangefinder", {"range_limits_m": (0.1, 51.0)}, NO_GO),
        ("rangefinder", {"range_limits_m": (0.1, 52.0)}, GO),
        ("camera", {"sight": CameraError("no picture came")}, NO_GO),
        ("camera", {"sight": Sight(wait_s=9.0, age_s=0.0)}, WARNING),
        ("detector", {"detector": "it failed"}, NO_GO),
        ("disk", {"free_bytes": 99}, NO_GO),
        ("height of the return", {"away_m": 5000.0}, NO_GO),
    ],
)
def test_what_it_is_flown_with_is_judged(name: str, changes: dict[str, Any], verdict: Verdict):
    assert _found(name, replace(FACTS, **changes)).judgement.verdict is verdict


@pytest.mark.parametrize(("action", "verdict"), [(1, WARNING), (2, GO), (3, WARNING), (6, NO_GO)])
def test_without_a_remote_control_lost_setpoints_do_what_its_loss_does(action, verdict):
    parameters = GOOD | {"COM_OBL_RC_ACT": 0, "NAV_RCL_ACT": action}
    facts = replace(FACTS, parameters=parameters, has_sticks=False)
    assert _found("setpoints lost", facts).judgement.verdict is verdict


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_a_parameter_that_is_missing_or_unreadable_is_said(row):
    for name in row.parameters:
        without = {key: value for key, value in GOOD.items() if key != name}
        finding = _found(row.name, replace(FACTS, parameters=without))
        assert finding.judgement.verdict is WARNING
        assert f"no {name}" in finding.judgement.meaning
        finding = _found(row.name, replace(FACTS, parameters=GOOD | {name: float("nan")}))
        assert finding.judgement.verdict is NO_GO
        assert name in finding.judgement.meaning
