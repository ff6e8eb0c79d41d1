"""How near a drone came to the targets that it keeps off, in the pictures of its patrol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dronemon.mission import Mission
from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.runner.watch import span
from dronemon.sightings import Sightings
from dronemon.types import FloatArray

_PAUSE_AU = 2.0 * MEASUREMENT_INTERVAL_AU
"""More between two pictures was not all flown: a battery was changed, or the run went on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearness:
    """How near it came to one target.

    nearest_m:    least distance over ground, None if it was never seen
    times_nearer: how often it came nearer than it is to keep off: pictures in a row count once
    nearer_s:     how long it was; a picture stands for half the time to the ones before and after,
                  but for no pause
    """

    nearest_m: float | None
    times_nearer: int
    nearer_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptOff:
    """The same where the target was seen, and where it truly was; None where that is not known."""

    distance_m: float
    seen: Nearness
    true: Nearness | None


def kept_off(
    sightings: Sightings, true_au: FloatArray | None, mission: Mission
) -> dict[str, KeptOff]:
    """Name -> how the drone kept off each target that it is to keep off.

    true_au: (T, N, 2) where each target was at each measurement
    """
    log = sightings.since(0)
    times_s = np.array([m.time_au for m in log]) * mission.seconds_per_au
    most_s = _PAUSE_AU * mission.seconds_per_au
    half_s = 0.5 * np.minimum(np.diff(times_s), most_s)
    stands_s = np.pad(half_s, (0, 1)) + np.pad(half_s, (1, 0)) if log else times_s
    agent_au = np.array([m.agent_au for m in log]).reshape(-1, 2)

    def nearness(places_au: FloatArray, least_m: float) -> Nearness:
        away_m = np.linalg.norm(places_au - agent_au, axis=-1) * mission.area.side_m
        return _nearness(np.where(np.isnan(away_m), math.inf, away_m), stands_s, least_m)

    told = {}
    for number, least_m in mission.kept_off_m.items():
        seen_au = [m.target_au[number] if m.seen[number] else (np.nan, np.nan) for m in log]
        told[mission.targets[number].name] = KeptOff(
            distance_m=least_m,
            seen=nearness(np.array(seen_au).reshape(-1, 2), least_m),
            true=None if true_au is None else nearness(true_au[:, number], least_m),
        )
    return told


def _nearness(away_m: FloatArray, stands_s: FloatArray, least_m: float) -> Nearness:
    """Sum up distances, infinite where not seen. away_m, stands_s (what it stands for): (T,)."""
    is_nearer = away_m < least_m
    nearest_m = float(away_m.min(initial=math.inf))
    return Nearness(
        nearest_m=nearest_m if math.isfinite(nearest_m) else None,
        times_nearer=int(np.sum(np.diff(is_nearer, prepend=False) & is_nearer)),
        nearer_s=float(stands_s[is_nearer].sum()),
    )


def in_words(kept: Mapping[str, Any]) -> dict[str, str]:
    """For a table: a line for each target. kept: `kept_off` of summary.json"""
    return {f"kept off {name}": _words(**how) for name, how in kept.items()}


def _words(distance_m: float, seen: Mapping[str, Any], true: Mapping[str, Any] | None) -> str:
    truly = f" (truly {true['nearest_m']:.0f} m)" if true else ""
    if seen["nearest_m"] is None:
        return f"never seen{truly}"
    nearer = f"never seen nearer than {distance_m:g} m"
    if times := seen["times_nearer"]:
        often = "once" if times == 1 else f"{times} times"
        nearer = f"nearer than {distance_m:g} m {often}, for {span(seen['nearer_s'])}"
    return f"{seen['nearest_m']:.0f} m at the nearest in its pictures{truly}; {nearer}"
