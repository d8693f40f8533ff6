"""Natural cubic splines through values at knots, as polynomials of their cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def natural_spline(knots: Floats, values: Floats) -> Floats:
    """Return the cubics (n + 1, 4, ...) of the cells in powers of the distance from their knot.

    Cell 0 lies in front of the first knot and has its powers from there, as cell 1 does. The spline
    is linear beyond the knots, and constant where there is one knot alone.

    Args:
        knots: Places (n,), ascending.
        values: Values there (n, ...).
    """
    n = len(knots)
    cubics = np.zeros((n + 1, 4, *values.shape[1:]))
    cubics[1:, 0] = values
    cubics[0, 0] = values[0]
    if n == 1:
        return cubics
    steps = np.diff(knots)
    widths = steps[(...,) + (None,) * (values.ndim - 1)]
    slopes = np.diff(values, axis=0) / widths
    # The second derivatives m: h0 m0 + 2 (h0 + h1) m1 + h1 m2 = 6 (slope 1 - slope 0), 0 at the
    # ends, by elimination of the diagonal below (Thomas).
    bend, factor = np.zeros_like(values), np.zeros(n)
    for k in range(1, n - 1):
        pivot = 2.0 * (steps[k - 1] + steps[k]) - steps[k - 1] * factor[k - 1]
        factor[k] = steps[k] / pivot
        bend[k] = (6.0 * (slopes[k] - slopes[k - 1]) - steps[k - 1] * bend[k - 1]) / pivot
    for k in range(n - 2, 0, -1):
        bend[k] -= factor[k] * bend[k + 1]
    inner = cubics[1:-1]
    inner[:, 1] = slopes - widths * (2.0 * bend[:-1] + bend[1:]) / 6.0
    inner[:, 2] = bend[:-1] / 2.0
    inner[:, 3] = np.diff(bend, axis=0) / (6.0 * widths)
    cubics[0, 1] = inner[0, 1]
    last = inner[-1]
    cubics[-1, 1] = last[1] + steps[-1] * (2.0 * last[2] + 3.0 * steps[-1] * last[3])
    return cubics
