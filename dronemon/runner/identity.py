"""Which of several targets that look alike each one of the log truly was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dronemon.sightings import Sightings
from dronemon.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Identities:
    """targets: (N,) int64 the true one that each target of the log was most often, one to one.

    num_switches: sights that were of another true one than the target's sight before; None where
    all look different
    """

    targets: IntArray
    num_switches: int | None


def identify(sightings: Sightings, true_au: FloatArray, looks: Sequence[str]) -> Identities:
    """Compare a log with the truth.

    true_au: (T, N, 2) where the targets were at each measurement; looks: of each target

    A sight is of the nearest true target of its look. Where a place was told before take-off, a
    first sight of another is a switch, too. Looks that are taken for others are told apart.
    """
    numbers = np.arange(len(looks))
    is_alike = np.array([[a == b for b in looks] for a in looks])
    times_seen = np.zeros(is_alike.shape)
    last = np.where(np.isfinite(sightings.priors_au).all(axis=1), numbers, -1)
    num_switches = 0
    for measurement, places_au in zip(sightings.since(0), true_au, strict=True):
        for target in np.flatnonzero(measurement.seen):
            away_au = np.linalg.norm(places_au - measurement.target_au[target], axis=1)
            who = int(np.where(is_alike[target], away_au, np.inf).argmin())
            times_seen[target, who] += 1.0
            num_switches += last[target] not in (-1, who)
            last[target] = who
    # Who was never seen is itself, if that is free.
    gain = np.where(is_alike, times_seen + 0.5 * np.eye(len(looks)), -1e9)
    targets: IntArray = linear_sum_assignment(gain, maximize=True)[1]
    return Identities(
        targets=targets, num_switches=num_switches if is_alike.sum() > len(looks) else None
    )
