"""Planners by name: those that come with the package, entry points, and `package.module:Class`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from dronemon.errors import OptionError, did_you_mean
from dronemon.outside import find_class
from dronemon.planner.lawnmower import Lawnmower
from dronemon.planner.planner import Planner
from dronemon.planner.tsp import ClairvoyantTspLoop, TspLoop, carried_on, last_seen, predicted

ENTRY_POINTS = "dronemon.planners"
"""Group of entry points by which other packages bring planners."""
_ROLE = "planner"
_KNOWN = {"dronemon", *sys.stdlib_module_names}
"""Whose versions are told anyway."""


def _load(path: str) -> Any:
    """What a module beside this one holds that is slow to import: most runs need one."""
    return resolve_name(f"dronemon.planner.{path}")


_SHIPPED: dict[str, Callable[..., Planner]] = {
    "clairvoyant": ClairvoyantTspLoop,
    "clairvoyant-search": lambda: _load("search:ClairvoyantSearchPlanner")(),
    "lawnmower": Lawnmower,
    "present-search": lambda: _load("search:PresentSearchPlanner")(),
    "search": lambda: _load("search:SearchPlanner")(),
    "search-roadmap": lambda: _load("search:RoadmapSearchPlanner")(),
    "stamp": lambda *given: _load("learned:LearnedPlanner.load")(*given),
    "tsp": lambda: TspLoop("tsp", last_seen),
    "tsp-heading": lambda: TspLoop("tsp-heading", carried_on),
    "tsp-predicted": lambda: TspLoop("tsp-predicted", predicted),
}
_ABOUT = {
    "clairvoyant": "tsp, told where targets will be: a bound, never flown",
    "clairvoyant-search": "search, told where targets will be: a bound, never flown",
    "lawnmower": "parallel lanes over the whole area, blind to what is seen",
    "present-search": "search, told where targets are but not where they will be: a bound",
    "search": "tries paths ahead on samples of where targets may be; the default",
    "search-roadmap": "search along the edges of the roadmap",
    "stamp": "attention network over the roadmap; flies trained weights",
    "tsp": "shortest loop over where targets were last seen; the paper's baseline",
    "tsp-heading": "tsp, with targets carried on along their headings",
    "tsp-predicted": "tsp over the peaks of the belief a little later",
}


def planner_names() -> tuple[str, ...]:
    """Names of the planners that come with the package, sorted."""
    return tuple(_SHIPPED)


def has_weights(kind: str) -> bool:
    """Whether planners of this name are made from a checkpoint, the shipped one for None."""
    return kind == "stamp"


def is_bound(kind: str) -> bool:
    """Whether planners of this name must be told the truth, and so cannot fly."""
    return kind in {"clairvoyant", "clairvoyant-search", "present-search"}


def create_planner(
    kind: str, *, checkpoint: str | None = None, history: int | None = None
) -> Planner:
    """Make a planner.

    kind:       one of `planner_names()`, an entry point's name, or package.module:Class
    checkpoint: trained weights, for planners that have some
    history:    T, how many decisions such a planner looks back, 100 for None

    Raises OptionError for a kind that cannot be made, or a checkpoint or a history given to a
    planner without weights; PolicyError for a checkpoint that cannot be used.
    """
    if has_weights(kind):
        return _SHIPPED[kind](checkpoint, history)
    for name, given in {"checkpoint": checkpoint, "history": history}.items():
        if given is not None:
            raise OptionError(f"planner {kind!r} has no weights, but {name} {given} was given")
    return _SHIPPED[kind]() if kind in _SHIPPED else _make_outside(_path_outside(kind))


def files_outside(kind: str) -> tuple[Path, ...]:
    """Files that decide how a planner of others plans; none for those that come with the package.

    They are those of the module named, of its class and of that one's bases, and what it has in
    `files`, such as weights or modules of its own, seen from the folder that we run in. Raises
    OptionError for a planner that cannot be made, or if `files` are no paths.
    """
    if kind in _SHIPPED:
        return ()
    path = _path_outside(kind)
    planner = _make_outside(path)
    named = getattr(planner, "files", ())
    if not isinstance(named, tuple | list) or not all(isinstance(f, str | Path) for f in named):
        raise OptionError(f"planner {path!r} has files {named!r}, which is no tuple of paths")
    modules = dict.fromkeys(
        [path.partition(":")[0], *(c.__module__ for c in type(planner).__mro__)]
    )
    theirs = [name for name in modules if name.partition(".")[0] not in _KNOWN]
    sources = [getattr(sys.modules.get(name), "__file__", None) for name in theirs]
    return tuple(map(Path, [*filter(None, sources), *named]))


def describe_planners() -> dict[str, str]:
    """Name -> one line of what it is, entry points included."""
    told = dict(_ABOUT)
    for point in entry_points(group=ENTRY_POINTS):
        try:
            about = (inspect.getdoc(find_class(point.value, _ROLE)) or "").split("\n")[0]
        except OptionError as exc:
            about = f"cannot be loaded: {exc}"
        told.setdefault(point.name, about or point.value)
    return told


def _path_outside(kind: str) -> str:
    """package.module:Class of a planner that does not come with the package. Raises OptionError."""
    brought = {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}
    if ":" in kind or kind in brought:
        return brought.get(kind, kind)
    names = sorted({*_SHIPPED, *brought})
    raise OptionError(
        f"there is no planner {kind!r}; {did_you_mean(kind, names)}"
        f"there are: {', '.join(names)}, and your own as package.module:Class"
    )


def _make_outside(path: str) -> Planner:
    """The planner of a class outside this package. Raises OptionError."""
    make = find_class(path, _ROLE)
    try:
        planner: Planner = make()
        given = {m: getattr(planner, m, None) for m in ("name", "reset", "next_waypoint")}
    except (Exception, SystemExit) as exc:  # a class of others may fail in any way
        raise OptionError(
            f"planner {path!r} cannot be made by calling it without arguments: {exc!r}"
        ) from exc
    is_right = {m: callable(it) or (m == "name" and isinstance(it, str)) for m, it in given.items()}
    if missing := [m for m in given if not is_right[m]]:
        raise OptionError(
            f"planner {path!r} has no {' and no '.join(missing)}; "
            "docs/your-own-planner.md shows what a planner gives"
        )
    return planner
