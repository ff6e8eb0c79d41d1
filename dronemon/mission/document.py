"""A YAML file as data whose keys keep their lines, so that an error names file, line and key."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from dronemon.errors import MissionFileError

KeyPath = tuple[str | int, ...]
_MAX_BYTES = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """A YAML file of one mapping. kind: what such a file is called."""

    path: Path
    kind: str
    root: yaml.Node
    data: dict[str, Any]

    @classmethod
    def read(cls, path: Path, kind: str) -> Document:
        """Read a file, without aliases and with no key twice. Raises MissionFileError."""
        try:
            if path.stat().st_size > _MAX_BYTES:
                raise MissionFileError(f"{path}: larger than {_MAX_BYTES} bytes; is it a {kind}?")
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
        if root is None or not isinstance(data, dict):
            raise MissionFileError(f"{path}:1: a {kind} is a mapping of sections, such as `area:`")
        _refuse_duplicates(path, root)
        return cls(path=path, kind=kind, root=root, data=data)

    def error(self, key_path: KeyPath, message: str) -> MissionFileError:
        """An error about one key of this file."""
        keys, line = [], 1
        node: yaml.Node | None = self.root
        for key in key_path:
            found = _child(node, key)
            if found is None:
                # Not in the file; a union's branch, as tuple[...], is in the path but is no key.
                if isinstance(key, str) and key.isidentifier():
                    keys.append(key)
                node = None
                continue
            keys.append(f"[{key}]" if isinstance(key, int) else key)
            line, node = found
        name = ".".join(str(key) for key in keys).replace(".[", "[") or self.kind.split()[0]
        return MissionFileError(f"{self.path}:{line}: {name}: {message}")


def problems(model: type[BaseModel], exc: ValidationError) -> Iterator[tuple[KeyPath, str]]:
    """What is wrong with data for a model: each key and its explanation, misspelt keys first."""
    # A misspelt key is also a missing one: the misspelling is the story.
    found = sorted(exc.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    for error in found:
        yield error["loc"], _explain(model, dict(error))


def _refuse_aliases(path: Path, text: str) -> None:
    """Nobody needs them, and a few lines of them can stand for more than fits into memory."""
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


def _child(node: yaml.Node | None, key: str | int) -> tuple[int, yaml.Node] | None:
    if isinstance(node, yaml.MappingNode):
        for key_node, value in node.value:
            if key_node.value == key:
                return key_node.start_mark.line + 1, value
    if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
        return node.value[key].start_mark.line + 1, node.value[key]
    return None


def _explain(model: Any, error: dict[str, Any]) -> str:
    kind, message, given = error["type"], str(error["msg"]), error["input"]
    if kind == "extra_forbidden":
        return _explain_unknown(model, error["loc"])
    if kind == "missing":
        return "is missing; add it"
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    text = f"{message[0].lower()}{message[1:]}, but is {given!r}"
    if kind in {"float_type", "float_parsing", "int_type", "int_parsing"}:
        text += "; write a bare number, its unit is the end of the key"
    return text


def _explain_unknown(model: Any, key_path: KeyPath) -> str:
    """Name the keys allowed beside an unknown one, and the nearest of them."""
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
