"""Systems of equations with a positive definite band matrix.

The lower triangle is kept: row i of a matrix (N, w) holds the entries (i, i - j) at [i, j].
"""

from __future__ import annotations

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats

LEAST_PIVOT = 1e-14
"""Part of a diagonal entry below which its pivot is rounding."""


@njit
def factorise(band: Floats) -> None:
    """Replace a matrix by its Cholesky factor; pivots that are rounding become LEAST_PIVOT."""
    size, width = band.shape
    for i in range(size):
        low = max(0, i - width + 1)
        for j in range(low, i):
            total = band[i, i - j]
            for k in range(max(low, j - width + 1), j):
                total -= band[i, i - k] * band[j, j - k]
            band[i, i - j] = total / band[j, 0]
        pivot = band[i, 0]
        total = pivot
        for k in range(low, i):
            total -= band[i, i - k] * band[i, i - k]
        band[i, 0] = np.sqrt(max(total, LEAST_PIVOT * abs(pivot) + 1e-300))


@njit
def solve(factor: Floats, b: Floats) -> None:
    """Solve a system with its Cholesky factor, in place of the right side b (N,)."""
    size, width = factor.shape
    for i in range(size):
        total = b[i]
        for j in range(1, min(width, i + 1)):
            total -= factor[i, j] * b[i - j]
        b[i] = total / factor[i, 0]
    for i in range(size - 1, -1, -1):
        b[i] /= factor[i, 0]
        value = b[i]
        for j in range(1, min(width, i + 1)):
            b[i - j] -= factor[i, j] * value


@njit
def times(band: Floats, e: Floats, out: Floats) -> None:
    """Write the product of a symmetric matrix and e (N,) into out (N,)."""
    size, width = band.shape
    for i in range(size):
        out[i] = band[i, 0] * e[i]
    for i in range(size):
        for j in range(1, min(width, i + 1)):
            out[i] += band[i, j] * e[i - j]
            out[i - j] += band[i, j] * e[i]
