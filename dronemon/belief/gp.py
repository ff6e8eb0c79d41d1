"""Exact Gaussian-process posteriors of presence fields, one per target, in batches.

Source: Rasmussen & Williams (2006), algorithm 2.1; kernel and length scales: paper, section III-C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
    """A batch of fitted Gaussian processes of zero prior mean and unit prior variance.

    points: (..., n, 3) au, padding moved far away; cholesky: (..., n, n) lower factor of their
    covariance; weights: (..., n) covariance⁻¹ · values, zero for padding.
    """

    kernel: Matern32
    points: Tensor
    cholesky: Tensor
    weights: Tensor

    def predict(self, query: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and standard deviation. query: (..., m, 3) au -> mean, std, both (..., m).

        The batch dimensions of `query` broadcast against those of the fit.
        Source: paper, equation 2.
        """
        mean, std = self._in_blocks(query, with_mean=True, with_std=True)
        return mean, std

    def mean(self, query: Tensor) -> Tensor:
        """Posterior mean alone. query: (..., m, 3) au -> (..., m)."""
        return self._in_blocks(query, with_mean=True, with_std=False)[0]

    def std(self, query: Tensor) -> Tensor:
        """Posterior standard deviation alone. query: (..., m, 3) au -> (..., m) in [0, 1]."""
        return self._in_blocks(query, with_mean=False, with_std=True)[1]

    def common_mean(self, query: Tensor, shared: Tensor) -> Tensor:
        """Posterior means of N processes at the same points: `mean`, but faster for many of them.

        The covariance with a point that several processes share is worked out once.

        query: (m, 3) au; shared: (n, 3) au, points that many processes have -> (N, m).
        """
        n = shared.shape[0]
        is_own = (self.points != shared).any(dim=-1) & (self.weights != 0.0)  # (N, n)
        process, index = is_own.nonzero(as_tuple=True)
        points = torch.cat([shared, self.points[process, index]])
        weights = self.weights.new_zeros(self.weights.shape[0], points.shape[0])
        weights[:, :n] = self.weights.masked_fill(is_own, 0.0)
        weights[process, n + torch.arange(len(index))] = self.weights[process, index]
        return weights @ self.kernel(points, query)

    def __getitem__(self, index: int) -> Posterior:
        """The processes at an index of the first batch dimension."""
        return replace(
            self,
            points=self.points[index],
            cholesky=self.cholesky[index],
            weights=self.weights[index],
        )

    def _in_blocks(
        self, query: Tensor, *, with_mean: bool, with_std: bool
    ) -> tuple[Tensor, Tensor]:
        """Predict a few batch elements at a time, so that their cross-covariance stays in cache."""
        n, m = self.points.shape[-2], query.shape[-2]
        batch = np.broadcast_shapes(self.points.shape[:-2], query.shape[:-2])
        points = self.points.expand(*batch, n, 3).reshape(-1, n, 3)
        cholesky = self.cholesky.expand(*batch, n, n).reshape(-1, n, n)
        weights = self.weights.expand(*batch, n).reshape(-1, n)
        query = query.expand(*batch, m, 3).reshape(-1, m, 3)
        size = points.shape[0]
        mean = query.new_empty((size, m if with_mean else 0))
        std = query.new_empty((size, m if with_std else 0))
        step = max(1, _BLOCK[query.device.type] // max(1, n * m))
        for start in range(0, size, step):
            block = slice(start, start + step)
            cross = self.kernel(points[block], query[block])  # (block, n, m)
            if with_mean:
                mean[block] = (weights[block, None, :] @ cross)[:, 0]
            if with_std:
                explained = torch.linalg.solve_triangular(cholesky[block], cross, upper=False)
                variance = 1.0 - explained.square_().sum(-2)
                std[block] = variance.clamp_min_(0.0).sqrt_()
        return mean.reshape(*batch, mean.shape[1]), std.reshape(*batch, std.shape[1])


def fit(
    points: Tensor,
    values: Tensor,
    mask: Tensor,
    kernel: Matern32 | None = None,
    jitter: float | None = None,
) -> Posterior:
    """Condition zero-mean Gaussian processes on noiseless observations.

    points: (..., n, 3) au x, y, t
    values: (..., n)    1 presence, 0 absence
    mask:   (..., n)    bool; false marks padding, whose points and values are ignored
    jitter: added to the diagonal; by default what the precision needs
    -> a `Posterior` on the device and in the precision of `points`.

    Raises BeliefError if a covariance is not positive definite.
    """
    n = points.shape[-2]
    kernel = kernel if kernel is not None else Matern32()
    jitter = jitter if jitter is not None else JITTER[points.dtype]
    far = _FAR_AU * torch.arange(1, n + 1, device=points.device, dtype=points.dtype)
    points = torch.where(mask[..., None], points, far[:, None])
    covariance = kernel(points, points)  # (..., n, n)
    covariance.diagonal(dim1=-2, dim2=-1).add_(jitter)
    cholesky, info = torch.linalg.cholesky_ex(covariance)
    if bool((info != 0).any()):
        raise BeliefError(
            f"{int((info != 0).sum())} of {info.numel()} covariances of {n} observations are not"
            f" positive definite with jitter {jitter:g} in {points.dtype}; look for observations"
            " that repeat or are not finite, or use float64"
        )
    values = torch.where(mask, values, 0.0)
    weights = torch.cholesky_solve(values[..., None], cholesky)[..., 0]
    return Posterior(kernel=kernel, points=points, cholesky=cholesky, weights=weights)
