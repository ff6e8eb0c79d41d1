"""Whether a vehicle is ready for take-off: what it must have said, and how well it is heard."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from dronemon.frames import GeoPoint, geo_to_ned
from dronemon.vehicle.link import VehicleState
from dronemon.vehicle.telemetry import Telemetry

_WINDOW_S = 3.0
_LEAST_POSES_HZ = 5.0
_LONGEST_GAP_S = 1.0
_LONGEST_ROUND_TRIP_S = 1.0
_FURTHEST_M = 10_000.0
_NO_NAME = (
    "its board does not say its own number (AUTOPILOT_VERSION, uid2 or uid), by which is kept what "
    "a flight changes on it: give it firmware that does, such as PX4 v1.17's"
)


def problems(telemetry: Telemetry, round_trips_s: Sequence[float]) -> list[str]:
    """What is against a take-off; empty when the vehicle is ready.

    round_trips_s: wall time from a question to its answer, as often as it was measured.
    """
    state = telemetry.state
    checks = {
        "arming checks not passed": state.is_armable or state.is_armed,
        "no good absolute position (GPS?)": state.is_position_good,
        _NO_NAME: state.hardware is not None,
    }
    return [
        *(problem for problem, is_passed in checks.items() if not is_passed),
        *_place_problems(state),
        *_pose_problems(telemetry),
        *_delay_problems(round_trips_s),
    ]


def _place_problems(state: VehicleState) -> list[str]:
    """Home and origin must be known, and near the vehicle."""
    place = state.place
    if place is None or not _is_somewhere(place):
        return ["no global position"]
    found = []
    for name, point in (("home position", state.home), ("origin of the local frame", state.origin)):
        if point is None:
            found.append(f"no {name}")
        elif not _is_somewhere(point):
            found.append(f"the {name} is at latitude 0, longitude 0: not yet set")
        elif (away_m := math.hypot(*geo_to_ned(point, place)[:2])) > _FURTHEST_M:
            found.append(f"the {name} is {away_m / 1000.0:.0f} km away from the vehicle")
    return found


def _is_somewhere(place: GeoPoint) -> bool:
    return (place.latitude_deg, place.longitude_deg) != (0.0, 0.0)


def _pose_problems(telemetry: Telemetry) -> list[str]:
    """Setpoints follow the poses, so these must come often and without gaps."""
    if telemetry.pose is None:
        return ["no local position with attitude"]
    start_s = telemetry.time_s - _WINDOW_S
    times_s = telemetry.pose_times_s()
    recent_s = [time_s for time_s in times_s if time_s > start_s]
    if times_s[0] > start_s:
        return ["poses not heard for long enough"]
    rate_hz = len(recent_s) / _WINDOW_S
    gap_s = max(b - a for a, b in zip([start_s, *recent_s], recent_s, strict=False))
    if rate_hz >= _LEAST_POSES_HZ and gap_s <= _LONGEST_GAP_S:
        return []
    return [
        f"poses come at {rate_hz:.1f} Hz with gaps of up to {gap_s:.1f} s, {_LEAST_POSES_HZ:g} Hz "
        f"and {_LONGEST_GAP_S:g} s are needed: have it stream ATTITUDE and LOCAL_POSITION_NED at "
        "10 Hz or more on this link"
    ]


def _delay_problems(round_trips_s: Sequence[float]) -> list[str]:
    if not round_trips_s:
        return ["no answer to a ping"]
    if (delay_s := statistics.median(round_trips_s)) <= _LONGEST_ROUND_TRIP_S:
        return []
    return [
        f"an answer takes {delay_s:.1f} s, {_LONGEST_ROUND_TRIP_S:g} s is the limit: a setpoint "
        "would come too late; use a faster link"
    ]
