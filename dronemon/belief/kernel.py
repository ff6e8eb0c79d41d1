"""The covariance function of presence fields.

Source: Rasmussen & Williams (2006), equation 4.17; length scales: paper, section III-C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dronemon.problem import LENGTH_SCALE_AU, TIME_SCALE_AU, WINDOW_TIME_SCALES


@dataclass(frozen=True, slots=True, kw_only=True)
class Matern32:
    """Unit-variance Matérn-3/2 kernel with one length scale per axis (x, y, t)."""

    length_scales_au: tuple[float, float, float] = (
        LENGTH_SCALE_AU,
        LENGTH_SCALE_AU,
        TIME_SCALE_AU,
    )

    @property
    def window_au(self) -> float:
        """Age from which an observation no longer counts."""
        return WINDOW_TIME_SCALES * self.length_scales_au[2]

    def __call__(self, a: Tensor, b: Tensor) -> Tensor:
        """Covariance of two sets of points.

        a: (..., n, 3) au; b: (..., m, 3) au -> (..., n, m) in [0, 1].
        """
        scale = self.scale(a)
        # The matrix-product form of the distance would lose half the digits of nearby points.
        r = torch.cdist(a * scale, b * scale, compute_mode="donot_use_mm_for_euclid_dist")
        decay = r.neg_().exp()
        return decay.addcmul_(decay, r, value=-1.0)  # (1 + r) exp(-r)

    def scale(self, like: Tensor) -> Tensor:
        """Factor that turns au into the distance r. -> (3,)."""
        return like.new_tensor([math.sqrt(3.0) / length_au for length_au in self.length_scales_au])
