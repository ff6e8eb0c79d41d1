"""Fit to fly or not: one table of what a vehicle is set up to do, and of what it is flown with.

Pure, as the guard is: the runner gathers facts, and each row says go, warning or no-go, what that
means in flight, and which values mend it. No-go is a set-up in which a failsafe would do harm, or
in which this program could never act before it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from dronemon.energy import RETURN_PARAMETERS
from dronemon.errors import CameraError
from dronemon.mission import Mission
from dronemon.preflight import autopilot, equipment
from dronemon.preflight.findings import Facts, Finding, Row, Verdict, no, warn


def _gps(facts: Facts) -> str:
    return "not heard" if facts.gps is None else str(facts.gps)


def _own_fence(facts: Facts) -> str:
    return "not looked at" if facts.own_fence is None else f"{facts.own_fence.num_areas} areas"


def _sight(facts: Facts) -> str:
    sight = facts.sight
    if isinstance(sight, CameraError):
        return "no picture"
    return f"a picture after {sight.wait_s:.2f} s, {sight.age_s:.2f} s old"


def _range(facts: Facts) -> str:
    if (limits_m := facts.range_limits_m) is None:
        return "not heard"
    return f"{limits_m[0]:g} to {limits_m[1]:g} m"


def _relief(facts: Facts) -> str:
    if (relief := facts.relief) is None:
        return "taken for flat"
    return f"{relief.lowest_m:+.0f} to {relief.highest_m:+.0f} m from the take-off's"


_LEVELS = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR", "COM_LOW_BAT_ACT")
# fmt: off
TABLE = (
    Row("arming checks", (), equipment.on_readiness,
        lambda f: "passed" if f.unready is None else "not passed"),
    Row("estimate", (), equipment.on_estimate,
        lambda f: ", ".join(f.estimate_doubts) or "good"),
    Row("GPS", (), equipment.on_gps, _gps),
    Row("setpoints lost", ("COM_OBL_RC_ACT", "NAV_RCL_ACT"), autopilot.on_setpoints_lost),
    Row("setpoints late", ("COM_OF_LOSS_T",), autopilot.on_loss_time),
    Row("remote control lost", ("NAV_RCL_ACT", "COM_RCL_EXCEPT"), autopilot.on_sticks_lost),
    Row("pilot takes over", ("COM_RC_OVERRIDE",), autopilot.on_override),
    Row("ground station lost", ("NAV_DLL_ACT",), autopilot.on_link_lost),
    Row("height of the return", tuple(RETURN_PARAMETERS), autopilot.on_return_height,
        lambda f: f"RTL_RETURN_ALT={f.parameters['RTL_RETURN_ALT']:g}"),
    Row("place of the return", ("RTL_TYPE",), autopilot.on_return_place),
    Row("landing after it", ("RTL_LAND_DELAY",), autopilot.on_return_hover),
    Row("fence crossed", ("GF_ACTION",), autopilot.on_fence),
    Row("fence around home", ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"),
        autopilot.on_fence_size),
    Row("vehicle's own fence", (), autopilot.on_own_fence, _own_fence),
    Row("battery levels", _LEVELS, autopilot.on_battery_levels),
    Row("battery", (), autopilot.on_battery,
        lambda f: "unknown" if f.battery is None else f"{f.battery:.0%}"),
    Row("motors idle", ("COM_DISARM_PRFLT",), autopilot.on_idle_disarming),
    Row("failsafe's delay", ("COM_FAIL_ACT_T",), autopilot.on_failsafe_delay),
    Row("remote ID", (), equipment.on_remote_id,
        lambda f: "not heard" if f.remote_id is None else "not ready" if f.remote_id else "ready"),
    Row("gimbal", (), equipment.on_gimbal,
        lambda f: "ready" if f.gimbal is None else "failed"),
    Row("rangefinder", (), equipment.on_rangefinder, _range),
    Row("ground below", (), equipment.on_relief, _relief),
    Row("camera", (), equipment.on_camera, _sight),
    Row("detector", (), equipment.on_detector,
        lambda f: "ready" if f.detector is None else "failed"),
    Row("disk", (), equipment.on_disk, lambda f: f"{f.free_bytes / 1e6:.0f} MB free"),
)
# fmt: on
_ASIDE = ("COM_RC_IN_MODE", *equipment.CLIMBING)  # of rows that can be judged without
PARAMETERS = tuple({name: None for row in TABLE for name in (*row.parameters, *_ASIDE)})
"""All that is asked of the vehicle."""


def judge(facts: Facts, mission: Mission) -> tuple[Finding, ...]:
    """What each row of the table says."""
    return tuple(_judge(row, facts, mission) for row in TABLE)


def against(findings: Sequence[Finding], verdict: Verdict) -> list[Finding]:
    """Those of one verdict."""
    return [finding for finding in findings if finding.judgement.verdict is verdict]


def mending_options(findings: Sequence[Finding]) -> str:
    """The options of `fly` and `preflight` that mend what is not `go`; empty if none do."""
    mends = {name: value for finding in findings for name, value in finding.judgement.mends.items()}
    return " ".join(f"--set {name}={value:g}" for name, value in mends.items())


def _judge(row: Row, facts: Facts, mission: Mission) -> Finding:
    missing = [name for name in row.parameters if name not in facts.parameters]
    if missing:
        what = f"the vehicle has no {' and no '.join(missing)}: what it does then is not known"
        return Finding(name=row.name, value="-", judgement=warn(what))
    unreadable = [name for name in row.parameters if not math.isfinite(facts.parameters[name])]
    if unreadable:
        what = f"{' and '.join(unreadable)} cannot be read over this link, or is no number"
        return Finding(name=row.name, value="?", judgement=no(what))
    values = [f"{name}={facts.parameters[name]:g}" for name in row.parameters]
    value = row.value(facts) if row.value else " ".join(values)
    return Finding(name=row.name, value=value, judgement=row.judge(facts, mission))
