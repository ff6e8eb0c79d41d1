"""The fence of a flight: one convex polygon around the area, home and the way between, and heights.

The vehicle is given this polygon, and the guard keeps it: it acts while the drone can still stop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

from dronemon.frames import AreaFrame, GeoPoint, degrees_to_ned, ned_to_geo
from dronemon.outline import circle_in_metres
from dronemon.types import BoolArray, FloatArray, Pose

_SIDES = 8
"""Of what stands for a circle around a place: more make more corners, fewer a larger fence."""
_MOST_CORNERS = 16
"""A vehicle keeps a few dozen at most; a field with more is given a polygon around it."""
_STOP_S = 2.0
"""A drone that brakes as hard as it turns stops within the way that it flies in this time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fence:
    """Where the drone may be on patrol.

    corners_ned_m: (n, 2) north and east, in order
    edges:         (n, 3) unit normal that points out, and offset: n.x + offset = 0 on the edge
    heights_m:     how far above and below its own height a patrol may be
    zones_ned_m:   (m, 2) north and east of the corners of each no-fly zone, which this program
                   alone keeps: an emergency's return is straight, and the vehicle would hold there
    """

    corners_ned_m: FloatArray
    edges: FloatArray
    heights_m: tuple[float, float]
    zones_ned_m: tuple[FloatArray, ...] = ()

    @classmethod
    def around(
        cls,
        frame: AreaFrame,
        others_ned_m: Sequence[tuple[float, float]],
        *,
        altitude_m: float,
        margin_m: float,
    ) -> Fence:
        """Keep a margin around an area, other places such as home, and all ways between them.

        altitude_m: of the patrol, above the ground; it may be left by the margin too, but never by
        more than half downwards
        """
        angle = (np.arange(_SIDES) + 0.5) * 2.0 * np.pi / _SIDES
        reach_m = margin_m / math.cos(np.pi / _SIDES)  # its sides, not its corners, are so far out
        rim_m = reach_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        places_m = np.concatenate([frame.au_to_ned(frame.arena.outline_au), np.array(others_ned_m)])
        hull = ConvexHull((places_m[:, None] + rim_m).reshape(-1, 2))
        if len(hull.vertices) > _MOST_CORNERS:
            hull = ConvexHull(_circumscribed(hull.points))
        return cls(
            corners_ned_m=hull.points[hull.vertices],
            edges=hull.equations,
            heights_m=(margin_m, min(margin_m, altitude_m / 2.0)),
            zones_ned_m=tuple(frame.au_to_ned(zone_au[:-1]) for zone_au in frame.arena.zones_au),
        )

    def laid_as(self, corners_ned_m: FloatArray) -> Fence:
        """The fence as it was laid before: (n, 2) corners in order, of a convex polygon."""
        edges = ConvexHull(corners_ned_m).equations
        return replace(self, corners_ned_m=corners_ned_m, edges=edges)

    def inside_m(self, places_ned_m: FloatArray) -> FloatArray:
        """How far inside places are, less than 0 outside. places_ned_m: (..., 2) -> (...) m."""
        out_m: FloatArray = places_ned_m @ self.edges[:, :2].T + self.edges[:, 2]
        inside_m: FloatArray = -out_m.max(axis=-1)
        return inside_m

    def stops_inside(self, pose: Pose) -> bool:
        """Whether the drone, if it turns back from now on, stays inside, and is in no zone."""
        here_m = np.array(pose.position_ned_m[:2])
        stop_m = here_m + _STOP_S * np.array(pose.velocity_ned_m_s[:2])
        is_in_zone = any(_contains(zone_m, here_m) for zone_m in self.zones_ned_m)
        return bool(self.inside_m(stop_m) > 0.0) and not is_in_zone

    def is_at_height(self, pose: Pose, down_m: float) -> bool:
        """Whether it is neither too high nor too low for a patrol whose height is `down_m` here."""
        above_m, below_m = self.heights_m
        return down_m - above_m <= pose.position_ned_m[2] <= down_m + below_m

    def corners_deg(self, origin: GeoPoint) -> list[tuple[float, float]]:
        """Latitude and longitude of each corner; origin: of the local frame."""
        points = [ned_to_geo(np.array([*corner, 0.0]), origin) for corner in self.corners_ned_m]
        return [(point.latitude_deg, point.longitude_deg) for point in points]


@dataclass(frozen=True, slots=True, kw_only=True)
class FenceArea:
    """A polygon, or a circle around its only corner, of a vehicle's own fence.

    corners_deg: latitude and longitude; radius_m: None for a polygon
    """

    is_inclusion: bool
    corners_deg: tuple[tuple[float, float], ...]
    radius_m: float | None = None

    def allows(self, fence: Fence, origin: GeoPoint) -> bool:
        """Whether one may be everywhere within a fence; origin: of the local frame."""
        outline_m, corners_m = self._outline_ned_m(origin), fence.corners_ned_m
        if _cross(outline_m, corners_m).any():
            return False
        is_around = _contains(outline_m, corners_m[0])
        return (
            is_around
            if self.is_inclusion
            else not (is_around or fence.inside_m(outline_m[0]) >= 0.0)
        )

    def _outline_ned_m(self, origin: GeoPoint) -> FloatArray:
        outline_m: FloatArray = degrees_to_ned(np.array(self.corners_deg), origin)[:, :2]
        if self.radius_m is not None:
            outline_m = outline_m + circle_in_metres(self.radius_m, is_inside=self.is_inclusion)
        return outline_m


def _circumscribed(places: FloatArray) -> FloatArray:
    """Corners of a polygon of few sides around places. (n, 2) -> (_MOST_CORNERS, 2)."""
    angle = 2.0 * np.pi * np.arange(_MOST_CORNERS) / _MOST_CORNERS
    out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    reach = (places @ out.T).max(axis=0)
    sides = np.stack([out, np.roll(out, -1, axis=0)], axis=1)  # two neighbours meet in a corner
    ends = np.stack([reach, np.roll(reach, -1)], axis=-1)
    corners: FloatArray = np.linalg.solve(sides, ends[..., None])[..., 0]
    return corners


def _contains(polygon: FloatArray, place: FloatArray) -> bool:
    """Whether a line from the place to the east crosses an odd number of sides. polygon: (n, 2)."""
    (north, east), (next_north, next_east) = polygon.T, np.roll(polygon, -1, axis=0).T
    is_beside = (north > place[0]) != (next_north > place[0])
    slope = (next_east - east) / np.where(is_beside, next_north - north, 1.0)
    is_crossed = is_beside & (place[1] < east + slope * (place[0] - north))
    return bool(is_crossed.sum() % 2)


def _cross(a: FloatArray, b: FloatArray) -> BoolArray:
    """Which sides of two polygons cross. a: (n, 2); b: (m, 2) -> (n, m)."""

    def parts(of: FloatArray, by: FloatArray) -> BoolArray:
        """Whether the line through each side of one has the ends of each of the other apart."""
        start, way = of[:, None], (np.roll(of, -1, axis=0) - of)[:, None]
        to = by - start
        turn = way[..., 0] * to[..., 1] - way[..., 1] * to[..., 0]
        apart: BoolArray = turn * np.roll(turn, -1, axis=1) < 0.0
        return apart

    both: BoolArray = parts(a, b) & parts(b, a).T
    return both
