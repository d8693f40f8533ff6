"""The table of the arc length of a piece, and its making.

It is made once for each piece. :func:`curve_arclen` and :func:`curve_inv_arclen` read it.

    s |            ____x      Rows are laid from u0 to u1. A row from a to b is tried: four panels
      |        _x''           of Gauss-Legendre give s at the three quarter points and at b. The
      |    _x''               Hermite interpolant of u(s) of degree 7 through both ends is compared
      |x''_________________  with the u of the quarter points. The difference times |dr/du| is
       a   .   .   .   b   u  the error in mm. It falls with the eighth power of the row's length,
                              which gives the length of the next trial.

A row is kept when the error is below half the accuracy and the interpolant rises all along (the
Bernstein coefficients of its derivative are positive). Six-point panels on a quarter of such a row
are exact to rounding, for they are of twelfth order on a quarter of the step. Towards an end where
|dr/du| vanishes the rows get ever shorter; the last, shorter than the accuracy, is a straight line.
So the search ends for every curve: a row never gets shorter than 2^-40 of the range.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import (
    AXES,
    LENGTH,
    METRIC,
    METRICS,
    ROW,
    SINGULAR,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
    curve_eval,
    curve_speed,
    is_plain_quintic,
)

MAX_ROWS = 1024
"""Where the accuracy would take more rows, it is lowered tenfold, repeatedly if necessary."""
SHORTEST = 2.0**-40

GAUSS_X = (
    -0.9324695142031521,
    -0.6612093864662645,
    -0.23861918608319693,
    0.23861918608319693,
    0.6612093864662645,
    0.9324695142031521,
)

GAUSS_W = (
    0.17132449237917027,
    0.3607615730481386,
    0.46791393457269126,
    0.46791393457269126,
    0.3607615730481386,
    0.17132449237917027,
)
"""Gauss-Legendre, 6 points: exact to degree 11."""


class Rates(NamedTuple):
    """Derivatives of u(s) at a place: du/ds, (d2u/ds2) / 2 and (d3u/ds3) / 6.

    They are 0 where the place is not regular, that is where |dr/du| vanishes.
    """

    regular: bool
    first: float
    second: float
    third: float


@njit
def _quintic_panel(data: Floats, at: int, ua: float, ub: float) -> float:
    """Return the arc length from ua to ub of a span that :func:`is_plain_quintic`.

    The weights of the slope, a Bernstein polynomial of degree 4, are the same for all axes. It
    takes a third of the time of :func:`curve_speed`.
    """
    body = at + START + 2 * int(data[at + AXES]) + SPAN_BODY
    metrics = int(data[at + METRICS])
    # Without a second or third axis, the first is counted with the factor 0.
    x = body + 6 * (int(data[at + METRIC]) + 1)
    y = body + 6 * (int(data[at + METRIC + 1]) + 1) if metrics > 1 else x
    z = body + 6 * (int(data[at + METRIC + 2]) + 1) if metrics > 2 else x
    with_y = 1.0 if metrics > 1 else 0.0
    with_z = 1.0 if metrics > 2 else 0.0
    x0, x1, x2 = data[x + 1] - data[x], data[x + 2] - data[x + 1], data[x + 3] - data[x + 2]
    x3, x4 = data[x + 4] - data[x + 3], data[x + 5] - data[x + 4]
    y0, y1, y2 = data[y + 1] - data[y], data[y + 2] - data[y + 1], data[y + 3] - data[y + 2]
    y3, y4 = data[y + 4] - data[y + 3], data[y + 5] - data[y + 4]
    z0, z1, z2 = data[z + 1] - data[z], data[z + 2] - data[z + 1], data[z + 3] - data[z + 2]
    z3, z4 = data[z + 4] - data[z + 3], data[z + 5] - data[z + 4]
    per_u = 1.0 / (data[at + U1] - data[at + U0])
    middle = (0.5 * (ua + ub) - data[at + U0]) * per_u
    half = 0.5 * (ub - ua) * per_u
    total = 0.0
    for k in range(6):
        t = middle + half * GAUSS_X[k]
        s = 1.0 - t
        tt, ss = t * t, s * s
        w0, w1, w2, w3, w4 = ss * ss, 4.0 * t * s * ss, 6.0 * tt * ss, 4.0 * t * tt * s, tt * tt
        dx = (w0 * x0 + w1 * x1) + (w2 * x2 + w3 * x3) + w4 * x4
        dy = (w0 * y0 + w1 * y1) + (w2 * y2 + w3 * y3) + w4 * y4
        dz = (w0 * z0 + w1 * z1) + (w2 * z2 + w3 * z3) + w4 * z4
        total += GAUSS_W[k] * math.sqrt(dx * dx + with_y * dy * dy + with_z * dz * dz)
    return total * 5.0 * half


@njit
def gauss(kind: int, data: Floats, at: int, ua: float, ub: float) -> float:
    """Return the arc length from ua to ub by one panel of 6-point Gauss-Legendre."""
    if kind == SPAN and is_plain_quintic(data, at):
        return _quintic_panel(data, at, ua, ub)
    middle = 0.5 * (ua + ub)
    half = 0.5 * (ub - ua)
    total = 0.0
    for k in range(6):
        total += GAUSS_W[k] * curve_speed(kind, data, at, middle + half * GAUSS_X[k])
    return total * half


@njit
def _row(data: Floats, first: int, rows: int, value: float) -> int:
    """Return the index of the last of ``rows`` entries that is at most ``value``.

    The entries are ROW apart, from ``first`` on. The result is the first one if none is so small.
    """
    low = 0
    high = rows
    while high - low > 1:
        middle = (low + high) // 2
        if data[first + middle * ROW] <= value:
            low = middle
        else:
            high = middle
    return first + low * ROW


@njit
def curve_arclen(kind: int, data: Floats, at: int, ua: float, ub: float) -> float:
    """Return the arc length from ua to ub in mm, negative if ub < ua.

    It comes from quadrature inside a row of the table, and from the table for the rows between.
    """
    length = 0.0
    if data[at + TABLE] != 0.0:
        table = at + int(data[at + TABLE])
        rows = int(data[table])
        a = _row(data, table + 2, rows, ua) - 1
        b = _row(data, table + 2, rows, ub) - 1
        if a != b:
            # From ua to the near edge of its row, then over the rows between. The rest lies in the
            # row of ub.
            a = a + ROW if a < b else a
            b = b if ua < ub else b + ROW
            length = gauss(kind, data, at, ua, data[a + 1]) + (data[b] - data[a])
            ua = data[b + 1]
        length += gauss(kind, data, at, ua, ub)
    return length if data[at + TABLE] != 0.0 else ub - ua


@njit
def curve_inv_arclen(kind: int, data: Floats, at: int, s: float) -> float:
    """Return the u at arc length s (mm) from the start of a piece, between u0 and u1.

    Its accuracy is that of the record.
    """
    u = data[at + U0]
    if s >= data[at + LENGTH]:
        u = data[at + U1]
    elif s > 0.0:
        if data[at + TABLE] == 0.0:
            u += s
        else:
            table = at + int(data[at + TABLE])
            r = _row(data, table + 1, int(data[table]), s)
            x = (s - data[r]) / (data[r + ROW] - data[r])
            v = data[r + 8]
            for k in range(7, 1, -1):
                v = v * x + data[r + k]
            u = min(max(data[r + 1] + v * x, data[r + 1]), data[r + ROW + 1])
    return min(u, data[at + U1])


@njit
def _rates(kind: int, data: Floats, at: int, u: float, guess: float, work: Floats) -> Rates:
    """Return the derivatives of u(s) at u.

    guess: about the length of the piece, mm. work: (4, n): work space.
    """
    curve_eval(kind, data, at, u, work)
    d11 = 0.0
    d12 = 0.0
    d22_13 = 0.0
    for k in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + k])
        x1 = work[1, i]
        x2 = work[2, i]
        d11 += x1 * x1
        d12 += x1 * x2
        d22_13 += x2 * x2 + x1 * work[3, i]
    sigma = math.sqrt(d11)
    regular = sigma * (data[at + U1] - data[at + U0]) > SINGULAR * guess
    r1 = 1.0 / sigma if regular else 0.0
    sigma1 = d12 * r1
    r2 = -0.5 * sigma1 * r1 * r1 * r1
    r3 = (4.0 * sigma1 * sigma1 - d22_13) * (r1 * r1 * r1) * (r1 * r1) / 6.0
    return Rates(regular, r1, r2, r3)


@njit
def _fit_row(
    kind: int,
    data: Floats,
    at: int,
    row: int,
    s: float,
    a: float,
    b: float,
    left: Rates,
    right: Rates,
    quarters: Floats,
) -> tuple[float, float, float]:
    """Write the row of the table from a to b at index ``row``, and measure its error.

    Args:
        kind: kind of the piece.
        data: the records.
        at: index of the piece's record.
        row: index of the row.
        s: arc length at a, mm.
        a: parameter at its start.
        b: parameter at its end.
        left: derivatives of u(s) at a.
        right: derivatives of u(s) at b.
        quarters: (4,): work space.

    Returns:
        The arc length of the row (mm), the error of its inverse (mm), and a lower bound on the
        slope of the interpolant.
    """
    du = b - a
    h = 0.0
    for k in range(4):
        h += gauss(kind, data, at, a + 0.25 * k * du, a + 0.25 * (k + 1) * du)
        quarters[k] = h
    data[row] = s
    data[row + 1] = a
    f1 = left.first * h
    f2 = left.second * h * h
    f3 = left.third * h * h * h
    e0 = du - (f1 + f2 + f3)
    e1 = right.first * h - (f1 + 2.0 * f2 + 3.0 * f3)
    e2 = right.second * h * h - (f2 + 3.0 * f3)
    e3 = right.third * h * h * h - f3
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
    error = 0.0
    behind = 0.0
    for k in range(3):
        x = quarters[k] / h if h > 0.0 else 0.0
        u = data[row + 8]
        for c in range(7, 1, -1):
            u = u * x + data[row + c]
        miss = abs(u * x - 0.25 * (k + 1) * du)
        if miss > 4e-16 * (abs(a) + abs(b)):
            # |dr/du| near the quarter point: the mean over the faster of the panels beside it
            faster = max(quarters[k + 1] - quarters[k], quarters[k] - behind)
            error = max(error, miss * 4.0 * faster / du)
        behind = quarters[k]
    return h, error, slope


@njit
def measure(kind: int, data: Floats, at: int, table: int, accuracy: float, work: Floats) -> int:
    """Write the table of a piece, whose record is complete but for the arc length.

    The length and the place of the table are set in the head of the record.

    Args:
        kind: kind of the piece.
        data: the records; 3 + ROW (MAX_ROWS + 1) numbers must be free from ``table`` on.
        at: index of the piece's record.
        table: index of the table.
        accuracy: largest error of the inverse arc length, mm.
        work: (4, n): work space.

    Returns:
        The index behind the table.
    """
    u0 = data[at + U0]
    u1 = data[at + U1]
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
        left = Rates(False, 0.0, 0.0, 0.0)
        while a < u1 and rows < MAX_ROWS:
            right = _rates(kind, data, at, b, guess, work)
            accepted = b == a
            if b > a:
                du = b - a
                row = table + 1 + rows * ROW
                h, error, slope = _fit_row(kind, data, at, row, s, a, b, left, right, quarters)
                # Nothing finer than rounding can be asked for.
                least = max(allowed, 2e-15 * (s + h))
                rising = left.regular and right.regular and slope > 0.0
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
                    # From a singular end s grows with the square of u at least. The first row must
                    # be shorter than the accuracy.
                    factor = 0.5 if left.regular else max(0.7 * math.sqrt(least / h), 1e-4)
                step = du * factor
            if accepted:
                a = b
                left = right
            b = u1 if u1 - a - step < shortest else a + step
        allowed *= 10.0
    end = table + 1 + rows * ROW
    data[table] = rows
    data[end] = s
    data[end + 1] = u1
    data[at + LENGTH] = s
    return end + 2
