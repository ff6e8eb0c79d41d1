"""Exact Gaussian processes of a few episodes on a processor: the compiled inside of the belief.

Points that all of an episode's targets have in common come first. What they explain is found once,
for the queries and for all points that only some targets have ("others", each listed once):

    U' U = K(common, common)      A = U'^-1 K(common, others)
    D' D = K(own, own) - a' a     for each target, of those others that are its own, a out of A

All elimination goes by blocks of four rows; see `blocks`.

Source: Rasmussen & Williams (2006), algorithm 2.1.
"""

# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from torch import Tensor

from dronemon.belief.blocks import (
    BLOCK,
    VECTOR,
    aligned,
    cholesky,
    dot,
    eliminate,
    subtract,
    subtract_squares,
    up,
)
from dronemon.belief.covariance import fill_row
from dronemon.types import BoolArray, FloatArray, IntArray

_compiled = partial(njit, cache=True, error_model="numpy", nogil=True)

_TILE = 512
"""Query points worked on together: with the covariances of all points they stay in cache."""


class Fitted(NamedTuple):
    """Fitted processes of b episodes.

    scale: (3,) factor that turns au into the distance r; the others: `_arrange`, `_factorise`
    """

    scale: FloatArray
    table: FloatArray
    counts: IntArray
    own: IntArray
    num_own: IntArray
    factor: FloatArray
    roots: FloatArray
    weights: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Fitted processes of episodes next to each other in a batch."""

    episodes: slice
    fitted: Fitted

    def predict(self, query: Tensor, mean: Tensor | None, std: Tensor | None) -> None:
        """Write mean and standard deviation, as `gp.Group` has it."""
        points = query[self.episodes].contiguous().numpy()
        nothing = np.empty((len(points), self.fitted.own.shape[1], 0))
        _predict(
            self.fitted,
            points,
            nothing if mean is None else mean[self.episodes].numpy(),
            nothing if std is None else std[self.episodes].numpy(),
        )


def is_ready() -> bool:
    """Whether an earlier process has left compiled loops on this machine, of this code or older."""
    folder = _predict.stats.cache_path
    return folder is not None and any(Path(folder).glob("compiled._predict-*.nbi"))


def fit(
    points: FloatArray,
    values: FloatArray,
    mask: BoolArray,
    scale: FloatArray,
    jitter: float,
    episodes: slice,
) -> tuple[Group, int]:
    """Fit some episodes of a batch. -> the group, how many of its covariances have no factor.

    points: (B, N, n, 3) au; values, mask: (B, N, n), all C-contiguous; scale: as in `Fitted`
    """
    table, counts, own, num_own, levels = _arrange(
        points[episodes], values[episodes], mask[episodes], scale
    )
    factor, roots, weights, num_failed = _factorise(table, counts, own, num_own, levels, jitter)
    fitted = Fitted(scale, table, counts, own, num_own, factor, roots, weights)
    return Group(episodes=episodes, fitted=fitted), num_failed


@_compiled()
def _arrange(points, values, mask, scale):
    """Put the common points first, and list all others once. The arguments are those of `fit`.

    -> table (b, rows, 3) scaled points; counts (b, 2) of common points, a multiple of the block,
    and of all; own (b, N, n) rows of a target's others; num_own (b, N), -1 if there are no
    observations; levels (b, N, n) values of the common points, then of a target's own.
    """
    size, num_targets, n = values.shape
    table = np.empty((size, num_targets * n, 3))
    counts = np.zeros((size, 2), dtype=np.int64)
    own = np.empty((size, num_targets, n), dtype=np.int64)
    num_own = np.full((size, num_targets), -1, dtype=np.int64)
    levels = np.zeros((size, num_targets, n))
    is_common = np.empty(n, dtype=np.bool_)
    row_of = np.empty(num_targets, dtype=np.int64)
    for b in range(size):
        first, num_common = _find_common(points[b], mask[b], num_own[b], is_common)
        common, row = 0, num_common
        for k in range(n):
            if is_common[k] and common < num_common:
                for axis in range(3):
                    table[b, common, axis] = points[b, first, k, axis] * scale[axis]
                for i in range(num_targets):
                    if num_own[b, i] >= 0:
                        levels[b, i, common] = values[b, i, k]
                common += 1
                continue
            for i in range(first, num_targets):
                if not mask[b, i, k]:
                    continue
                row_of[i] = row
                for j in range(first, i):
                    if mask[b, j, k] and _is_same(points[b], k, i, j):
                        row_of[i] = row_of[j]
                        break
                if row_of[i] == row:
                    for axis in range(3):
                        table[b, row, axis] = points[b, i, k, axis] * scale[axis]
                    row += 1
                own[b, i, num_own[b, i]] = row_of[i]
                levels[b, i, num_common + num_own[b, i]] = values[b, i, k]
                num_own[b, i] += 1
        counts[b, 0], counts[b, 1] = num_common, row
    return table, counts, own, num_own, levels


@_compiled()
def _find_common(points, mask, num_own, is_common):
    """Mark with 0 the targets that have observations, and the columns that they have in common.

    -> the first such target, and how many of these columns make whole blocks.
    """
    num_targets, n = mask.shape
    first = num_targets
    for i in range(num_targets - 1, -1, -1):
        if mask[i].any():
            num_own[i] = 0
            first = i
    num_common = 0
    for k in range(n):
        is_common[k] = first < num_targets and mask[first, k]
        for i in range(first + 1, num_targets):
            if num_own[i] == 0:
                is_common[k] &= mask[i, k] and _is_same(points, k, i, first)
        num_common += is_common[k]
    return first, num_common // BLOCK * BLOCK


@_compiled()
def _is_same(points, k, i, j):
    """Whether two targets have the same point in a column. points: (N, n, 3)."""
    is_same = True
    for axis in range(3):
        is_same &= points[i, k, axis] == points[j, k, axis]
    return is_same


@_compiled()
def _factorise(table, counts, own, num_own, levels, jitter):
    """Factor the covariances of what `_arrange` gave.

    -> factor (b, c, columns) U and A; roots (b, N, r, r) D; weights (b, rows, N), covariance^-1
    values, negative, zero where a point is not a target's; how many factors do not exist.
    """
    size, num_targets = num_own.shape
    most_common, most_rows, most_own = 0, 0, 0
    for b in range(size):
        most_common = max(most_common, counts[b, 0])
        most_rows = max(most_rows, up(counts[b, 1], BLOCK))
        for i in range(num_targets):
            most_own = max(most_own, up(num_own[b, i], BLOCK))
    width = up(most_rows + num_targets, VECTOR)
    factor = aligned(size * most_common, width).reshape((size, most_common, width))
    roots = np.empty((size, num_targets, most_own, most_own))
    weights = np.zeros((size, most_rows, up(num_targets, BLOCK)))
    columns = aligned(3, width)
    columns[:] = 0.0
    part = aligned(most_common + most_own, up(most_own + 1, VECTOR))
    num_failed = 0
    for b in range(size):
        num_common, num_rows = counts[b, 0], counts[b, 1]
        is_sound = _factorise_common(
            table[b, :num_rows], num_common, levels[b], jitter, columns, factor[b]
        )
        for i in range(num_targets):
            if num_own[b, i] < 0:
                continue
            rows = own[b, i, : num_own[b, i]]
            last = up(num_rows, BLOCK) + i
            is_good = _factorise_own(
                table[b], num_common, rows, last, levels[b, i], jitter, columns, factor[b], part
            )
            num_failed += not (is_sound and is_good)
            r = up(len(rows), BLOCK)
            for row in range(r):
                for column in range(r):
                    roots[b, i, row, column] = part[num_common + row, column]
            _solve_weights(factor[b], num_common, part, rows, last, i, weights[b])
    return factor, roots, weights, num_failed


@_compiled()
def _factorise_common(table, num_common, levels, jitter, columns, factor):
    """Write U, A and the whitened values of the common points, side by side, to factor."""
    num_rows, num_targets = len(table), len(levels)
    first = up(num_rows, BLOCK)
    width = up(first + num_targets, VECTOR)
    for row in range(num_rows):
        for axis in range(3):
            columns[axis, row] = table[row, axis]
    for row in range(num_common):
        fill_row(table[row], columns, width, factor[row])
        factor[row, row] += jitter
        factor[row, num_rows:width] = 0.0
        for i in range(num_targets):
            factor[row, first + i] = levels[i, row]
    return cholesky(factor, np.int64(0), num_common, width)


@_compiled()
def _factorise_own(table, num_common, rows, last, levels, jitter, columns, factor, part):
    """Write a, below it D, and beside them the whitened values of a target, to part."""
    r = up(len(rows), BLOCK)
    width = up(r + 1, VECTOR)
    for column, row in enumerate(rows):
        for axis in range(3):
            columns[axis, column] = table[row, axis]
    for k in range(num_common):
        for column, row in enumerate(rows):
            part[k, column] = factor[k, row]
        part[k, len(rows) : width] = 0.0
        part[k, r] = factor[k, last]
    for column in range(r):
        below = part[num_common + column]
        if column < len(rows):
            fill_row(table[rows[column]], columns, width, below)
            below[column] += jitter
            below[len(rows) : width] = 0.0
            below[r] = levels[num_common + column]
        else:  # fills up the block
            below[:width] = 0.0
            below[column] = 1.0
    return cholesky(part, num_common, num_common + r, width)


@_compiled()
def _solve_weights(factor, num_common, part, rows, last, i, weights):
    """Write covariance^-1 values of target i, negative, by substituting backwards."""
    r = len(rows)
    common, own = np.empty(num_common), np.empty(r)
    column = up(r, BLOCK)
    for k in range(r - 1, -1, -1):
        row = part[num_common + k]
        own[k] = (row[column] - dot(row[k + 1 : r], own[k + 1 :])) * row[k]
        weights[rows[k], i] = -own[k]
    for k in range(num_common - 1, -1, -1):
        row = factor[k]
        rest = row[last] - dot(part[k, :r], own)
        common[k] = (rest - dot(row[k + 1 : num_common], common[k + 1 :])) * row[k]
        weights[k, i] = -common[k]


@_compiled()
def _predict(fitted, query, mean, std):
    """Write posterior mean and standard deviation; of either, nothing if it has no columns.

    query: (b, 1 or N, m, 3) au; mean, std: (b, N, m or 0).
    """
    scale, table, counts, own, num_own, factor, roots, weights = fitted
    num_targets = num_own.shape[1]
    size, num_sets, m = query.shape[:3]
    if num_targets == 0 or m == 0:
        return
    num_tiles = (m + _TILE - 1) // _TILE
    step = up((m + num_tiles - 1) // num_tiles, VECTOR)
    most_rows = weights.shape[1]
    x = aligned(most_rows + max(BLOCK, roots.shape[2]), step)
    columns, variance = aligned(3, step), aligned(2, step)
    columns[:] = 0.0
    for b in range(size):
        num_rows = up(counts[b, 1], BLOCK)
        for which in range(num_sets):
            first, last = (0, num_targets) if num_sets == 1 else (which, which + 1)
            for begin in range(0, m, step):
                end = min(begin + step, m)
                width = up(end - begin, VECTOR)
                for j in range(begin, end):
                    for axis in range(3):
                        columns[axis, j - begin] = query[b, which, j, axis] * scale[axis]
                for row in range(counts[b, 1]):
                    fill_row(table[b, row], columns, width, x[row])
                x[counts[b, 1] : num_rows, :width] = 0.0
                if mean.shape[2] > 0:
                    out = mean[b, :, begin:end]
                    _write_means(weights[b, :num_rows], first, last, x, width, out)
                if std.shape[2] == 0:
                    continue
                eliminate(factor[b], counts[b, 0], x, num_rows, width)
                variance[0, :width] = 1.0
                subtract_squares(x, counts[b, 0], width, variance[0])
                for i in range(first, last):
                    rows = own[b, i, : max(num_own[b, i], 0)]
                    deviation = std[b, i, begin:end]
                    _write_deviation(roots[b, i], rows, x, most_rows, width, variance, deviation)
                    if num_own[b, i] < 0:
                        deviation[:] = 1.0


@_compiled()
def _write_means(weights, first, last, x, width, out):
    """Write the means of some targets to out. x: covariances, and below them room for four rows."""
    num_rows = len(weights)
    for begin in range(first // BLOCK * BLOCK, last, BLOCK):
        x[num_rows : num_rows + BLOCK, :width] = 0.0
        for k in range(0, num_rows, BLOCK):
            subtract(weights, k, begin, x, num_rows, width)
        for i in range(max(first, begin), min(last, begin + BLOCK)):
            for j in range(out.shape[1]):
                out[i, j] = x[num_rows + i - begin, j]


@_compiled()
def _write_deviation(root, rows, x, room, width, variance, out):
    """Write the standard deviation of a target to out.

    x: covariances given the common points, and room for the target's own below; variance: (2,
    columns) given the common points, and scratch
    """
    r = up(len(rows), BLOCK)
    own = x[room : room + r]
    for k, row in enumerate(rows):
        for j in range(width):
            own[k, j] = x[row, j]
    own[len(rows) :, :width] = 0.0
    eliminate(root, r, own, r, width)
    for j in range(width):
        variance[1, j] = variance[0, j]
    subtract_squares(own, r, width, variance[1])
    for j in range(len(out)):
        out[j] = np.sqrt(max(variance[1, j], 0.0))
