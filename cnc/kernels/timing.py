"""When the motion is where: the inverse of s(t) inside a constant-jerk phase, and time stamps."""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit

CLOSE = 1e-12
"""s: a step this short ends the iteration; the convergence is cubic, so what remains is rounding."""


@njit
def time_in_phase(v: float, a: float, j: float, ds: float, span: float, guess: float) -> float:
    """The t in [0, span] with t (v + t (a / 2 + t j / 6)) = ds, on a phase in which the speed is never negative.

    v, a, j: speed, acceleration and jerk (mm/s, mm/s^2, mm/s^3) at t = 0 and throughout. ds mm. guess: where to begin. The ends stand in
    for a ds outside.

    Euler's irrational method: each step solves the parabola that touches the cubic, so that the approach is cubic and a start or an end at
    rest (v = 0, where Newton's step would be infinite) is no trouble. The root stays bracketed; a step out of the bracket is halved
    into it, so that it always ends.
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
    """``whole_ns`` plus ``seconds``, to the nearest ns. The sum is integer, so that it is as exact after days as at the start."""
    return whole_ns + int(np.rint(seconds * 1e9))
