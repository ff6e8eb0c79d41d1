"""From a YAML file to a `Mission`, or to one error: file, line, key and what is allowed."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from dronemon.errors import MissionFileError
from dronemon.mission.schema import Mission

KeyPath = tuple[str | int, ...]
Overrides = Mapping[tuple[str, str], tuple[str, object]]
_MAX_BYTES = 1_000_000
_CLIMB_M_S = 1.5  # cautious rates for the estimate of flight time
_DESCENT_M_S = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFile:
    """A valid mission and the text it came from, so that later checks can still name the line."""

    path: Path
    text: str
    mission: Mission

    def error(self, key_path: KeyPath, message: str) -> MissionFileError:
        """An error about one key of this file."""
        return _error(self.path, yaml.compose(self.text, yaml.SafeLoader), key_path, message)


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
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise MissionFileError(f"{path}: larger than {_MAX_BYTES} bytes; is it a mission file?")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise MissionFileError(f"{path}: cannot be read: {exc}") from exc
    try:
        _refuse_aliases(path, text)
        root = yaml.compose(text, yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.MarkedYAMLError as exc:
        line = exc.problem_mark.line + 1 if exc.problem_mark else 1
        raise MissionFileError(f"{path}:{line}: not valid YAML: {exc.problem}") from exc
    except (yaml.YAMLError, ValueError) as exc:
        raise MissionFileError(f"{path}: not valid YAML: {exc}") from exc
    except RecursionError as exc:
        raise MissionFileError(f"{path}: not valid YAML: nested too deeply") from exc
    if not isinstance(data, dict):
        raise MissionFileError(
            f"{path}:1: a mission file is a mapping of sections, such as `area:`"
        )
    if root is not None:
        _refuse_duplicates(path, root)
    for (section, key), (_, value) in overrides.items():
        given = data.setdefault(section, {})
        if isinstance(given, dict):
            given[key] = value
            if key == "horizon_au":
                given.pop("horizon_min", None)
    try:
        mission = Mission.model_validate(data)
    except ValidationError as exc:
        problems = exc.errors(include_url=False)
        # A misspelt key is also a missing one: the misspelling is the story.
        first = min(problems, key=lambda problem: problem["type"] != "extra_forbidden")
        for key_path, (option, _) in overrides.items():
            if first["loc"][:2] == key_path:
                raise MissionFileError(f"{option}: {_explain(dict(first))}") from exc
        raise _error(path, root, first["loc"], _explain(dict(first))) from exc
    loaded = MissionFile(path=path, text=text, mission=mission)
    _check(loaded)
    return loaded


def _refuse_aliases(path: Path, text: str) -> None:
    """A mission needs none, and a few lines of them can stand for more than fits into memory."""
    for event in yaml.parse(text, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise MissionFileError(f"{path}:{line}: *{event.anchor}: aliases are not allowed")


def _refuse_duplicates(path: Path, node: yaml.Node) -> None:
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if key.value in seen:
                raise MissionFileError(
                    f"{path}:{key.start_mark.line + 1}: {key.value}: given twice; remove one"
                )
            seen.add(key.value)
            _refuse_duplicates(path, value)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_duplicates(path, item)


def _error(path: Path, root: yaml.Node | None, key_path: KeyPath, message: str) -> MissionFileError:
    keys, line = [], 1
    node = root
    for key in key_path:
        found = _child(node, key)
        if found is None:
            # Not in the file; a union's branch, such as tuple[...], is in the path but is no key.
            if isinstance(key, str) and key.isidentifier():
                keys.append(key)
            node = None
            continue
        keys.append(f"[{key}]" if isinstance(key, int) else key)
        line, node = found
    name = ".".join(str(key) for key in keys).replace(".[", "[") or "mission"
    return MissionFileError(f"{path}:{line}: {name}: {message}")


def _child(node: yaml.Node | None, key: str | int) -> tuple[int, yaml.Node] | None:
    if isinstance(node, yaml.MappingNode):
        for key_node, value in node.value:
            if key_node.value == key:
                return key_node.start_mark.line + 1, value
    if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
        return node.value[key].start_mark.line + 1, node.value[key]
    return None


def _explain(error: dict[str, Any]) -> str:
    kind, message, given = error["type"], str(error["msg"]), error["input"]
    if kind == "extra_forbidden":
        return _explain_unknown(error["loc"])
    if kind == "missing":
        return "is missing; add it"
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    text = f"{message[0].lower()}{message[1:]}, but is {given!r}"
    if kind in {"float_type", "float_parsing", "int_type", "int_parsing"}:
        text += "; write a bare number, its unit is the end of the key"
    return text


def _explain_unknown(key_path: KeyPath) -> str:
    """Name the keys allowed beside an unknown one, and the nearest of them."""
    model: Any = Mission
    for key in key_path[:-1]:
        if isinstance(key, str):
            model = _model_of(model.model_fields[key].annotation)
    allowed = list(model.model_fields)
    near = difflib.get_close_matches(str(key_path[-1]), allowed, n=1, cutoff=0.4)
    hint = f"; did you mean `{near[0]}`?" if near else ""
    return f"no such key{hint} (allowed here: {', '.join(allowed)})"


def _model_of(annotation: Any) -> Any:
    """The section model inside an annotation such as tuple[Target, ...]."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation
    inner = typing.get_args(annotation)
    return next(a for a in inner if isinstance(a, type) and issubclass(a, BaseModel))


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
