"""Rows on what the vehicle knows, and what it is flown with."""

from __future__ import annotations

import math
from types import MappingProxyType

from dronemon.errors import CameraError
from dronemon.mission import Mission
from dronemon.mission.schema import FOLLOWING_M_S
from dronemon.preflight.findings import HIGH_M, Facts, Judgement, go, no, warn
from dronemon.problem import MEASUREMENT_INTERVAL_AU

_LEAST_SATELLITES, _GOOD_SATELLITES = 6, 8
_GOOD_DILUTION, _WORST_DILUTION = 2.0, 2.5
_RANGED_TILT_DEG = 30.0
CLIMBING = MappingProxyType({"MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 1.5})
"""How fast PX4 climbs and sinks at most, as it comes."""


def on_readiness(facts: Facts, _: Mission) -> Judgement:
    """Whether it can be armed."""
    return go("it can be armed") if facts.unready is None else no(facts.unready)


def on_estimate(facts: Facts, _: Mission) -> Judgement:
    """Whether it knows where it is."""
    if facts.estimate_doubts:
        return no("where it is cannot be trusted; wait, or see what the autopilot says")
    return go("attitude, velocity and position are known")


def on_gps(facts: Facts, _: Mission) -> Judgement:
    """How well satellites place it."""
    gps = facts.gps
    if gps is None:
        return warn("how good its position is, is not known")
    satellites, dilution = gps.num_satellites, gps.dilution
    is_few = satellites is not None and satellites < _LEAST_SATELLITES
    is_blurred = dilution is not None and dilution > _WORST_DILUTION
    if not gps.is_3d or is_few or is_blurred:
        return no(
            f"too poor to fly by: a 3D fix, {_LEAST_SATELLITES} satellites and a dilution of "
            f"{_WORST_DILUTION:g} or less are needed; wait, or go where the sky is open"
        )
    is_few = satellites is not None and satellites < _GOOD_SATELLITES
    is_blurred = dilution is not None and dilution > _GOOD_DILUTION
    return warn("poor: it may be lost on the way") if is_few or is_blurred else go("good")


def on_remote_id(facts: Facts, _: Mission) -> Judgement:
    """Whether its remote ID is ready."""
    if facts.remote_id is None:
        return go("none is heard; see whether the rules ask for one")
    return no(facts.remote_id) if facts.remote_id else go("ready")


def on_gimbal(facts: Facts, mission: Mission) -> Judgement:
    """Whether a camera on a gimbal looks down."""
    if not mission.camera.gimbal:
        return go("none: the camera is fixed to the drone")
    return go("it looks straight down") if facts.gimbal is None else no(facts.gimbal)


def on_rangefinder(facts: Facts, mission: Mission) -> Judgement:
    """Whether the ground is told from as high as the flight will be over it."""
    if not mission.area.rangefinder:
        return go("it is not asked: area.rangefinder is not given")
    if facts.range_limits_m is None:
        return no(
            "pictures are to be laid on the ground that it finds; have the autopilot tell of one "
            "that looks down, twice a second or more, or leave area.rangefinder out"
        )
    relief, altitude_m = facts.relief, mission.flight.altitude_m
    most_m = relief.most_m if relief is not None else altitude_m
    needed_m = most_m / math.cos(math.radians(_RANGED_TILT_DEG))
    if facts.range_limits_m[1] < needed_m:
        return no(
            f"{needed_m:.0f} m are needed, {most_m:.0f} m up and leaning by "
            f"{_RANGED_TILT_DEG:g} degrees; fly lower, or leave area.rangefinder out"
        )
    return go("it tells how far the ground is")


def on_relief(facts: Facts, mission: Mission) -> Judgement:
    """Whether hills stay below the flight, and the camera sees what it must over hill and dale."""
    relief, flight = facts.relief, mission.flight
    if relief is None:
        return go("no hills are known: area.terrain is not given")
    least_m, most_m = relief.least_m, relief.most_m
    if least_m < flight.stand_off_m:
        enough_m = flight.altitude_m - least_m + flight.stand_off_m
        return no(
            f"the highest is {least_m:.0f} m below the flight, not {flight.stand_off_m:g};"
            f" set flight.altitude_m to {enough_m:.0f} or more"
        )
    if flight.ceiling_m is not None and most_m > flight.ceiling_m:
        return no(
            f"the lowest is {most_m:.0f} m below the flight, more than flight.ceiling_m, "
            f"{flight.ceiling_m:g}; fly lower, or slower with follow_terrain, or leave valleys out"
        )
    which = ", which follows it" if flight.follow_terrain else ""
    seen = (
        f"{least_m:.0f} to {most_m:.0f} m below the flight{which}: {relief.px_m / most_m:.1f} to "
        f"{relief.px_m / least_m:.1f} pixels a metre"
    )
    if least_m < relief.needed_m:
        return no(
            f"{seen}; over the highest the camera does not show all that is to be looked at: that "
            f"takes {relief.needed_m:.0f} m; fly higher, or make the sensor radius smaller"
        )
    if relief.px_m / most_m < relief.needed_px_per_m:
        slower = ", or slower, which follows steeper ground," if flight.follow_terrain else ","
        return no(
            f"{seen}; over the lowest the detector does not have the {relief.needed_px_per_m:g} "
            f"that it needs; fly lower{slower} or use a camera with more pixels"
        )
    return _on_following(facts, mission, seen) if flight.follow_terrain else go(seen)


def _on_following(facts: Facts, mission: Mission, seen: str) -> Judgement:
    """Whether the vehicle may climb and sink so fast; and what rules say of valleys."""
    slow = {
        name: speed_m_s
        for name, speed_m_s in CLIMBING.items()
        if not facts.parameters.get(name, speed_m_s) >= FOLLOWING_M_S
    }
    if slow:
        what = f"{seen}; to follow it takes {FOLLOWING_M_S:g} m/s up and down"
        return no(f"{what}, and {' and '.join(slow)} allow less", **slow)
    limit_m = mission.flight.ceiling_m or max(HIGH_M, mission.flight.altitude_m)
    if facts.relief is not None and facts.relief.most_m > limit_m:
        return warn(f"{seen}; over valleys that is more than the {HIGH_M:g} m of most rules")
    return go(seen)


def on_camera(facts: Facts, mission: Mission) -> Judgement:
    """Whether pictures come, and in time."""
    if isinstance(facts.sight, CameraError):
        return no(str(facts.sight))
    interval_s = MEASUREMENT_INTERVAL_AU * mission.area.side_m / mission.flight.cruise_speed_m_s
    what = f"a picture is due every {interval_s:.1f} s"
    is_late = max(facts.sight.wait_s, facts.sight.age_s) > interval_s
    return warn(f"{what}: it comes too late for that") if is_late else go(what)


def on_detector(facts: Facts, _: Mission) -> Judgement:
    """Whether pictures can be read."""
    return go("loaded and tried") if facts.detector is None else no(facts.detector)


def on_disk(facts: Facts, _: Mission) -> Judgement:
    """Whether the record has room."""
    needed = f"a flight needs {facts.needed_bytes / 1e6:.0f} MB"
    return go(needed) if facts.free_bytes >= facts.needed_bytes else no(f"{needed}; free some")
