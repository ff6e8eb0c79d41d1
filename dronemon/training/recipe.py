"""Recipes: YAML files that say what network learns in which way.

learner: expert           # or ppo
network: {width: 64}      # keys of NetworkConfig; what is left out keeps its default
settings: {updates: 64}   # keys of ExpertConfig or PpoConfig
"""

from __future__ import annotations

import json
import typing
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, create_model

from dronemon.errors import MissionFileError, OptionError, PolicyError
from dronemon.mission.document import Document
from dronemon.policy import NetworkConfig, Scope
from dronemon.training.imitation import ExpertConfig
from dronemon.training.ppo import PpoConfig

_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """What is trained and how; a run of it adds a seed, a time and a place."""

    learner: Literal["ppo", "expert"] = "expert"
    network: NetworkConfig = field(default_factory=NetworkConfig)
    settings: PpoConfig | ExpertConfig = field(default_factory=ExpertConfig)

    @property
    def facts(self) -> dict[str, Any]:
        """Every value, as a file would hold it."""
        as_read: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return as_read

    @property
    def scope(self) -> Scope:
        """What a network that learned so was trained for."""
        how = self.settings
        speeds = (0.0, how.max_speed_ratio) if isinstance(how, PpoConfig) else how.speed_ratio
        return Scope(
            num_targets=how.num_targets,
            num_nodes=how.num_nodes,
            speed_ratio=speeds,
            priors=tuple(dict.fromkeys(how.priors)),
        )

    @property
    def text(self) -> str:
        """A recipe file with every value."""
        return yaml.safe_dump(self.facts, sort_keys=False)


def load_recipe(name: str) -> Recipe:
    """The recipe of a file, or of the name of a shipped one.

    Raises OptionError naming file, line and key.
    """
    try:
        return _read(_find(name))
    except MissionFileError as exc:
        raise OptionError(str(exc)) from exc


def _find(name: str) -> Path:
    shipped = Path(str(files("dronemon.training"))) / "recipes"
    for path in (Path(name), shipped / f"{name}.yaml"):
        if path.is_file():
            return path
    names = ", ".join(sorted(path.stem for path in shipped.glob("*.yaml")))
    raise OptionError(
        f"{name}: no such recipe, neither as a file nor shipped; shipped are: {names}"
    )


def _read(path: Path) -> Recipe:
    document = Document.read(path, "recipe file")
    learns_alone = document.data.get("learner") == "ppo"
    default = Recipe(settings=PpoConfig() if learns_alone else ExpertConfig())
    given = document.validate(_model_of(default)).model_dump(exclude_unset=True)
    try:
        recipe: Recipe = _changed(default, given)
    except PolicyError as exc:
        raise document.error(("network",), str(exc)) from exc
    return recipe


def _model_of(config: Any) -> type[BaseModel]:
    """What a file may say instead of a dataclass's values."""
    hints = typing.get_type_hints(type(config), include_extras=True)
    allowed: dict[str, Any] = {}
    for name in (f.name for f in fields(config)):
        value = getattr(config, name)
        allowed[name] = (_model_of(value) if is_dataclass(value) else hints[name], None)
    return create_model(type(config).__name__, __config__=_STRICT, **allowed)


def _changed(config: Any, given: dict[str, Any]) -> Any:
    """A dataclass, and those in it, with the values that were given."""
    nested = {n: _changed(getattr(config, n), v) for n, v in given.items() if isinstance(v, dict)}
    return replace(config, **given | nested)
