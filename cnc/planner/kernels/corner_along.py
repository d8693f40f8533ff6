r"""The limits of jerk and acceleration along the path, for the motion past corners.

With r the position and v = |r'|, the rates are the jerk and the acceleration along the path, and
the acceleration across it:

    v''  = (r''.r'' + r'.r''') / v - (r'.r'')^2 / v^3,
    v'   = r'.r'' / v,
    a_n^2 = r''.r'' - v'^2.

In a step r''' is constant, r'' changes linearly and r' is a parabola. So f = r'.r' and g = r''.r''
are polynomials of the time of order 4 and 2, and r'.r'' = f'/2.

Each rate depends on all four control points of a step. So each of its rows
has a gradient of its own. The rates are not convex; their second derivatives are left out, as those
by the durations are (:mod:`cnc.planner.kernels.corner_motion`).

The jerk has rows at the ends of each step, and one between them where it is largest. The
acceleration has rows at three fixed places (SHARES). Where a rate is larger between its rows,
``tighten`` lowers their bounds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.planner.kernels.corner_tube import (
    ACCELERATION,
    CORNER,
    EARLY,
    EDGE,
    FIXED,
    JERK,
    Tube,
    place_ends,
    set_knots,
    steps_of,
    write_stencil,
)

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


RATES = (ALONG_JERK, ALONG, ACROSS)

SHARES = ((0.0, 0.5, 1.0), (0.0, 1.0 / 3.0, 2.0 / 3.0), (0.0, 1.0 / 3.0, 2.0 / 3.0))
"""Places of the rows of a step for each rate, as parts of its duration. The middle one of the jerk
moves. The acceleration at the end of a step is that at the start of the next one.
"""

MOST_GROUPS = 2
"""Groups whose durations change a place: it depends on five steps, and no group is shorter than 4.
"""

SMALL = 1e-6
"""Change of the logarithm of a duration in a difference quotient."""

FINE = 64
"""Parts of a step, at whose ends a rate is compared with its limit."""

COARSE = 16
"""Parts of a step, at one of whose ends its middle row stands: where the rate is largest."""

BETWEEN = 5e-4
"""Part of the limit that is left for places between the rows of a step."""

BETWEEN_FINE = 1e-4
"""Part of the limit that is left for places between those that FINE parts have."""


class AlongRows(NamedTuple):
    """Rows |rate| <= bound, those of a step and a rate beside each other.

    Attributes:
        number: (1,): of rows that count.
        rate: (rows,): which rate each bounds.
        step: (rows,): their steps.
        share: (rows,): their places in the step.
        limit: (rows,): the limit of the rate. Beside the ends it is no less than what the motion
            beside takes, and a little more.
        scale: (rows,): 1 / bound, which is less than the limit.
        value: (rows,): the rate.
        gradient: (rows, 4, d): its derivatives by control points step .. step + 3.
        group: (rows, MOST_GROUPS): groups whose duration changes it; -1 for none.
        by_group: (rows, MOST_GROUPS): derivative by the logarithm of that duration.
        weight: (rows,): second derivative of the barrier by the rate.
        before: (rows,): the rate before a step of the search.
        ahead: (rows,): its change in the step, to first order.
    """

    number: Ints
    rate: Ints
    step: Ints
    share: Floats
    limit: Floats
    scale: Floats
    value: Floats
    gradient: Floats
    group: Ints
    by_group: Floats
    weight: Floats
    before: Floats
    ahead: Floats


@njit
def new_along(steps: int, directions: int) -> AlongRows:
    """Return space for the rows of so many steps."""
    rows = len(RATES) * len(SHARES[0]) * steps
    return AlongRows(
        np.zeros(1, np.int64),
        np.zeros(rows, np.int64),
        np.zeros(rows, np.int64),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros((rows, 4, directions)),
        np.zeros((rows, MOST_GROUPS), np.int64),
        np.zeros((rows, MOST_GROUPS)),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
    )


@njit
def limit_of(tube: Tube, rate: int) -> float:
    """Return the limit of a rate."""
    if rate == ALONG_JERK:
        return tube.along_jerk
    return tube.along_pull if rate == ALONG else tube.across_pull**2


@njit
def _rests(tube: Tube, end: int) -> bool:
    """Return whether the motion rests at its start (0) or its end (1)."""
    square = 0.0
    for q in range(tube.ends.shape[2]):
        square += tube.ends[end, 1, q] ** 2
    return math.sqrt(square) <= REST


@njit
def _at_end(tube: Tube, rate: int, end: int) -> float:
    """Return the size of a rate of the motion beside the start (0) or the end (1).

    It is 0 at a rest, and for the jerk, which may jump there.
    """
    if rate == ALONG_JERK or _rests(tube, end):
        return 0.0
    v, a = tube.ends[end, 1], tube.ends[end, 2]
    f = half = pull = 0.0
    for q in range(len(v)):
        f += v[q] * v[q]
        half += v[q] * a[q]
        pull += a[q] * a[q]
    return abs(half) / math.sqrt(f) if rate == ALONG else pull - half * half / f


@njit
def write_along(tube: Tube, along: AlongRows) -> None:
    """Write the rows of a tube, for the rates that are limited."""
    along.number[0] = 0
    along.group[:] = -1
    steps = len(tube.leg)
    for k in range(steps):
        for rate in RATES:
            limit = limit_of(tube, rate)
            if not limit < math.inf:
                continue
            if k == 0:
                limit = max(limit, (1.0 + EDGE + BETWEEN) * _at_end(tube, rate, 0))
            if k == steps - 1:
                limit = max(limit, (1.0 + EDGE + BETWEEN) * _at_end(tube, rate, 1))
            for share in SHARES[rate]:
                if rate != ALONG_JERK and k == 0 and share == 0.0:
                    continue
                if k == 0 and share == 0.0 and _rests(tube, 0):
                    continue
                if k == steps - 1 and share == 1.0 and _rests(tube, 1):
                    continue
                m = along.number[0]
                along.rate[m] = rate
                along.step[m] = k
                along.share[m] = share
                along.limit[m] = limit
                along.scale[m] = (1.0 + BETWEEN) / limit
                along.number[0] += 1


@njit
def evaluate_along(along: AlongRows, t: Floats, c: Floats) -> None:
    """Write values and gradients for control points ``c`` (steps + 3, d)."""
    d = c.shape[1]
    weights, r, polynomials = np.empty((3, 4)), np.empty((3, d)), np.empty(NUMBERS)
    read, h = -1, 0.0
    for m in range(along.number[0]):
        k, rate = along.step[m], along.rate[m]
        if k != read:
            read, h = k, read_step(k, t, c, weights, r, polynomials)
        if rate == ALONG_JERK and 0.0 < along.share[m] < 1.0:
            along.share[m] = peak_in(rate, polynomials, h, COARSE)
        passed = along.share[m] * h
        along.value[m] = rate_at(rate, polynomials, passed)
        if not along.value[m] < math.inf:
            continue
        write_gradient(rate, polynomials, r, passed, weights, along.gradient[m])


@njit
def derive_along(tube: Tube, along: AlongRows, spans: Floats, t: Floats, c: Floats) -> None:
    """Write the derivatives by the unknowns ``spans``; ``t`` is overwritten."""
    if along.number[0] == 0:
        set_knots(tube, spans, t)
        return
    other, moved = spans.copy(), c.copy()
    weights, r, polynomials = np.empty((3, 4)), np.empty((3, c.shape[1])), np.empty(NUMBERS)
    along.group[:] = -1
    begin = 0
    for group in range(len(spans)):
        first, end = steps_of(tube, group, begin)
        other[group] = spans[group] + SMALL
        set_knots(tube, other, t)
        place_ends(tube, t, moved)
        read, h = -1, 0.0
        for m in range(along.number[0]):
            k = along.step[m]
            if first - 2 <= k < end + 2:
                if k != read:
                    read, h = k, read_step(k, t, moved, weights, r, polynomials)
                slot = 0 if along.group[m, 0] < 0 else 1
                along.group[m, slot] = group
                moved_rate = rate_at(along.rate[m], polynomials, along.share[m] * h)
                along.by_group[m, slot] = (moved_rate - along.value[m]) / SMALL
        other[group] = spans[group]
        begin = end
    set_knots(tube, spans, t)


@njit
def tighten(along: AlongRows, t: Floats, c: Floats) -> float:
    """Lower the bounds of each step in which a rate is larger between its rows than at them.

    Returns:
        The largest part of a limit that a rate takes.
    """
    weights, r, polynomials = np.empty((3, 4)), np.empty((3, c.shape[1])), np.empty(NUMBERS)
    most, m = 0.0, 0
    while m < along.number[0]:
        k, rate, first = along.step[m], along.rate[m], m
        limit = (1.0 - BETWEEN_FINE) * along.limit[m]
        h = read_step(k, t, c, weights, r, polynomials)
        peak = peak_in(rate, polynomials, h, FINE)
        between, at_rows = abs(rate_at(rate, polynomials, peak * h)), 0.0
        while m < along.number[0] and along.step[m] == k and along.rate[m] == rate:
            at_rows = max(at_rows, abs(along.value[m]))
            m += 1
        most = max(most, between / limit)
        if between > limit and between > at_rows > 0.0:
            for row in range(first, m):
                tightened = (1.0 + BETWEEN) * between / at_rows / along.limit[row]
                along.scale[row] = max(along.scale[row], tightened)
    return most


@njit
def most_along(along: AlongRows) -> float:
    """Return the largest part of its bound that a row takes."""
    most = 0.0
    for m in range(along.number[0]):
        most = max(most, abs(along.value[m]) * along.scale[m])
    return most


@njit
def along_ahead(along: AlongRows, d: int, slope: Floats, by_groups: Floats) -> None:
    """Write the values, and their change in the step of the points and of the logarithms."""
    free = len(slope)
    for m in range(along.number[0]):
        first = d * (along.step[m] - FIXED)
        ahead = 0.0
        for i in range(4):
            at = first + d * i
            if 0 <= at < free:
                for q in range(d):
                    ahead += along.gradient[m, i, q] * slope[at + q]
        for a in range(MOST_GROUPS):
            if along.group[m, a] >= 0:
                ahead += along.by_group[m, a] * by_groups[along.group[m, a]]
        along.before[m] = along.value[m]
        along.ahead[m] = ahead


@njit
def add_along(along: AlongRows, d: int, band: Floats) -> None:
    """Add ``weight`` times the square of the gradient of each row to second derivatives."""
    free = len(band)
    flat = np.empty(4 * d)
    for m in range(along.number[0]):
        first = d * (along.step[m] - FIXED)
        for i in range(4):
            for q in range(d):
                flat[d * i + q] = along.gradient[m, i, q]
        end = min(4 * d, free - first)
        for column in range(max(-first, 0), end):
            # The entries of a row of the matrix are contiguous.
            factor = along.weight[m] * flat[column]
            for k in range(column, end):
                band[first + column, k - column] += factor * flat[k]
