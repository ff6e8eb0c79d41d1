"""Ground that is not flat, and rays cast onto it.

Only differences of heights count, from the place of the take-off, where the vehicle says how high
the ground is: so it does not matter from which sea level a file counts.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from dronemon.frames import GeoPoint, ned_to_degrees, pixel_to_ray
from dronemon.types import CameraModel, FloatArray, Pose
from dronemon.vision.heights import HeightGrid

_MOST_REACH = 5.0
"""Metres that a ray goes aside for each down; what looks farther is as good as at the horizon."""
_MOST_STEPS = 1000
_HALVINGS = 24
_SLOPE_STEP_M = 0.5


class Terrain:
    """A `Surface` with the heights of a grid."""

    def __init__(
        self, grid: HeightGrid, origin: GeoPoint, home_ned_m: FloatArray, home_down_m: float
    ) -> None:
        """origin: of the local frame; home_ned_m, home_down_m: of the ground at the take-off."""
        self._grid, self._origin = grid, origin
        home_m = float(grid.at(ned_to_degrees(home_ned_m, origin)))
        self.level_down_m = home_down_m + home_m  # of a height of 0
        lowest, highest = np.nanmin(grid.heights_m), np.nanmax(grid.heights_m)
        self._top_m, self._bottom_m = self.level_down_m - highest, self.level_down_m - lowest

    def down_m(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`; NaN where no height is known."""
        down: FloatArray = self.level_down_m - self._grid.at(
            ned_to_degrees(place_ned_m, self._origin)
        )
        return down

    def slope(self, place_ned_m: FloatArray) -> FloatArray:
        """See `Surface`."""
        steps = _SLOPE_STEP_M * np.eye(2)
        ahead, behind = (
            self.down_m(np.asarray(place_ned_m)[..., None, :] + sign * steps)
            for sign in (1.0, -1.0)
        )
        return np.nan_to_num((ahead - behind) / (2.0 * _SLOPE_STEP_M))  # flat at the grid's edge

    def hidden_au(self, _: Pose) -> FloatArray | None:
        """See `Surface`: nothing stands on it."""
        return None

    def places(self, pixel_px: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
        """See `Surface`: steps of half a cell at most find the first cut, halvings its place."""
        ray = pixel_to_ray(pixel_px, camera, pose.attitude_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(ray[..., 2:] > 1e-6, ray[..., :2] / ray[..., 2:], np.nan)
            reach[np.linalg.norm(reach, axis=-1) > _MOST_REACH] = np.nan
        eye_m, eye_down_m = np.array(pose.position_ned_m[:2]), pose.position_ned_m[2]

        def above_m(depth_m: FloatArray) -> FloatArray:
            """How far above the ground rays are, so far below the camera. (...) -> (...)"""
            return self.down_m(eye_m + depth_m[..., None] * reach) - (eye_down_m + depth_m)

        start_m = max(0.0, self._top_m - eye_down_m - _SLOPE_STEP_M)
        end_m = max(start_m, self._bottom_m - eye_down_m) + _SLOPE_STEP_M
        most = np.nan_to_num(np.linalg.norm(reach, axis=-1)).max(initial=0.1)
        count = math.ceil(2.0 * most * (end_m - start_m) / self._grid.cell_m) + 1
        depths_m = np.linspace(start_m, end_m, min(count, _MOST_STEPS) + 1)
        high_m, low_m = np.full(reach.shape[:-1], np.nan), np.full(reach.shape[:-1], np.nan)
        for before_m, after_m in pairwise(depths_m):
            is_cut = np.isnan(low_m) & (above_m(np.full_like(low_m, after_m)) <= 0.0)
            high_m, low_m = np.where(is_cut, before_m, high_m), np.where(is_cut, after_m, low_m)
        for _ in range(_HALVINGS):
            middle_m = 0.5 * (high_m + low_m)
            is_above = above_m(middle_m) > 0.0
            high_m = np.where(is_above, middle_m, high_m)
            low_m = np.where(is_above, low_m, middle_m)
        places: FloatArray = eye_m + low_m[..., None] * reach
        return places
