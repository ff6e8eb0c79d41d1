"""JSON of other programs, of which nothing is taken for granted."""

from __future__ import annotations

import json
from typing import Any

from dronemon.outline.feature import Flaw


def parse_json(text: str) -> dict[str, Any]:
    """The object that a text is, its numbers as floats. Raises Flaw."""
    try:
        data = json.loads(text, parse_int=float, parse_constant=_refuse)
    except json.JSONDecodeError as exc:
        raise Flaw(f"not valid JSON: {exc}; is the file complete?") from exc
    except RecursionError as exc:
        raise Flaw("not valid JSON: nested too deeply") from exc
    if not isinstance(data, dict):
        raise Flaw("not what it should be: its JSON is no object, {...}")
    return data


def listed(value: object, what: str) -> list[Any]:
    """A list, if it is one. Raises Flaw."""
    if not isinstance(value, list):
        raise Flaw(f"{what} is no list, [...]")
    return value


def mapped(value: object, what: str) -> dict[str, Any]:
    """An object, if it is one. Raises Flaw."""
    if not isinstance(value, dict):
        raise Flaw(f"{what} is no object, {{...}}")
    return value


def numbers(value: object, what: str, counts: tuple[int, ...]) -> list[float]:
    """So many numbers, if it is a list of them. Raises Flaw."""
    given = listed(value, what)
    if len(given) not in counts or not all(isinstance(number, float) for number in given):
        allowed = " or ".join(map(str, counts))
        raise Flaw(f"{what} is not of {allowed} numbers: {json.dumps(given)[:60]}")
    return given


def _refuse(word: str) -> None:
    raise Flaw(f"not valid JSON: {word} is no number there")
