"""From a YAML file to a `Mission`, or to one error: file, line, key and what is allowed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any

from dronemon.errors import MissionFileError
from dronemon.mission.addresses import is_video_file
from dronemon.mission.checks import mission_problems
from dronemon.mission.document import Document, KeyPath, Overrides, Problem
from dronemon.mission.schema import Mission
from dronemon.problem import is_tracks


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
    path, missions = Path(name), shipped_missions()
    is_path = path.suffix in {".yaml", ".yml"} or path.parent != Path()
    found = path if is_path else missions.get(name)
    if found is None or not found.is_file():
        raise MissionFileError(
            f"{name!r}: no such mission, neither a .yaml file nor shipped; shipped missions are: "
            f"{', '.join(missions)}"
        )
    return found


def shipped_missions() -> dict[str, Path]:
    """Name -> file of the missions that come with the package (or lie in the checkout)."""
    packaged = Path(str(resources.files("dronemon"))) / "data" / "missions"
    folder = packaged if packaged.is_dir() else packaged.parents[2] / "missions"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_mission(
    path: Path,
    overrides: Overrides | None = None,
    more_checks: Callable[[Mission], Iterable[Problem]] = lambda _: (),
) -> MissionFile:
    """Read, validate and check a mission file.

    overrides:   command line options; more_checks: what only the caller can tell is wrong

    Raises MissionFileError that tells all that is wrong.
    """
    document = Document.read(path, "mission file", overrides)
    if ("flight", "horizon_au") in document.options and isinstance(document.data["flight"], dict):
        document.data["flight"].pop("horizon_min", None)
    _anchor_files(document.data, path.parent)
    mission = document.validate(Mission, lambda m: chain(mission_problems(m), more_checks(m)))
    return MissionFile(document=document, mission=mission)


def _anchor_files(data: dict[str, Any], folder: Path) -> None:
    """Have files that a mission names, relative to itself, found from anywhere."""
    for section, key, is_file in (
        ("planner", "checkpoint", lambda name: Path(name).suffix or Path(name).parent != Path()),
        ("camera", "url", is_video_file),
        ("area", "terrain", bool),
        ("area", "file", bool),
        ("camera", "calibration", bool),
        ("detector", "file", bool),
        ("simulation", "motion", is_tracks),
    ):
        given = data.get(section)
        if isinstance(given, dict) and isinstance(name := given.get(key), str) and is_file(name):
            given[key] = str((folder / name).absolute())
