"""How each target was watched, read off the log of sightings."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dronemon.frames import GeoPoint
from dronemon.sightings import Sightings
from dronemon.types import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Watched:
    """How one target was watched.

    num_seen:         pictures that showed it
    longest_unseen_s: longest time without one, from the patrol's start to its end
    unseen_since_s:   time without one at the end, None if it was never seen
    position_au:      (2,) where it was seen last, None if it was never seen
    place:            the same on the globe, None also where that is not known
    """

    num_seen: int
    longest_unseen_s: float
    unseen_since_s: float | None
    position_au: FloatArray | None
    place: GeoPoint | None


def watch(
    sightings: Sightings,
    number: int,
    seconds_per_au: float,
    place_of: Callable[[FloatArray], GeoPoint | None],
) -> Watched:
    """How the target of this number was watched until the last measurement."""
    num_seen, end_au = sightings.num_seen[number], sightings.time_au
    all_sights = sightings.sights(number, np.inf, sys.maxsize)
    seen = all_sights[len(all_sights) - num_seen :]  # without a prior
    times_au = np.array([0.0, *(sight.time_au for sight in seen), end_au])
    position_au = np.array(seen[-1][1:]) if seen else None
    return Watched(
        num_seen=num_seen,
        longest_unseen_s=float(np.diff(times_au).max()) * seconds_per_au,
        unseen_since_s=(end_au - seen[-1].time_au) * seconds_per_au if seen else None,
        position_au=position_au,
        place=None if position_au is None else place_of(position_au),
    )


def in_words(watched: Watched) -> str:
    """For a table."""
    if watched.unseen_since_s is None:
        return f"never seen in {span(watched.longest_unseen_s)}"
    where = f" at {watched.place}" if watched.place else ""
    unseen = f"out of sight for {span(watched.longest_unseen_s)} at most"
    seen, last = seen_in_words(watched.num_seen), ago_in_words(watched.unseen_since_s)
    return f"seen {seen}, {unseen}; last {last}{where}"


def seen_in_words(num_seen: int) -> str:
    """How often."""
    return {0: "never", 1: "once"}.get(num_seen, f"{num_seen} times")


def ago_in_words(unseen_since_s: float) -> str:
    """When it was seen last."""
    return f"{span(unseen_since_s)} before the end" if unseen_since_s else "at the end"


def span(duration_s: float) -> str:
    """A duration in words: 45 s, 3 min 5 s, 1 h 12 min."""
    minutes, seconds = divmod(round(duration_s), 60)
    hours, minutes = divmod(minutes, 60)
    parts = [(hours, "h"), (minutes, "min"), (seconds, "s")]
    shown = [f"{number} {unit}" for number, unit in parts if number][:2]
    return " ".join(shown) or "0 s"
