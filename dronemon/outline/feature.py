"""What the readers of all formats give: features made of polygons."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

NAMED_SO = re.compile(r"\s*no[\W_]?fly", re.IGNORECASE)
_YES, _NO = {"true", "yes", "1"}, {"false", "no", "0", "", "none"}
_LONGEST_NAME = 80
_HIGHEST_M = 500.0


class Flaw(ValueError):
    """What is wrong with what a user wrote; whoever knows file and key adds them."""


@contextlib.contextmanager
def blamed_on(what: str) -> Iterator[None]:
    """Have a flaw that is found meanwhile name what has it."""
    try:
        yield
    except Flaw as flaw:
        raise Flaw(f"{what}: {flaw}") from flaw


Ring = tuple[tuple[float, float], ...]
"""Latitude and longitude of each corner in order, the first one not again at the end."""
Polygon = tuple[Ring, ...]
"""A ring around it, and one around each of its holes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One thing of a file.

    label:    what errors call it
    name:     as the file has it, on one line; empty if it has none
    below_m:  how far up it is no-fly, where it says so
    height_m: of what stands there, where it says so
    polygons: none of a point, a line and so on
    """

    label: str
    name: str
    is_no_fly: bool
    polygons: tuple[Polygon, ...]
    below_m: float | None = None
    height_m: float | None = None


def plain_name(given: object) -> str:
    """A name as it can be shown on one line, from whatever a file has there."""
    if given is None or isinstance(given, bool | list | dict):
        return ""
    text = f"{given:g}" if isinstance(given, float) else str(given)
    return "".join(c for c in " ".join(text.split()) if c.isprintable())[:_LONGEST_NAME]


def zone_marks(name: str, read: Callable[[str], object]) -> tuple[bool, float | None, float | None]:
    """Whether a feature is no-fly, and its `below_m` and `height_m` if it is. Raises Flaw.

    read: gives its property of a name, None where it has none
    """
    marks = {key: read(key) for key in ("below_m", "height_m")}
    if not _is_no_fly(name, read("no_fly")):
        for key, mark in marks.items():
            if _is_given(mark):
                raise Flaw(f"{key} is a no-fly zone's: say no_fly, too, or leave it out")
        return False, None, None
    below_m, height_m = (_metres(*mark) for mark in marks.items())
    check_heights(below_m, height_m)
    return True, below_m, height_m


def check_heights(below_m: float | None, height_m: float | None) -> None:
    """Refuse a zone out of which something stands. Raises Flaw."""
    if below_m is not None and height_m is not None and height_m > below_m:
        raise Flaw(
            f"height_m {height_m:g} is more than below_m {below_m:g}: what stands there would reach"
            " out of the zone; raise below_m, or leave it out"
        )


def _is_given(mark: object) -> bool:
    return mark is not None and bool(str(mark).strip())


def _metres(name: str, mark: object) -> float | None:
    if not _is_given(mark):
        return None
    try:
        height_m = float(str(mark))
    except ValueError:
        height_m = math.nan
    if isinstance(mark, bool) or not 0.0 < height_m <= _HIGHEST_M:
        raise Flaw(f"{name} is {str(mark)[:_LONGEST_NAME]!r}, not a height up to {_HIGHEST_M:g} m")
    return height_m


def _is_no_fly(name: str, mark: object) -> bool:
    """Whether a feature's name or its property `no_fly` says so. Raises Flaw."""
    text = (f"{mark:g}" if isinstance(mark, float) else str(mark)).strip().lower()
    if text not in _YES | _NO:
        raise Flaw(f"no_fly is {text[:_LONGEST_NAME]!r}, which is neither true nor false")
    return text in _YES or bool(NAMED_SO.match(name))
