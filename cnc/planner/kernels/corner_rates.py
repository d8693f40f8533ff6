r"""Jerk and acceleration along the path, and the acceleration across it, in a step past a corner.

With r the position and v = |r'|, they are

    v''  = (r''.r'' + r'.r''') / v - (r'.r'')^2 / v^3,
    v'   = r'.r'' / v,
    a_n^2 = r''.r'' - v'^2.

In a step r''' is constant, r'' changes linearly and r' is a parabola. So f = r'.r' and g = r''.r''
are polynomials of the time of order 4 and 2, and r'.r'' = f'/2.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats
from cnc.planner.kernels.corner_tube import ACCELERATION, CORNER, EARLY, JERK, write_stencil

ALONG_JERK, ALONG, ACROSS = range(3)
"""Kinds of rates: v'', v' and a_n^2."""

NUMBERS = 8
"""Numbers of the polynomials of a step: five of f and three of g."""

BESIDE_REST = 1e-3
"""Part of a step beside a rest that is not searched for the place of the least speed."""

SLOWEST_STEPS = 12
"""Largest number of Newton steps to the place of the least speed."""

FOUND = 1e-12
"""A shorter step, as a part of the duration, ends that search."""

REST = 1e-9
"""mm/s; the rates have no value where the motion rests."""


@njit
def read_step(
    k: int, t: Floats, c: Floats, weights: Floats, r: Floats, polynomials: Floats
) -> float:
    """Write the derivatives of r of order 1 to 3 (3, d) at the start of step k.

    ``weights`` (3, 4) receives those of the control points in them; ``polynomials`` (NUMBERS,) the
    coefficients of f and g by the time from the start of the step.

    Returns:
        The duration of the step, s.
    """
    h = t[k + 3] - t[k + 2]
    write_stencil(EARLY, k, t, weights[0])
    write_stencil(CORNER, k, t, weights[1])
    write_stencil(JERK, k, t, weights[2])
    for m in range(4):
        weights[0, m] = 3.0 * (weights[0, m] - weights[1, m]) / h
    write_stencil(ACCELERATION, k, t, weights[1])
    polynomials[:] = 0.0
    for q in range(c.shape[1]):
        for order in range(3):
            r[order, q] = 0.0
            for m in range(4):
                r[order, q] += weights[order, m] * c[k + m, q]
        v, a, j = r[0, q], r[1, q], r[2, q]
        polynomials[0] += v * v
        polynomials[1] += 2.0 * v * a
        polynomials[2] += a * a + v * j
        polynomials[3] += a * j
        polynomials[4] += 0.25 * j * j
        polynomials[5] += a * a
        polynomials[6] += 2.0 * a * j
        polynomials[7] += j * j
    return h


@njit
def at_time(polynomials: Floats, passed: float) -> tuple[float, float, float, float]:
    """Return f, f'/2, f''/2 and g so many seconds behind the start of a step."""
    f0, f1, f2, f3, f4, g0, g1, g2 = polynomials
    x = passed
    f = f0 + x * (f1 + x * (f2 + x * (f3 + x * f4)))
    first = 0.5 * f1 + x * (f2 + x * (1.5 * f3 + 2.0 * x * f4))
    return f, first, f2 + x * (3.0 * f3 + 6.0 * x * f4), g0 + x * (g1 + x * g2)


@njit
def rate_at(kind: int, polynomials: Floats, passed: float) -> float:
    """Return a rate there; infinity where the motion rests."""
    f, first, second, pull = at_time(polynomials, passed)
    if f <= REST * REST:
        return math.inf
    if kind == ALONG:
        return first / math.sqrt(f)
    if kind == ACROSS:
        return pull - first * first / f
    return (second - first * first / f) / math.sqrt(f)


@njit
def _largest_at(kind: int, polynomials: Floats, h: float, parts: int) -> float:
    """Return the end of one of so many parts of a step at which a rate is largest, as its part."""
    largest, place = -1.0, 0.5
    for i in range(1, parts):
        f, first, second, pull = at_time(polynomials, i * h / parts)
        if f <= REST * REST:
            return i / parts
        # The square of the rate, or a_n^2, with one division.
        if kind == ALONG_JERK:
            excess = f * second - first * first
            value = excess * excess / (f * f * f)
        elif kind == ALONG:
            value = first * first / f
        else:
            value = pull - first * first / f
        if value > largest:
            largest, place = value, i / parts
    return place


@njit
def _slowest_at(polynomials: Floats, h: float) -> float:
    """Return the place in a step at which the speed is least, as a part of its duration; or -1.

    There v'' and a_n may have a peak that is too narrow for places at equal distances. It is -1
    where the speed only falls, or only rises.
    """
    low, high = 0.0, h
    if not at_time(polynomials, low)[1] < 0.0 < at_time(polynomials, high)[1]:
        return -1.0
    at = 0.5 * h
    for _ in range(SLOWEST_STEPS):
        # The root of f' by Newton's method.
        _, first, second, _ = at_time(polynomials, at)
        if first < 0.0:
            low = at
        else:
            high = at
        newton = -first / second if second > 0.0 else math.inf
        if abs(newton) <= FOUND * h:
            break
        at += newton
        if not low < at < high:
            at = 0.5 * (low + high)
    return at / h


@njit
def peak_in(kind: int, polynomials: Floats, h: float, parts: int) -> float:
    """Return the place in a step at which a rate is about largest, as a part of its duration."""
    place = _largest_at(kind, polynomials, h, parts)
    if kind == ALONG:
        # It is 0 at the least speed.
        return place
    slowest = _slowest_at(polynomials, h)
    if slowest < 0.0 or _beside_rest(polynomials, h, slowest):
        return place
    if abs(rate_at(kind, polynomials, slowest * h)) > abs(rate_at(kind, polynomials, place * h)):
        return slowest
    return place


@njit
def _beside_rest(polynomials: Floats, h: float, part: float) -> bool:
    """Return whether a place, as a part of the step, is beside an end at which the motion rests."""
    end = 0.0 if part < 0.5 else h
    return abs(part * h - end) < BESIDE_REST * h and at_time(polynomials, end)[0] <= REST * REST


@njit
def write_gradient(
    kind: int, polynomials: Floats, r: Floats, passed: float, weights: Floats, gradient: Floats
) -> None:
    """Write the derivatives of a rate by the four control points of its step.

    Args:
        kind: of the rate.
        polynomials: of the step.
        r: (3, d): derivatives of the position at its start.
        passed: the place of the rate, s behind the start of the step.
        weights: (3, 4): those of the control points in r.
        gradient: (4, d): receives the derivatives.
    """
    f, half, bent, _ = at_time(polynomials, passed)
    by_f = 1.0 / f
    by_speed = math.sqrt(by_f)
    share = half * by_f
    for q in range(r.shape[1]):
        first = r[0, q] + passed * (r[1, q] + 0.5 * passed * r[2, q])
        second = r[1, q] + passed * r[2, q]
        across = second - share * first
        by_j = 0.0
        if kind == ALONG_JERK:
            by_v = r[2, q] - first * bent * by_f + (3.0 * share * first - 2.0 * second) * share
            by_v *= by_speed
            by_a = 2.0 * across * by_speed
            by_j = first * by_speed
        elif kind == ALONG:
            by_v, by_a = across * by_speed, first * by_speed
        else:
            by_v, by_a = -2.0 * share * across, 2.0 * across
        by_j += passed * (by_a + 0.5 * passed * by_v)
        by_a += passed * by_v
        for i in range(4):
            gradient[i, q] = weights[0, i] * by_v + weights[1, i] * by_a + weights[2, i] * by_j
