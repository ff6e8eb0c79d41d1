"""What is wrong with a mission though every key is right by itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from dronemon.energy import cost_home
from dronemon.errors import did_you_mean
from dronemon.mission.addresses import is_video_file
from dronemon.mission.detector import KEYS_OF_KIND, DetectorSection
from dronemon.mission.document import Problem
from dronemon.mission.faults import parse_fault
from dronemon.mission.field import field_problems, mission_obstacles, place_problems, reach_m
from dronemon.mission.schema import Mission
from dronemon.types import APPEARANCES

_CLIMB_M_S = 1.5  # cautious, for the estimate of flight time
_LEAST_PATROL_MIN = 1.0  # of each battery of a relay
_IN_SIGHT = 0.9
"""Share of the sensor radius from which targets that are kept off are still seen."""
_AS_IT_COMES: Mapping[str, float] = MappingProxyType({})


def mission_problems(mission: Mission) -> Iterator[Problem]:
    """Each key at fault, and what is wrong."""
    yield from _twins(mission)
    yield from _detector_problems(mission)
    flawed = [*field_problems(mission)]
    yield from flawed or place_problems(mission)
    yield from _keep_off_problems(mission)
    flight = mission.flight
    if flight.speed_limit_m_s < flight.cruise_speed_m_s:
        yield (
            ("flight", "max_speed_m_s"),
            f"{flight.speed_limit_m_s:g} is less than cruise_speed_m_s, "
            f"{flight.cruise_speed_m_s:g}; raise it, or leave it out for cruise and 10 %",
        )
    if flight.ceiling_m is not None and flight.altitude_m > flight.ceiling_m:
        yield ("flight", "altitude_m"), f"{flight.altitude_m:g} m is above flight.ceiling_m"
    if flight.follow_terrain and mission.area.terrain is None:
        what = "needs area.terrain, a file of the ground's heights; name it, or leave this out"
        yield ("flight", "follow_terrain"), what
    if not flawed and mission.area.rangefinder and mission_obstacles(mission):
        what = "knows nothing of what stands there; leave height_m out of the zones, or this out"
        yield ("area", "rangefinder"), what
    if not flawed and (problem := battery_problem(mission)):
        horizon = "horizon_min" if flight.horizon_min is not None else "horizon_au"
        yield ("flight", horizon if flight.relay is None else "endurance_min"), problem
    is_swapped = any(parse_fault(fault).kind == "swap" for fault in mission.simulation.faults)
    if flight.relay == "automatic" and mission.vehicle.is_mock and not is_swapped:
        yield (
            ("flight", "relay"),
            "nothing would change the mock's battery; add swap=60 to simulation.faults",
        )
    if is_video_file(mission.camera.url) and not Path(mission.camera.url).is_file():
        yield (
            ("camera", "url"),
            f"{mission.camera.url}: no such file; name a video file (relative to the mission "
            "file), a URL such as rtsp://HOST/PATH, the number of a camera, or `simulated`",
        )


def _twins(mission: Mission) -> Iterator[Problem]:
    first: dict[str, int] = {}
    for target in mission.targets:
        if target.name in first:
            yield (
                ("targets", target.entry, "name"),
                f"{target.name!r} is already the name of target {first[target.name] + 1}; "
                "targets are told apart by it, so give each its own",
            )
        first.setdefault(target.name, target.entry)


def _keep_off_problems(mission: Mission) -> Iterator[Problem]:
    """Targets that a drone which keeps so far off would never see; an entry once."""
    flight, sees_m = mission.flight, mission.sensor_radius_m
    most_m = _IN_SIGHT * sees_m - flight.clearance_m
    for entry, distance_m in {
        mission.targets[n].entry: distance_m for n, distance_m in mission.kept_off_m.items()
    }.items():
        if distance_m > most_m:
            less = f"keep {most_m:.1f} m or less off, " if most_m >= 1.0 else ""
            yield (
                ("targets", entry, "keep_off", "distance_m"),
                f"{distance_m:g} m, and {flight.clearance_m:.1f} m that a drone of "
                f"{flight.cruise_speed_m_s:g} m/s keeps for cutting corners, are too much to see "
                f"it: the sensor radius is {sees_m:g} m; {less}fly slower, or make "
                f"area.{mission.area.size[0]} larger",
            )


def _detector_problems(mission: Mission) -> Iterator[Problem]:
    """Keys of another kind of detector, and appearances that this one cannot know."""
    detector = mission.detector
    for kind, keys in KEYS_OF_KIND.items():
        for key in keys if kind != detector.kind else ():
            if getattr(detector, key) != DetectorSection.model_fields[key].default:
                yield ("detector", key), f"is for kind {kind}, but kind is {detector.kind!r}"
    if detector.kind == "onnx" and detector.file is None:
        yield ("detector", "file"), "is missing; name the network's ONNX file"
    looks = [target.appearance for target in mission.targets]
    if detector.kind == "blobs" and len(set(looks)) > 1:
        yield ("detector", "kind"), "blobs look alike, so all targets have the same appearance"
    if detector.kind == "markers" and len(set(looks)) < len(looks):
        yield ("targets",), "several have the same marker; give each its own number"
    if detector.kind == "blobs" and not (
        detector.hue_deg or detector.saturation or detector.brightness
    ):
        yield ("detector", "kind"), "anything is a blob; give hue_deg, saturation or brightness"
    for look in detector.confusion:
        if look not in looks:
            yield (
                ("detector", "confusion", look),
                f"no target looks like that; {did_you_mean(look, looks)}leave it out",
            )
    others = {other for taken in detector.confusion.values() for other in taken}
    if detector.kind == "drawn" and (strange := sorted(others - set(APPEARANCES))):
        yield ("detector", "confusion"), f"kind drawn finds no {strange[0]!r}"
    if detector.kind == "markers" and (detector.side_m or 0.0) > mission.sensor_radius_m:
        yield (
            ("detector", "side_m"),
            f"{detector.side_m:g} m is more than the sensor's radius of "
            f"{mission.sensor_radius_m:g} m: such a marker is never wholly in view",
        )
    if detector.kind == "drawn":
        yield from strangers(mission, "kind drawn knows")


def strangers(mission: Mission, who: str) -> Iterator[Problem]:
    """Targets that look like nothing that the simulator draws. who: cannot know them"""
    for target in mission.targets:
        if (name := target.appearance) not in APPEARANCES:
            yield (
                ("targets", target.entry, "appearance"),
                f"{name!r} is none of what {who}; {did_you_mean(name, APPEARANCES)}"
                f"there are: {', '.join(APPEARANCES)}",
            )


def _reach_m(mission: Mission, away_m: float) -> float:
    """Distance of the farthest corner from home, whose distance from the centre is `away_m`."""
    return away_m + reach_m(mission)


def outbound_min(mission: Mission, away_m: float = 0.0) -> float:
    """Time in the air until the return begins: climb, the longest way to the start, patrol.

    away_m: distance of the area's centre from home.
    """
    flight = mission.flight
    approach_s = _reach_m(mission, away_m) / flight.cruise_speed_m_s
    return (flight.altitude_m / _CLIMB_M_S + approach_s + mission.patrol_duration_s) / 60.0


def return_min(
    mission: Mission,
    away_m: float = 0.0,
    parameters: Mapping[str, float] = _AS_IT_COMES,
    top_m: float | None = None,
) -> float:
    """Time from the farthest corner to home and down to the ground.

    parameters: the vehicle's energy.RETURN_PARAMETERS
    top_m:      above home, where it begins; the patrol's altitude unless it is given
    """
    legs_m = [(_reach_m(mission, away_m), 0.0)]
    height_m = mission.flight.altitude_m if top_m is None else top_m
    return cost_home(legs_m, height_m, parameters).time_s / 60.0


def battery_problem(
    mission: Mission,
    away_m: float = 0.0,
    parameters: Mapping[str, float] = _AS_IT_COMES,
    top_m: float | None = None,
) -> str | None:
    """Say why the battery does not allow the flight, if so. See return_min."""
    flight, limit = mission.flight, usable_min(mission)
    minutes = outbound_min(mission, away_m) + return_min(mission, away_m, parameters, top_m)
    what = "take-off, the way to the start, the patrol and the way home take"
    mend = "shorten the horizon, the side or the way, or fly on with fresh batteries: flight.relay"
    if flight.relay is not None:
        minutes -= max(0.0, mission.patrol_duration_s / 60.0 - _LEAST_PATROL_MIN)
        what = "take-off, the way to the area, a minute of patrol and the way home take"
        mend = "shorten the side or the way"
    if minutes <= limit:
        return None
    return (
        f"{what} {minutes:.1f} min, but "
        f"the battery allows {limit:.1f} min ({flight.endurance_min:g} min endurance less "
        f"{flight.reserve_battery:.0%} to land with); {mend}"
    )


def usable_min(mission: Mission) -> float:
    """Flight time until the battery reaches the level to land with."""
    return mission.flight.endurance_min * (1.0 - mission.flight.reserve_battery)
