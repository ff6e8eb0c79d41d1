"""Ground on which things stand that hide what is behind them.

A place on the ground is hidden where something stands between it and the camera, or on it. Seen
from the camera a thing's shadow begins at its near wall and ends where the ray over its top comes
down: in the direction of each of its points, as much farther than the point as the camera is higher
above the ground than above the top.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dronemon.frames import AreaFrame
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import BoolArray, CameraModel, FloatArray, Obstacle, Pose
from dronemon.vision.surface import Surface

_NUM_SECTORS = 72
_WIDER_RAD = 1e-6
"""By which a sector is taken as wider to both sides, for rounding."""
_STEPS_PER_AU = 10_000
"""To which what is hidden is told: never less of it."""
_NUM_LOOKS = 21
"""Along each axis, for the highest ground below an obstacle and the lowest in view."""
_ROUNDING = 1e-9
"""Share of an edge; or a camera right over it would see none of it in any sector."""
_LEAST_OVER_M = 1e-9
"""Of a camera over a top: from there on what it hides has no end."""
_LEAST = 1e-30


class BuiltUp:
    """A `Surface`: another one, and obstacles on it."""

    def __init__(self, ground: Surface, frame: AreaFrame, obstacles: Sequence[Obstacle]) -> None:
        self._ground, self._frame = ground, frame
        rings = [obstacle.corners_au for obstacle in obstacles]
        sizes = [len(ring) for ring in rings]
        self._starts_au = np.concatenate(rings)  # of all their edges
        self._ends_au = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        self._first = np.cumsum([0, *sizes[:-1]])  # edge of each
        self._whose = np.repeat(np.arange(len(rings)), sizes)
        boxes = [(ring.min(axis=0), ring.max(axis=0)) for ring in rings]
        downs_m = self._look_about(*np.moveaxis(np.array(boxes), 1, 0))
        downs_m = np.nan_to_num(downs_m, nan=-math.inf)  # not known: hides all behind
        self._tops_down_m = downs_m.min(axis=(0, 1)) - [obstacle.height_m for obstacle in obstacles]

    def _look_about(self, low_au: FloatArray, high_au: FloatArray) -> FloatArray:
        """Down coordinates of the ground all over boxes. (..., 2) corners -> (n, n, ...)"""
        x, y = np.moveaxis(np.linspace(low_au, high_au, _NUM_LOOKS), -1, 0)
        places_au = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
        return self._ground.down_m(self._frame.au_to_ned(places_au))

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`."""
        return self._ground.down_m(place_ned_m)

    def slope(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`."""
        return self._ground.slope(place_ned_m)

    def places(self, pixel_px: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
        """See `Surface`: a ray that meets an obstacle before the ground has no place on it."""
        places_m = self._ground.places(pixel_px, camera, pose)
        seen_m: FloatArray = np.where(self.hides(places_m, pose)[..., None], np.nan, places_m)
        return seen_m

    def hides(self, place_ned_m: FloatArray, pose: Pose) -> BoolArray:
        """Whether an obstacle stands on places on the ground, or between them and a camera.

        place_ned_m: (..., 2) north, east -> (...)
        """
        eye_au, eye_down_m = self._eye(pose)
        way = (self._frame.ned_to_au(place_ned_m) - eye_au)[..., None, :]
        depth_m = self.down_m(place_ned_m) - eye_down_m
        with np.errstate(divide="ignore", invalid="ignore"):
            # Of the way: from there on the ray is below a top. (..., O)
            share = (self._tops_down_m - eye_down_m) / depth_m[..., None]
        below = np.clip(share, 0.0, 1.0)[..., self._whose, None] * way  # (..., E, 2)
        starts, ends = self._starts_au - eye_au, self._ends_au - eye_au
        is_cut = _are_parted(below, way, starts, ends) & _are_parted(starts, ends, below, way)
        is_met = np.logical_or.reduceat(is_cut, self._first, axis=-1)
        is_met |= self._are_around(way + eye_au)
        hidden: BoolArray = np.any(is_met & (share <= 1.0), axis=-1)
        return hidden

    def hidden_au(self, pose: Pose) -> FloatArray:
        """See `Surface`: of each sector all that is hidden in any of its directions, or more."""
        eye_au, eye_down_m = self._eye(pose)
        lowest_down_m = np.nanmax(
            self._look_about(eye_au - SENSOR_RADIUS_AU, eye_au + SENSOR_RADIUS_AU)
        )
        over_m = np.maximum(self._tops_down_m - eye_down_m, _LEAST_OVER_M)
        stretch = np.maximum((lowest_down_m - eye_down_m) / over_m, 1.0)
        starts, ends = self._starts_au - eye_au, self._ends_au - eye_au
        is_around = self._are_around(eye_au[None])
        is_near = np.minimum.reduceat(_away(starts, ends), self._first) < SENSOR_RADIUS_AU
        shown = (is_around | is_near)[self._whose]  # edges of what is within the sensor's radius
        near_au, far_au = _spans(starts[shown], ends[shown])
        near_au[is_around[self._whose[shown]]] = 0.0
        far_au *= stretch[self._whose[shown], None]
        first = np.floor(_STEPS_PER_AU * near_au.min(axis=0, initial=math.inf)) / _STEPS_PER_AU
        last = np.ceil(_STEPS_PER_AU * far_au.max(axis=0, initial=0.0)) / _STEPS_PER_AU
        hidden_au: FloatArray = np.minimum(np.stack([first, last], axis=-1), SENSOR_RADIUS_AU)
        hidden_au[first >= SENSOR_RADIUS_AU] = SENSOR_RADIUS_AU
        return hidden_au

    def _eye(self, pose: Pose) -> tuple[FloatArray, float]:
        """Where the camera is: (2,) au, and down in m."""
        return self._frame.ned_to_au(np.array(pose.position_ned_m)), pose.position_ned_m[2]

    def _are_around(self, place_au: FloatArray) -> BoolArray:
        """Which obstacles places are in. (..., 1, 2) -> (..., O)"""
        x, y = place_au[..., 0], place_au[..., 1]
        (start_x, start_y), (end_x, end_y) = self._starts_au.T, self._ends_au.T
        is_beside = (start_y > y) != (end_y > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            at_x = start_x + (y - start_y) / (end_y - start_y) * (end_x - start_x)
        around: BoolArray = np.logical_xor.reduceat(is_beside & (x < at_x), self._first, axis=-1)
        return around


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _are_parted(
    starts: FloatArray, ends: FloatArray, ones: FloatArray, others: FloatArray
) -> BoolArray:
    """Whether lines are between two places, or one of them is on it. (..., 2) each -> (...)"""
    along = ends - starts
    parted: BoolArray = _cross(along, ones - starts) * _cross(along, others - starts) <= 0.0
    return parted


def _foot(starts: FloatArray, ends: FloatArray) -> FloatArray:
    """How far along lines the nearest place to (0, 0) is, as a share of each. -> (E,)"""
    along = ends - starts
    length2 = np.maximum(np.sum(along**2, axis=-1), _LEAST)
    share: FloatArray = -np.sum(starts * along, axis=-1) / length2
    return share


def _away(starts: FloatArray, ends: FloatArray) -> FloatArray:
    """How far from (0, 0) edges are. (E, 2), (E, 2) -> (E,)"""
    share = np.clip(_foot(starts, ends), 0.0, 1.0)[:, None]
    away: FloatArray = np.linalg.norm(starts + share * (ends - starts), axis=-1)
    return away


def _spans(starts: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nearest and farthest from (0, 0) of the part of each edge that is in each sector.

    starts, ends: (E, 2) -> (E, S), (E, S), inf and 0 where no part is
    """
    along = ends - starts

    def away(share: FloatArray) -> FloatArray:
        """Of places so far along each edge. (E, S) -> (E, S)"""
        at: FloatArray = starts[:, None] + share[..., None] * along[:, None]
        return np.hypot(at[..., 0], at[..., 1])

    first, last = np.zeros((2, len(starts), _NUM_SECTORS))  # of the way along each edge
    last += 1.0
    borders_rad = np.linspace(0.0, math.tau, _NUM_SECTORS + 1)
    for side, at_rad in (1.0, borders_rad[:-1] - _WIDER_RAD), (-1.0, borders_rad[1:] + _WIDER_RAD):
        inwards = side * np.stack([-np.sin(at_rad), np.cos(at_rad)])
        inside, gain = starts @ inwards, along @ inwards
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = -inside / gain
        first = np.where(gain > 0.0, np.maximum(first, crossing), first)
        last = np.where(gain < 0.0, np.minimum(last, crossing), last)
        last = np.where((gain == 0.0) & (inside < 0.0), -1.0, last)
    is_in = first <= last + _ROUNDING
    near = away(np.clip(_foot(starts, ends)[:, None], first, np.maximum(first, last)))
    far = np.maximum(away(first), away(last))
    return np.where(is_in, near, np.inf), np.where(is_in, far, 0.0)
