"""The covariance function, compiled: in arithmetic that the compiler turns into vectors."""

# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numba import njit
from numpy.polynomial import Chebyshev, Polynomial

_compiled = partial(njit, cache=True, error_model="numpy", nogil=True)

_LOG2_E = 1.0 / math.log(2.0)
_DEGREE = 10
_SERIES = Chebyshev.interpolate(np.exp2, _DEGREE, domain=[-0.5, 0.5]).convert(kind=Polynomial).coef
_POWER_OF_TWO = (1.0, *_SERIES[1:].tolist())
"""Of 2^f, |f| <= 1/2, right to the last digits; exactly 1 at 0."""
_BIAS = 1023
_ROUNDING = 1.5 * 2.0**52 + _BIAS
"""Added to a number, leaves its nearest integer, plus the bias of exponents, in the last bits."""


@_compiled(fastmath={"contract"})
def _covariance(dx, dy, dt):
    """(1 + r) exp(-r), of scaled differences, in arithmetic that the compiler turns into vectors.

    exp(-r) = 2^z = 2^i 2^f; a library's function would be called for one number at a time.
    """
    r = np.sqrt(dx * dx + dy * dy + dt * dt)
    z = max(-_LOG2_E * r, -float(_BIAS))  # where the power's bits are those of 0
    rounded = z + _ROUNDING
    f = z - (rounded - _ROUNDING)
    c, f2 = _POWER_OF_TWO, f * f
    low = c[0] + c[1] * f + f2 * (c[2] + c[3] * f)
    middle = c[4] + c[5] * f + f2 * (c[6] + c[7] * f)
    high = c[8] + c[9] * f + f2 * c[10]
    f4 = f2 * f2
    power = np.int64(np.float64(rounded).view(np.int64) << 52).view(np.float64)
    return (1.0 + r) * power * (low + f4 * (middle + f4 * high))


@_compiled()
def fill_row(point, columns, width, out):
    """Covariance of a point with the first columns. columns: (3, m)."""
    x, y, t = point[0], point[1], point[2]
    for j in range(width):
        out[j] = _covariance(columns[0, j] - x, columns[1, j] - y, columns[2, j] - t)
