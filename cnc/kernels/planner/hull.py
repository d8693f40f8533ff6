"""Bounds of a piece's derivatives by arc length, from the hull of its control points.

The derivatives by t of a polynomial span are polynomials in Bernstein form. Their coefficients are
differences of its own, and their values lie in the hull of these. With e the direction of the
chord, sigma = |dr/dt| >= (dr/dt).e >= m, the least of the first differences along e. By the chain
rule (see :func:`cnc.kernels.path.curve.curve_eval_s`), with D1, D2, D3 the largest of an axis's
derivatives by t and N2, N3 those of all metric axes,

    |q'|   <= D1 / m
    |q''|  <= D2 / m^2 + D1 N2 / m^3
    |q'''| <= D3 / m^3 + 3 D2 N2 / m^4 + D1 (3 N2^2 / m^5 + N3 / m^4)

for u' = 1 / sigma, |u''| <= N2 / sigma^3,
|u'''| = |4 sigma'^2 - |r''|^2 - r'.r'''| / sigma^5 and |sigma'| <= |r''|. The curvature is at most
N2 / m^2. All of them are sharp on a span that bends little.
"""

from __future__ import annotations

import math

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    LINE,
    METRIC,
    METRICS,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
)

BOUNDS = 3
"""Columns: bounds of the first, second and third derivative."""


@njit
def derivative_bounds(kind: int, data: Floats, at: int, out: Floats) -> None:
    """Compute bounds of the derivatives by arc length on a piece.

    They are sharp for lines, finite for polynomial spans that turn less than 90 degrees, and
    infinite for everything else.

    Args:
        kind: the kind of the piece.
        data: the records.
        at: index of the record of the piece.
        out: (n + 1, BOUNDS): receives bounds of |q'|, |q''| and |q'''| of each of the n axes. The
            last row receives those of |q'| and |q''| of all metric axes together.
    """
    n = out.shape[0] - 1
    for i in range(n + 1):
        for k in range(BOUNDS):
            out[i, k] = math.inf
    if kind == LINE:
        start = at + START
        end = start + n
        per_u = 1.0 / (data[at + U1] - data[at + U0])
        for i in range(n):
            out[i, 0] = abs((data[end + i] - data[start + i]) * per_u)
            out[i, 1] = 0.0
            out[i, 2] = 0.0
        out[n, 0] = 1.0
        out[n, 1] = 0.0
        out[n, 2] = 0.0
    elif kind == SPAN and data[at + TABLE] != 0.0:
        span_bounds(data, at, out)


@njit
def span_bounds(data: Floats, at: int, out: Floats) -> None:
    """Compute the bounds of a span: the arguments of :func:`derivative_bounds`."""
    n = out.shape[0] - 1
    start = at + START
    end = start + n
    p = int(data[end + n])
    weight = end + n + SPAN_BODY
    polynomial = True
    for k in range(1, p + 1):
        polynomial = polynomial and data[weight + k] == data[weight]
    metrics = int(data[at + METRICS])
    chord = 0.0
    for m in range(metrics):
        c = int(data[at + METRIC + m])
        chord += (data[end + c] - data[start + c]) ** 2
    chord = math.sqrt(chord)
    least = math.inf
    n2 = 0.0
    n3 = 0.0
    for k in range(p):
        along = 0.0
        second = 0.0
        third = 0.0
        for m in range(metrics):
            c = int(data[at + METRIC + m])
            i = weight + (c + 1) * (p + 1) + k
            along += (data[i + 1] - data[i]) * (data[end + c] - data[start + c])
            if k < p - 1:
                second += (data[i + 2] - 2.0 * data[i + 1] + data[i]) ** 2
            if k < p - 2:
                third += (data[i + 3] - 3.0 * (data[i + 2] - data[i + 1]) - data[i]) ** 2
        least = min(least, along)
        n2 = max(n2, second)
        n3 = max(n3, third)
    least *= p
    if not (polynomial and least > 0.0):
        return
    unit = 1.0 / data[weight]
    m1 = chord / (least * unit)
    m2 = m1 * m1
    m3 = m2 * m1
    n2 = math.sqrt(n2) * p * (p - 1) * unit
    n3 = math.sqrt(n3) * p * (p - 1) * (p - 2) * unit
    for axis in range(n):
        d1 = 0.0
        d2 = 0.0
        d3 = 0.0
        row = weight + (axis + 1) * (p + 1)
        for k in range(p):
            i = row + k
            d1 = max(d1, abs(data[i + 1] - data[i]))
            if k < p - 1:
                d2 = max(d2, abs(data[i + 2] - 2.0 * data[i + 1] + data[i]))
            if k < p - 2:
                d3 = max(d3, abs(data[i + 3] - 3.0 * (data[i + 2] - data[i + 1]) - data[i]))
        d1 *= p * unit
        d2 *= p * (p - 1) * unit
        d3 *= p * (p - 1) * (p - 2) * unit
        out[axis, 0] = d1 * m1
        out[axis, 1] = d2 * m2 + d1 * n2 * m3
        out[axis, 2] = (
            d3 * m3 + 3.0 * d2 * n2 * m2 * m2 + d1 * (3.0 * n2 * n2 * m3 * m2 + n3 * m2 * m2)
        )
    out[n, 0] = 1.0
    out[n, 1] = n2 * m2
