"""The table of the arc length: made once a piece, read by curve_arclen and curve_inv_arclen of
:mod:`cnc.kernels.path.curve`.

    s |            ____x      Rows are laid from u0 to u1. A row from a to b is tried: four Gauss-Legendre panels give s at the three
      |        _x''           quarter points and at b; the degree 7 Hermite interpolant of u(s) through both ends is compared with the u of
      |    _x''               the quarter points. The difference times |dr/du| is the error in mm; it falls with the eighth power of
      |x''__________________  the row's length, which tells how long the next trial should be.
       a   .   .   .   b   u

A row is kept when the error is below half the accuracy and the interpolant rises all along (the
Bernstein coefficients of its derivative are positive). Six-point panels on a quarter of such a row
are exact to rounding, for they are of twelfth order on a quarter of the step. Towards an end where
|dr/du| vanishes the rows get ever shorter; the last, shorter than the accuracy, is a straight line.
So the search ends for every curve: a row never gets shorter than 2^-40 of the range.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    LENGTH,
    METRIC,
    METRICS,
    ROW,
    SINGULAR,
    TABLE,
    U0,
    U1,
    Floats,
    curve_eval,
    gauss,
)

MAX_ROWS = 1024
"""Where the accuracy asked for would take more rows it is lowered tenfold, as often as need be."""
SHORTEST = 2.0**-40


@njit
def measure(kind: int, data: Floats, at: int, table: int, accuracy: float, work: Floats) -> int:
    """Lay the table of the piece at ``at``, whose record is complete but for the arc length, from
    index ``table`` on.

    accuracy: largest error of the inverse in mm. work: scratch (4, n). Sets the length and the
    table's place in the head; returns the index behind the table. ``data`` needs room for 3 + ROW
    (MAX_ROWS + 1) numbers there.
    """
    u0 = data[at + U0]
    u1 = data[at + U1]
    metrics = int(data[at + METRICS])
    data[at + TABLE] = table - at
    guess = gauss(kind, data, at, u0, u1)
    shortest = SHORTEST * (u1 - u0)
    quarters = np.empty(4)
    allowed = 0.5 * accuracy
    rows = 0
    s = 0.0
    a = u0
    while a < u1:
        rows = 0
        s = 0.0
        a = u0
        b = u0
        step = 0.5 * (u1 - u0)
        left_regular = False
        l1 = 0.0
        l2 = 0.0
        l3 = 0.0
        while a < u1 and rows < MAX_ROWS:
            # du/ds, (d2u/ds2) / 2 and (d3u/ds3) / 6 at b
            curve_eval(kind, data, at, b, work)
            d11 = 0.0
            d12 = 0.0
            d22_13 = 0.0
            for k in range(metrics):
                i = int(data[at + METRIC + k])
                x1 = work[1, i]
                x2 = work[2, i]
                d11 += x1 * x1
                d12 += x1 * x2
                d22_13 += x2 * x2 + x1 * work[3, i]
            sigma = math.sqrt(d11)
            regular = sigma * (u1 - u0) > SINGULAR * guess
            r1 = 1.0 / sigma if regular else 0.0
            sigma1 = d12 * r1
            r2 = -0.5 * sigma1 * r1 * r1 * r1
            r3 = (4.0 * sigma1 * sigma1 - d22_13) * (r1 * r1 * r1) * (r1 * r1) / 6.0
            accepted = b == a
            if b > a:
                du = b - a
                h = 0.0
                for k in range(4):
                    h += gauss(kind, data, at, a + 0.25 * k * du, a + 0.25 * (k + 1) * du)
                    quarters[k] = h
                # rounding alone: nothing finer can be asked for
                least = max(allowed, 2e-15 * (s + h))
                row = table + 1 + rows * ROW
                data[row] = s
                data[row + 1] = a
                f1 = l1 * h
                f2 = l2 * h * h
                f3 = l3 * h * h * h
                e0 = du - (f1 + f2 + f3)
                e1 = r1 * h - (f1 + 2.0 * f2 + 3.0 * f3)
                e2 = r2 * h * h - (f2 + 3.0 * f3)
                e3 = r3 * h * h * h - f3
                data[row + 2] = f1
                data[row + 3] = f2
                data[row + 4] = f3
                data[row + 5] = 35.0 * e0 - 15.0 * e1 + 5.0 * e2 - e3
                data[row + 6] = -84.0 * e0 + 39.0 * e1 - 14.0 * e2 + 3.0 * e3
                data[row + 7] = 70.0 * e0 - 34.0 * e1 + 13.0 * e2 - 3.0 * e3
                data[row + 8] = -20.0 * e0 + 10.0 * e1 - 4.0 * e2 + e3
                slope = f1
                for k in range(2, 8):
                    slope -= k * abs(data[row + 1 + k])
                rising = left_regular and regular and slope > 0.0
                error = 0.0
                behind = 0.0
                for k in range(3):
                    x = quarters[k] / h if h > 0.0 else 0.0
                    u = data[row + 8]
                    for c in range(7, 1, -1):
                        u = u * x + data[row + c]
                    miss = abs(u * x - 0.25 * (k + 1) * du)
                    if miss > 4e-16 * (abs(a) + abs(b)):
                        # |dr/du| near the quarter point: the mean over the faster of the panels
                        # beside it
                        error = max(
                            error,
                            miss
                            * 4.0
                            * max(quarters[k + 1] - quarters[k], quarters[k] - behind)
                            / du,
                        )
                    behind = quarters[k]
                accepted = rising and error <= least
                factor = 0.9 * (least / max(error, 1e-30)) ** 0.125
                if not accepted and (h <= least or du <= shortest):
                    accepted = True
                    factor = 0.9 * math.sqrt(least / max(h, 1e-30))
                    data[row + 2] = du
                    for k in range(3, ROW):
                        data[row + k] = 0.0
                if accepted:
                    factor = min(max(factor, 0.3), 4.0)
                    rows += 1
                    s += h
                elif rising:
                    factor = min(max(factor, 0.1), 0.7)
                else:
                    # from a singular end s grows with the square of u at least, and the first row
                    # must be shorter than the accuracy
                    factor = 0.5 if left_regular else max(0.7 * math.sqrt(least / h), 1e-4)
                step = du * factor
            if accepted:
                a = b
                left_regular = regular
                l1 = r1
                l2 = r2
                l3 = r3
            b = u1 if u1 - a - step < shortest else a + step
        allowed *= 10.0
    end = table + 1 + rows * ROW
    data[table] = rows
    data[end] = s
    data[end + 1] = u1
    data[at + LENGTH] = s
    return end + 2
