r"""The fastest motion round a corner within its tolerance, by an interior-point method.

The duration h of a step is lowered to the least at which all rows can be kept. For one h let

    |x| <= b h^p (1 + s)

for each row (:mod:`cnc.kernels.planner.corner_rows`). x is linear in the control points, or convex
(feed, tolerance), so the least s is found by convex optimisation: Newton's method lowers

    t s - sum over the rows of log(b h^p (1 + s) - x) + log(b h^p (1 + s) + x)

for growing t. The matrix of second derivatives is a band of 8 with one column more, for s. Where s
is below 0, the motion is legal. The derivative of the least s by h follows from the last Newton
step, because all others vanish there. So h goes to the root of s by Newton's method, too.

       s |`.
         |  `.
         |    `.
       0 |------`o.------- h
         |         ``--..
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats
from cnc.kernels.path.fit_band import factorise, solve
from cnc.kernels.planner.corner_rows import (
    FIXED,
    POINTS,
    TRAVEL,
    CornerLimits,
    Rows,
    evaluate,
    set_step,
)

FREE = 2 * (POINTS - 2 * FIXED)
"""Number of free coordinates."""

BAND = 8

GAP = 4e-3
"""The last s may be so much above the least, by the number of rows / t, and so much below 0."""

RAISE = 12.0
"""Factor from one t to the next."""

CLOSE = 0.05
"""Newton's decrement at which a search ends."""

NEWTON_STEPS = 25
"""Largest number of steps for one t."""

LEAST_STEP = 1e-4

LEAST_PRODUCT = 1e-100
"""Products of distances are not smaller, nor larger than its inverse, before their logarithm."""

FIRST = 10.0
"""The first t, by the number of rows."""

INSIDE = 0.02
"""A search starts with bounds that are raised by so much more than it needs."""

ROUNDS = 10
"""Largest number of values of h."""

CHANGE = 0.15
"""Largest relative change of h in one round."""


class State(NamedTuple):
    """The state beside a corner: distance from it, speed and acceleration along the leg.

    Attributes:
        s: mm.
        v: mm/s.
        a: mm/s^2.
    """

    s: float
    v: float
    a: float


class Newton(NamedTuple):
    """Arrays of the search.

    Attributes:
        c: (POINTS, 2): control points.
        tried: (POINTS, 2): those of the step that is tried.
        band: (FREE, BAND): second derivatives by the free coordinates.
        side: (FREE,): those by s and a free coordinate.
        slope: (FREE,): first derivatives by the free coordinates.
        ahead: (FREE,): derivatives of the free coordinates by h.
    """

    c: Floats
    tried: Floats
    band: Floats
    side: Floats
    slope: Floats
    ahead: Floats


@njit
def place_ends(c: Floats, h: float, before: State, after: State, turn: tuple[float, float]) -> None:
    """Write the control points that give the motion its state at both ends."""
    for k in range(FIXED):
        # The second differences vanish but for the acceleration: r -+ v h + a h^2 / 3.
        by_v = (k - 1.0) * h
        by_a = h * h / 3.0 if k != 1 else -h * h / 6.0
        c[k, 0] = -before.s + by_v * before.v + by_a * before.a
        c[k, 1] = 0.0
        on = after.s + by_v * after.v + by_a * after.a
        c[POINTS - FIXED + k, 0] = on * turn[0]
        c[POINTS - FIXED + k, 1] = on * turn[1]


@njit
def _inside(rows: Rows, s: float) -> float:
    """Return the sum of the logarithms of the distances from the bounds; -infinity outside."""
    total = 0.0
    if 1.0 + s <= 0.0:
        return -math.inf
    product = 1.0
    for m in range(rows.number[0]):
        used = rows.value[m] * rows.scale[m]
        room = 1.0 + s - used
        if rows.kind[m] != TRAVEL:
            room *= 1.0 + s + used
        if not room > 0.0:
            return -math.inf
        product *= room
        # One logarithm for several distances is faster.
        if not LEAST_PRODUCT < product < 1.0 / LEAST_PRODUCT:
            total += math.log(product)
            product = 1.0
    return total + math.log(product)


@njit
def _most_used(rows: Rows) -> float:
    """Return the largest part of its bound that a row takes."""
    most = 0.0
    for m in range(rows.number[0]):
        used = rows.value[m] * rows.scale[m]
        most = max(most, used if rows.kind[m] == TRAVEL else abs(used))
    return most


@njit
def _assemble(rows: Rows, s: float, n: Newton) -> tuple[float, float]:
    """Write the derivatives of the barrier, and return the first and the second one by s."""
    band, side, slope = n.band, n.side, n.slope
    band[:] = 0.0
    side[:] = 0.0
    slope[:] = 0.0
    slope_s = 0.0
    ss = 0.0
    for m in range(rows.number[0]):
        raw = rows.scale[m]
        x = rows.value[m] * raw
        up = 1.0 / (1.0 + s - x)
        down = 0.0 if rows.kind[m] == TRAVEL else 1.0 / (1.0 + s + x)
        by_x = (up - down) * raw
        xx = (up * up + down * down) * raw * raw
        slope_s -= up + down
        ss += up * up + down * down
        xs = (down * down - up * up) * raw
        bend = max(by_x, 0.0) * rows.bend[m]
        first = 2 * (rows.first[m] - FIXED)
        for j in range(max(-first, 0), min(8, FREE - first)):
            i = first + j
            g = rows.gradient[m, j]
            if g != 0.0:
                slope[i] += by_x * g
                side[i] += xs * g
                weight = xx * g
                for o in range(j, min(8, FREE - first)):
                    band[i, o - j] += weight * rows.gradient[m, o]
            if bend > 0.0:
                across = -rows.gradient[m, j + 1] if j % 2 == 0 else rows.gradient[m, j - 1]
                weight = bend * across
                for o in range(j, min(8, FREE - first)):
                    if o % 2 == 0:
                        other = -rows.gradient[m, o + 1]
                    else:
                        other = rows.gradient[m, o - 1]
                    band[i, o - j] += weight * other
    return slope_s, ss


@njit
def _centre(rows: Rows, limits: CornerLimits, n: Newton, s: float, t: float) -> float:
    """Lower the barrier for one ``t``, and return s; infinity after a rounding error."""
    evaluate(rows, limits, n.c)
    value = t * s - _inside(rows, s)
    if not value < math.inf:
        return math.inf
    for _ in range(NEWTON_STEPS):
        slope_s, ss = _assemble(rows, s, n)
        slope_s += t
        step_s, decrement = _newton_step(n, slope_s, ss)
        if not CLOSE <= decrement < math.inf:
            break
        part = 1.0
        better = False
        n.tried[:] = n.c
        while part > LEAST_STEP and not better:
            for k in range(FIXED, POINTS - FIXED):
                for i in range(2):
                    n.tried[k, i] = n.c[k, i] + part * n.slope[2 * (k - FIXED) + i]
            evaluate(rows, limits, n.tried)
            new = t * (s + part * step_s) - _inside(rows, s + part * step_s)
            better = new < value - 0.1 * part * decrement
            if not better:
                part *= 0.5
        if not better:
            evaluate(rows, limits, n.c)
            break
        n.c[:] = n.tried
        s += part * step_s
        value = new
    return s


@njit
def _newton_step(n: Newton, slope_s: float, ss: float) -> tuple[float, float]:
    """Return the step of s and the decrement; ``n.slope`` becomes the rest of the step.

    The column is eliminated last: the band alone is factorised.
    """
    band, side, slope = n.band, n.side, n.slope
    factorise(band)
    by_s, free = side.copy(), slope.copy()
    solve(band, by_s)
    solve(band, free)
    rest = slope_s
    for i in range(FREE):
        ss -= side[i] * by_s[i]
        rest -= side[i] * free[i]
    step_s = -rest / max(ss, 1e-300)
    decrement = -slope_s * step_s
    for i in range(FREE):
        step = -free[i] - by_s[i] * step_s
        decrement -= slope[i] * step
        slope[i] = step
    return step_s, decrement


@njit
def _follow(
    rows: Rows, n: Newton, h: float, s: float, t: float, ends: tuple[State, State, float, float]
) -> float:
    """Return the derivative of the least s by h, and write that of the control points.

    ``n.band`` has to be the factor at this place, from the last Newton step. ``ends``: the states
    beside the corner, and its turn.
    """
    before, after, cos, sin = ends
    small = 1e-6 * h
    place_ends(n.tried, h + small, before, after, (cos, sin))
    place_ends(n.c, h, before, after, (cos, sin))
    for k in range(FIXED, POINTS - FIXED):
        n.tried[k] = n.c[k]
    ahead = n.ahead
    ahead[:] = 0.0
    slope = 0.0
    ss = 0.0
    sh = 0.0
    for m in range(rows.number[0]):
        raw = rows.scale[m]
        x = rows.value[m] * raw
        up = 1.0 / (1.0 + s - x)
        down = 0.0 if rows.kind[m] == TRAVEL else 1.0 / (1.0 + s + x)
        k = rows.first[m]
        x_h = -rows.power[m] * x / h
        for j in range(8):
            p, i = k + j // 2, j % 2
            x_h += rows.gradient[m, j] * (n.tried[p, i] - n.c[p, i]) / small * raw
        slope += (up - down) * x_h
        ss += up * up + down * down
        sh += (down * down - up * up) * x_h
        to_c = ((up * up + down * down) * x_h - (up - down) * rows.power[m] / h) * raw
        first = 2 * (k - FIXED)
        for j in range(max(-first, 0), min(8, FREE - first)):
            ahead[first + j] += to_c * rows.gradient[m, j]
    by_s = n.side.copy()
    solve(n.band, by_s)
    solve(n.band, ahead)
    for i in range(FREE):
        ss -= n.side[i] * by_s[i]
        sh -= n.side[i] * ahead[i]
    step_s = -sh / max(ss, 1e-300)
    for i in range(FREE):
        ahead[i] = -ahead[i] - by_s[i] * step_s
    return slope / t


@njit
def fastest_corner(
    rows: Rows, limits: CornerLimits, before: State, after: State, c: Floats, h: float
) -> float:
    """Make a motion round a corner the fastest one.

    Args:
        rows: the rows of the corner.
        limits: in its plane.
        before: the state at the start, at a distance ``s`` before the corner.
        after: the state at the end, behind the corner.
        c: (POINTS, 2): control points of a motion near it, replaced by those of the result.
        h: the duration of a step there, s.

    Returns:
        The duration of a step, s; 0 if no faster motion inside the limits was found.
    """
    n = Newton(
        c.copy(),
        np.zeros((POINTS, 2)),
        np.zeros((FREE, BAND)),
        np.zeros(FREE),
        np.zeros(FREE),
        np.zeros(FREE),
    )
    ends = (before, after, limits.turn[0], limits.turn[1])
    last = rows.number[0] / GAP
    found = 0.0
    longest = h
    h *= 1.0 - CHANGE
    t = FIRST * rows.number[0]
    for _ in range(ROUNDS):
        place_ends(n.c, h, before, after, limits.turn)
        set_step(rows, h)
        evaluate(rows, limits, n.c)
        s = (1.0 + INSIDE) * _most_used(rows) - 1.0 + INSIDE
        while True:
            s = _centre(rows, limits, n, s, t)
            if t == last or s == math.inf:
                break
            t = min(last, RAISE * t)
        if s == math.inf:
            break
        slope = _follow(rows, n, h, s, t, ends)
        if s < 0.0 and (found == 0.0 or h < found):
            found = h
            c[:] = n.c
        if -GAP < s < 0.0 and slope < 0.0:
            break
        change = CHANGE * h
        if slope < 0.0:
            change = (s + 0.5 * GAP) / slope
        change = max(-CHANGE * h, min(CHANGE * h, change))
        h -= change
        if h >= longest:
            break
        for k in range(FIXED, POINTS - FIXED):
            for i in range(2):
                n.c[k, i] -= change * n.ahead[2 * (k - FIXED) + i]
        t = last / RAISE
    return found
