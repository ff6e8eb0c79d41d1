"""Exact Gaussian-process posteriors of presence fields, one per target, in batches.

Targets of an episode that were not seen have the agent's position in common. What depends on
points that all targets have in common is found once: the covariance is ordered common points
first, and its factor is

    [ C   0 ]      C C' = K(common, common)      A = C^-1 K(common, own)
    [ A'  D ]      D D' = K(own, own) - A' A

Source: Rasmussen & Williams (2006), algorithm 2.1.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from dronemon.belief.kernel import Matern32
from dronemon.errors import BeliefError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

JITTER = {torch.float64: 1e-10, torch.float32: 1e-5}
"""Added to the covariance's diagonal so that its Cholesky factor exists in that precision."""
_FAR_AU = 1e5
"""Padding points lie this far away, and from each other, where the covariance is exactly zero."""
_GROUP_SIZE = {"cpu": 8, "cuda": 512}
"""Episodes worked on together: what a core's cache, or the device, holds."""
_QUERY_SIZE = 512
"""Query points worked on together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """Fitted processes of N targets, of zero prior mean and unit prior variance, in batches.

    shape: (..., N)
    """

    kernel: Matern32
    shape: tuple[int, ...]
    groups: tuple[Group, ...]
    num_threads: int

    def predict(self, query: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and standard deviation.

        query: (..., N, m, 3) au, or (..., 1, m, 3) or (m, 3), the same points for all targets,
        which is faster -> mean, std, both (..., N, m).

        Source: paper, equation 2.
        """
        return self._evaluate(query, with_mean=True, with_std=True)

    def mean(self, query: Tensor) -> Tensor:
        """Posterior mean alone. query: as for `predict` -> (..., N, m)."""
        return self._evaluate(query, with_mean=True, with_std=False)[0]

    def std(self, query: Tensor) -> Tensor:
        """Posterior standard deviation alone. query: as for `predict` -> (..., N, m) in [0, 1]."""
        return self._evaluate(query, with_mean=False, with_std=True)[1]

    def _evaluate(self, query: Tensor, *, with_mean: bool, with_std: bool) -> tuple[Tensor, Tensor]:
        """Predict a few episodes and points at a time, so that all stays in cache."""
        query = query[None] if query.dim() == 2 else query
        *batch, num_targets = self.shape
        size, m = math.prod(batch), query.shape[-2]
        query = query.expand(*batch, *query.shape[-3:]).reshape(size, *query.shape[-3:])
        mean = query.new_empty((size, num_targets, m if with_mean else 0))
        std = query.new_empty((size, num_targets, m if with_std else 0))

        def evaluate(group: Group) -> None:
            for start in range(0, m, _QUERY_SIZE):
                some = slice(start, start + _QUERY_SIZE)
                cross = group.cross(self.kernel, query[group.episodes, :, some])
                if with_mean:
                    mean[group.episodes, :, some] = group.mean(cross)
                if with_std:
                    std[group.episodes, :, some] = group.std(cross)

        _in_threads(evaluate, self.groups, self.num_threads)
        return mean.reshape(*batch, *mean.shape[1:]), std.reshape(*batch, *std.shape[1:])


class Cross(NamedTuple):
    """Covariance of a group's points with a query.

    shared: (b, 1 or N, n, m) of the shared points; own: (k, m) of those that are a target's own
    """

    shared: Tensor
    own: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """b episodes of which all have c points common to their N targets, and n - c others.

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

    def cross(self, kernel: Matern32, query: Tensor) -> Cross:
        """Covariance with a query. query: (b, 1 or N, m, 3) au."""
        episode, target, _ = self.own
        num_sets = query.shape[1]
        index = episode if num_sets == 1 else episode * num_sets + target
        own = kernel.each(self.own_points, query.flatten(0, 1), index)
        return Cross(kernel(self.shared[:, None], query), own)

    def mean(self, cross: Cross) -> Tensor:
        """Posterior mean. -> (b, N, m)."""
        mean = self._for_each_target(self.weights[:, :, None], cross.shared)[:, :, 0]
        own = self.own_weights[:, None] * cross.own
        return mean.index_put_(self.own[:2], own, accumulate=True)

    def std(self, cross: Cross) -> Tensor:
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


def fit(
    points: Tensor,
    values: Tensor,
    mask: Tensor,
    kernel: Matern32 | None = None,
    jitter: float | None = None,
    num_threads: int = 1,
) -> Posterior:
    """Condition zero-mean Gaussian processes on noiseless observations.

    points: (..., N, n, 3) au x, y, t
    values: (..., N, n)    1 presence, 0 absence
    mask:   (..., N, n)    bool; false marks padding, whose points and values are ignored
    jitter: added to the diagonal; by default what the precision needs
    num_threads: that share the episodes, here and in the posterior; each does torch's work alone
        if torch.set_num_threads(1) was called, which many small matrices need
    -> a `Posterior` on the device and in the precision of `points`.

    Raises BeliefError if a covariance is not positive definite.
    """
    shape = values.shape
    kernel = kernel if kernel is not None else Matern32()
    jitter = jitter if jitter is not None else JITTER[points.dtype]
    size = math.prod(shape[:-2])
    points = points.reshape(size, *points.shape[-3:])
    values, mask = (x.reshape(size, *shape[-2:]) for x in (values, mask))
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
    num_common = shape[-1] - has_own.sum(dim=-1)
    # Alike in the number of common points, episodes of a group waste little on the fewest.
    groups = torch.split(num_common.argsort(), _GROUP_SIZE[points.device.type])

    def fit_group(episodes: Tensor) -> tuple[Group, Tensor]:
        return _fit_group(
            episodes,
            points[episodes],
            shared[episodes],
            values[episodes],
            is_own[episodes],
            is_believed[episodes],
            num_common=int(num_common[episodes].amin()),
            kernel=kernel,
            jitter=jitter,
        )

    fitted = _in_threads(fit_group, groups, num_threads)
    num_failed = int(sum(is_bad.sum() for _, is_bad in fitted))
    if num_failed:
        raise BeliefError(
            f"{num_failed} of {shape[:-1].numel()} covariances of {shape[-1]} observations are not"
            f" positive definite with jitter {jitter:g} in {points.dtype}; look for observations"
            " that repeat or are not finite, or use float64"
        )
    return Posterior(
        kernel=kernel,
        shape=shape[:-1],
        groups=tuple(group for group, _ in fitted),
        num_threads=num_threads,
    )


def _in_threads(
    work: Callable[[_Item], _Result], items: Sequence[_Item], num_threads: int
) -> list[_Result]:
    """What comes of some work that leaves the interpreter free, in the items' order."""
    if num_threads == 1:
        return [work(item) for item in items]
    return list(_pool(num_threads, os.getpid()).map(work, items))


@cache
def _pool(num_threads: int, process_id: int) -> ThreadPoolExecutor:
    """Threads that keep their memory from one use to the next; a forked process has its own."""
    return ThreadPoolExecutor(num_threads, thread_name_prefix=f"belief-{process_id}")


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


def _fit_group(
    episodes: Tensor,
    points: Tensor,
    shared: Tensor,
    values: Tensor,
    is_own: Tensor,
    is_believed: Tensor,
    *,
    num_common: int,
    kernel: Matern32,
    jitter: float,
) -> tuple[Group, Tensor]:
    """Factor the covariances of episodes, all of which have their first columns in common.

    -> the group, and which factors do not exist: (b, N) bool.
    """
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
