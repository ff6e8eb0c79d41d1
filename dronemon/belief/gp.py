"""Exact Gaussian-process posteriors of presence fields, one per target, in batches.

On a processor in double precision they are fitted by compiled loops, which find once what all
targets have in common, as the agent's positions; elsewhere by torch's operations.

Source: Rasmussen & Williams (2006), algorithm 2.1.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from typing import Protocol, TypeVar

import torch
from torch import Tensor

from dronemon.belief import batched, compiled
from dronemon.belief.kernel import Matern32
from dronemon.errors import BeliefError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_JITTER = {torch.float64: 1e-10, torch.float32: 1e-5}
"""Added to the covariance's diagonal so that its Cholesky factor exists in that precision."""


class Group(Protocol):
    """Fitted processes of some episodes of a batch, worked on together."""

    def predict(self, query: Tensor, mean: Tensor | None, std: Tensor | None) -> None:
        """Write posterior mean and standard deviation of these episodes; None is left out.

        query: (B, 1 or N, m, 3) au, of all episodes; mean, std: (B, N, m), of all episodes.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """Fitted processes of N targets, of zero prior mean and unit prior variance, in batches.

    shape: (..., N)
    """

    shape: tuple[int, ...]
    groups: Sequence[Group]
    num_threads: int

    def predict(self, query: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and standard deviation.

        query: (..., N, m, 3) au, or (..., 1, m, 3) or (m, 3), the same points for all targets,
        which is faster -> mean, std, both (..., N, m).

        Source: paper, equation 2.
        """
        mean, std = self._empty(query), self._empty(query)
        self._evaluate(query, mean, std)
        return mean, std

    def mean(self, query: Tensor) -> Tensor:
        """Posterior mean alone. query: as for `predict` -> (..., N, m)."""
        mean = self._empty(query)
        self._evaluate(query, mean, None)
        return mean

    def std(self, query: Tensor) -> Tensor:
        """Posterior standard deviation alone. query: as for `predict` -> (..., N, m) in [0, 1]."""
        std = self._empty(query)
        self._evaluate(query, None, std)
        return std

    def _empty(self, query: Tensor) -> Tensor:
        return query.new_empty((*self.shape, query.shape[-2]))

    def _evaluate(self, query: Tensor, mean: Tensor | None, std: Tensor | None) -> None:
        """Have every group write its part."""
        query = query[None] if query.dim() == 2 else query
        *batch, num_targets = self.shape
        size = math.prod(batch)
        query = query.expand(*batch, *query.shape[-3:]).reshape(size, *query.shape[-3:])
        flat = (size, num_targets, query.shape[-2])
        mean, std = (out if out is None else out.view(flat) for out in (mean, std))
        _in_threads(lambda group: group.predict(query, mean, std), self.groups, self.num_threads)


def fit(
    points: Tensor,
    values: Tensor,
    mask: Tensor,
    kernel: Matern32 | None = None,
    num_threads: int = 1,
) -> Posterior:
    """Condition zero-mean Gaussian processes on noiseless observations.

    points: (..., N, n, 3) au x, y, t
    values: (..., N, n)    1 presence, 0 absence
    mask:   (..., N, n)    bool; false marks padding, whose points and values are ignored
    num_threads: that share the episodes of the compiled loops, here and in the posterior
    -> a `Posterior` on the device and in the precision of `points`.

    Raises BeliefError if a covariance is not positive definite.
    """
    shape = values.shape
    kernel = kernel if kernel is not None else Matern32()
    jitter = _JITTER[points.dtype]
    size = math.prod(shape[:-2])
    points = points.reshape(size, *points.shape[-3:])
    values, mask = (x.reshape(size, *shape[-2:]) for x in (values, mask))
    if is_compiled(points):
        groups, num_failed = _fit_compiled(points, values, mask, kernel, jitter, num_threads)
    else:
        group, num_failed = batched.fit(points, values, mask, kernel, jitter)
        groups = [group]
    if num_failed:
        raise BeliefError(
            f"{num_failed} of {shape[:-1].numel()} covariances of {shape[-1]} observations are not"
            f" positive definite with jitter {jitter:g} in {points.dtype}; look for observations"
            " that repeat or are not finite, or use float64"
        )
    return Posterior(shape=shape[:-1], groups=groups, num_threads=num_threads)


def is_compiled(points: Tensor) -> bool:
    """Whether points are where the compiled loops work: ten times as fast as torch's operations."""
    return points.device.type == "cpu" and points.dtype == torch.float64


def _fit_compiled(
    points: Tensor, values: Tensor, mask: Tensor, kernel: Matern32, jitter: float, num_threads: int
) -> tuple[Sequence[Group], int]:
    """Fit in compiled loops, a group for each thread. -> groups, how many fits failed."""
    size = len(points)
    group_size = max(1, math.ceil(size / num_threads))
    episodes = [slice(start, start + group_size) for start in range(0, size, group_size)]
    fit_group = partial(
        compiled.fit,
        points.contiguous().numpy(),
        values.contiguous().numpy(),
        mask.contiguous().numpy(),
        kernel.scale(points).numpy(),
        jitter,
    )
    fitted = _in_threads(fit_group, episodes, num_threads)
    return [group for group, _ in fitted], sum(num_failed for _, num_failed in fitted)


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
