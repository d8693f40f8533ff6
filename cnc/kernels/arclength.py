"""The table of the arc length: made once a piece, read by curve_arclen and curve_inv_arclen of :mod:`cnc.kernels.curve`.

    s |            ____x      Rows are laid from u0 to u1. A row from a to b is tried: four Gauss-Legendre panels give s at the three
      |        _x''           quarter points and at b; the degree 7 Hermite interpolant of u(s) through both ends is compared with the u of
      |    _x''               the quarter points. The difference times |dr/du| is the error in mm; it falls with the eighth power of
      |x''__________________  the row's length, which tells how long the next trial should be.
       a   .   .   .   b   u

A row is kept when the error is below half the accuracy and the interpolant rises all along (the Bernstein coefficients of its derivative are
positive). Six-point panels on a quarter of such a row are exact to rounding, for they are of twelfth order on a quarter of the step. Towards
an end where |dr/du| vanishes the rows get ever shorter; the last, shorter than the accuracy, is a straight line. So the search ends for
every curve: a row never gets shorter than 2^-40 of the range.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.curve import LENGTH, METRIC, METRICS, ROW, SINGULAR, TABLE, U0, U1, Floats, curve_eval, gauss
from cnc.kernels.jit import njit

MAX_ROWS = 1024
"""Where the accuracy asked for would take more rows it is lowered tenfold, as often as need be."""
SHORTEST = 2.0**-40


@njit
def _rates(kind: int, data: Floats, at: int, u: float, work: Floats, rates: Floats) -> bool:
    """du/ds, (d2u/ds2) / 2 and (d3u/ds3) / 6 into rates (3,); False where |dr/du| is as good as zero."""
    curve_eval(kind, data, at, u, work)
    d11 = 0.0
    d12 = 0.0
    d22_13 = 0.0
    for k in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + k])
        d11 += work[1, i] * work[1, i]
        d12 += work[1, i] * work[2, i]
        d22_13 += work[2, i] * work[2, i] + work[1, i] * work[3, i]
    if math.sqrt(d11) * (data[at + U1] - data[at + U0]) <= SINGULAR * data[at + LENGTH]:
        return False
    sigma1 = d12 / math.sqrt(d11)
    u_s = 1.0 / math.sqrt(d11)
    rates[0] = u_s
    rates[1] = -0.5 * sigma1 * u_s**3
    rates[2] = (4.0 * sigma1 * sigma1 - d22_13) * u_s**5 / 6.0
    return True


@njit
def _hermite(data: Floats, row: int, h: float, du: float, left: Floats, right: Floats, b: Floats) -> bool:
    """c1..c7 of a row of length h over du from the rates at its ends, du > 0; False if u would not rise all along. b: scratch (7,)."""
    f1 = left[0] * h
    f2 = left[1] * h * h
    f3 = left[2] * h * h * h
    g3 = right[2] * h * h * h
    r0 = du - (f1 + f2 + f3)
    r1 = right[0] * h - (f1 + 2.0 * f2 + 3.0 * f3)
    r2 = right[1] * h * h - (f2 + 3.0 * f3)
    r3 = g3 - f3
    data[row + 2] = f1
    data[row + 3] = f2
    data[row + 4] = f3
    data[row + 5] = 35.0 * r0 - 15.0 * r1 + 5.0 * r2 - r3
    data[row + 6] = -84.0 * r0 + 39.0 * r1 - 14.0 * r2 + 3.0 * r3
    data[row + 7] = 70.0 * r0 - 34.0 * r1 + 13.0 * r2 - 3.0 * r3
    data[row + 8] = -20.0 * r0 + 10.0 * r1 - 4.0 * r2 + r3
    # powers to Bernstein form: divide by the binomials of 6, then sum as in Pascal's triangle
    choose = 1.0
    for i in range(7):
        b[i] = (i + 1) * data[row + 2 + i] / choose
        choose *= (6.0 - i) / (i + 1.0)
    for k in range(1, 7):
        for i in range(6, k - 1, -1):
            b[i] += b[i - 1]
    for i in range(7):
        if not b[i] > 0.0:
            return False
    return True


@njit
def _straight(data: Floats, row: int, du: float) -> None:
    """A row along which u rises evenly."""
    data[row + 2] = du
    for k in range(3, ROW):
        data[row + k] = 0.0


@njit
def measure(kind: int, data: Floats, at: int, table: int, accuracy: float, work: Floats) -> int:
    """Lay the table of the piece at ``at``, whose record is complete but for the arc length, from index ``table`` on.

    accuracy: largest error of the inverse in mm. work: scratch (4, n). Sets the length and the table's place in the head; returns the index
    behind the table. ``data`` needs room for 2 + ROW (MAX_ROWS + 1) numbers there.
    """
    u0 = data[at + U0]
    u1 = data[at + U1]
    data[at + TABLE] = table - at
    data[at + LENGTH] = gauss(kind, data, at, u0, u1)  # a first guess, to tell what is as good as zero
    left = np.empty(3)
    right = np.empty(3)
    scratch = np.empty(7)
    quarters = np.empty(4)
    allowed = 0.5 * accuracy
    while True:
        rows = 0
        a = u0
        s = 0.0
        step = 0.5 * (u1 - u0)
        shortest = SHORTEST * (u1 - u0)
        regular = _rates(kind, data, at, a, work, left)
        while a < u1 and rows < MAX_ROWS:
            step = min(step, u1 - a)
            b = u1 if u1 - a - step < shortest else a + step
            h = 0.0
            for k in range(4):
                h += gauss(kind, data, at, a + 0.25 * k * (b - a), a + 0.25 * (k + 1) * (b - a))
                quarters[k] = h
            row = table + 1 + rows * ROW
            data[row] = s
            data[row + 1] = a
            ends_regular = _rates(kind, data, at, b, work, right)
            # rounding alone: nothing finer can be asked for
            least = max(allowed, 2e-15 * (s + h))
            error = math.inf
            rising = False
            if regular and ends_regular:
                rising = _hermite(data, row, h, b - a, left, right, scratch)
                error = 0.0
                for k in range(3):
                    x = quarters[k] / h
                    u = data[row + 8]
                    for c in range(7, 1, -1):
                        u = u * x + data[row + c]
                    miss = abs(u * x - 0.25 * (k + 1) * (b - a))
                    if miss > 4e-16 * (abs(a) + abs(b)):
                        # the slope of s(u) near the quarter point: at most that of the steeper panel beside it
                        panel = max(quarters[k + 1] - quarters[k], quarters[k] - (quarters[k - 1] if k > 0 else 0.0))
                        error = max(error, miss * 4.0 * panel / (b - a))
            if not (rising and error <= least):
                if h > least and b - a > shortest:
                    factor = 0.5
                    if rising and error < math.inf:
                        factor = min(max(0.9 * (least / error) ** 0.125, 0.1), 0.7)
                    elif not regular or not ends_regular:
                        # a singular end: no interpolant until the row is shorter than the accuracy
                        factor = 0.5 if regular else max(0.7 * math.sqrt(least / h), 1e-4)
                    step = factor * (b - a)
                    continue
                _straight(data, row, b - a)
                error = least
            rows += 1
            s += h
            step = (b - a) * min(max(0.9 * (least / max(error, 1e-30)) ** 0.125, 0.3), 4.0)
            a = b
            regular = ends_regular
            for k in range(3):
                left[k] = right[k]
        if a >= u1:
            break
        allowed *= 10.0
    data[table] = rows
    end = table + 1 + rows * ROW
    data[end] = s
    data[end + 1] = u1
    data[at + LENGTH] = s
    return end + 2
