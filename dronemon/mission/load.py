"""From a YAML file to a `Mission`, or to one error: file, line, key and what is allowed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from pydantic import ValidationError

from dronemon.errors import MissionFileError
from dronemon.mission.document import Document, KeyPath, problems
from dronemon.mission.schema import Mission

Overrides = Mapping[tuple[str, str], tuple[str, object]]
_CLIMB_M_S = 1.5  # cautious rates for the estimate of flight time
_DESCENT_M_S = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFile:
    """A valid mission and the file it came from, so that later checks can still name the line."""

    document: Document
    mission: Mission

    @property
    def path(self) -> Path:
        """Where it came from."""
        return self.document.path

    def error(self, key_path: KeyPath, message: str) -> MissionFileError:
        """An error about one key of this file."""
        return self.document.error(key_path, message)


def find_mission(name: str) -> Path:
    """The mission file of a path, or of the name of a shipped mission ('animals').

    Raises MissionFileError if there is none.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} or path.parent != Path():
        if path.is_file():
            return path
        raise MissionFileError(
            f"{path}: no such mission file; shipped missions are: {', '.join(shipped_missions())}"
        )
    missions = shipped_missions()
    if name in missions:
        return missions[name]
    raise MissionFileError(
        f"{name}: no shipped mission has this name; there are: {', '.join(missions)} "
        "(or give the path of a .yaml file)"
    )


def shipped_missions() -> dict[str, Path]:
    """Name -> file of the missions that come with the package (or lie in the checkout)."""
    packaged = Path(str(resources.files("dronemon"))) / "data" / "missions"
    folder = packaged if packaged.is_dir() else packaged.parents[2] / "missions"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_mission(path: Path, overrides: Overrides | None = None) -> MissionFile:
    """Read, validate and check a mission file.

    overrides: (section, key) -> name and value of a command line option, taken as if it stood in
    the file. Raises MissionFileError.
    """
    overrides = overrides or {}
    document = Document.read(path, "mission file")
    for (section, key), (_, value) in overrides.items():
        given = document.data.setdefault(section, {})
        if isinstance(given, dict):
            given[key] = value
            if key == "horizon_au":
                given.pop("horizon_min", None)
    try:
        mission = Mission.model_validate(document.data)
    except ValidationError as exc:
        loc, message = next(problems(Mission, exc))
        for key_path, (option, _) in overrides.items():
            if loc[:2] == key_path:
                raise MissionFileError(f"{option}: {message}") from exc
        raise document.error(loc, message) from exc
    loaded = MissionFile(document=document, mission=mission)
    _check(loaded)
    return loaded


def _check(file: MissionFile) -> None:
    """What no single key can say. Raises MissionFileError."""
    mission = file.mission
    for key in ("appearance", "name"):
        first: dict[str, int] = {}
        for index, target in enumerate(mission.targets):
            value = getattr(target, key)
            if value in first:
                raise file.error(
                    ("targets", index, key),
                    f"{value!r} is already the {key} of target {first[value] + 1}; "
                    "targets are told apart by it, so give each its own",
                )
            first[value] = index
    needed_m = mission.needed_altitude_m
    if mission.flight.altitude_m < needed_m:
        raise file.error(
            ("flight", "altitude_m"),
            f"{mission.flight.altitude_m:g} m is too low: the camera must see "
            f"{mission.sensor_radius_m:g} m around the drone (0.1 of the area's side), which takes "
            f"{needed_m:.1f} m at its angle of view; fly higher or make the area smaller",
        )
    if problem := battery_problem(mission):
        horizon = "horizon_min" if mission.flight.horizon_min is not None else "horizon_au"
        raise file.error(("flight", horizon), problem)


def outbound_min(mission: Mission, away_m: float = 0.0) -> float:
    """Time in the air until the return begins: climb, the longest way to the start, patrol.

    away_m: distance of the area's centre from home.
    """
    flight = mission.flight
    approach_s = (away_m + mission.area.side_m * 0.71) / flight.cruise_speed_m_s
    return (flight.altitude_m / _CLIMB_M_S + approach_s + mission.patrol_duration_s) / 60.0


def return_min(mission: Mission, away_m: float = 0.0) -> float:
    """Time from the farthest corner to home and down to the ground."""
    flight = mission.flight
    way_s = (away_m + mission.area.side_m * 0.71) / flight.cruise_speed_m_s
    return (way_s + flight.altitude_m / _DESCENT_M_S) / 60.0


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
