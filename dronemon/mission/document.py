"""A YAML file as data whose keys keep their lines, so that every error names file, line and key."""

from __future__ import annotations

import contextlib
import copy
import difflib
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from dronemon.errors import MissionFileError
from dronemon.mission.scalars import Loader, scalar_flaw

Model = TypeVar("Model", bound=BaseModel)
KeyPath = tuple[str | int, ...]
Problem = tuple[KeyPath, str]
"""A key and what is wrong with it."""
Entry = tuple[KeyPath, int, bool]
"""A key or an item, its line, and whether its mapping has the key already."""
Overrides = Mapping[tuple[str, str], tuple[str, object]]
"""Section and key -> name and value of a command line option, as if it stood in the file."""
_MAX_BYTES = 1_000_000
_MAX_DEPTH = 20
_WRONG_ELSEWHERE = "default_factory_not_called"
"""Of a default that follows from another key, where that one is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """A YAML file of one mapping.

    kind:    what such a file is called
    data:    its content, options included
    entries: its keys and items, in the order of the file
    flaws:   keys and items that YAML does not read as they are written
    options: keys that came by an option -> its name
    """

    path: Path
    kind: str
    data: dict[str, Any]
    entries: tuple[Entry, ...]
    flaws: tuple[Problem, ...]
    options: Mapping[KeyPath, str]

    @classmethod
    def read(cls, path: Path, kind: str, overrides: Overrides | None = None) -> Document:
        """Read a file without aliases. Raises MissionFileError."""
        try:
            if path.stat().st_size > _MAX_BYTES:
                raise MissionFileError(f"{path}: larger than {_MAX_BYTES} bytes; is it a {kind}?")
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as exc:
            raise MissionFileError(f"{path}: cannot be read: {exc}") from exc
        try:
            _refuse_traps(path, text)
            root = yaml.compose(text, Loader)
            data = yaml.load(text, Loader)
            flaws = tuple(_flaws(root))
        except yaml.reader.ReaderError as exc:
            line = text.count("\n", 0, exc.position) + 1
            what = f"the character {chr(exc.character)!a} is not allowed"
            raise MissionFileError(f"{path}:{line}: not valid YAML: {what}") from exc
        except yaml.MarkedYAMLError as exc:
            line = exc.problem_mark.line + 1 if exc.problem_mark else 1
            raise MissionFileError(f"{path}:{line}: not valid YAML: {exc.problem}") from exc
        except (yaml.YAMLError, ValueError) as exc:
            raise MissionFileError(f"{path}: not valid YAML: {exc}") from exc
        if root is None or not isinstance(data, dict):
            raise MissionFileError(f"{path}:1: a {kind} is a mapping of sections, each `name:`")
        overrides = overrides or {}
        for (section, key), (_, value) in overrides.items():
            given = data.setdefault(section, {})
            if isinstance(given, dict):
                given[key] = value
        options: dict[KeyPath, str] = {keys: name for keys, (name, _) in overrides.items()}
        return cls(
            path=path,
            kind=kind,
            data=data,
            entries=tuple(_entries(root)),
            flaws=flaws,
            options=options,
        )

    def validate(
        self, model: type[Model], check: Callable[[Model], Iterable[Problem]] = lambda _: ()
    ) -> Model:
        """The model of this file.

        Raises MissionFileError that tells all that is wrong, a line each, in the file's order.

        check: finds what no single key can say; wrong keys are left out, if the others can do alone
        """
        problems = self.flaws or _all_problems(model, self.data, check)
        told = [self._tell(*problem) for problem in problems]
        told += [
            (line, f"{self.path}:{line}: {key_path[-1]}: given twice; remove one")
            for key_path, line, is_again in self.entries
            if is_again
        ]
        if told:
            raise MissionFileError("\n".join(text for _, text in sorted(told, key=lambda t: t[0])))
        return model.model_validate(self.data)

    def error(self, key_path: KeyPath, message: str) -> MissionFileError:
        """An error about one key of this file, or the option that it came by."""
        return MissionFileError(self._tell(key_path, message)[1])

    def _tell(self, key_path: KeyPath, message: str) -> tuple[int, str]:
        """The line of a key, 0 for an option, and the whole message."""
        if option := self.options.get(key_path[:2]):
            return 0, f"{option}: {message}"
        lines = {keys: line for keys, line, is_again in self.entries if not is_again}
        above = (key_path[:n] for n in range(len(key_path), 0, -1))
        line = next((lines[keys] for keys in above if keys in lines), 1)
        name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in key_path)
        name = name.removeprefix(".") or self.kind.split()[0]
        return line, f"{self.path}:{line}: {name}: {message}"


def _all_problems(
    model: type[Model], data: dict[str, Any], check: Callable[[Model], Iterable[Problem]]
) -> list[Problem]:
    """What is wrong with each key, and with the others without these keys."""
    try:
        return list(check(model.model_validate(data)))
    except ValidationError as exc:
        found = list(_problems(model, exc))
    rest = copy.deepcopy(data)
    removed = [path for key_path, _ in found for path in _take_out(model, rest, key_path)]
    if removed:
        known = [key_path for key_path, _ in found] + removed
        for other, text in _all_problems(model, rest, check):
            pairs = (zip(path, other, strict=False) for path in known)
            if not any(all(a == b for a, b in path) for path in pairs):  # inside it, or around it
                found += [(other, text)]
    return found


def _take_out(model: type[BaseModel], data: dict[str, Any], key_path: KeyPath) -> Iterator[KeyPath]:
    """Remove a wrong value; that of a misspelt key, not of another unit, goes to the right one."""
    with contextlib.suppress(KeyError, ValueError):  # it is not there
        *above, key = key_path
        holder: Any = data
        for part in above:
            holder = holder[part]
        if isinstance(holder, list):
            yield from _take_out(model, data, tuple(above))
            return
        value = holder.pop(key)
        yield key_path
        if key not in _fields(model, key_path):
            for near in _nearest(model, key_path):
                if not near.startswith(str(key).rpartition("_")[0] or str(key)):
                    holder.setdefault(near, value)
                yield (*above, near)


def _problems(model: type[BaseModel], exc: ValidationError) -> Iterator[Problem]:
    """What is wrong with data for a model: each key and its explanation, misspelt keys first."""
    errors = [e for e in exc.errors(include_url=False) if e["type"] != _WRONG_ELSEWHERE]
    found = sorted(errors, key=lambda e: e["type"] != "extra_forbidden")
    told: set[KeyPath] = set()
    inside = {error["loc"][:n] for error in found for n in range(len(error["loc"]))}
    for error in found:
        key_path = error["loc"]
        if key_path in inside:
            continue  # a section that is wrong for what is wrong inside it
        if error["type"] == "extra_forbidden":
            # A misspelt key is also a missing one: the misspelling is the story.
            told |= {(*key_path[:-1], near) for near in _nearest(model, key_path)}
        else:
            # Each branch of a union has an error of its own: the first one speaks for the key.
            key_path = tuple(takewhile(_is_key, key_path))
        if key_path not in told:
            yield key_path, _explain(model, dict(error))
            told.add(key_path)


def _refuse_traps(path: Path, text: str) -> None:
    """Nobody needs aliases or depth; a few lines of them can take all memory, or minutes."""
    depth = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH or isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else 1
            what = "nested too deeply" if depth > _MAX_DEPTH else "aliases are not allowed"
            raise MissionFileError(f"{path}:{line}: {what}")


def _entries(node: yaml.Node, above: KeyPath = ()) -> Iterator[Entry]:
    inner: list[tuple[str | int, yaml.Node, yaml.Node]] = []
    if isinstance(node, yaml.MappingNode):
        inner = [(key.value, key, value) for key, value in node.value]
    elif isinstance(node, yaml.SequenceNode):
        inner = [(index, item, item) for index, item in enumerate(node.value)]
    seen: set[str | int] = set()
    for key, marked, value in inner:
        yield (*above, key), marked.start_mark.line + 1, key in seen
        seen.add(key)
        yield from _entries(value, (*above, key))


def _flaws(node: yaml.Node | None, above: KeyPath = ()) -> Iterator[Problem]:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if flaw := scalar_flaw(key):
                yield above, f"the key {key.value!a} {flaw}"
            yield from _flaws(value, (*above, key.value))
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _flaws(item, (*above, index))
    elif node is not None and (flaw := scalar_flaw(node)):
        yield above, flaw


def _explain(model: Any, error: dict[str, Any]) -> str:
    kind, message, given = error["type"], str(error["msg"]), error["input"]
    if kind == "extra_forbidden":
        hint = "".join(f"; did you mean `{near}`?" for near in _nearest(model, error["loc"]))
        return f"no such key{hint} (allowed here: {', '.join(_fields(model, error['loc']))})"
    if kind == "missing":
        return "is missing; add it"
    key_path = tuple(takewhile(_is_key, error["loc"]))
    if kind == "tuple_type" and (about := _description(model, key_path)):
        return f"{given!r} cannot be this: {about}"
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    text = f"{message[0].lower()}{message[1:]}, but is {given!r}"
    if kind == "string_type" and isinstance(given, int | float):
        text += f'; put it in quotes: "{given}"'
    if kind in {"float_type", "float_parsing", "int_type", "int_parsing"}:
        text += "; write a bare number, its unit is the end of the key"
    return text


def _description(model: Any, key_path: KeyPath) -> str | None:
    """What is said of a key, or of that whose item it is."""
    while isinstance(key_path[-1], int):
        key_path = key_path[:-1]
    about: str | None = _fields(model, key_path)[key_path[-1]].description
    return about


def _nearest(model: Any, key_path: KeyPath) -> list[str]:
    """The allowed key that an unknown one is most like, if it is like one."""
    return difflib.get_close_matches(str(key_path[-1]), _fields(model, key_path), n=1, cutoff=0.4)


def _fields(model: Any, key_path: KeyPath) -> Any:
    """The keys, and what is said of them, of the section that a key lies in."""
    for key in key_path[:-1]:
        if isinstance(key, str):
            annotation = model.model_fields[key].annotation
            inside = (annotation, *typing.get_args(annotation))  # tuple[Target, ...] has a Target
            sections = (a for a in inside if isinstance(a, type) and issubclass(a, BaseModel))
            model = next(sections, None)
            if model is None:  # a mapping whose keys are the user's own
                return {}
    return model.model_fields


def _is_key(part: str | int) -> bool:
    """Whether a part of a path is a key or an index, and no union's branch, such as tuple[...]."""
    return isinstance(part, int) or part.isidentifier()
