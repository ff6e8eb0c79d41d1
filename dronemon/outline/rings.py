"""Whether a walk around corners is the border of a polygon, in degrees and in metres."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence

import numpy as np
import shapely

from dronemon.frames import GeoPoint, degrees_to_ned
from dronemon.outline.feature import Flaw, Polygon, Ring, blamed_on
from dronemon.types import BoolArray, FloatArray

FARTHEST_M = 500_000.0
"""How far one corner may be from another: beyond it, it is a mistake."""
_SAME_M = 1e-3
"""Corners in a row that are no farther apart are one."""
_LEAST_M2 = 1.0
_MOST_CORNERS = 1000
_CIRCLE_SIDES = 64


def ring_in_degrees(corners: Iterable[Sequence[float]]) -> Ring:
    """A walk around a polygon, each corner once. Raises Flaw.

    corners: latitude, longitude and perhaps height of each in order; the last may be the first
    """
    ring = tuple(_corner(number, *corner) for number, corner in enumerate(corners, start=1))
    if not ring:
        raise Flaw("has no corners; a polygon has three or more")
    first = GeoPoint.at(ring[0])
    if (across_m := float(_distances_m(ring, first).max())) > FARTHEST_M:
        raise Flaw(
            f"is {across_m / 1000.0:.0f} km across, more than {FARTHEST_M / 1000.0:.0f}; is a "
            "corner misplaced, or are its latitude and longitude swapped?"
        )
    kept = _checked(degrees_to_ned(np.array(ring), first)[:, :2])
    return tuple(corner for corner, is_kept in zip(ring, kept, strict=True) if is_kept)


def away_m(ring: Ring, place: GeoPoint) -> float:
    """Distance of the nearest corner from a place, however far."""
    return float(_distances_m(ring, place).min())


def ring_in_metres(corners_m: Iterable[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    """The same of corners in metres along any two axes. Raises Flaw."""
    ring = tuple((first, second) for first, second in corners_m)
    kept = _checked(np.array(ring, dtype=np.float64).reshape(-1, 2))
    return tuple(corner for corner, is_kept in zip(ring, kept, strict=True) if is_kept)


def polygon_in_degrees(rings: Iterable[Iterable[Sequence[float]]]) -> Polygon:
    """A polygon's outer ring and its holes. Raises Flaw."""
    checked = []
    for number, ring in enumerate(rings):
        with blamed_on(f"hole {number}") if number else contextlib.nullcontext():
            checked.append(ring_in_degrees(ring))
    return tuple(checked)


def unwound(ring: Ring, near_deg: float) -> Ring:
    """A ring whose longitudes begin near another one, and do not leap."""
    unwound: list[tuple[float, float]] = []
    for latitude, longitude in ring:
        turns = round((near_deg - longitude) / 360.0)
        near_deg = longitude + 360.0 * turns
        unwound.append((latitude, near_deg))
    return tuple(unwound)


def circle_in_metres(radius_m: float, *, is_inside: bool) -> FloatArray:
    """A polygon within a circle, or else around it. -> (64, 2) float64 m from its centre."""
    reach_m = radius_m if is_inside else radius_m / math.cos(math.pi / _CIRCLE_SIDES)
    angle = np.arange(_CIRCLE_SIDES) * 2.0 * np.pi / _CIRCLE_SIDES
    rim_m: FloatArray = reach_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return rim_m


def _distances_m(ring: Ring, place: GeoPoint) -> FloatArray:
    """Of each corner, straight through the ground. -> (K,) m."""
    distances_m: FloatArray = np.linalg.norm(degrees_to_ned(np.array(ring), place), axis=-1)
    return distances_m


def _corner(
    number: int, latitude_deg: float, longitude_deg: float, height_m: float = 0.0
) -> tuple[float, float]:
    what = f"corner {number}: "
    if not all(map(math.isfinite, (latitude_deg, longitude_deg, height_m))):
        raise Flaw(f"{what}is not of finite numbers")
    if abs(latitude_deg) > 180.0 or abs(longitude_deg) > 360.0:
        raise Flaw(
            f"{what}{latitude_deg:g}, {longitude_deg:g} are no latitude and longitude; are these "
            "metres? save it in degrees, WGS 84 (EPSG:4326)"
        )
    if abs(latitude_deg) > 90.0:
        raise Flaw(
            f"{what}latitude {latitude_deg:g} is beyond 90 degrees; are latitude and longitude "
            "swapped?"
        )
    if height_m:
        raise Flaw(
            f"{what}is {height_m:g} m high, but the drone flies at one height, "
            "flight.altitude_m; save the outline without heights, on the ground"
        )
    return float(latitude_deg), float(longitude_deg)


def _checked(corners_m: FloatArray) -> BoolArray:
    """Which corners to keep, the same one in a row but once. (K, 2) -> (K,). Raises Flaw."""
    step_m = np.linalg.norm(np.roll(corners_m, -1, axis=0) - corners_m, axis=-1)
    kept: BoolArray = step_m > _SAME_M
    ring = corners_m[kept]
    if len(ring) < 3:
        raise Flaw("has fewer than three different corners")
    if len(ring) > _MOST_CORNERS:
        raise Flaw(f"has {len(ring)} corners, more than {_MOST_CORNERS}; simplify it")
    polygon = shapely.Polygon(ring)
    if polygon.convex_hull.area < _LEAST_M2:
        raise Flaw("encloses no area: its corners are on one line")
    if not polygon.is_valid:
        raise Flaw(f"crosses or touches itself {_where(ring, kept, polygon)}; redraw it")
    if polygon.area < _LEAST_M2:
        raise Flaw(f"encloses {polygon.area:.2g} m2, less than {_LEAST_M2:g}")
    return kept


def _where(ring_m: FloatArray, kept: BoolArray, polygon: shapely.Polygon) -> str:
    """The two sides that meet where they may not, by the corners that they begin at."""
    x, y = (float(v) for v in shapely.is_valid_reason(polygon).rpartition("[")[2][:-1].split())
    ends_m = np.stack([ring_m, np.roll(ring_m, -1, axis=0)], axis=1)
    off_m = shapely.distance(shapely.linestrings(ends_m), shapely.Point(x, y))
    corners = np.flatnonzero(kept)
    first, *others = np.argsort(off_m)
    neighbours = {(first - 1) % len(ring_m), (first + 1) % len(ring_m)}
    second = next((side for side in others if side not in neighbours), others[0])
    low, high = sorted(int(corners[side]) + 1 for side in (first, second))
    return f"where its sides from corners {low} and {high} meet"
