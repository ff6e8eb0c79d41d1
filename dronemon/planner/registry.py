"""Planners by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable

from dronemon.errors import OptionError
from dronemon.planner.lawnmower import Lawnmower
from dronemon.planner.planner import Planner
from dronemon.planner.tsp import CarriedOn, ClairvoyantTspLoop, LastSeen, Predicted, TspLoop

# What is slow to import is imported where it is made: most runs need one planner.


def _learned(checkpoint: str | None) -> Planner:
    from dronemon.planner.learned import LearnedPlanner

    return LearnedPlanner.load(checkpoint)


def _search() -> Planner:
    from dronemon.planner.search import SearchPlanner

    return SearchPlanner()


def _roadmap_search() -> Planner:
    from dronemon.planner.search import RoadmapSearchPlanner

    return RoadmapSearchPlanner()


def _clairvoyant_search() -> Planner:
    from dronemon.planner.search import ClairvoyantSearchPlanner

    return ClairvoyantSearchPlanner()


_LEARNED: dict[str, Callable[[str | None], Planner]] = {"stamp": _learned}
"""Planners made from trained weights: a checkpoint's path or name, the shipped one for None."""
_OTHERS: dict[str, Callable[[], Planner]] = {
    "clairvoyant": ClairvoyantTspLoop,
    "clairvoyant-search": _clairvoyant_search,
    "lawnmower": Lawnmower,
    "search": _search,
    "search-roadmap": _roadmap_search,
    "tsp": lambda: TspLoop("tsp", LastSeen()),
    "tsp-heading": lambda: TspLoop("tsp-heading", CarriedOn()),
    "tsp-predicted": lambda: TspLoop("tsp-predicted", Predicted()),
}


def planner_names() -> tuple[str, ...]:
    """Names that `create_planner` takes, sorted."""
    return tuple(sorted({**_LEARNED, **_OTHERS}))


def has_weights(kind: str) -> bool:
    """Whether planners of this name are made from a checkpoint."""
    return kind in _LEARNED


def create_planner(kind: str, *, checkpoint: str | None = None) -> Planner:
    """Make a planner.

    kind: one of `planner_names()`; checkpoint: trained weights, for planners that have some.

    Raises OptionError for an unknown kind, or a checkpoint given to a planner without weights.
    """
    if kind in _LEARNED:
        return _LEARNED[kind](checkpoint)
    if kind not in _OTHERS:
        near = difflib.get_close_matches(kind, planner_names(), n=1)
        nearest = f"did you mean {near[0]}? " if near else ""
        raise OptionError(
            f"there is no planner {kind!r}; {nearest}there are: {', '.join(planner_names())}"
        )
    if checkpoint is not None:
        raise OptionError(f"planner {kind!r} has no weights, but checkpoint {checkpoint} was given")
    return _OTHERS[kind]()
