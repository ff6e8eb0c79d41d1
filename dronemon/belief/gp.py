"""Exact Gaussian-process posteriors of presence fields, one per target, in batches.

Source: Rasmussen & Williams (2006), algorithm 2.1; kernel and length scales: paper, section III-C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dronemon.errors import BeliefError

JITTER = {torch.float64: 1e-10, torch.float32: 1e-5}
"""Added to the covariance's diagonal so that its Cholesky factor exists in that precision."""
_FAR_AU = 1e5
"""Padding points lie this far away, and from each other, where the covariance is exactly zero."""
_BLOCK = {"cpu": 1 << 18, "cuda": 1 << 26}
"""Entries of cross-covariance worked on at a time: what a core's cache, or the device, holds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Matern32:
    """Unit-variance Matérn-3/2 kernel with one length scale per axis (x, y, t)."""

    length_scales_au: tuple[float, float, float] = (0.1, 0.1, 3.0)

    def __call__(self, a: Tensor, b: Tensor) -> Tensor:
        """Covariance of two sets of points.

        a: (..., n, 3) au; b: (..., m, 3) au -> (..., n, m) in [0, 1].
        """
        scale = math.sqrt(3.0) / a.new_tensor(self.length_scales_au)
        # The matrix-product form of the distance would lose half the digits of nearby points.
        r = torch.cdist(a * scale, b * scale, compute_mode="donot_use_mm_for_euclid_dist")
        decay = r.neg_().exp()
        return decay.addcmul_(decay, r, value=-1.0)  # (1 + r) exp(-r)


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """Fitted processes of N targets, of zero prior mean and unit prior variance, in batches.

    points:   (..., N, n, 3) au, padding moved far away
    shared:   (..., n, 3)    au, the point of each column that targets have in common
    cholesky: (..., N, n, n) lower factor of the points' covariance
    weights:  (..., N, n)    covariance^-1 values; zero for padding
    """

    kernel: Matern32
    points: Tensor
    shared: Tensor
    cholesky: Tensor
    weights: Tensor

    def predict(self, query: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and standard deviation.

        query: (..., N, m, 3) au, or (..., 1, m, 3) or (m, 3), the same points for all targets,
        which is faster -> mean, std, both (..., N, m).

        Source: paper, equation 2.
        """
        return self._in_blocks(query, with_mean=True, with_std=True)

    def mean(self, query: Tensor) -> Tensor:
        """Posterior mean alone. query: as for `predict` -> (..., N, m)."""
        return self._in_blocks(query, with_mean=True, with_std=False)[0]

    def std(self, query: Tensor) -> Tensor:
        """Posterior standard deviation alone. query: as for `predict` -> (..., N, m) in [0, 1]."""
        return self._in_blocks(query, with_mean=False, with_std=True)[1]

    def _in_blocks(
        self, query: Tensor, *, with_mean: bool, with_std: bool
    ) -> tuple[Tensor, Tensor]:
        """Predict a few batch elements at a time, so that their cross-covariance stays in cache."""
        query = query[None] if query.dim() == 2 else query
        batch = np.broadcast_shapes(self.points.shape[:-3], query.shape[:-3])
        size = math.prod(batch)
        points, shared, cholesky, weights, query = (
            x.expand(*batch, *x.shape[-dims:]).reshape(size, *x.shape[-dims:])
            for x, dims in zip(
                (self.points, self.shared, self.cholesky, self.weights, query),
                (3, 2, 3, 2, 3),
                strict=True,
            )
        )
        num_targets, n = weights.shape[1:]
        m, is_common = query.shape[-2], query.shape[1] < num_targets
        mean = query.new_empty((size, num_targets, m if with_mean else 0))
        std = query.new_empty((size, num_targets, m if with_std else 0))
        step = max(1, _BLOCK[query.device.type] // max(1, num_targets * n * m))
        for start in range(0, size, step):
            block = slice(start, start + step)
            if is_common and not with_std:
                mean[block] = self._common_mean(
                    points[block], shared[block], weights[block], query[block, 0]
                )
                continue
            if is_common:
                cross = self._common_cross(points[block], shared[block], query[block, 0])
            else:
                cross = self.kernel(points[block], query[block])  # (block, N, n, m)
            if with_mean:
                mean[block] = (weights[block, :, None] @ cross)[:, :, 0]
            if with_std:
                explained = torch.linalg.solve_triangular(cholesky[block], cross, upper=False)
                variance = 1.0 - explained.square_().sum(-2)
                std[block] = variance.clamp_min_(0.0).sqrt_()
        return mean.reshape(*batch, *mean.shape[1:]), std.reshape(*batch, *std.shape[1:])

    def _common_cross(self, points: Tensor, shared: Tensor, query: Tensor) -> Tensor:
        """Covariance of all targets' points with a common query; a shared point's is found once.

        points: (b, N, n, 3); shared: (b, n, 3); query: (b, m, 3) -> (b, N, n, m).
        """
        cross = self.kernel(shared, query)[:, None].repeat(1, points.shape[1], 1, 1)
        own = (points != shared[:, None]).any(dim=-1).nonzero(as_tuple=True)
        cross[own] = self.kernel(points[own][:, None], query[own[0]])[:, 0]
        return cross

    def _common_mean(
        self, points: Tensor, shared: Tensor, weights: Tensor, query: Tensor
    ) -> Tensor:
        """Posterior means at a common query, without every target's own cross-covariance.

        points, shared, query: as above; weights: (b, N, n) -> (b, N, m).
        """
        is_own = (points != shared[:, None]).any(dim=-1)
        mean = weights.masked_fill(is_own, 0.0) @ self.kernel(shared, query)
        episode, target, index = (is_own & (weights != 0.0)).nonzero(as_tuple=True)
        own = (episode, target, index)
        cross = self.kernel(points[own][:, None], query[episode])[:, 0]
        return mean.index_put_((episode, target), weights[own][:, None] * cross, accumulate=True)


def fit(
    points: Tensor,
    values: Tensor,
    mask: Tensor,
    kernel: Matern32 | None = None,
    jitter: float | None = None,
) -> Posterior:
    """Condition zero-mean Gaussian processes on noiseless observations.

    points: (..., N, n, 3) au x, y, t
    values: (..., N, n)    1 presence, 0 absence
    mask:   (..., N, n)    bool; false marks padding, whose points and values are ignored
    jitter: added to the diagonal; by default what the precision needs
    -> a `Posterior` on the device and in the precision of `points`.

    Raises BeliefError if a covariance is not positive definite.
    """
    n = points.shape[-2]
    kernel = kernel if kernel is not None else Matern32()
    jitter = jitter if jitter is not None else JITTER[points.dtype]
    far = _FAR_AU * torch.arange(1, n + 1, device=points.device, dtype=points.dtype)
    points = torch.where(mask[..., None], points, far[:, None])
    values = torch.where(mask, values, 0.0)
    covariance = kernel(points, points)  # (..., N, n, n)
    covariance.diagonal(dim1=-2, dim2=-1).add_(jitter)
    cholesky, info = torch.linalg.cholesky_ex(covariance)
    if bool((info != 0).any()):
        raise BeliefError(
            f"{int((info != 0).sum())} of {info.numel()} covariances of {n} observations are not"
            f" positive definite with jitter {jitter:g} in {points.dtype}; look for observations"
            " that repeat or are not finite, or use float64"
        )
    return Posterior(
        kernel=kernel,
        points=points,
        shared=_common_points(points, values, mask),
        cholesky=cholesky,
        weights=torch.cholesky_solve(values[..., None], cholesky)[..., 0],
    )


def _common_points(points: Tensor, values: Tensor, mask: Tensor) -> Tensor:
    """The point of one target in each column: of one that was not seen, if there is one.

    Targets that one measurement did not see have the agent's position in common.
    (..., N, n, 3), (..., N, n) twice -> (..., n, 3).
    """
    if points.shape[-3] == 0:
        return points.new_zeros(*points.shape[:-3], *points.shape[-2:])
    rank = torch.where(mask, values, torch.inf)
    target = rank.argmin(dim=-2)[..., None, :, None].expand(*points.shape[:-3], 1, -1, 3)
    return points.gather(-3, target)[..., 0, :, :]
