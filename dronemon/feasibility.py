"""What a mission asks of simulator, detector and planner, judged before anything is started."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from itertools import groupby

from dronemon.card import find_checkpoint, read_card
from dronemon.errors import CameraError, MissionFileError, OptionError, PolicyError
from dronemon.mission import (
    Mission,
    MissionFile,
    field_centre,
    find_mission,
    load_mission,
    mission_arena,
    mission_obstacles,
)
from dronemon.mission.addresses import parse_udpin
from dronemon.mission.checks import outbound_min, return_min, strangers, usable_min
from dronemon.mission.document import Overrides, Problem
from dronemon.mission.field import field_problems, flown_over
from dronemon.mission.schema import Planner as PlannerSection
from dronemon.planner import Clairvoyant, Planner, create_planner, has_weights, planner_names
from dronemon.planner.registry import is_bound
from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.vision.view import needed_altitude_m, needed_px_per_m, px_per_m, tilt_rad
from dronemon.world.motions import motion_flaw


def load_checked(name: str, overrides: Overrides, follow: str | None) -> MissionFile:
    """A mission that can be flown as it stands.

    name:   of its file, or of a shipped mission
    follow: second MAVLink URL of a real vehicle, for simulated animals and camera to follow it

    Raises MissionFileError that tells all that is wrong.
    """

    def problems(mission: Mission) -> Iterator[Problem]:
        yield from _simulator_problems(mission, follow)
        yield from _sight_problems(mission)
        yield from _planner_problems(mission)
        yield from _lens_problems(mission)
        yield from _terrain_problems(mission)
        yield from _detector_problems(mission)

    told = []
    try:
        if follow is not None:
            parse_udpin(follow)
    except ValueError as exc:
        told.append(f"--follow: {exc}")
    try:
        file = load_mission(find_mission(name), overrides, problems)
    except MissionFileError as exc:
        told.append(str(exc))
    if told:
        raise MissionFileError("\n".join(told))
    return file


@cache
def make_planner(of: PlannerSection) -> Planner:
    """The planner of a flight, one a process. Raises OptionError or PolicyError."""
    planner = (
        None
        if is_bound(of.kind)
        else create_planner(of.kind, checkpoint=of.checkpoint, history=of.history)
    )
    if planner is None or isinstance(planner, Clairvoyant):
        raise OptionError(
            f"{of.kind!r} must be told the future: it is a bound for `dronemon evaluate`, not a "
            "planner to fly"
        )
    return planner


def doubts(mission: Mission, follow: str | None) -> list[str]:
    """What of a mission its planner was not trained for, a sentence each."""
    if not has_weights(mission.planner.kind):
        return []
    scope = read_card(find_checkpoint(mission.planner.checkpoint)).scope
    if scope is None:
        return ["the checkpoint does not say what it was trained for"]
    is_simulated = mission.vehicle.is_mock or follow is not None
    return scope.outside(
        num_targets=len(mission.targets),
        num_nodes=mission.roadmap.num_nodes,
        speed_ratio=mission.simulation.speed_ratio if is_simulated else None,
        unplaced=[target.name for target in mission.targets if target.prior_au is None],
    )


def _area_fact(m: Mission) -> str:
    arena, au_m = mission_arena(m), m.area.side_m
    turned = f"heading {m.area.heading_deg:g} degrees"
    if (centre := field_centre(m.area)) is not None:
        turned += f", around {centre.latitude_deg:.5f}, {centre.longitude_deg:.5f}"
    if arena.is_rectangle:
        return f"{au_m:g} m side, {turned}"
    width_m, height_m = au_m * arena.extent_au
    return (
        f"{1e-4 * au_m**2 * arena.field.area_au2:.1f} ha in {width_m:.0f} m by {height_m:.0f} m,"
        f" {turned}; {len(arena.no_fly_au)} no-fly zones{_flown_over(m)}{_hiding(m)}. The drone"
        f" keeps {m.flight.clearance_m:.0f} m from them and the border:"
        f" {arena.free.area_au2 / arena.field.area_au2:.0%} is left to fly in"
    )


def _flown_over(m: Mission) -> str:
    names = flown_over(m)
    return f", and {len(names)} that it flies over ({', '.join(names[:5])})" if names else ""


def _hiding(m: Mission) -> str:
    heights_m = [obstacle.height_m for obstacle in mission_obstacles(m)]
    if not heights_m:
        return ""
    count = f"{len(heights_m)} zone{'s' * (len(heights_m) > 1)}"
    up_m = f"up to {max(heights_m):g} m"
    return f"; what stands in {count}, {up_m} high, hides the ground behind it"


def flight_facts(m: Mission) -> dict[str, str]:
    """What would be flown, in words."""
    # Mean distance to one of the k nearest of V random places.
    leg_au = 2.0 / 3.0 * math.sqrt(m.roadmap.num_neighbours / (math.pi * m.roadmap.num_nodes))
    return {
        "targets": ", ".join(_targets_fact(m)),
        "area": _area_fact(m),
        "ground": _ground_fact(m),
        "altitude": f"{m.flight.altitude_m:g} m{_above(m)}; the sensor radius of "
        f"{m.sensor_radius_m:g} m needs {needed_altitude_m(m):.1f} m, "
        f"{'its gimbal off by' if m.camera.gimbal else 'banked'} "
        f"{math.degrees(tilt_rad(m)):.0f} degrees",
        "camera": _camera_fact(m),
        "detail": f"{px_per_m(m):.1f} pixels a metre; the detector needs {_needed_fact(m)}",
        "patrol": f"{m.horizon_au:g} au = {m.horizon_au * m.area.side_m:.0f} m at "
        f"{m.flight.cruise_speed_m_s:g} m/s = {m.patrol_duration_s / 60:.1f} min",
        "pictures": f"{m.num_pictures}, one every {MEASUREMENT_INTERVAL_AU * m.area.side_m:g} m",
        "roadmap": f"{m.roadmap.num_nodes} nodes; about "
        f"{m.horizon_au / leg_au:.0f} decisions of a planner that keeps to it",
        "battery": f"{outbound_min(m):.1f} min until the return, {return_min(m):.1f} min home, of "
        f"{usable_min(m):.1f} min usable ({m.flight.endurance_min:g} min, landing with "
        f"{m.flight.reserve_battery:.0%})",
        "relay": _relay_fact(m),
        "planner": m.planner.kind,
        "vehicle": m.vehicle.url,
    }


def _above(m: Mission) -> str:
    if not m.flight.follow_terrain:
        return ""
    return (
        f" or more above the ground, which it follows up and down slopes of {m.flight.steepest:.0%}"
    )


def _ground_fact(m: Mission) -> str:
    ranged = "; pictures are laid on what the rangefinder finds" if m.area.rangefinder else ""
    if m.area.terrain is None:
        return f"taken for flat{ranged}"
    from dronemon.runner.relief import describe_relief

    return describe_relief(m) + ranged


def _camera_fact(m: Mission) -> str:
    camera = m.camera
    where = "on a gimbal, which it is told to look down" if camera.gimbal else "fixed to the drone"
    mounted = f", turned on it by {list(camera.mount_deg)} degrees" if any(camera.mount_deg) else ""
    return f"{where}{mounted}"


def _targets_fact(m: Mission) -> Iterator[str]:
    """Each entry of the file: who, and how the detector knows it."""
    for _, group in groupby(m.targets, key=lambda target: target.entry):
        first, *rest = group
        names = f"{first.name} to {rest[-1].name}" if rest else first.name
        distance_m = m.kept_off_m.get(m.targets.index(first))
        kept = f", kept {distance_m:g} m off" if distance_m else ""
        if first.keep_off and not distance_m:
            kept = f", flown over: kept off below {first.keep_off.below_m:g} m only"
        yield f"{names} ({first.appearance}{kept})"


def _relay_fact(m: Mission) -> str:
    if m.flight.relay is None:
        return "none: one battery, one flight"
    patrol_min = m.patrol_duration_s / 60.0
    each_min = usable_min(m) - return_min(m) - outbound_min(m) + patrol_min
    return f"{m.flight.relay}, about {math.ceil(patrol_min / each_min)} batteries"


def _needed_fact(mission: Mission) -> str:
    needed_px = needed_px_per_m(mission)
    return "some: say it in detector.needed_px_per_m" if needed_px is None else f"{needed_px:.1f}"


def _simulator_problems(mission: Mission, follow: str | None) -> Iterator[Problem]:
    """What only a simulator could give, and what one beside the vehicle cannot share with it."""
    url = mission.vehicle.url
    if follow is not None and mission.vehicle.is_mock:
        yield (
            ("vehicle", "url"),
            "is the mock, which has its own animals; --follow goes with --vehicle URL",
        )
    elif follow == url:
        yield ("vehicle", "url"), f"{url} is --follow's too; have the vehicle stream to two ports"
    if follow is not None and mission.camera.gimbal and mission.camera.is_simulated:
        yield (
            ("camera", "gimbal"),
            "is of a real camera or of the mock's: the simulated one that follows a vehicle is "
            "fixed to it; leave it out",
        )
    if mission.camera.is_simulated:
        yield from _drawing_problems(mission)
    if mission.vehicle.is_mock or follow is not None:
        motion, count = mission.simulation.motion, len(mission.targets)
        if any(field_problems(mission)):  # they are told already
            return
        if flaw := motion_flaw(motion, count, mission_arena(mission)):
            yield ("simulation", "motion"), flaw
        return
    if mission.camera.is_simulated:
        yield (
            ("camera", "url"),
            "is `simulated`, but a vehicle at a URL has no simulator beside it; name its "
            "camera, or let simulated animals follow it with --follow URL",
        )
    for target in mission.targets:
        if target.prior_au == "simulated":
            yield (
                ("targets", target.entry, "prior_au"),
                "is `simulated`, but there is no simulator; give [x, y] or leave it out",
            )


def _drawing_problems(mission: Mission) -> Iterator[Problem]:
    """What the simulator cannot draw."""
    detector = mission.detector
    if detector.kind not in ("drawn", "markers"):
        yield from strangers(mission, "the simulator draws (a real camera is named as camera.url)")
    if detector.kind == "markers" and detector.side_m is None:
        yield (
            ("detector", "side_m"),
            "is missing; give the side of the markers' black square, in m, for the simulator",
        )


def _sight_problems(mission: Mission) -> Iterator[Problem]:
    """Whether the camera sees the whole footprint from the patrol's height, and targets in it."""
    needed_px = needed_px_per_m(mission)
    highest_m = math.inf if needed_px is None else mission.camera.model.focal_px / needed_px
    (key, size_m), altitude_m = mission.area.size, mission.flight.altitude_m
    needed_m, (tilt, or_lower) = needed_altitude_m(mission), _tilting(mission)
    least_m, most_m = _to_tenth(math.ceil, needed_m), _to_tenth(math.floor, highest_m)
    smaller_m = _to_tenth(math.floor, size_m * (most_m - 0.1) / needed_m)
    better = "or use a camera with more pixels"
    if mission.detector.kind == "markers":
        better += " or larger markers"
    if needed_m == math.inf:
        yield (
            ("flight", "altitude_m"),
            f"no height will do: the camera cannot see what is below the drone {tilt}; "
            f"use a camera with a wider view{or_lower}",
        )
    elif highest_m < needed_m or (altitude_m > highest_m and most_m < least_m):
        yield (
            ("area", key),
            f"{size_m:g} m is too large for the camera: its footprint of "
            f"{mission.sensor_radius_m:g} m takes {least_m:.1f} m of height, but "
            f"above {most_m:.1f} m a metre is less than the {needed_px:.1f} pixels that "
            f"the detector needs; make it {smaller_m:.1f} m or less, {better}{or_lower}",
        )
    elif altitude_m < needed_m:
        yield (
            ("flight", "altitude_m"),
            f"{altitude_m:g} m is too low: the camera must see {mission.sensor_radius_m:g} m "
            f"around the drone (0.1 au) {tilt}, which takes {least_m:.1f} m at its angle "
            f"of view; fly higher, or make area.{key} smaller{or_lower}",
        )
    elif altitude_m > highest_m:
        yield (
            ("flight", "altitude_m"),
            f"{altitude_m:g} m is too high: a metre on the ground is {px_per_m(mission):.1f} "
            f"pixels of this camera, and the detector needs {needed_px:.1f} to know a "
            f"target; fly at {least_m:.1f} to {most_m:.1f} m, {better}",
        )


def _tilting(mission: Mission) -> tuple[str, str]:
    """How the camera tilts, and what else could be made less for that."""
    tilt_deg = math.degrees(tilt_rad(mission))
    if mission.camera.gimbal:
        return f"with its gimbal off by {tilt_deg:.1f} degrees", ""
    tilt = f"while it banks {tilt_deg:.1f} degrees to accelerate"
    return tilt, f", or lower {mission.flight.what_banks}"


def _to_tenth(rounded: Callable[[float], int], length_m: float) -> float:
    """A length to a tenth, so that what is advised is not refused for its last digit."""
    return rounded(10.0 * length_m) / 10.0 if length_m < math.inf else length_m


def _lens_problems(mission: Mission) -> Iterator[Problem]:
    """Whether the lens is known, and shows what is to be looked at."""
    camera = mission.camera
    if camera.calibration is None and not any(camera.mount_deg):
        return
    from dronemon.vision.lens import Rectifier

    try:
        rectifier = Rectifier.of_mission(mission)
    except CameraError as exc:
        yield ("camera", "calibration"), str(exc)
        return
    if rectifier is None:
        return
    needed_px = needed_px_per_m(mission) or 0.0
    if (shown_px := rectifier.focal_px / mission.flight.altitude_m) < needed_px:
        yield (
            ("camera", "calibration"),
            f"this lens shows {shown_px:.1f} pixels a metre from {mission.flight.altitude_m:g} m, "
            f"and the detector needs {needed_px:g}; fly lower",
        )
    if not rectifier.sees_circle():
        yield (
            ("camera", "horizontal_fov_deg"),
            f"{camera.horizontal_fov_deg:g}: this lens, mounted so, does not show all that is to "
            "be looked at, a circle about the point below the drone; make the angle smaller, or "
            "see that calibration and mount_deg are right",
        )


def _terrain_problems(mission: Mission) -> Iterator[Problem]:
    """Whether the ground's heights can be read, and are those of the area, if it is known where.

    Whether they are of the take-off and the ways there, too, preflight sees.
    """
    if mission.area.terrain is None or any(field_problems(mission)):  # they are told already
        return
    from dronemon.runner.relief import describe_relief

    try:
        describe_relief(mission)
    except MissionFileError as exc:
        yield ("area", "terrain"), str(exc)


def _detector_problems(mission: Mission) -> Iterator[Problem]:
    """Whether the detector can be made; the simulator's, which is slow to import, always can."""
    of = mission.detector
    if of.kind == "drawn" or (of.kind == "onnx" and of.file is None):
        return
    from dronemon.vision.registry import make_detector

    try:
        make_detector(mission)
    except OptionError as exc:
        yield ("detector",), str(exc)


def _planner_problems(mission: Mission) -> Iterator[Problem]:
    """Whether the planner can be made; ours, which are slow to import, can if their weights can."""
    of = mission.planner
    if has_weights(of.kind) and not mission.area.is_square:
        yield (
            ("planner", "kind"),
            f"{of.kind!r} learned on a square, and cannot fly another field; take search",
        )
    is_plain = of.checkpoint is None and of.history is None and of.kind in planner_names()
    try:
        if has_weights(of.kind):
            read_card(find_checkpoint(of.checkpoint))
        elif is_bound(of.kind) or not is_plain:
            make_planner(of)
    except OptionError as exc:
        yield ("planner", "kind"), str(exc)
    except PolicyError as exc:
        yield ("planner", "checkpoint"), str(exc)
