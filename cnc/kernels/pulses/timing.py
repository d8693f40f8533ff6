"""When the motion is where: the inverse of s(t) inside a constant-jerk phase, and time stamps.

Rows come dense: many lie so near to each other that the speed changes by a few hundredths over all
of them. About a time t_e with speed v, acceleration a and jerk j, s - s_e = v (x + alpha x^2 + beta
x^3) with x = t - t_e, alpha = a / 2v and beta = j / 6v, so that with y = (s - s_e) / v

    x = y - alpha y^2 + (2 alpha^2 - beta) y^3 + .. ,    c_n = 1/n [x^(n-1)] (1 + alpha x + beta x^2)^-n    (Lagrange's inversion)

which is cut behind y^7: seven products a row, no root and no quotient. The next term is at most
2871 kappa^7 y^8 with kappa the larger of |alpha| and sqrt|beta|; that gives the reach of a series.
Where rows are too far apart for one, next to rest, each is found by itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLOSE = 1e-12
"""s: a step this short ends the iteration; the convergence is cubic, so what remains is
rounding.
"""

TAIL = 1e-14
"""s: the first term that a series leaves out is at most 2871 times that by the speed at its first
row, three times as much where the motion brakes: less than 0.1 ns.
"""
NEAR = 0.125
"""A series reaches so far in units of 1 / kappa at most: what it leaves out shrinks by a factor of
two or more with each term.
"""
DENSE = 2
"""Rows that are worth a series."""


@njit
def time_in_phase(v: float, a: float, j: float, ds: float, span: float, guess: float) -> float:
    """The t in [0, span] with t (v + t (a / 2 + t j / 6)) = ds, on a phase in which the speed is
    never negative.

    v, a, j: speed, acceleration and jerk (mm/s, mm/s^2, mm/s^3) at t = 0 and throughout. ds mm.
    guess: where to begin. The ends stand in for a ds outside.

    Euler's irrational method: each step solves the parabola that touches the cubic, so that the
    approach is cubic and a start or an end at rest (v = 0, where Newton's step would be infinite)
    is no trouble. The root stays bracketed; a step out of the bracket is halved into it, so that it
    always ends.
    """
    if ds <= 0.0:
        return 0.0
    if a == 0.0 and j == 0.0:
        return min(ds / v, span) if v > 0.0 else span
    if span * (v + span * (0.5 * a + span * (j / 6.0))) <= ds:
        return span
    low = 0.0
    high = span
    t = guess
    if v == 0.0 and a == 0.0 and guess <= 0.0:
        t = (6.0 * ds / j) ** (1.0 / 3.0)
    if not low <= t <= high:
        t = 0.5 * span
    for _ in range(100):
        f = t * (v + t * (0.5 * a + t * (j / 6.0))) - ds
        if f > 0.0:
            high = t
        else:
            low = t
        f1 = v + t * (a + t * (0.5 * j))
        under = f1 * f1 - 2.0 * f * (a + t * j)
        step = math.inf
        slope = f1 + math.sqrt(max(under, 0.0))
        if under >= 0.0 and f1 >= 0.0 and slope > 0.0:
            step = -2.0 * f / slope
        near = t + step
        if not low <= near <= high:
            near = 0.5 * (low + high)
        step = near - t
        t = near
        if abs(step) <= CLOSE:
            break
    return t


@njit
def nanoseconds(whole_ns: int, seconds: float) -> int:
    """``whole_ns`` plus ``seconds``, to the nearest ns. The sum is integer, so that it is as exact
    after days as at the start.
    """
    return whole_ns + int(np.rint(seconds * 1e9))


@njit
def phase_times(
    t0: float, s0: float, v0: float, a0: float, j0: float, span: float, dt: float, whole_ns: int, last_ns: int, first: int, rows: int,
    reach: Floats, time_ns: Ints,
) -> tuple[float, int]:  # fmt: skip
    """Write when rows ``first`` to ``rows``, all in one phase, are due: at the path coordinates in
    ``reach``, and none before ``last_ns``.

    The phase begins at whole_ns + t0 (s) at s0 with v0, a0, j0 and lasts for ``span``; dt: where in
    it the row before was due. Returns that of the last row and its time.
    """
    row = first
    if a0 == 0.0 and j0 == 0.0 and v0 > 0.0:
        slow = 1.0 / v0
        for k in range(first, rows):
            dt = min(max((reach[k] - s0) * slow, 0.0), span)
            last_ns = max(last_ns, whole_ns + int(np.rint((t0 + dt) * 1e9)))
            time_ns[k] = last_ns
        row = rows
    while row < rows:
        v = v0 + dt * (a0 + dt * (0.5 * j0))
        half = 0.0
        if v > 0.0:
            slow = 1.0 / v
            kappa = max(0.5 * abs(a0 + dt * j0) * slow, math.sqrt(abs(j0) * slow / 6.0))
            # TAIL = kappa^7 half^8
            part = min(NEAR, math.sqrt(math.sqrt(math.sqrt(TAIL * kappa))))
            half = min(0.5 * (span - dt), part / kappa if kappa > 0.0 else math.inf)
        te = dt + half
        end = te + half
        beyond = s0 + end * (v0 + end * (0.5 * a0 + end * (j0 / 6.0)))
        if half > 0.0 and reach[min(row + DENSE, rows) - 1] <= beyond:
            ve = v0 + te * (a0 + te * (0.5 * j0))
            se = s0 + te * (v0 + te * (0.5 * a0 + te * (j0 / 6.0)))
            slow = 1.0 / ve
            p = 0.5 * (a0 + te * j0) * slow
            q = j0 / 6.0 * slow
            p2 = p * p
            c3 = 2.0 * p2 - q
            c4 = p * (5.0 * q - 5.0 * p2)
            c5 = p2 * (14.0 * p2 - 21.0 * q) + 3.0 * q * q
            c6 = p * (p2 * (84.0 * q - 42.0 * p2) - 28.0 * q * q)
            c7 = p2 * (p2 * (132.0 * p2 - 330.0 * q) + 180.0 * q * q) - 12.0 * q * q * q
            while row < rows and reach[row] <= beyond:
                y = (reach[row] - se) * slow
                y2 = y * y
                x = y + y2 * ((c3 * y - p) + y2 * ((c4 + c5 * y) + y2 * (c6 + c7 * y)))
                dt = min(max(te + x, 0.0), span)
                last_ns = max(last_ns, whole_ns + int(np.rint((t0 + dt) * 1e9)))
                time_ns[row] = last_ns
                row += 1
        else:
            dt = time_in_phase(v0, a0, j0, reach[row] - s0, span, dt)
            last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
            time_ns[row] = last_ns
            row += 1
    return dt, last_ns
