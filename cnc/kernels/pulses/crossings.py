"""Where axes cross half-grid lines along a window of a curve.

A window is a part [ua, ub] of a piece, x = (u - ua) / (ub - ua), over which the position of each
axis in BLU, and the arc length, are polynomials of degree 7: the Hermite interpolants through the
values and first three derivatives at both ends. They are compared with the curve itself at two
points inside, and the window is made shorter until they agree to what rounding leaves. On a cubic
the axes' are exact; on an arc a window is about 180 steps, whatever the radius. So a crossing costs
a few products, not an evaluation of the curve.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    MAX_TURNING_POINTS,
    METRIC,
    METRICS,
    TABLE,
    Floats,
    Ints,
    curve_arclen,
    curve_eval,
    curve_range,
    curve_turning_points,
)

SLACK = 5e-10
"""BLU. Far below anything that matters, and above the rounding of positions of up to 100 000
BLU.
"""
SLACK_PER_BLU = 2e-15
"""Added to SLACK for each BLU of distance from the origin, where rounding grows with the position:
some products of that size.
"""
EXACT = 1e-11
"""mm: by how much the arc length's polynomial may be off."""
CHECKS = (0.375, 0.75)
"""Where in a window the polynomials are compared with the curve: not in the middle, where the error
may vanish by symmetry.
"""
SHORTEST = 2.0**-20
"""Part of a piece that is not divided any more."""
ROUNDING = 1e3
"""A polynomial off by up to so many times what is allowed is taken where a narrower window is
hardly better: rounding.
"""
FEW = 8.0
"""BLU: next to a cusp, where the arc length is no polynomial of u at any scale, it is asked of the
table over so much of the path.
"""
TOGETHER = 1e-4
"""Part of a window within which another axis's crossing is looked at for being at the same
point.
"""
GENTLE = 1.0 / 256.0
"""With second and third derivatives so much smaller than the first the inverse series of the cubic
is sharp to 1e-9 of a step.
"""

KEPT = 32
"""Numbers that a generator of rows may keep of a piece while it is under way; zeros when the piece
is entered.
"""

POLYNOMIAL = 26
"""Coefficients of a polynomial (8) and of its first (7), second (6) and third derivative (5)."""
X, OFF, RATE, BEND, TWIST, LINE_AT = range(6)
"""State of an axis in a window: the last point looked at, position there less LINE_AT, and the
first three derivatives by x.
"""
STATE = 6
DUE = -math.inf
"""In the place of a crossing: still to be found."""


@njit
def slack(p: float) -> float:
    """What rounding may do to a position of p BLU."""
    return SLACK + SLACK_PER_BLU * abs(p)


@njit
def grid_after(g: int, p: float) -> int:
    """The grid point of an axis that had g and has moved to p BLU: g unless p is beyond the
    half-grid line next to g.
    """
    margin = 0.5 + slack(p)
    if p > g + margin:
        return math.ceil(p - margin)
    if p < g - margin:
        return math.floor(p + margin)
    return g


@njit
def interpolate(
    poly: Floats, row: int, p0: float, p1: float, p2: float, p3: float, q0: float, q1: float, q2: float, q3: float
) -> None:  # fmt: skip
    """Write the polynomial with value, slope, half of the second and a sixth of the third
    derivative p at 0 and q at 1.
    """
    e0 = q0 - p0 - (p1 + p2 + p3)
    e1 = q1 - (p1 + 2.0 * p2 + 3.0 * p3)
    e2 = q2 - (p2 + 3.0 * p3)
    e3 = q3 - p3
    c = poly[row]
    c[0] = p0
    c[1] = p1
    c[2] = p2
    c[3] = p3
    c[4] = 35.0 * e0 - 15.0 * e1 + 5.0 * e2 - e3
    c[5] = -84.0 * e0 + 39.0 * e1 - 14.0 * e2 + 3.0 * e3
    c[6] = 70.0 * e0 - 34.0 * e1 + 13.0 * e2 - 3.0 * e3
    c[7] = -20.0 * e0 + 10.0 * e1 - 4.0 * e2 + e3
    for k in range(7):
        c[8 + k] = (k + 1) * c[1 + k]
    for k in range(6):
        c[15 + k] = (k + 1) * c[9 + k]
    for k in range(5):
        c[21 + k] = (k + 1) * c[16 + k]


@njit
def risen(
    c0: float, c1: float, c2: float, c3: float, c4: float, c5: float, c6: float, c7: float, x: float
) -> float:
    """The polynomial at x, c0 added last."""
    x2 = x * x
    return c0 + (c1 * x + (c2 + c3 * x) * x2 + ((c4 + c5 * x) + (c6 + c7 * x) * x2) * (x2 * x2))


@njit
def _value(poly: Floats, row: int, x: float) -> float:
    c = poly[row]
    return risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)


@njit
def length_rates(data: Floats, at: int, r: Floats, out: Floats) -> None:
    """Write the arc length's first three derivatives by u into out[1:], from r (4, n); just a 0
    first where it does not grow.
    """
    d11 = 0.0
    d12 = 0.0
    d22_13 = 0.0
    for k in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + k])
        d11 += r[1, i] * r[1, i]
        d12 += r[1, i] * r[2, i]
        d22_13 += r[2, i] * r[2, i] + r[1, i] * r[3, i]
    sigma = math.sqrt(d11)
    out[1] = sigma
    if sigma > 0.0:
        out[2] = d12 / sigma
        out[3] = (d22_13 - out[2] * out[2]) / sigma


@njit
def fit_window(
    kind: int, data: Floats, at: int, ua: float, ub: float, scale: Floats, ra: Floats, rb: Floats, rc: Floats, lengths: Floats, poly: Floats
) -> tuple[float, float]:  # fmt: skip
    """Fit the polynomials (n + 1, POLYNOMIAL) of the axes (BLU) and, in the last row, of the arc
    length (mm from the piece's start).

    ra (4, n): the curve at ua; lengths[0, 0]: arc length there. scale (n,): steps per mm. rb (4, n)
    becomes the curve at ub, lengths[1, 0] the arc length there. rc (4, n) and the rest of lengths
    (2, 4): scratch. Returns by how many times what is allowed the axes' and the arc length's
    polynomials are off.
    """
    n = len(scale)
    u0, _ = curve_range(kind, data, at)
    h = ub - ua
    h2 = 0.5 * h * h
    h3 = h * h * h / 6.0
    curve_eval(kind, data, at, ub, rb)
    for i in range(n):
        k = scale[i]
        interpolate(
            poly, i, ra[0, i] * k, ra[1, i] * k * h, ra[2, i] * k * h2, ra[3, i] * k * h3,
            rb[0, i] * k, rb[1, i] * k * h, rb[2, i] * k * h2, rb[3, i] * k * h3,
        )  # fmt: skip
    farthest = 0.0
    for i in range(n):
        farthest = max(farthest, abs(ra[0, i] * scale[i]), abs(rb[0, i] * scale[i]))
    # one axis of an arc is as rough as the other is far; narrower windows would not be better
    allowed = 0.25 * SLACK + SLACK_PER_BLU * farthest
    axes_off = 0.0
    length_off = 0.0
    measured = data[at + TABLE] != 0.0
    if measured:
        lengths[1, 0] = curve_arclen(kind, data, at, u0, ub)
        length_rates(data, at, ra, lengths[0])
        length_rates(data, at, rb, lengths[1])
        if lengths[0, 1] > 0.0 and lengths[1, 1] > 0.0:
            interpolate(
                poly, n, lengths[0, 0], lengths[0, 1] * h, lengths[0, 2] * h2, lengths[0, 3] * h3,
                lengths[1, 0], lengths[1, 1] * h, lengths[1, 2] * h2, lengths[1, 3] * h3,
            )  # fmt: skip
        else:
            length_off = math.inf
    else:
        lengths[1, 0] = ub - u0
        interpolate(poly, n, lengths[0, 0], h, 0.0, 0.0, lengths[1, 0], h, 0.0, 0.0)
    for k in range(2):
        x = CHECKS[k]
        u = ua + x * h
        curve_eval(kind, data, at, u, rc)
        for i in range(n):
            p = rc[0, i] * scale[i]
            axes_off = max(axes_off, abs(_value(poly, i, x) - p) / allowed)
        if measured and length_off < math.inf:
            length_off = max(
                length_off, abs(_value(poly, n, x) - curve_arclen(kind, data, at, u0, u)) / EXACT
            )
    return axes_off, length_off


@njit
def approach(f: float, f1: float, f2: float, f3: float) -> float:
    """The step to the zero of the cubic with value f <= 0 and these derivatives, as good as one
    step gets; inf where it has none ahead.
    """
    step = math.inf
    square = GENTLE * f1 * f1
    if f1 > 0.0 and abs(f * f2) <= square and abs(f * f * f3) <= square * f1:
        inverse = 1.0 / f1
        w = -f * inverse
        a = 0.5 * f2 * inverse * w
        b = f3 * inverse * w * w / 6.0
        step = w * (1.0 - a + 2.0 * a * a - b - 5.0 * a * (a * a - b))
    else:
        # Euler's irrational method: the parabola that touches solves a crossing next to a turning
        # point, too
        under = f1 * f1 - 2.0 * f * f2
        slope = f1 + math.sqrt(max(under, 0.0))
        if under >= 0.0 and f1 >= 0.0 and slope > 0.0:
            step = -2.0 * f / slope
            # the cubic term bends the parabola's root by one Newton step
            slope = f1 + step * (f2 + 0.5 * step * f3)
            if slope > 0.0:
                step -= step * step * step * f3 / (6.0 * slope)
    return step


@njit
def window_rows(
    poly: Floats, ends: Floats, scale: Floats, rb: Floats, grid: Ints, state: Floats, place: Floats, stretch: Ints,
    error: float, rows: int, step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of a window from row ``rows`` on, as many as there is room for.

    ends (n, ..): x where each axis turns, in order, then 1. rb: the curve at x = 1. grid (n,) is
    carried on. state (n, STATE), place (n,), stretch (n, 2): scratch. step gets the rows, reach the
    x of each. Returns the number of rows, the x up to which all is done (1 when the window is
    through), and the largest |grid - position| in BLU seen so far.
    """
    n = len(grid)
    first = rows
    room = len(reach)
    reached = 1.0
    last = 0.0
    for i in range(n):
        place[i] = DUE
        stretch[i, 0] = 0
        at_end = _value(poly, i, ends[i, 0]) if ends[i, 0] < 1.0 else rb[0, i] * scale[i]
        stretch[i, 1] = grid_after(grid[i], at_end)
        state[i, X] = -1.0
    while True:
        lead = 0
        for i in range(n):
            if place[i] == DUE:
                g = grid[i]
                x = state[i, X]
                low = max(x, 0.0)
                k = stretch[i, 0]
                while stretch[i, 1] == g and ends[i, k] < 1.0:
                    low = ends[i, k]
                    k += 1
                    at_end = (
                        _value(poly, i, ends[i, k]) if ends[i, k] < 1.0 else rb[0, i] * scale[i]
                    )
                    stretch[i, 1] = grid_after(g, at_end)
                stretch[i, 0] = k
                place[i] = math.inf
                if stretch[i, 1] != g:
                    sign = 1.0 if stretch[i, 1] > g else -1.0
                    line = g + 0.5 * sign
                    close = 0.25 * slack(line)
                    high = ends[i, k]
                    c = poly[i]
                    off = c[0] - line
                    x = low
                    known = state[i, X] == low
                    at_line = state[i, OFF] + (state[i, LINE_AT] - line)
                    f1 = state[i, RATE]
                    f2 = state[i, BEND]
                    f3 = state[i, TWIST]
                    while True:
                        if not known:
                            x2 = x * x
                            x4 = x2 * x2
                            at_line = off + (
                                c[1] * x
                                + (c[2] + c[3] * x) * x2
                                + ((c[4] + c[5] * x) + (c[6] + c[7] * x) * x2) * x4
                            )
                            f1 = (
                                (c[8] + c[9] * x)
                                + (c[10] + c[11] * x) * x2
                                + ((c[12] + c[13] * x) + c[14] * x2) * x4
                            )
                            f2 = (
                                (c[15] + c[16] * x)
                                + (c[17] + c[18] * x) * x2
                                + (c[19] + c[20] * x) * x4
                            )
                            f3 = (c[21] + c[22] * x) + (c[23] + c[24] * x) * x2 + c[25] * x4
                        known = False
                        f = sign * at_line
                        # at the very start of a stretch the line may lie behind, by rounding
                        if abs(f) <= close or x >= high or (f > 0.0 and x == low):
                            break
                        if f > 0.0:
                            high = x
                        else:
                            low = x
                        near = x + approach(f, sign * f1, sign * f2, sign * f3)
                        if not low < near < high:
                            near = 0.5 * (low + high)
                            if not low < near < high:
                                # neighbouring numbers: the line lies between them
                                near = high
                        x = near
                    place[i] = x
                    state[i, X] = x
                    state[i, OFF] = at_line
                    state[i, LINE_AT] = line
                    state[i, RATE] = f1
                    state[i, BEND] = f2
                    state[i, TWIST] = f3
            if place[i] < place[lead]:
                lead = i
        x = place[lead]
        if x == math.inf:
            break
        if rows == room:
            reached = last
            break
        last = x
        reach[rows] = x
        for i in range(n):
            step[rows, i] = 0
            if place[i] - x <= TOGETHER:
                sign = 1 if stretch[i, 1] > grid[i] else -1
                steps = i == lead
                if not steps:
                    p = _value(poly, i, x)
                    steps = sign * (grid[i] + 0.5 * sign - p) <= slack(p)
                if steps:
                    step[rows, i] = sign
                    grid[i] += sign
                    place[i] = DUE
        rows += 1
    # each axis once more, by itself: where the polynomial is and where its grid point
    for i in range(n):
        c = poly[i]
        g = grid[i]
        for row in range(rows - 1, first - 1, -1):
            p = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], reach[row])
            error = max(error, abs(g - p))
            g -= step[row, i]
    return rows, reached, error


@njit
def next_window(
    kind: int, data: Floats, at: int, ua: float, limit: float, width: float, scale: Floats, ra: Floats, rb: Floats, rc: Floats,
    lengths: Floats, poly: Floats,
) -> tuple[float, float, bool]:  # fmt: skip
    """Fit the next window, from ua on, at most to ``limit`` and about ``width`` long if that can
    be: see :func:`fit_window`.

    Returns its end ub, the width that the next one may try, and whether arc lengths in it are to be
    asked of the table.
    """
    u0, u1 = curve_range(kind, data, at)
    shortest = SHORTEST * (u1 - u0)
    steepest = 0.0
    for i in range(len(scale)):
        steepest = max(steepest, scale[i])
    wider_off = math.inf
    ub = ua
    by_table = False
    too_wide = True
    while too_wide:
        ub = ua + width if limit - (ua + width) > 0.1 * width else limit
        axes_off, length_off = fit_window(kind, data, at, ua, ub, scale, ra, rb, rc, lengths, poly)
        # the error goes with the eighth power of the width
        width = (ub - ua) * min(
            max(0.9 * math.sqrt(math.sqrt(math.sqrt(1.0 / max(axes_off, length_off, 1e-9)))), 0.1),
            4.0,
        )
        by_table = length_off > 1.0
        by_rounding = 0.5 * wider_off < axes_off < ROUNDING
        too_wide = (axes_off > 1.0 and not by_rounding) or (
            by_table and (lengths[1, 0] - lengths[0, 0]) * steepest > FEW
        )
        too_wide = too_wide and ub - ua > shortest
        if too_wide:
            width = min(width, 0.7 * (ub - ua))
            wider_off = axes_off
        else:
            # what was taken with more than is allowed would not be better for being narrower
            width = max(width, ub - ua if axes_off > 1.0 else shortest)
    return ub, width, by_table


@njit
def place_rows(
    kind: int,
    data: Floats,
    at: int,
    ua: float,
    ub: float,
    s0: float,
    by_table: bool,
    poly: Floats,
    first: int,
    rows: int,
    reach: Floats,
) -> None:
    """Turn the x of the rows from ``first`` on, places in the window [ua, ub], into path
    coordinates: s0 at the start of the piece.
    """
    u0, _ = curve_range(kind, data, at)
    c = poly[len(poly) - 1]
    for row in range(first, rows):
        if by_table:
            reach[row] = s0 + curve_arclen(kind, data, at, u0, ua + reach[row] * (ub - ua))
        else:
            reach[row] = s0 + risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], reach[row])


@njit
def curve_rows(
    kind: int, data: Floats, at: int, begin: float, upto: float, s0: float, scale: Floats, grid: Ints, turns: Floats,
    ends: Floats, poly: Floats, ra: Floats, rb: Floats, rc: Floats, lengths: Floats, state: Floats, place: Floats, stretch: Ints,
    error: float, rows: int, step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of an arc or a span from u = begin to upto, from row ``rows`` on, as
    many as there is room for.

    turns .. stretch: scratch. step gets the rows, reach the arc length of each, s0 at the start of
    the piece. Returns the number of rows, the u up to which all is done, and the largest |grid -
    position| in BLU seen so far.
    """
    n = len(grid)
    u0, _ = curve_range(kind, data, at)
    for i in range(n):
        turns[i, curve_turning_points(kind, data, at, i, turns[i])] = math.inf
    ua = begin
    width = upto - begin
    curve_eval(kind, data, at, ua, ra)
    lengths[0, 0] = curve_arclen(kind, data, at, u0, ua)
    full = False
    while ua < upto and not full:
        ub, width, by_table = next_window(
            kind, data, at, ua, upto, width, scale, ra, rb, rc, lengths, poly
        )
        for i in range(n):
            k = 0
            for j in range(MAX_TURNING_POINTS):
                if turns[i, j] >= ub:
                    break
                if turns[i, j] > ua:
                    ends[i, k] = (turns[i, j] - ua) / (ub - ua)
                    k += 1
            ends[i, k] = 1.0
        first = rows
        rows, x, error = window_rows(
            poly, ends, scale, rb, grid, state, place, stretch, error, rows, step, reach
        )
        full = x < 1.0
        place_rows(kind, data, at, ua, ub, s0, by_table, poly, first, rows, reach)
        ua = ua + x * (ub - ua) if full else ub
        lengths[0, 0] = lengths[1, 0]
        ra, rb = rb, ra
    return rows, ua, error
