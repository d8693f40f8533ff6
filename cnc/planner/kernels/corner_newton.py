"""The barrier of a motion past corners, its derivatives, and a step of Newton's method.

See :mod:`cnc.planner.kernels.corner_motion`. The second derivatives by the control points are a
band, and there is a column for the duration of each group and for s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.path.kernels.fit_program import backward, factorise, forward, solve
from cnc.planner.kernels.corner_along import MOST_GROUPS, add_along, along_ahead
from cnc.planner.kernels.corner_rows import TRAVEL, Rows, evaluate
from cnc.planner.kernels.corner_tube import FIXED, Tube, durations_of

SHORTEST = math.log(0.1)
"""Groups become no shorter than by this change of their logarithm: rounding errors of the states at
the ends count in short steps.
"""

LEAST_PRODUCT = 1e-100
"""Products of distances are not smaller, nor larger than its inverse, before their logarithm."""


class Newton(NamedTuple):
    """Unknowns and arrays of the search.

    Attributes:
        c: (steps + 3, d): control points.
        spans: (groups,): logarithms of the durations of the groups; then the place of the end, if
            it is sought. It counts as a group without a duration.
        tried: (steps + 3, d): control points of the step that is tried.
        tried_spans: (groups,): its logarithms.
        band: (free, 4 d): second derivatives by the free coordinates.
        side: (groups + 1, free): those by a logarithm, or s, and a coordinate.
        block: (groups + 1, groups + 1): those by logarithms and s.
        slope: (free,): first derivatives by the coordinates.
        other: (groups + 1,): those by the logarithms and s.
        least: (groups,): least values.
        share: (groups,): number of times that the duration of a group counts.
        weight: (places, d, d): second derivatives by x of each place.
        by_x: (places, d): first derivatives by x of each place.
        by_x_and_s: (places, d): second derivatives by x and s.
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
    by_x: Floats
    by_x_and_s: Floats
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
    least = spans + SHORTEST
    # The place of the end is no earlier than the start of the leg.
    least[durations_of(tube, spans) :] = 0.0
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
        least,
        share,
        np.zeros((rows.number[0], d, d)),
        np.zeros((rows.number[0], d)),
        np.zeros((rows.number[0], d)),
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
def barrier(rows: Rows, s: float, spans: Floats, least: Floats) -> float:
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
    along = rows.along
    for m in range(along.number[0]):
        used = along.value[m] * along.scale[m]
        bound = 1.0 + s
        if not abs(used) < bound:
            return math.inf
        total += math.log((bound - used) * (bound + used))
    return -total - math.log(product)


@njit
def most_used(rows: Rows) -> float:
    """Return the largest part of its bound that a row takes."""
    most = 0.0
    for m in range(rows.number[1]):
        used = rows.value[m] * rows.scale[m]
        most = max(most, used if rows.row[m] == TRAVEL else abs(used))
    return most


@njit
def assemble(tube: Tube, rows: Rows, s: float, n: Newton) -> None:
    """Write the derivatives of the barrier."""
    n.band[:] = 0.0
    n.side[:] = 0.0
    n.slope[:] = 0.0
    n.block[:] = 0.0
    n.other[:] = 0.0
    # Each call passes dozens of arrays, so one call does the work of all rows.
    _add_up_rows(tube, rows, s, n)
    add_to_band(rows, n.weight, n.band)
    _add_slopes(rows, n)
    _add_along(rows, s, n)


@njit
def _add_up_rows(tube: Tube, rows: Rows, s: float, n: Newton) -> None:
    """Add up the derivatives of the rows of each place: by x, by x and s, twice by x.

    The derivatives by s alone go into their place.
    """
    last, d = len(n.spans), n.c.shape[1]
    for i in range(rows.number[0]):
        leg = tube.leg[rows.step[i]]
        for q in range(d):
            n.by_x[i, q] = n.by_x_and_s[i, q] = 0.0
            for o in range(d):
                n.weight[i, q, o] = 0.0
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
            across = 0.0 if rows.row[m] <= TRAVEL else max(by_x, 0.0) * rows.bend[m]
            along = across * rows.beside[m]
            if rows.row[m] > TRAVEL and rows.bend[m] == 0.0:
                # At a length of 0 both bounds bend alike in all directions.
                across, along = xx, xx * rows.beside[m]
            for q in range(d):
                n.by_x[i, q] += by_x * rows.gradient[m, q]
                n.by_x_and_s[i, q] += xs * rows.gradient[m, q]
                n.weight[i, q, q] += across
                for o in range(d):
                    bend = (xx - across) * rows.gradient[m, q] * rows.gradient[m, o]
                    # Along a leg its distance does not change.
                    bend -= along * tube.along[leg, q] * tube.along[leg, o]
                    n.weight[i, q, o] += bend


@njit
def add_to_band(rows: Rows, weight: Floats, band: Floats) -> None:
    """Add second derivatives by x (places, d, d) to those by the coordinates."""
    free, d = len(band), weight.shape[1]
    segment = np.empty(4 * d)
    for i in range(rows.number[0]):
        first = d * (rows.step[i] - FIXED)
        begin, end = 0, 4
        while begin < 4 and (rows.stencil[i, begin] == 0.0 or first + d * begin < 0):
            begin += 1
        while end > begin and (rows.stencil[i, end - 1] == 0.0 or first + d * end > free):
            end -= 1
        for q in range(d):
            for o in range(begin, end):
                for r in range(d):
                    segment[d * o + r] = rows.stencil[i, o] * weight[i, q, r]
            for j in range(begin, end):
                # The entries of a row of the matrix are contiguous.
                factor, column = rows.stencil[i, j], d * j + q
                for k in range(column, d * end):
                    band[first + column, k - column] += factor * segment[k]


@njit
def _add_slopes(rows: Rows, n: Newton) -> None:
    """Add the derivatives by x of all places to those by the unknowns."""
    free, d, last = len(n.slope), n.c.shape[1], len(n.spans)
    bent = np.empty(d)
    for i in range(rows.number[0]):
        first = d * (rows.step[i] - FIXED)
        for j in range(4):
            weight = rows.stencil[i, j]
            at = first + d * j
            if weight == 0.0 or at < 0 or at >= free:
                continue
            for q in range(d):
                n.slope[at + q] += weight * n.by_x[i, q]
                n.side[last, at + q] += weight * n.by_x_and_s[i, q]
        for a in range(MOST_GROUPS):
            g = rows.group[i, a]
            if g < 0:
                continue
            for q in range(d):
                moved = rows.by_group[i, a, q]
                n.other[g] += n.by_x[i, q] * moved
                n.block[g, last] += n.by_x_and_s[i, q] * moved
                n.block[last, g] += n.by_x_and_s[i, q] * moved
                bent[q] = 0.0
                for o in range(d):
                    bent[q] += n.weight[i, q, o] * rows.by_group[i, a, o]
                for b in range(MOST_GROUPS):
                    h = rows.group[i, b]
                    if h >= 0:
                        n.block[g, h] += bent[q] * rows.by_group[i, b, q]
            for j in range(4):
                weight, at = rows.stencil[i, j], first + d * j
                if weight != 0.0 and 0 <= at < free:
                    for q in range(d):
                        n.side[g, at + q] += weight * bent[q]


@njit
def _add_along(rows: Rows, s: float, n: Newton) -> None:
    """Add the derivatives of the rows of the jerk along the path."""
    along = rows.along
    free, d, last = len(n.slope), n.c.shape[1], len(n.spans)
    for m in range(along.number[0]):
        raw = along.scale[m]
        x = along.value[m] * raw
        up, down = 1.0 / (1.0 + s - x), 1.0 / (1.0 + s + x)
        by_x = (up - down) * raw
        xx = (up * up + down * down) * raw * raw
        xs = (down * down - up * up) * raw
        along.weight[m] = xx
        n.other[last] -= up + down
        n.block[last, last] += up * up + down * down
        first = d * (along.step[m] - FIXED)
        for i in range(4):
            at = first + d * i
            if 0 <= at < free:
                for q in range(d):
                    n.slope[at + q] += by_x * along.gradient[m, i, q]
                    n.side[last, at + q] += xs * along.gradient[m, i, q]
        for a in range(MOST_GROUPS):
            g = along.group[m, a]
            if g < 0:
                continue
            moved = along.by_group[m, a]
            n.other[g] += by_x * moved
            n.block[g, last] += xs * moved
            n.block[last, g] += xs * moved
            for b in range(MOST_GROUPS):
                if along.group[m, b] >= 0:
                    n.block[g, along.group[m, b]] += xx * moved * along.by_group[m, b]
            for i in range(4):
                at = first + d * i
                if 0 <= at < free:
                    for q in range(d):
                        n.side[g, at + q] += xx * moved * along.gradient[m, i, q]
    add_along(along, d, n.band)


@njit
def newton_step(n: Newton, first: int, end: int) -> float:
    """Return the decrement; ``n.slope`` and ``n.other`` become the step.

    The columns are eliminated last: the band alone is factorised. Those before ``first`` and from
    ``end`` on stay as they are.
    """
    free, columns = len(n.slope), end - first
    factorise(n.band)
    rest = n.slope.copy()
    forward(n.band, rest)
    sides = np.empty((free, columns))
    for a in range(columns):
        for i in range(free):
            sides[i, a] = n.side[first + a, i]
    begun = _forward_columns(n.band, sides)
    reduced, right = np.zeros((columns, columns)), np.empty(columns)
    for a in range(columns):
        right[a] = -n.other[first + a]
        for b in range(a, columns):
            reduced[a, b - a] = n.block[first + a, first + b]
    for i in range(free):
        for a in range(begun[i]):
            value = sides[i, a]
            right[a] += value * rest[i]
            for b in range(a, begun[i]):
                reduced[a, b - a] -= value * sides[i, b]
    factorise(reduced)
    solve(reduced, right)
    for i in range(free):
        for a in range(begun[i]):
            rest[i] += sides[i, a] * right[a]
    backward(n.band, rest)
    decrement = 0.0
    for i in range(free):
        decrement += n.slope[i] * rest[i]
        n.slope[i] = -rest[i]
    for a in range(columns):
        decrement -= n.other[first + a] * right[a]
    n.other[:] = 0.0
    n.other[first:end] = right
    return decrement


@njit
def _forward_columns(factor: Floats, sides: Floats) -> Ints:
    """Solve U'y = b for each column of ``sides`` (free, columns), in its place.

    Returns:
        (free,): the number of columns that may differ from 0 in each row. The columns are in the
        order of the groups of steps, so all behind them are 0 there.
    """
    free, columns = sides.shape
    width = factor.shape[1]
    begun = np.zeros(free, np.int64)
    count = 0
    for i in range(free):
        for a in range(columns - 1, count - 1, -1):
            if sides[i, a] != 0.0:
                count = a + 1
                break
        begun[i] = count
        inverse = 1.0 / factor[i, 0]
        for a in range(count):
            sides[i, a] *= inverse
        for j in range(1, min(width, free - i)):
            weight = factor[i, j]
            for a in range(count):
                sides[i + j, a] -= weight * sides[i, a]
    return begun


@njit
def look_ahead(rows: Rows, n: Newton) -> None:
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
    along_ahead(rows.along, d, n.slope, n.other)


@njit
def furthest(rows: Rows, n: Newton, s: float, step_s: float) -> float:
    """Return the part of the step at which, to first order, the first bound is reached."""
    d = n.c.shape[1]
    part, bound = math.inf, 1.0 + s
    for i in range(rows.number[0]):
        for m in range(rows.first[i], rows.first[i + 1]):
            if rows.row[m] > TRAVEL:
                continue
            change = 0.0
            for q in range(d):
                change += rows.gradient[m, q] * n.ahead[i, q]
            change *= rows.scale[m]
            used = rows.value[m] * rows.scale[m]
            if change > step_s:
                part = min(part, (bound - used) / (change - step_s))
            elif -change > step_s and rows.row[m] != TRAVEL:
                part = min(part, (bound + used) / (-change - step_s))
    along = rows.along
    for m in range(along.number[0]):
        change, used = along.ahead[m] * along.scale[m], along.value[m] * along.scale[m]
        if change > step_s:
            part = min(part, (bound - used) / (change - step_s))
        elif -change > step_s:
            part = min(part, (bound + used) / (-change - step_s))
    return part


@njit
def correct(tube: Tube, rows: Rows, n: Newton, part: float) -> None:
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
    along = rows.along
    for m in range(along.number[0]):
        off = along.before[m] + part * along.ahead[m] - along.value[m]
        if not abs(off) < math.inf:
            continue
        first = d * (along.step[m] - FIXED)
        for i in range(4):
            at = first + d * i
            if 0 <= at < free:
                for q in range(d):
                    right[at + q] += along.weight[m] * off * along.gradient[m, i, q]
    add_to_band(rows, n.weight, band)
    add_along(along, d, band)
    factorise(band)
    solve(band, right)
    for i in range(free):
        n.tried[FIXED + i // d, i % d] += right[i]
    evaluate(tube, rows, n.tried)
