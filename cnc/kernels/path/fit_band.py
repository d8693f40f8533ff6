"""Systems of equations with a positive definite band matrix.

The upper triangle is kept: row i of a matrix (N, w) holds the entries (i, i + j) at [i, j]. Inner
loops run along rows, so a processor does several entries at a time.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats

LEAST_PIVOT = 1e-14
"""Part of a diagonal entry below which its pivot is rounding."""


@njit
def factorise(band: Floats) -> None:
    """Replace a matrix by its Cholesky factor U, with U'U the matrix.

    Pivots that are rounding become LEAST_PIVOT.
    """
    size, width = band.shape
    least = np.empty(size)
    for i in range(size):
        least[i] = LEAST_PIVOT * abs(band[i, 0]) + 1e-300
    for i in range(size):
        pivot = math.sqrt(max(band[i, 0], least[i]))
        inverse = 1.0 / pivot
        band[i, 0] = pivot
        reach = min(width, size - i)
        for j in range(1, reach):
            band[i, j] *= inverse
        for j in range(1, reach):
            factor = band[i, j]
            for k in range(width - j):
                band[i + j, k] -= factor * band[i, j + k]


@njit
def solve(factor: Floats, b: Floats) -> None:
    """Solve a system with its Cholesky factor, in place of the right side b (N,)."""
    forward(factor, b)
    backward(factor, b)


@njit
def forward(factor: Floats, b: Floats) -> None:
    """Solve U'y = b with a Cholesky factor U, in place of b (N,)."""
    size, width = factor.shape
    for i in range(size):
        value = b[i] / factor[i, 0]
        b[i] = value
        for j in range(1, min(width, size - i)):
            b[i + j] -= factor[i, j] * value


@njit
def backward(factor: Floats, b: Floats) -> None:
    """Solve U x = b with a Cholesky factor U, in place of b (N,)."""
    size, width = factor.shape
    for i in range(size - 1, -1, -1):
        # Three sums, so that an addition need not wait for the one before.
        reach = min(width, size - i)
        total, second, third = b[i], 0.0, 0.0
        j = 1
        while j + 2 < reach:
            total -= factor[i, j] * b[i + j]
            second += factor[i, j + 1] * b[i + j + 1]
            third += factor[i, j + 2] * b[i + j + 2]
            j += 3
        while j < reach:
            total -= factor[i, j] * b[i + j]
            j += 1
        b[i] = (total - (second + third)) / factor[i, 0]


@njit
def times(band: Floats, e: Floats, out: Floats) -> None:
    """Write the product of a symmetric matrix and e (N,) into out (N,)."""
    size, width = band.shape
    for i in range(size):
        out[i] = 0.0
    for i in range(size):
        total = band[i, 0] * e[i]
        for j in range(1, min(width, size - i)):
            total += band[i, j] * e[i + j]
            out[i + j] += band[i, j] * e[i]
        out[i] += total
