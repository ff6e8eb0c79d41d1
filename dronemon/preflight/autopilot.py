"""Rows on what the autopilot is set up to do by itself. Source: PX4 v1.17, commander/failsafe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum

from dronemon.mission import Mission, mission_obstacles, reach_m
from dronemon.mission.checks import battery_problem, outbound_min, return_min, usable_min
from dronemon.preflight.findings import HIGH_M, Facts, Judgement, go, no, warn


class _Deed(Enum):
    """What a failsafe does."""

    NOTHING = "does nothing"
    PILOT = "leaves it to the pilot's sticks, and the pilot must fly at once"
    HOLD = "hovers where it is"
    RETURN = "returns home and lands"
    LAND = "lands where it is, whatever is below"
    STOP = "stops the motors in the air"


_ON_LOSS = {
    0: _Deed.NOTHING,
    1: _Deed.HOLD,
    2: _Deed.RETURN,
    3: _Deed.LAND,
    5: _Deed.STOP,
    6: _Deed.STOP,
}
"""NAV_RCL_ACT and NAV_DLL_ACT."""
_ON_SETPOINTS_LOST = {
    0: _Deed.PILOT,
    1: _Deed.PILOT,
    2: _Deed.PILOT,
    3: _Deed.RETURN,
    4: _Deed.LAND,
    5: _Deed.HOLD,
    6: _Deed.STOP,
    7: _Deed.STOP,
}
_ON_FENCE = {
    0: _Deed.NOTHING,
    1: _Deed.NOTHING,
    2: _Deed.HOLD,
    3: _Deed.RETURN,
    4: _Deed.STOP,
    5: _Deed.LAND,
}
_OFFBOARD_BIT = {"COM_RCL_EXCEPT": 4, "COM_RC_OVERRIDE": 2}
_ENDS_A_HOLD = (1.0, 2.0, 3.0)
"""COM_LOW_BAT_ACT: at a critical battery it returns, lands, or the one and then the other."""
_NO_STICKS_READ = 4.0
"""COM_RC_IN_MODE: manual control is switched off."""
_LOSS_S = (0.5, 1.0, 2.0, 5.0)
_HOLD_MARGIN_S = 1.0
_SLOWEST_START_S = 6.0
"""From arming to leaving the ground: a heartbeat, spooling up, the ramp of the thrust."""
_FENCE_ROOM = 1.2
_CRITICAL = (
    {"BAT_CRIT_THR": 0.07, "BAT_EMERGEN_THR": 0.05},
    {"BAT_CRIT_THR": 0.05, "BAT_EMERGEN_THR": 0.03},
)
"""Levels of a critical battery to choose from: PX4's own, and the lowest that it takes."""
_LONG_HOVER_S = 60.0


def _deed(table: Mapping[int, _Deed], value: float) -> _Deed | None:
    return table.get(int(value)) if value == value // 1 else None


def _weigh(deed: _Deed | None, when: str, facts: Facts, mends: Mapping[str, float]) -> Judgement:
    """A failsafe that must bring the vehicle down when this program is gone."""
    if deed is None:
        return no(f"{when} it does what PX4 v1.17 has no word for", **mends)
    what = f"{when} it {deed.value}"
    if deed is _Deed.HOLD and facts.parameters.get("COM_LOW_BAT_ACT") not in _ENDS_A_HOLD:
        return no(f"{what}, and nothing brings it down before the battery is empty", **mends)
    if deed is _Deed.HOLD:
        return warn(f"{what} until the battery is critical", **mends)
    if deed is _Deed.STOP:
        return no(what, **mends)
    return go(what) if deed in {_Deed.RETURN, _Deed.NOTHING} else warn(what, **mends)


def on_setpoints_lost(facts: Facts, _: Mission) -> Judgement:
    """Setpoints stop, since this program is gone, or its link."""
    p = facts.parameters
    deed, mends = _deed(_ON_SETPOINTS_LOST, p["COM_OBL_RC_ACT"]), {"COM_OBL_RC_ACT": 3.0}
    when = "when this program or its link is gone"
    if deed is _Deed.PILOT and not facts.has_sticks:
        when += ", without a remote control,"
        deed = _deed(_ON_LOSS, p["NAV_RCL_ACT"])
        deed = _Deed.RETURN if deed is _Deed.NOTHING else deed  # no mode can fly then
    return _weigh(deed, when, facts, mends)


def on_loss_time(facts: Facts, _: Mission) -> Judgement:
    """How late a setpoint may come."""
    shortest, short, long, longest = _LOSS_S
    time_s = facts.parameters["COM_OF_LOSS_T"]
    what = f"the autopilot waits {time_s:g} s for a late setpoint before it helps itself"
    if not shortest <= time_s <= longest:
        return no(f"{what}; {short:g} s is right", COM_OF_LOSS_T=short)
    return go(what) if short <= time_s <= long else warn(what, COM_OF_LOSS_T=short)


def _reads_sticks(facts: Facts) -> bool:
    return facts.parameters.get("COM_RC_IN_MODE") != _NO_STICKS_READ


def on_sticks_lost(facts: Facts, _: Mission) -> Judgement:
    """A remote control that was heard is heard no more."""
    p = facts.parameters
    if not _reads_sticks(facts):
        return go("manual control is switched off: there is nothing to lose")
    deed = _deed(_ON_LOSS, p["NAV_RCL_ACT"])
    if int(p["COM_RCL_EXCEPT"]) & _OFFBOARD_BIT["COM_RCL_EXCEPT"] and deed is not _Deed.STOP:
        return go("on patrol a lost remote control is ignored")
    when = "when a remote control that was heard is lost"
    return _weigh(deed, when, facts, {"NAV_RCL_ACT": 2.0})


def on_override(facts: Facts, _: Mission) -> Judgement:
    """How a pilot takes over."""
    if not (_reads_sticks(facts) and facts.has_sticks):
        return warn(
            "no remote control is heard: a pilot can take over only from a ground station, by "
            "choosing a mode"
        )
    override = int(facts.parameters["COM_RC_OVERRIDE"])
    if override & _OFFBOARD_BIT["COM_RC_OVERRIDE"]:
        return go("a pilot takes over by moving the sticks, or by choosing a mode")
    what = "on patrol moving the sticks does nothing: a pilot takes over by choosing a mode"
    return warn(what, COM_RC_OVERRIDE=override | _OFFBOARD_BIT["COM_RC_OVERRIDE"])


def on_link_lost(facts: Facts, _: Mission) -> Judgement:
    """No ground station is heard."""
    deed = _deed(_ON_LOSS, facts.parameters["NAV_DLL_ACT"])
    when = "when no ground station is heard, this program is one,"
    return _weigh(deed, when, facts, {"NAV_DLL_ACT": 0.0})


def on_return_height(facts: Facts, mission: Mission) -> Judgement:
    """The height of the return, against hills, the battery, a fence and rules."""
    p, flight, top_m = facts.parameters, mission.flight, facts.top_m(mission)
    height_m, least_m = max(p["RTL_RETURN_ALT"], top_m), flight.altitude_m
    tallest_m = max((thing.height_m for thing in mission_obstacles(mission)), default=0.0)
    what = f"the autopilot returns at {height_m:g} m above home"
    if flight.follow_terrain and facts.relief is not None:
        what = f"the autopilot returns at {p['RTL_RETURN_ALT']:g} to {height_m:.0f} m above home"
        hills_m = top_m - flight.altitude_m  # no mast is between two looks
        least_m = hills_m + tallest_m + flight.stand_off_m
        if not p["RTL_RETURN_ALT"] >= least_m:
            why = f"hills, what stands there and flight.stand_off_m need {least_m:.0f} m"
            return no(f"{what}, straight: {why}", RTL_RETURN_ALT=math.ceil(least_m))
    mends = {"RTL_RETURN_ALT": math.ceil(least_m)}
    if problem := battery_problem(mission, facts.away_m, p, top_m):
        is_mended = battery_problem(mission, facts.away_m, {**p, **mends}, top_m) is None
        return no(f"{what}: {problem}", **(mends if is_mended else {}))
    if 0.0 < (most_m := p.get("GF_MAX_VER_DIST", 0.0)) <= height_m:
        if most_m <= math.ceil(top_m):
            mends["GF_MAX_VER_DIST"] = math.ceil(_FENCE_ROOM * top_m)
        return no(f"{what}, which is not below GF_MAX_VER_DIST", **mends)
    if tallest_m > 0.0 and height_m < (clear_m := tallest_m + flight.stand_off_m):
        why = f"what stands in no-fly zones and flight.stand_off_m need {clear_m:.0f} m"
        return warn(f"{what}, straight: {why}", RTL_RETURN_ALT=math.ceil(clear_m))
    if height_m > (flight.ceiling_m or max(HIGH_M, top_m)):
        limit = f"the {HIGH_M:g} m that most rules allow"
        if flight.ceiling_m is not None:
            limit = f"flight.ceiling_m, {flight.ceiling_m:g}"
        return warn(f"{what}: higher than {limit}", **mends)
    return go(what)


def on_return_place(facts: Facts, _: Mission) -> Judgement:
    """Where it returns to."""
    if facts.parameters["RTL_TYPE"] == 0.0:
        return go("the autopilot returns home, or to a nearer rally point where it has one")
    what = "the autopilot may return to the landing of a mission, or to a rally point, not home"
    return no(what, RTL_TYPE=0.0)


def on_return_hover(facts: Facts, _: Mission) -> Judgement:
    """How long it hovers over home before it lands."""
    delay_s = facts.parameters["RTL_LAND_DELAY"]
    if delay_s < 0.0:
        return no("back at home it hovers and never lands", RTL_LAND_DELAY=0.0)
    what = f"back at home it hovers for {delay_s:g} s before it lands"
    return go(what) if delay_s <= _LONG_HOVER_S else warn(what, RTL_LAND_DELAY=0.0)


def on_fence(facts: Facts, _: Mission) -> Judgement:
    """What happens at a fence."""
    action = facts.parameters["GF_ACTION"]
    deed, mends = _deed(_ON_FENCE, action), {"GF_ACTION": 3.0}
    when = "at a fence"
    if action == 0:
        return no(f"{when} it does nothing, and the flight's own is for nothing", **mends)
    if deed is _Deed.HOLD:
        what = f"this program returns after {facts.hold_limit_s:g} s"
        return warn(f"{when} it hovers; {what}, and nobody if that is gone", **mends)
    if deed is _Deed.NOTHING:
        return warn(
            f"{when} it only warns; this program returns, and nobody if that is gone", **mends
        )
    return _weigh(deed, when, facts, mends)


def on_own_fence(facts: Facts, mission: Mission) -> Judgement:
    """Whether the vehicle's own fence, which is kept beside the flight's, allows the flight."""
    own = facts.own_fence
    if own is None:
        return warn("whether it allows the flight is not known")
    if own.num_against:
        return no(
            f"{own.num_against} of them are against the mission's area, home or the way between; "
            "change them with a ground station, or move the area"
        )
    if own.num_near:
        return warn(
            f"{own.num_near} of them are nearer than flight.fence_margin_m, "
            f"{mission.flight.fence_margin_m:g} m: there the autopilot acts before this program"
        )
    return go("it is kept, besides the flight's own" if own.num_areas else "it has none")


def on_fence_size(facts: Facts, mission: Mission) -> Judgement:
    """Whether the patrol is within the fence around home."""
    p = facts.parameters
    farthest_m = facts.away_m + reach_m(mission)
    height_m = facts.top_m(mission)
    problems, mends = [], {}
    if 0.0 < p["GF_MAX_HOR_DIST"] <= farthest_m:
        problems.append(f"the farthest corner is {farthest_m:.0f} m from home")
        mends["GF_MAX_HOR_DIST"] = math.ceil(_FENCE_ROOM * farthest_m)
    if 0.0 < p["GF_MAX_VER_DIST"] <= height_m:
        problems.append(f"the patrol is at {height_m:.4g} m")
        mends["GF_MAX_VER_DIST"] = math.ceil(_FENCE_ROOM * height_m)
    if problems:
        return no(f"{' and '.join(problems)}: outside this fence", **mends)
    return go("the patrol is within the fence around home, where there is one")


def on_battery_levels(facts: Facts, mission: Mission) -> Judgement:
    """Who acts first when the battery is low."""
    p, ours = facts.parameters, mission.flight.reserve_battery
    action = p["COM_LOW_BAT_ACT"]
    if action not in _ENDS_A_HOLD:
        what = "at a critical battery the autopilot only warns"
        mends = {"COM_LOW_BAT_ACT": 3.0}
        link = p.get("NAV_DLL_ACT", math.nan)
        if _deed(_ON_LOSS, link) in {_Deed.RETURN, _Deed.LAND}:
            return warn(f"{what}: nobody brings it home if this program is gone", **mends)
        return no(
            f"{what}, and with NAV_DLL_ACT={link:g} nothing else brings it down: if this program "
            "is gone in the climb, it hovers until it falls",
            **mends,
        )
    level = max(p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
    if not level < ours:
        mends = next((levels for levels in _CRITICAL if levels["BAT_CRIT_THR"] < ours), {})
        return no(
            f"the autopilot acts at {level:.0%}, before this program has landed, with "
            f"flight.reserve_battery, {ours:.0%}{'' if mends else ': raise that'}",
            **mends,
        )
    if action == 2:
        what = f"at {level:.0%} the autopilot lands where it is, whatever is below"
        return warn(what, COM_LOW_BAT_ACT=3.0)
    if not p["BAT_LOW_THR"] >= level:
        what = f"the autopilot acts at {level:.0%} without a warning at a higher level"
        return warn(what, BAT_LOW_THR=max(level, 0.15))
    return go(f"this program lands with {ours:.0%}, the autopilot acts at {level:.0%}")


def on_battery(facts: Facts, mission: Mission) -> Judgement:
    """Whether the battery lasts."""
    flight = mission.flight
    if facts.battery is None:
        return warn(
            "the vehicle does not tell its level: the drone is back after "
            f"{usable_min(mission):.1f} min in the air instead"
        )
    left_min = (facts.battery - flight.reserve_battery) * flight.endurance_min
    home_min = return_min(mission, facts.away_m, facts.parameters, facts.top_m(mission))
    needed_min = outbound_min(mission, facts.away_m) + home_min
    what = f"it lasts {max(left_min, 0.0):.1f} min down to {flight.reserve_battery:.0%}"
    if left_min < needed_min - mission.patrol_duration_s / 60.0:
        return no(f"{what}, no longer than the ways to the area and home; charge it")
    what = f"{what}, the flight {needed_min:.1f} min"
    return go(what) if left_min >= needed_min else warn(f"{what}: it returns before that")


def on_idle_disarming(facts: Facts, _: Mission) -> Judgement:
    """Whether the motors run until it has left the ground."""
    time_s = facts.parameters["COM_DISARM_PRFLT"]
    if not time_s > 0.0:
        return go("armed, it waits for the take-off without a limit")
    what = f"armed, it stops the motors unless it takes off within {time_s:g} s"
    if time_s < _SLOWEST_START_S:
        return no(f"{what}; that may take {_SLOWEST_START_S:g} s", COM_DISARM_PRFLT=10.0)
    return go(what)


def on_failsafe_delay(facts: Facts, _: Mission) -> Judgement:
    """How long a failsafe holds before it acts."""
    time_s = facts.parameters["COM_FAIL_ACT_T"]
    what = f"a failsafe holds for {time_s:g} s before it acts"
    if not 0.0 <= time_s <= facts.hold_limit_s - _HOLD_MARGIN_S:
        return no(
            f"{what}, and this program takes one of {facts.hold_limit_s:g} s for all that it does",
            COM_FAIL_ACT_T=5.0,
        )
    return go(what)
