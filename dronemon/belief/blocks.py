"""Elimination by blocks of four rows, compiled: what Cholesky factors and their use are made of.

All goes along contiguous columns, whose number is a multiple of a vector's length. The compiler
turns these loops into vectors, provided that they begin at 0, that their end is not a constant, and
that single numbers are not taken out of slices. Diagonals hold reciprocals.
"""

# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

_compiled = partial(njit, cache=True, error_model="numpy", nogil=True)

BLOCK, VECTOR = 4, 8


@_compiled()
def up(number, multiple):
    """Round up to a multiple."""
    return (number + multiple - 1) // multiple * multiple


@_compiled()
def aligned(num_rows, width):
    """Memory that begins where vectors of the processor should: a quarter faster."""
    size = num_rows * width
    memory = np.empty(size + VECTOR)
    skip = (VECTOR - memory.ctypes.data // memory.itemsize % VECTOR) % VECTOR
    return memory[skip : skip + size].reshape((num_rows, width))


@_compiled()
def cholesky(x, first, last, width):
    """Turn covariances into the upper factor, given what lies above: rows from first to last.

    Column 0 belongs to row first. -> whether the factor exists.
    """
    is_good = True
    block = np.empty((BLOCK, BLOCK))
    for row in range(first, last, BLOCK):
        column = row - first
        for k in range(0, row, BLOCK):
            subtract(x, k, column, x, row, width)
        for i in range(BLOCK):
            for j in range(i, BLOCK):
                entry = x[row + i, column + j]
                for k in range(i):
                    entry -= block[k, i] * block[k, j]
                if i == j:
                    is_good &= entry > 0.0
                    block[i, i] = 1.0 / np.sqrt(entry)
                else:
                    block[i, j] = entry * block[i, i]
        divide(block, first - first, first - first, x, row, width)
        for i in range(BLOCK):
            for j in range(BLOCK):
                x[row + i, column + j] = block[i, j] if j >= i else 0.0
    return is_good


@_compiled()
def eliminate(factor, num_pivots, x, num_rows, width):
    """Solve for the first rows of x; take away from the others what these explain."""
    for row in range(0, num_rows, BLOCK):
        for k in range(0, min(row, num_pivots), BLOCK):
            subtract(factor, k, row, x, row, width)
        if row < num_pivots:
            divide(factor, row, row, x, row, width)


@_compiled(fastmath={"contract"})
def subtract(factor, k, column, x, row, width):
    """Take the rows from k, times factor[k:, column:], away from those from row: four of each."""
    f, i = factor, column
    a0, a1, a2, a3 = f[k, i], f[k, i + 1], f[k, i + 2], f[k, i + 3]
    b0, b1, b2, b3 = f[k + 1, i], f[k + 1, i + 1], f[k + 1, i + 2], f[k + 1, i + 3]
    c0, c1, c2, c3 = f[k + 2, i], f[k + 2, i + 1], f[k + 2, i + 2], f[k + 2, i + 3]
    d0, d1, d2, d3 = f[k + 3, i], f[k + 3, i + 1], f[k + 3, i + 2], f[k + 3, i + 3]
    a, b, c, d = x[k], x[k + 1], x[k + 2], x[k + 3]
    out0, out1, out2, out3 = x[row], x[row + 1], x[row + 2], x[row + 3]
    for j in range(width):
        p, q, r, s = a[j], b[j], c[j], d[j]
        new0 = out0[j] - a0 * p - b0 * q - c0 * r - d0 * s
        new1 = out1[j] - a1 * p - b1 * q - c1 * r - d1 * s
        new2 = out2[j] - a2 * p - b2 * q - c2 * r - d2 * s
        new3 = out3[j] - a3 * p - b3 * q - c3 * r - d3 * s
        out0[j], out1[j], out2[j], out3[j] = new0, new1, new2, new3


@_compiled(fastmath={"contract"})
def divide(factor, k, column, x, row, width):
    """Solve four rows for the triangle factor[k:, column:]."""
    f, i = factor, column
    a0, a1, a2, a3 = f[k, i], f[k, i + 1], f[k, i + 2], f[k, i + 3]
    b1, b2, b3 = f[k + 1, i + 1], f[k + 1, i + 2], f[k + 1, i + 3]
    c2, c3, d3 = f[k + 2, i + 2], f[k + 2, i + 3], f[k + 3, i + 3]
    out0, out1, out2, out3 = x[row], x[row + 1], x[row + 2], x[row + 3]
    for j in range(width):
        p = out0[j] * a0
        q = (out1[j] - a1 * p) * b1
        r = (out2[j] - a2 * p - b2 * q) * c2
        s = (out3[j] - a3 * p - b3 * q - c3 * r) * d3
        out0[j], out1[j], out2[j], out3[j] = p, q, r, s


@_compiled(fastmath={"contract", "reassoc"})
def dot(a, b):
    """Scalar product of two rows of one length."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@_compiled(fastmath={"contract"})
def subtract_squares(x, num_rows, width, out):
    """Take the sum of some rows' squares away from out, four rows at a time."""
    for k in range(0, num_rows, BLOCK):
        for j in range(width):
            squares = x[k, j] * x[k, j] + x[k + 1, j] * x[k + 1, j]
            squares += x[k + 2, j] * x[k + 2, j] + x[k + 3, j] * x[k + 3, j]
            out[j] -= squares
