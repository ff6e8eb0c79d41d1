"""The fields of `benchmarks/fields.py`, and whether a track keeps to one, by plain shapely."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import shapely
from shapely import Polygon

from dronemon.arena import Arena
from dronemon.types import FloatArray

MARGIN_AU = 0.03
TOLERANCE_AU = 1e-6
"""By how much a leg may be where it may not."""
_ACROSS_AU = (1.0, 2.5)
_ZONE_AU = (0.08, 0.3)
"""Farthest corner of a no-fly zone from its middle."""
_MOST_CUT_OFF = 0.05
"""Share of the field that no way leads to: more would not be flown either."""
_CONCAVE = 0.85
"""Most of its hull that a field fills."""


@cache
def draw_field(seed: int) -> Arena:
    """A concave polygon 1 to 2.5 au across, with 1 to 4 no-fly zones inside of it."""
    rng = np.random.default_rng(seed)
    num_zones, across_au = int(rng.integers(1, 5)), rng.uniform(*_ACROSS_AU)
    while True:
        border_au = _star(int(rng.integers(6, 13)), rng)
        border_au -= border_au.min(axis=0)
        border_au *= across_au / border_au.max()
        field = Polygon(border_au)
        zones_au = [
            rng.uniform(0.0, border_au.max(axis=0))
            + rng.uniform(*_ZONE_AU) * _star(int(rng.integers(3, 8)), rng)
            for _ in range(num_zones)
        ]
        is_concave = field.is_valid and field.area < _CONCAVE * field.convex_hull.area
        if not is_concave or not all(field.contains(Polygon(zone)) for zone in zones_au):
            continue
        try:
            arena = Arena.polygon(border_au, zones_au, margin_au=MARGIN_AU)
        except ValueError:  # nothing is left to fly in
            continue
        if arena.cut_off <= _MOST_CUT_OFF:
            return arena


def _star(num_corners: int, rng: np.random.Generator) -> FloatArray:
    """Corners around (0, 0), 0.35 to 1 away. -> (n, 2)."""
    angle = (
        2.0 * np.pi * (np.arange(num_corners) + rng.uniform(-0.3, 0.3, num_corners)) / num_corners
    )
    away = rng.uniform(0.35, 1.0, num_corners)
    corners: FloatArray = away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return corners


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """How a track keeps to its field, in the unit of both.

    num_legs: straight parts of it
    num_bad:  those in a no-fly zone or outside the border by more than is allowed
    zone:     least distance to a zone, 0 if it is crossed
    border:   the same to the border
    """

    num_legs: int
    num_bad: int
    zone: float
    border: float


def how_kept(
    track: FloatArray, border: FloatArray, zones: list[FloatArray], tolerance: float
) -> Kept:
    """Judge a track of two places at least. track: (n, 2); border, zones: corners, not closed."""
    legs = shapely.linestrings(np.stack([track[:-1], track[1:]], axis=1))
    field = Polygon(border)
    taken = shapely.union_all([Polygon(zone) for zone in zones])
    is_out = ~shapely.covers(field.buffer(tolerance), legs)
    is_in_zone = shapely.intersects(taken.buffer(-tolerance), legs)
    return Kept(
        num_legs=len(legs),
        num_bad=int((is_out | is_in_zone).sum()),
        zone=float(shapely.distance(legs, taken).min()),
        border=0.0 if is_out.any() else float(shapely.distance(legs, field.exterior).min()),
    )


def corners(arena: Arena) -> tuple[FloatArray, list[FloatArray]]:
    """Those of its border, and of each no-fly zone."""
    return np.array(arena.border_au), [np.array(zone) for zone in arena.no_fly_au]
