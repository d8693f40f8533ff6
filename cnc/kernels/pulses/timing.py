"""Times of path coordinates: the inverse of s(t) in a phase of constant jerk, and time stamps.

Rows are dense: over many of them the speed changes by a few hundredths. About a time t_e with speed
v, acceleration a and jerk j, s - s_e = v (x + alpha x^2 + beta x^3) with x = t - t_e, alpha = a /
2v and beta = j / 6v, so that with y = (s - s_e) / v

    x = y - alpha y^2 + (2 alpha^2 - beta) y^3 + ..
    c_n = 1/n [x^(n-1)] (1 + alpha x + beta x^2)^-n    (Lagrange's inversion)

which is cut off after y^7: seven products a row, no root and no quotient. The next term is at most
2871 kappa^7 y^8 with kappa the larger of |alpha| and sqrt|beta|; that limits the range of a series.
Where rows are too far apart for a series, next to rest, each is found by iteration.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.plan_arrays import PlanArrays

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLOSE = 1e-12
"""s: a step this short ends the iteration. The convergence is cubic, so the rest is rounding."""

TAIL = 1e-14
"""s: the first term that a series leaves out is at most 2871 times that by the speed at its first
row, three times as much where the motion brakes: less than 0.1 ns.
"""
NEAR = 0.125
"""Largest range of a series in units of 1 / kappa. There each term left out is at most half of the
term before it.
"""
DENSE = 2
"""Smallest number of rows for which a series is made."""


@njit
def time_in_phase(v: float, a: float, j: float, ds: float, span: float, guess: float) -> float:
    """Return the t in [0, span] with t (v + t (a / 2 + t j / 6)) = ds; the nearer end outside.

    The method is Euler's irrational one: each step solves the parabola that touches the cubic. So
    the convergence is cubic, and a start or an end at rest needs no special care (v = 0, where
    Newton's step would be infinite). The root stays bracketed; a step out of the bracket is
    replaced by bisection, so that the iteration always ends.

    Args:
        v: speed at t = 0, mm/s; never negative in the phase.
        a: acceleration at t = 0, mm/s^2.
        j: jerk, mm/s^3.
        ds: distance, mm.
        span: duration of the phase, s.
        guess: start of the iteration, s.
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
    """Return ``whole_ns`` plus ``seconds``, to the nearest ns.

    The sum is integer, so that it is as exact after days as at the start.
    """
    return whole_ns + int(np.rint(seconds * 1e9))


@njit
def phase_times(
    plan: PlanArrays,
    phase: int,
    whole_ns: int,
    seconds: float,
    dt: float,
    last_ns: int,
    first: int,
    rows: int,
    s: Floats,
    time_ns: Ints,
) -> tuple[float, int]:
    """Write the times of the rows ``first`` to ``rows``, all in one phase, into time_ns.

    Args:
        plan: the plan.
        phase: index of the phase.
        whole_ns: whole seconds of the time at which the plan begins, ns.
        seconds: the fraction of that time, s.
        dt: time of the row before, from the start of the phase, s.
        last_ns: no row is due before this time.
        first: first row.
        rows: row behind the last.
        s: path coordinates of the rows, mm.
        time_ns: takes the times.

    Returns:
        The time of the last row from the start of the phase (s), and its time (ns).
    """
    t0 = seconds + plan.t[phase]
    s0 = plan.s[phase]
    v0 = plan.v[phase]
    a0 = plan.a[phase]
    j0 = plan.j[phase]
    span = plan.t[phase + 1] - plan.t[phase]
    row = first
    if a0 == 0.0 and j0 == 0.0 and v0 > 0.0:
        slow = 1.0 / v0
        for k in range(first, rows):
            dt = min(max((s[k] - s0) * slow, 0.0), span)
            last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
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
        if half > 0.0 and s[min(row + DENSE, rows) - 1] <= beyond:
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
            while row < rows and s[row] <= beyond:
                y = (s[row] - se) * slow
                y2 = y * y
                x = y + y2 * ((c3 * y - p) + y2 * ((c4 + c5 * y) + y2 * (c6 + c7 * y)))
                dt = min(max(te + x, 0.0), span)
                last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
                time_ns[row] = last_ns
                row += 1
        else:
            dt = time_in_phase(v0, a0, j0, s[row] - s0, span, dt)
            last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
            time_ns[row] = last_ns
            row += 1
    return dt, last_ns
