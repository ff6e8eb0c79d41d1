"""Gaussian processes of several episodes at a time in torch's batched operations: on any device.

The covariance is ordered common points first, and its factor is

    [ C   0 ]      C C' = K(common, common)      A = C^-1 K(common, own)
    [ A'  D ]      D D' = K(own, own) - A' A

Source: Rasmussen & Williams (2006), algorithm 2.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from dronemon.belief.kernel import Matern32

_FAR_AU = 1e5
"""Padding points lie this far away, and from each other, where the covariance is exactly zero."""
_GROUP_SIZE = {"cpu": 8, "cuda": 512}
"""Episodes worked on together: what a core's cache, or the device, holds."""
_QUERY_SIZE = 512
"""Query points worked on together."""


class Cross(NamedTuple):
    """Covariance of a group's points with a query.

    shared: (b, 1 or N, n, m) of the shared points; own: (k, m) of those that are a target's own
    """

    shared: Tensor
    own: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """b fitted episodes of which all have c points common to their N targets, and n - c others.

    kernel:      the covariance function
    episodes:    (b,)                 which ones of the batch, laid flat
    shared:      (b, n, 3)            au, the common points, then points of most targets
    own:         three (k,)           episode, target and column where a point is not the shared one
    own_points:  (k, 3)               au
    is_believed: (b, N)               false where there are no observations
    common_root: (b, 1, c, c)         C^-1
    own_root:    (b, N, n - c, n - c) D^-1
    lean:        (b, N, n - c, c)     D^-1 A'
    weights:     (b, N, n)            covariance^-1 values, zero where a point is not the shared one
    own_weights: (k,)                 the others
    """

    kernel: Matern32
    episodes: Tensor
    shared: Tensor
    own: tuple[Tensor, ...]
    own_points: Tensor
    is_believed: Tensor
    common_root: Tensor
    own_root: Tensor
    lean: Tensor
    weights: Tensor
    own_weights: Tensor

    def predict(self, query: Tensor, mean: Tensor | None, std: Tensor | None) -> None:
        """Write mean and standard deviation, as `gp.Group` has it, a few points at a time."""
        for start in range(0, query.shape[-2], _QUERY_SIZE):
            some = slice(start, start + _QUERY_SIZE)
            cross = self._cross(query[self.episodes, :, some])
            if mean is not None:
                mean[self.episodes, :, some] = self._mean(cross)
            if std is not None:
                std[self.episodes, :, some] = self._std(cross)

    def _cross(self, query: Tensor) -> Cross:
        """Covariance with a query. query: (b, 1 or N, m, 3) au."""
        episode, target, _ = self.own
        num_sets = query.shape[1]
        index = episode if num_sets == 1 else episode * num_sets + target
        own = self.kernel.each(self.own_points, query.flatten(0, 1), index)
        return Cross(self.kernel(self.shared[:, None], query), own)

    def _mean(self, cross: Cross) -> Tensor:
        """Posterior mean. -> (b, N, m)."""
        mean = self._for_each_target(self.weights[:, :, None], cross.shared)[:, :, 0]
        own = self.own_weights[:, None] * cross.own
        return mean.index_put_(self.own[:2], own, accumulate=True)

    def _std(self, cross: Cross) -> Tensor:
        """Posterior standard deviation. -> (b, N, m)."""
        num_targets, c = self.is_believed.shape[1], self.common_root.shape[-1]
        common, own = cross.shared.tensor_split([c], dim=-2)
        own = own.expand(-1, num_targets, -1, -1).clone()  # (b, N, n - c, m)
        episode, target, column = self.own
        own[episode, target, column - c] = cross.own
        explained = self.common_root @ common  # (b, 1 or N, c, m)
        own = (self.own_root @ own).sub_(self._for_each_target(self.lean, explained))
        variance = 1.0 - explained.square_().sum(-2) - own.square_().sum(-2)
        variance.masked_fill_(~self.is_believed[..., None], 1.0)
        return variance.clamp_min_(0.0).sqrt_()

    def _for_each_target(self, matrices: Tensor, columns: Tensor) -> Tensor:
        """One product per target, or a single one if the columns are the same for all.

        matrices: (b, N, r, c); columns: (b, 1 or N, c, m) -> (b, N, r, m).
        """
        b, num_targets, r, c = matrices.shape
        if columns.shape[1] == num_targets:
            return matrices @ columns
        product = torch.bmm(matrices.reshape(b, num_targets * r, c), columns[:, 0])
        return product.view(b, num_targets, r, columns.shape[-1])


class Arranged(NamedTuple):
    """Episodes to be fitted together, their common points first.

    episodes: (b,); points: (b, N, n, 3) au; shared: (b, n, 3) au; values: (b, N, n);
    is_own: (b, N, n) where a point is not the shared one; is_believed: (b, N)
    """

    episodes: Tensor
    points: Tensor
    shared: Tensor
    values: Tensor
    is_own: Tensor
    is_believed: Tensor
    num_common: int


def arrange(points: Tensor, values: Tensor, mask: Tensor) -> list[Arranged]:
    """Put points that targets have in common first. The arguments are those of `gp.fit`."""
    is_believed = mask.any(dim=-1)
    points, shared = _shared_points(points, values, mask)
    values = torch.where(mask, values, 0.0)
    x, y, t = (points != shared[:, None]).unbind(dim=-1)
    is_own = x | y | t  # (B, N, n)
    has_own = is_own.any(dim=1)
    column = has_own.to(torch.int8).argsort(dim=-1, stable=True)
    points = points.take_along_dim(column[:, None, :, None], dim=2)
    shared = shared.take_along_dim(column[..., None], dim=1)
    values = values.take_along_dim(column[:, None], dim=2)
    is_own = is_own.take_along_dim(column[:, None], dim=2)
    num_common = mask.shape[-1] - has_own.sum(dim=-1)
    # Alike in the number of common points, episodes of a group waste little on the fewest.
    groups = torch.split(num_common.argsort(), _GROUP_SIZE[points.device.type])
    return [
        Arranged(
            episodes,
            points[episodes],
            shared[episodes],
            values[episodes],
            is_own[episodes],
            is_believed[episodes],
            int(num_common[episodes].amin()),
        )
        for episodes in groups
    ]


def _shared_points(points: Tensor, values: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Points with padding moved, and the point of each column that targets have in common.

    Padding is far away, unless a target has nothing else: it then has the shared points.
    points: (B, N, n, 3); values, mask: (B, N, n) -> (B, N, n, 3), (B, n, 3).
    """
    far = torch.arange(1, points.shape[2] + 1, device=points.device, dtype=points.dtype)
    far = (_FAR_AU * far)[:, None].expand(points.shape[0], -1, 3)
    points = torch.where(mask[..., None], points, far[:, None])
    if points.shape[1] == 0:
        return points, far
    # Of a target that was not seen, if there is one: the agent's place.
    target = torch.where(mask, values, torch.inf).argmin(dim=1)
    shared = points.take_along_dim(target[:, None, :, None], dim=1)[:, 0]
    return torch.where(mask.any(dim=-1)[..., None, None], points, shared[:, None]), shared


def fit(arranged: Arranged, kernel: Matern32, jitter: float) -> tuple[Group, Tensor]:
    """Factor the covariances of episodes, all of which have their first columns in common.

    -> the group, and which factors do not exist: (b, N) bool.
    """
    episodes, points, shared, values, is_own, is_believed, num_common = arranged
    b, num_targets, n = values.shape
    own = points[:, :, num_common:]  # (b, N, n - c, 3)
    common_root, common_info = _inverse_root(
        kernel(shared[:, :num_common], shared[:, :num_common]), jitter
    )
    coupling = common_root @ kernel(shared[:, :num_common], own.flatten(1, 2))  # A
    coupling = coupling.view(b, num_common, num_targets, n - num_common).permute(0, 2, 3, 1)
    own_root, own_info = _inverse_root(kernel(own, own) - coupling @ coupling.mT, jitter)
    lean = own_root @ coupling  # (b, N, n - c, c)

    values_common, values_own = values.tensor_split([num_common], dim=-1)
    white_common = values_common @ common_root.mT  # (b, N, c)
    white_own = (own_root @ values_own[..., None] - lean @ white_common[..., None])[..., 0]
    white_common = white_common - (white_own[..., None, :] @ lean)[..., 0, :]
    weights = torch.cat(
        [white_common @ common_root, (white_own[..., None, :] @ own_root)[..., 0, :]], dim=-1
    )
    index = is_own.nonzero(as_tuple=True)
    group = Group(
        kernel=kernel,
        episodes=episodes,
        shared=shared,
        own=index,
        own_points=points[index],
        is_believed=is_believed,
        common_root=common_root[:, None],
        own_root=own_root,
        lean=lean,
        weights=weights.masked_fill(is_own, 0.0),
        own_weights=weights[index],
    )
    return group, common_info[:, None] | own_info


def _inverse_root(covariance: Tensor, jitter: float) -> tuple[Tensor, Tensor]:
    """Inverse of the lower Cholesky factor. (..., n, n) -> (..., n, n), (...) whether it failed.

    Many queries are multiplied by it several times as fast as the factor is solved for them.
    """
    covariance.diagonal(dim1=-2, dim2=-1).add_(jitter)
    factor, info = torch.linalg.cholesky_ex(covariance)
    identity = torch.eye(factor.shape[-1], dtype=factor.dtype, device=factor.device)
    return torch.linalg.solve_triangular(factor, identity, upper=False), info != 0
