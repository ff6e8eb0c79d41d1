"""What is wrong with a mission though every key is right by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from dronemon.mission.addresses import is_video_file
from dronemon.mission.document import Problem
from dronemon.mission.schema import Mission

_CLIMB_M_S = 1.5  # cautious rates for the estimate of flight time
_DESCENT_M_S = 0.7


def mission_problems(mission: Mission) -> Iterator[Problem]:
    """Each key at fault, and what is wrong."""
    yield from _twins(mission)
    flight = mission.flight
    if flight.speed_limit_m_s < flight.cruise_speed_m_s:
        yield (
            ("flight", "max_speed_m_s"),
            f"{flight.speed_limit_m_s:g} is less than cruise_speed_m_s, "
            f"{flight.cruise_speed_m_s:g}; raise it, or leave it out for cruise and 10 %",
        )
    if problem := battery_problem(mission):
        horizon = "horizon_min" if mission.flight.horizon_min is not None else "horizon_au"
        yield ("flight", horizon), problem
    if is_video_file(mission.camera.url) and not Path(mission.camera.url).is_file():
        yield (
            ("camera", "url"),
            f"{mission.camera.url}: no such file; name a video file (relative to the mission "
            "file), a URL such as rtsp://HOST/PATH, the number of a camera, or `simulated`",
        )


def _twins(mission: Mission) -> Iterator[Problem]:
    for key in ("appearance", "name"):
        first: dict[str, int] = {}
        for index, target in enumerate(mission.targets):
            value = getattr(target, key)
            if value in first:
                yield (
                    ("targets", index, key),
                    f"{value!r} is already the {key} of target {first[value] + 1}; "
                    "targets are told apart by it, so give each its own",
                )
            first.setdefault(value, index)


def outbound_min(mission: Mission, away_m: float = 0.0) -> float:
    """Time in the air until the return begins: climb, the longest way to the start, patrol.

    away_m: distance of the area's centre from home.
    """
    flight = mission.flight
    approach_s = (away_m + mission.area.side_m * 0.71) / flight.cruise_speed_m_s
    return (flight.altitude_m / _CLIMB_M_S + approach_s + mission.patrol_duration_s) / 60.0


def return_min(mission: Mission, away_m: float = 0.0, height_m: float = 0.0) -> float:
    """Time from the farthest corner to home and down to the ground.

    height_m: above home, to which it climbs before it returns
    """
    flight = mission.flight
    way_s = (away_m + mission.area.side_m * 0.71) / flight.cruise_speed_m_s
    highest_m = max(height_m, flight.altitude_m)
    climb_s = (highest_m - flight.altitude_m) / _CLIMB_M_S
    return (climb_s + way_s + highest_m / _DESCENT_M_S) / 60.0


def battery_problem(mission: Mission, away_m: float = 0.0) -> str | None:
    """Say why the battery does not allow the flight, if so."""
    flight = mission.flight
    minutes, limit = outbound_min(mission, away_m), usable_min(mission)
    if minutes > limit:
        return (
            f"take-off, the way to the start and the patrol take {minutes:.1f} min, but the "
            f"battery allows {limit:.1f} min ({flight.endurance_min:g} min endurance less "
            f"{flight.return_battery:.0%} to return); shorten the horizon, the side or the way"
        )
    minutes, limit = return_min(mission, away_m), flight.endurance_min * flight.return_battery
    if minutes > limit:
        return (
            f"the way back from the farthest corner takes {minutes:.1f} min, but at "
            f"{flight.return_battery:.0%} the battery has {limit:.1f} min left; raise "
            "return_battery, or bring home and area nearer to each other"
        )
    return None


def usable_min(mission: Mission) -> float:
    """Flight time until the battery reaches the level at which the drone returns."""
    return mission.flight.endurance_min * (1.0 - mission.flight.return_battery)
