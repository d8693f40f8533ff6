r"""The fastest motion past corners within their tolerance, by an interior-point method.

The control points and the durations of the groups of steps are sought together. All rows of
:mod:`cnc.kernels.planner.corner_rows` have the form |x| <= b. Newton's method lowers

    t T / T0 - sum over the rows of log(1 - x/b) + log(1 + x/b)

for growing t, where T is the duration. T0, its first value, makes t a plain number. At the least
value T exceeds the optimum by about T0 (number of rows) / t.

x is linear in the control points, or convex (feed, tolerance), and there the second derivatives are
exact. By the durations, those of x are left out. They count less and less, because the fastest
motion has nearly as many bounds as unknowns. The matrix is a band, and one column for each group.

The method begins inside all bounds. To get there, (1 + s) b takes the place of each bound, and s is
lowered in the same way until it is negative.
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
    MOST_GROUPS,
    TRAVEL,
    Rows,
    Tube,
    derive_by_groups,
    evaluate,
    place_ends,
    set_knots,
    set_stencils,
)

GAP = 2e-3
"""The last (number of rows) / t."""

FIRST = 10.0
"""The first t, by the number of rows."""

RAISE = 8.0
"""Factor from one t to the next."""

CLOSE = 0.1
"""Newton's decrement at which a search ends."""

NEWTON_STEPS = 40
"""Largest number of steps for one t."""

LEAST_STEP = 1e-4

SHORTEST = math.log(0.1)
"""Groups become no shorter than by this change of their logarithm: rounding errors of the states at
the ends count in short steps.
"""

LONGEST = 0.05
"""Largest change of the logarithm of a duration in one step. The rows are far from linear in it."""

LEAST_PRODUCT = 1e-100
"""Products of distances are not smaller, nor larger than its inverse, before their logarithm."""

INSIDE = 0.02
"""The search for a first motion begins with bounds that are raised by so much more than it needs.
"""

LEGAL = -0.01
"""It ends at this s."""

ENOUGH = -0.001
"""The motion is legal enough with this s where no lower one was found."""

TRIALS = 3
"""Number of times that it is begun with slower motion."""

SLOWER = 0.04
"""Rise of the logarithms of the durations from one to the next."""

WEIGHT = 0.01
"""T / T0 counts so much beside s in that search, so that slower motion is not sought at any price.
"""


class Newton(NamedTuple):
    """Unknowns and arrays of the search.

    Attributes:
        c: (steps + 3, d): control points.
        spans: (groups,): logarithms of the durations of the groups.
        tried: (steps + 3, d): control points of the step that is tried.
        tried_spans: (groups,): its logarithms.
        band: (free, 4 d): second derivatives by the free coordinates.
        side: (groups + 1, free): those by a logarithm, or s, and a coordinate.
        block: (groups + 1, groups + 1): those by logarithms and s.
        slope: (free,): first derivatives by the coordinates.
        other: (groups + 1,): those by the logarithms and s.
        least: (groups,): least logarithms.
        share: (groups,): number of times that the duration of a group counts.
        weight: (places, d, d): second derivatives by x of each place.
        x: (places, d): the places before a step.
        ahead: (places, d): their change in the step, to first order.
    """

    c: Floats
    spans: Floats
    tried: Floats
    tried_spans: Floats
    band: Floats
    side: Floats
    block: Floats
    slope: Floats
    other: Floats
    least: Floats
    share: Floats
    weight: Floats
    x: Floats
    ahead: Floats


@njit
def new_newton(tube: Tube, rows: Rows, c: Floats, spans: Floats) -> Newton:
    """Return the arrays for a search that begins with these control points and logarithms."""
    points, d = c.shape
    free, columns = d * (points - 2 * FIXED), len(spans) + 1
    share = np.zeros(len(spans))
    for k in range(len(tube.leg)):
        share[tube.group[k]] += tube.part[k]
    return Newton(
        c.copy(),
        spans.copy(),
        c.copy(),
        spans.copy(),
        np.zeros((free, 4 * d)),
        np.zeros((columns, free)),
        np.zeros((columns, columns)),
        np.zeros(free),
        np.zeros(columns),
        spans + SHORTEST,
        share,
        np.zeros((rows.number[0], d, d)),
        np.zeros((rows.number[0], d)),
        np.zeros((rows.number[0], d)),
    )


@njit
def duration(share: Floats, spans: Floats) -> float:
    """Return the duration of all groups, s."""
    total = 0.0
    for g in range(len(spans)):
        total += share[g] * math.exp(spans[g])
    return total


@njit
def _barrier(rows: Rows, s: float, spans: Floats, least: Floats) -> float:
    """Return minus the sum of the logarithms of the distances from the bounds; infinity outside."""
    total = 0.0
    product = 1.0
    for g in range(len(spans)):
        if not spans[g] > least[g]:
            return math.inf
        total += math.log(spans[g] - least[g])
    for m in range(rows.number[1]):
        used = rows.value[m] * rows.scale[m]
        room = 1.0 + s - used
        other = 1.0 if rows.row[m] == TRAVEL else 1.0 + s + used
        if not (room > 0.0 and other > 0.0):
            return math.inf
        product *= room * other
        # One logarithm for several distances is faster.
        if not LEAST_PRODUCT < product < 1.0 / LEAST_PRODUCT:
            total += math.log(product)
            product = 1.0
    return -total - math.log(product)


@njit
def _most_used(rows: Rows) -> float:
    """Return the largest part of its bound that a row takes."""
    most = 0.0
    for m in range(rows.number[1]):
        used = rows.value[m] * rows.scale[m]
        most = max(most, used if rows.row[m] == TRAVEL else abs(used))
    return most


@njit
def _assemble(tube: Tube, rows: Rows, s: float, n: Newton) -> None:
    """Write the derivatives of the barrier."""
    n.band[:] = 0.0
    n.side[:] = 0.0
    n.slope[:] = 0.0
    n.block[:] = 0.0
    n.other[:] = 0.0
    d = n.c.shape[1]
    slope, by_s, bend = np.empty(d), np.empty(d), np.empty((d, d))
    for i in range(rows.number[0]):
        _add_rows(tube, rows, i, s, n, slope, by_s, bend)
        n.weight[i] = bend
        _add_place(rows, i, n, slope, by_s, bend)


@njit
def _add_rows(
    tube: Tube,
    rows: Rows,
    i: int,
    s: float,
    n: Newton,
    slope: Floats,
    by_s: Floats,
    bend: Floats,
) -> None:
    """Add up the derivatives of the rows of place i: by x (d,), by x and s (d,), twice by x (d, d).

    The derivatives by s alone go into ``n``.
    """
    last, d = len(n.spans), len(slope)
    leg = tube.leg[rows.step[i]]
    slope[:] = 0.0
    by_s[:] = 0.0
    bend[:] = 0.0
    for m in range(rows.first[i], rows.first[i + 1]):
        raw = rows.scale[m]
        x = rows.value[m] * raw
        up = 1.0 / (1.0 + s - x)
        down = 0.0 if rows.row[m] == TRAVEL else 1.0 / (1.0 + s + x)
        by_x = (up - down) * raw
        xx = (up * up + down * down) * raw * raw
        xs = (down * down - up * up) * raw
        n.other[last] -= up + down
        n.block[last, last] += up * up + down * down
        gradient = rows.gradient[m]
        across = 0.0 if rows.row[m] <= TRAVEL else max(by_x, 0.0) * rows.bend[m]
        along = across * rows.beside[m]
        if rows.row[m] > TRAVEL and rows.bend[m] == 0.0:
            # At a length of 0 both bounds bend alike in all directions.
            across, along = xx, xx * rows.beside[m]
        for q in range(d):
            slope[q] += by_x * gradient[q]
            by_s[q] += xs * gradient[q]
            bend[q, q] += across
            for o in range(d):
                bend[q, o] += (xx - across) * gradient[q] * gradient[o]
                # Along a leg its distance does not change.
                bend[q, o] -= along * tube.along[leg, q] * tube.along[leg, o]


@njit
def _add_place(rows: Rows, i: int, n: Newton, slope: Floats, by_s: Floats, bend: Floats) -> None:
    """Add the derivatives of place i by x to those by the unknowns."""
    free, d, last = len(n.slope), len(slope), len(n.spans)
    first = d * (rows.step[i] - FIXED)
    for j in range(4):
        weight = rows.stencil[i, j]
        at = first + d * j
        if weight == 0.0 or at < 0 or at >= free:
            continue
        for q in range(d):
            n.slope[at + q] += weight * slope[q]
            n.side[last, at + q] += weight * by_s[q]
        for o in range(j, 4):
            both = weight * rows.stencil[i, o]
            to = first + d * o
            if both == 0.0 or to >= free:
                continue
            for q in range(d):
                for r in range(q if o == j else 0, d):
                    n.band[at + q, to + r - at - q] += both * bend[q, r]
    for a in range(MOST_GROUPS):
        g = rows.group[i, a]
        if g < 0:
            continue
        for q in range(d):
            moved = rows.by_group[i, a, q]
            n.other[g] += slope[q] * moved
            n.block[g, last] += by_s[q] * moved
            n.block[last, g] += by_s[q] * moved
            bent = 0.0
            for o in range(d):
                bent += bend[q, o] * rows.by_group[i, a, o]
            for b in range(MOST_GROUPS):
                h = rows.group[i, b]
                if h >= 0:
                    n.block[g, h] += bent * rows.by_group[i, b, q]
            for j in range(4):
                at = first + d * j
                if 0 <= at < free:
                    n.side[g, at + q] += rows.stencil[i, j] * bent


@njit
def _newton_step(n: Newton, first: int, end: int) -> float:
    """Return the decrement; ``n.slope`` and ``n.other`` become the step.

    The columns are eliminated last: the band alone is factorised. Those before ``first`` and from
    ``end`` on stay as they are.
    """
    free, columns = len(n.slope), end - first
    factorise(n.band)
    rest = n.slope.copy()
    solve(n.band, rest)
    reduced, right = np.zeros((columns, columns)), np.empty(columns)
    solved = np.empty((columns, free))
    for a in range(columns):
        solved[a] = n.side[first + a]
        solve(n.band, solved[a])
        right[a] = -n.other[first + a]
        for i in range(free):
            right[a] += n.side[first + a, i] * rest[i]
    for a in range(columns):
        for b in range(a, columns):
            value = n.block[first + a, first + b]
            for i in range(free):
                value -= n.side[first + a, i] * solved[b, i]
            reduced[a, b - a] = value
    factorise(reduced)
    solve(reduced, right)
    decrement = 0.0
    for i in range(free):
        step = -rest[i]
        for a in range(columns):
            step -= solved[a, i] * right[a]
        decrement -= n.slope[i] * step
        n.slope[i] = step
    for a in range(columns):
        decrement -= n.other[first + a] * right[a]
    n.other[:] = 0.0
    n.other[first:end] = right
    return decrement


@njit
def _place(tube: Tube, rows: Rows, c: Floats, spans: Floats) -> None:
    """Evaluate the rows for these unknowns; the fixed points of ``c`` are written."""
    set_knots(tube, spans, rows)
    place_ends(tube, rows, c)
    set_stencils(rows)
    evaluate(tube, rows, c)


@njit
def _look_ahead(rows: Rows, n: Newton) -> None:
    """Write the places, and their change in the step ``n.slope`` and ``n.other``."""
    free, d = len(n.slope), n.c.shape[1]
    for i in range(rows.number[0]):
        first = d * (rows.step[i] - FIXED)
        for q in range(d):
            n.x[i, q] = rows.x[i, q]
            ahead = 0.0
            for j in range(4):
                at = first + d * j
                if 0 <= at < free:
                    ahead += rows.stencil[i, j] * n.slope[at + q]
            for a in range(MOST_GROUPS):
                if rows.group[i, a] >= 0:
                    ahead += rows.by_group[i, a, q] * n.other[rows.group[i, a]]
            n.ahead[i, q] = ahead


@njit
def _correct(tube: Tube, rows: Rows, n: Newton, part: float) -> None:
    """Move the tried points so that the places change as the step foresees.

    The places are far from linear in the durations. The difference is least in the sum of squares
    in which the step was the best.
    """
    free, d = len(n.slope), n.c.shape[1]
    band = np.zeros_like(n.band)
    right = np.zeros(free)
    for i in range(rows.number[0]):
        first = d * (rows.step[i] - FIXED)
        for j in range(4):
            weight = rows.stencil[i, j]
            at = first + d * j
            if weight == 0.0 or at < 0 or at >= free:
                continue
            for q in range(d):
                for r in range(d):
                    off = n.x[i, r] + part * n.ahead[i, r] - rows.x[i, r]
                    right[at + q] += weight * n.weight[i, q, r] * off
            for o in range(j, 4):
                both = weight * rows.stencil[i, o]
                to = first + d * o
                if both == 0.0 or to >= free:
                    continue
                for q in range(d):
                    for r in range(q if o == j else 0, d):
                        band[at + q, to + r - at - q] += both * n.weight[i, q, r]
    factorise(band)
    solve(band, right)
    for i in range(free):
        n.tried[FIXED + i // d, i % d] += right[i]
    evaluate(tube, rows, n.tried)


@njit
def _lowered(
    tube: Tube, rows: Rows, n: Newton, weights: tuple[float, float], s: float, goal: float
) -> float:
    """Lower the sum for one t, and return s.

    Args:
        tube: the legs.
        rows: their limits.
        n: receives the unknowns.
        weights: of T / T0 (as t / T0), and of s. Where one is 0, the durations or s stay.
        s: part by which the bounds are raised.
        goal: s that ends the search.
    """
    groups = len(n.spans)
    first = 0 if weights[0] > 0.0 else groups
    end = groups + (1 if weights[1] > 0.0 else 0)
    _place(tube, rows, n.c, n.spans)
    value = (
        weights[0] * duration(n.share, n.spans)
        + weights[1] * s
        + _barrier(rows, s, n.spans, n.least)
    )
    d = n.c.shape[1]
    held = False
    for _ in range(NEWTON_STEPS):
        if not value < math.inf or s <= goal:
            break
        if first == 0 and not held:
            derive_by_groups(tube, rows, n.spans, n.c)
        _assemble(tube, rows, s, n)
        for g in range(groups):
            time = weights[0] * n.share[g] * math.exp(n.spans[g])
            rest = 1.0 / (n.spans[g] - n.least[g])
            n.other[g] += time - rest
            n.block[g, g] += time + rest * rest
        n.other[groups] += weights[1]
        decrement = _newton_step(n, groups if held else first, end)
        if not CLOSE <= decrement < math.inf:
            if not held:
                break
            held = False
            continue
        if first == 0 and not held:
            _look_ahead(rows, n)
        part = 1.0
        for g in range(groups):
            part = min(part, LONGEST / max(abs(n.other[g]), LONGEST))
        step_s = n.other[groups]
        better = False
        while part > LEAST_STEP and not better:
            for i in range(len(n.slope)):
                k, q = FIXED + i // d, i % d
                n.tried[k, q] = n.c[k, q] + part * n.slope[i]
            for g in range(groups):
                n.tried_spans[g] = n.spans[g] + part * n.other[g]
            _place(tube, rows, n.tried, n.tried_spans)
            if first == 0 and not held:
                _correct(tube, rows, n, part)
            tried = s + part * step_s
            new = weights[0] * duration(n.share, n.tried_spans) + weights[1] * tried
            new += _barrier(rows, tried, n.tried_spans, n.least)
            better = new < value - 0.05 * part * decrement
            if not better:
                part *= 0.5
        if not better:
            if held or first == groups:
                break
            # With the durations as they are, the sum is convex: its least value is a better place
            # to change them.
            held = True
            _place(tube, rows, n.c, n.spans)
            continue
        n.c[:] = n.tried
        n.spans[:] = n.tried_spans
        s += part * step_s
        value = new
    return s


@njit
def fastest_motion(tube: Tube, rows: Rows, c: Floats, spans: Floats) -> bool:
    """Make a motion past corners the fastest one.

    Args:
        tube: the legs, and the states at both ends.
        rows: their limits.
        c: (steps + 3, d): control points of a motion near it, replaced by those of the result.
        spans: (groups,): logarithms of the durations of the groups there, replaced likewise.

    Returns:
        Whether a motion inside all limits was found.
    """
    n = new_newton(tube, rows, c, spans)
    _place(tube, rows, n.c, n.spans)
    count = float(rows.number[1])
    unit = 1.0 / duration(n.share, n.spans)
    s = (1.0 + INSIDE) * _most_used(rows) - 1.0 + INSIDE
    last = count / GAP
    rows.group[:] = -1
    for trial in range(TRIALS + 1):
        # With given durations the problem is convex. If slower motion does not help, they change.
        weight = WEIGHT * unit if trial == TRIALS else 0.0
        t = FIRST * count
        while s > LEGAL and t <= last:
            s = _lowered(tube, rows, n, (weight * t, t), s, LEGAL)
            t *= RAISE
        if s < ENOUGH:
            break
        if trial + 1 < TRIALS:
            n.spans[:] += SLOWER
            _place(tube, rows, n.c, n.spans)
            s = (1.0 + INSIDE) * _most_used(rows) - 1.0 + INSIDE
    if not s < 0.0:
        return False
    # Far from all bounds the durations change more freely.
    _lowered(tube, rows, n, (0.0, 0.0), 0.0, -math.inf)
    t = FIRST * count
    while True:
        _lowered(tube, rows, n, (t * unit, 0.0), 0.0, -math.inf)
        if t == last:
            break
        t = min(last, RAISE * t)
    _place(tube, rows, n.c, n.spans)
    if not _barrier(rows, 0.0, n.spans, n.least) < math.inf:
        return False
    c[:] = n.c
    spans[:] = n.spans
    return True
