"""The grid at which beliefs are compared with the truth, over an arena of any form.

Source: paper, section V-A: 40 x 40 points over the square.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache

import numpy as np
import torch
from torch import Tensor

from dronemon.arena import Arena
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import FloatArray

GRID_SIZE = 40
"""Points along each side of the square, both borders included."""
_AREA_SPAN = math.floor(2.0 * SENSOR_RADIUS_AU * (GRID_SIZE - 1)) + 1
"""Most grid points of a target area along one axis."""


class EvaluationGrid:
    """Points over the box of an arena, as far apart as the square's; those of its field count.

    points_au: (Q, 2) those in the field, y changing fastest
    """

    def __init__(self, arena: Arena) -> None:
        self._arena = arena
        low, high = arena.bounds
        self._size = np.rint((GRID_SIZE - 1) * arena.extent_au).astype(np.int64) + 1
        self.axes_au: list[FloatArray] = [
            np.linspace(low[k], high[k], int(self._size[k])) for k in (0, 1)
        ]
        points_au = np.stack(np.meshgrid(*self.axes_au, indexing="ij"), axis=-1).reshape(-1, 2)
        self._is_in_field = torch.as_tensor(arena.contains(points_au))
        self.points_au = torch.as_tensor(points_au)[self._is_in_field]
        self._steps_per_au = (self._size - 1) / arena.extent_au

    def bumps(self, targets_au: Tensor, std_au: float) -> Tensor:
        """Unit Gaussian bumps around targets. (..., 2) au -> (..., Q)."""
        x, y = (
            torch.exp(
                -0.5 * ((targets_au.new_tensor(axis) - targets_au[..., k, None]) / std_au).square()
            )
            for k, axis in enumerate(self.axes_au)
        )
        bumps = (x[..., :, None] * y[..., None, :]).flatten(-2)
        return bumps if self._is_whole else bumps[..., self._is_in_field]

    def target_area(self, targets_au: Tensor) -> tuple[Tensor, Tensor]:
        """Grid points in the field nearer than 0.1 au to each target.

        A target so far outside that there are none has the area of the nearest place that has.

        targets_au: (..., 2) au
        -> points (..., 64, 2) au, the square of grid points around the target, and
           is_inside (..., 64) bool, which of them are in the area
        """
        points, is_inside = self._points_around(targets_au)
        is_outside = ~is_inside.any(dim=-1, keepdim=True)
        if not bool(is_outside.any()):
            return points, is_inside
        return self._points_around(torch.where(is_outside, self._nearest(targets_au), targets_au))

    @cached_property
    def _is_whole(self) -> bool:
        """Whether all of the box is field."""
        return bool(self._is_in_field.all())

    def _nearest(self, targets_au: Tensor) -> Tensor:
        if self._is_whole:
            return targets_au.clamp(*targets_au.new_tensor(self._arena.bounds))
        points_au = self.points_au.to(targets_au)
        return points_au[torch.cdist(targets_au.reshape(-1, 2), points_au).argmin(dim=1)].reshape(
            targets_au.shape
        )

    def _points_around(self, targets_au: Tensor) -> tuple[Tensor, Tensor]:
        low = targets_au.new_tensor(self._arena.low_au)
        per_au, size = targets_au.new_tensor(self._steps_per_au), targets_au.new_tensor(self._size)
        first = torch.ceil((targets_au - SENSOR_RADIUS_AU - low) * per_au)  # (..., 2)
        steps = torch.arange(_AREA_SPAN, dtype=targets_au.dtype, device=targets_au.device)
        index = first[..., None] + steps  # (..., 2, 8)
        is_on_grid = (index >= 0) & (index < size[:, None])
        axes = index / per_au[:, None] + low[:, None]
        shape = (*targets_au.shape[:-1], _AREA_SPAN, _AREA_SPAN)
        points = torch.stack(
            [axes[..., 0, :, None].expand(shape), axes[..., 1, None, :].expand(shape)], dim=-1
        ).flatten(-3, -2)
        is_inside = (is_on_grid[..., 0, :, None] & is_on_grid[..., 1, None, :]).flatten(-2)
        if not self._is_whole:
            column, row = (i.clamp_min(0).long() for i in index.unbind(-2))
            column, row = column.clamp_max(self._size[0] - 1), row.clamp_max(self._size[1] - 1)
            number = column[..., :, None] * int(self._size[1]) + row[..., None, :]
            is_inside &= self._is_in_field.to(is_inside.device)[number.flatten(-2)]
        distance_au = torch.linalg.vector_norm(points - targets_au[..., None, :], dim=-1)
        return points, is_inside & (distance_au < SENSOR_RADIUS_AU)


@lru_cache(maxsize=16)
def evaluation_grid(arena: Arena) -> EvaluationGrid:
    """Grid of an arena, the same object whenever it is asked for."""
    return EvaluationGrid(arena)
