"""How near a drone came to the targets that it keeps off, in the pictures of its patrol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dronemon.mission import Mission
from dronemon.runner.watch import span
from dronemon.sightings import Sightings
from dronemon.types import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearness:
    """How near it came to one target.

    nearest_m:    least distance over ground, None if it was never seen
    times_nearer: how often it came nearer than it is to keep off: pictures in a row count once
    nearer_s:     how long it was; a picture stands for half the time to the ones before and after
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
    agent_au = np.array([m.agent_au for m in log]).reshape(-1, 2)

    def nearness(places_au: FloatArray, least_m: float) -> Nearness:
        away_m = np.linalg.norm(places_au - agent_au, axis=-1) * mission.area.side_m
        return _nearness(np.where(np.isnan(away_m), math.inf, away_m), times_s, least_m)

    told = {}
    for number, least_m in mission.kept_off_m.items():
        seen_au = [m.target_au[number] if m.seen[number] else (np.nan, np.nan) for m in log]
        told[mission.targets[number].name] = KeptOff(
            distance_m=least_m,
            seen=nearness(np.array(seen_au).reshape(-1, 2), least_m),
            true=None if true_au is None else nearness(true_au[:, number], least_m),
        )
    return told


def _nearness(away_m: FloatArray, times_s: FloatArray, least_m: float) -> Nearness:
    """Sum up distances, infinite where not seen. away_m, times_s: (T,)."""
    is_nearer = away_m < least_m
    ends_s = np.concatenate([times_s[:1], 0.5 * (times_s[1:] + times_s[:-1]), times_s[-1:]])
    nearest_m = float(away_m.min(initial=math.inf))
    return Nearness(
        nearest_m=nearest_m if math.isfinite(nearest_m) else None,
        times_nearer=int(np.sum(np.diff(is_nearer, prepend=False) & is_nearer)),
        nearer_s=float(np.diff(ends_s)[is_nearer].sum()) if len(times_s) else 0.0,
    )


def in_words(kept: Mapping[str, Any]) -> dict[str, str]:
    """For a table: a line for each target. kept: `kept_off` of summary.json"""
    return {f"kept off {name}": _words(**how) for name, how in kept.items()}


def _words(distance_m: float, seen: Mapping[str, Any], true: Mapping[str, Any] | None) -> str:
    if seen["nearest_m"] is None:
        return "never seen"
    nearer = f"never nearer than {distance_m:g} m"
    if times := seen["times_nearer"]:
        often = "once" if times == 1 else f"{times} times"
        nearer = f"nearer than {distance_m:g} m {often}, for {span(seen['nearer_s'])}"
    truly = f" (truly {true['nearest_m']:.0f} m)" if true else ""
    return f"{seen['nearest_m']:.0f} m at the nearest{truly}; {nearer}"
