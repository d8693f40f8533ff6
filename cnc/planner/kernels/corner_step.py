"""A step of Newton's method for a motion past corners, and how far it goes.

See :mod:`cnc.planner.kernels.corner_motion`.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.path.kernels.fit_program import backward, factorise, forward, solve
from cnc.planner.kernels.corner_along import MOST_GROUPS, add_along, along_ahead
from cnc.planner.kernels.corner_newton import Newton, add_to_band
from cnc.planner.kernels.corner_rows import TRAVEL, Rows, evaluate
from cnc.planner.kernels.corner_tube import FIXED, Tube


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
