r"""The limit of the jerk along the path, for the motion past corners.

With r the position and v = |r'|, the jerk along the path is

    v'' = (r''.r'' + r'.r''') / v - (r'.r'')^2 / v^3.

It depends on all four control points of a step. So each of its rows has a gradient of its own. It
is not convex; its second derivatives are left out, as those by the durations are
(:mod:`cnc.kernels.planner.corner_motion`).

In a step r''' is constant, r'' changes linearly and r' is a parabola. A row stands at the start
and the end of each step, and one between them where v'' is largest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.planner.corner_tube import (
    ACCELERATION,
    CORNER,
    EARLY,
    FIXED,
    JERK,
    Tube,
    place_ends,
    set_knots,
    steps_of,
    write_stencil,
)

SHARES = (0.0, 0.5, 1.0)
"""Places of the rows of a step, as parts of its duration. The middle one moves."""

MOST_GROUPS = 2
"""Groups whose durations change a place: it depends on five steps, and no group is shorter than 4.
"""

SMALL = 1e-6
"""Change of the logarithm of a duration in a difference quotient."""

FINE = 64
"""Parts of a step, at whose ends v'' is compared with the limit."""

COARSE = 16
"""Parts of a step, at one of whose ends its middle row stands: where v'' is largest."""

BETWEEN = 5e-4
"""Part of the limit that is left for places between the rows of a step."""

BETWEEN_FINE = 1e-4
"""Part of the limit that is left for places between those that FINE parts have."""

BESIDE_REST = 1e-3
"""Part of a step beside a rest that is not searched for the place of the least speed."""

SLOWEST_STEPS = 12
"""Largest number of Newton steps to the place of the least speed."""

FOUND = 1e-12
"""A shorter step, as a part of the duration, ends that search."""

REST = 1e-9
"""mm/s; the jerk along the path has no value where the motion rests."""


class AlongRows(NamedTuple):
    """Rows |v''| <= jerk.

    Attributes:
        number: (1,): of rows that count.
        step: (rows,): their steps.
        share: (rows,): their places in the step.
        scale: (rows,): 1 / bound.
        value: (rows,): v'', mm/s^3.
        gradient: (rows, 4, d): its derivatives by control points step .. step + 3.
        group: (rows, MOST_GROUPS): groups whose duration changes it; -1 for none.
        by_group: (rows, MOST_GROUPS): derivative by the logarithm of that duration.
        weight: (rows,): second derivative of the barrier by v''.
        before: (rows,): v'' before a step of the search.
        ahead: (rows,): its change in the step, to first order.
    """

    number: Ints
    step: Ints
    share: Floats
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
    rows = len(SHARES) * steps
    return AlongRows(
        np.zeros(1, np.int64),
        np.zeros(rows, np.int64),
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
def _rests(tube: Tube, end: int) -> bool:
    """Return whether the motion rests at its start (0) or its end (1)."""
    square = 0.0
    for q in range(tube.ends.shape[2]):
        square += tube.ends[end, 1, q] ** 2
    return math.sqrt(square) <= REST


@njit
def write_along(tube: Tube, along: AlongRows) -> None:
    """Write the rows of a tube; none where the jerk along the path is not limited."""
    along.number[0] = 0
    along.group[:] = -1
    if not tube.along_jerk < math.inf:
        return
    steps = len(tube.leg)
    for k in range(steps):
        for share in SHARES:
            if k == 0 and share == 0.0 and _rests(tube, 0):
                continue
            if k == steps - 1 and share == 1.0 and _rests(tube, 1):
                continue
            m = along.number[0]
            along.step[m] = k
            along.share[m] = share
            along.scale[m] = (1.0 + BETWEEN) / tube.along_jerk
            along.number[0] += 1


@njit
def _read_step(k: int, t: Floats, c: Floats, weights: Floats, r: Floats, square: Floats) -> float:
    """Write the derivatives of r of order 1 to 3 (3, d) at the start of step k.

    ``weights`` (3, 4) receives those of the control points in them; ``square`` (5,) the
    coefficients of the polynomial r'.r' of the time from the start of the step.

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
    square[:] = 0.0
    for q in range(c.shape[1]):
        for order in range(3):
            r[order, q] = 0.0
            for m in range(4):
                r[order, q] += weights[order, m] * c[k + m, q]
        v, a, j = r[0, q], r[1, q], r[2, q]
        square[0] += v * v
        square[1] += 2.0 * v * a
        square[2] += a * a + v * j
        square[3] += a * j
        square[4] += 0.25 * j * j
    return h


@njit
def _along(square: Floats, passed: float) -> tuple[float, float, float]:
    """Return f = r'.r', f'/2 and f''/2 so many seconds behind the start of a step."""
    f0, f1, f2, f3, f4 = square[0], square[1], square[2], square[3], square[4]
    x = passed
    f = f0 + x * (f1 + x * (f2 + x * (f3 + x * f4)))
    first = 0.5 * f1 + x * (f2 + x * (1.5 * f3 + 2.0 * x * f4))
    return f, first, f2 + x * (3.0 * f3 + 6.0 * x * f4)


@njit
def _jerk_at(square: Floats, passed: float) -> float:
    """Return v'' there; infinity where the motion rests."""
    f, first, second = _along(square, passed)
    if f <= REST * REST:
        return math.inf
    return (second - first * first / f) / math.sqrt(f)


@njit
def _largest_at(square: Floats, h: float, parts: int) -> float:
    """Return the end of one of so many parts of a step at which v'' is largest, as its part."""
    largest, place = -1.0, 0.5
    for i in range(1, parts):
        f, first, second = _along(square, i * h / parts)
        if f <= REST * REST:
            return i / parts
        # v'' squared, with one division.
        excess = f * second - first * first
        value = excess * excess / (f * f * f)
        if value > largest:
            largest, place = value, i / parts
    return place


@njit
def _slowest_at(square: Floats, h: float) -> float:
    """Return the place in a step at which the speed is least, as a part of its duration; or -1.

    There v'' may have a peak that is too narrow for places at equal distances. It is -1 where the
    speed only falls, or only rises.
    """
    low, high = 0.0, h
    if not _along(square, low)[1] < 0.0 < _along(square, high)[1]:
        return -1.0
    at = 0.5 * h
    for _ in range(SLOWEST_STEPS):
        # The root of f' by Newton's method.
        _, first, second = _along(square, at)
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
def peak_in(square: Floats, h: float, parts: int) -> float:
    """Return the place in a step at which v'' is about largest, as a part of its duration."""
    place = _largest_at(square, h, parts)
    slowest = _slowest_at(square, h)
    if slowest < 0.0 or _beside_rest(square, h, slowest):
        return place
    if abs(_jerk_at(square, slowest * h)) > abs(_jerk_at(square, place * h)):
        return slowest
    return place


@njit
def _beside_rest(square: Floats, h: float, part: float) -> bool:
    """Return whether a place, as a part of the step, is beside an end at which the motion rests."""
    end = 0.0 if part < 0.5 else h
    return abs(part * h - end) < BESIDE_REST * h and _along(square, end)[0] <= REST * REST


@njit
def evaluate_along(along: AlongRows, t: Floats, c: Floats) -> None:
    """Write values and gradients for control points ``c`` (steps + 3, d)."""
    d = c.shape[1]
    weights, r, square = np.empty((3, 4)), np.empty((3, d)), np.empty(5)
    read, h = -1, 0.0
    for m in range(along.number[0]):
        k = along.step[m]
        if k != read:
            read, h = k, _read_step(k, t, c, weights, r, square)
        if 0.0 < along.share[m] < 1.0:
            along.share[m] = peak_in(square, h, COARSE)
        passed = along.share[m] * h
        f, half, bent = _along(square, passed)
        if f <= REST * REST:
            along.value[m] = math.inf
            continue
        v = math.sqrt(f)
        along.value[m] = (bent - half * half / f) / v
        for q in range(d):
            first = r[0, q] + passed * (r[1, q] + 0.5 * passed * r[2, q])
            second = r[1, q] + passed * r[2, q]
            by_v = r[2, q] / v - first * bent / (v * f)
            by_v += (3.0 * half * first / f - 2.0 * second) * half / (v * f)
            by_a = 2.0 * (second - half / f * first) / v
            by_j = first / v
            # By the derivatives at the start of the step.
            by_j += passed * (by_a + 0.5 * passed * by_v)
            by_a += passed * by_v
            for i in range(4):
                along.gradient[m, i, q] = (
                    weights[0, i] * by_v + weights[1, i] * by_a + weights[2, i] * by_j
                )


@njit
def derive_along(tube: Tube, along: AlongRows, spans: Floats, t: Floats, c: Floats) -> None:
    """Write the derivatives by the unknowns ``spans``; ``t`` is overwritten."""
    if along.number[0] == 0:
        set_knots(tube, spans, t)
        return
    other, moved = spans.copy(), c.copy()
    weights, r, square = np.empty((3, 4)), np.empty((3, c.shape[1])), np.empty(5)
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
                    read, h = k, _read_step(k, t, moved, weights, r, square)
                slot = 0 if along.group[m, 0] < 0 else 1
                along.group[m, slot] = group
                changed = _jerk_at(square, along.share[m] * h) - along.value[m]
                along.by_group[m, slot] = changed / SMALL
        other[group] = spans[group]
        begin = end
    set_knots(tube, spans, t)


@njit
def tighten(tube: Tube, along: AlongRows, t: Floats, c: Floats) -> float:
    """Lower the bounds of each step in which v'' is larger between its rows than at them.

    Returns:
        The largest part of the limit that v'' takes.
    """
    limit = (1.0 - BETWEEN_FINE) * tube.along_jerk
    weights, r, square = np.empty((3, 4)), np.empty((3, c.shape[1])), np.empty(5)
    most, m = 0.0, 0
    while m < along.number[0]:
        k, first = along.step[m], m
        h = _read_step(k, t, c, weights, r, square)
        between, at_rows = abs(_jerk_at(square, peak_in(square, h, FINE) * h)), 0.0
        while m < along.number[0] and along.step[m] == k:
            at_rows = max(at_rows, abs(along.value[m]))
            m += 1
        most = max(most, between / limit)
        if between > limit and between > at_rows > 0.0:
            for row in range(first, m):
                tightened = (1.0 + BETWEEN) * between / at_rows / tube.along_jerk
                along.scale[row] = max(along.scale[row], tightened)
    return most


@njit
def most_along(along: AlongRows) -> float:
    """Return the largest part of the limit that a row takes."""
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
    for m in range(along.number[0]):
        first = d * (along.step[m] - FIXED)
        for i in range(4):
            at = first + d * i
            if at < 0 or at >= free:
                continue
            for o in range(i, 4):
                to = first + d * o
                if to >= free:
                    continue
                for q in range(d):
                    bent = along.weight[m] * along.gradient[m, i, q]
                    for r in range(q if o == i else 0, d):
                        band[at + q, to + r - at - q] += bent * along.gradient[m, o, r]
