"""Exact Gaussian processes of a batch in torch's operations: on any device and in any precision.

The plain form that `compiled` is held to.

Source: Rasmussen & Williams (2006), algorithm 2.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dronemon.belief.kernel import Matern32

_FAR_AU = 1e5
"""Padding points lie this far away, and from each other, where the covariance is exactly zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """All fitted processes of a batch.

    points:  (B, N, n, 3) au, padding far away
    factor:  (B, N, n, n) lower Cholesky factor of their covariance
    weights: (B, N, n)    covariance^-1 values
    """

    kernel: Matern32
    points: Tensor
    factor: Tensor
    weights: Tensor

    def predict(self, query: Tensor, mean: Tensor | None, std: Tensor | None) -> None:
        """Write mean and standard deviation, as `gp.Group` has it."""
        cross = self.kernel(self.points, query)  # (B, N, n, m)
        if mean is not None:
            mean.copy_((self.weights[..., None, :] @ cross)[..., 0, :])
        if std is not None:
            explained = torch.linalg.solve_triangular(self.factor, cross, upper=False)
            std.copy_((1.0 - explained.square().sum(-2)).clamp_min(0.0).sqrt())


def fit(
    points: Tensor, values: Tensor, mask: Tensor, kernel: Matern32, jitter: float
) -> tuple[Group, int]:
    """Fit a batch. The arguments are those of `gp.fit`. -> the group, how many have no factor."""
    far_au = _FAR_AU * torch.arange(1, points.shape[-2] + 1, device=points.device)
    points = torch.where(mask[..., None], points, far_au[:, None].to(points.dtype))
    covariance = kernel(points, points)
    covariance.diagonal(dim1=-2, dim2=-1).add_(jitter)
    factor, info = torch.linalg.cholesky_ex(covariance)
    levels = torch.where(mask, values, 0.0)[..., None]
    weights = torch.cholesky_solve(levels, factor)[..., 0]
    group = Group(kernel=kernel, points=points, factor=factor, weights=weights)
    return group, int((info != 0).sum())
