"""The fastest motion through a row of cells: an interior-point descent over constant-jerk phases.

The unknowns are speed and acceleration at the cuts between cells
(:mod:`cnc.kernels.planner.cell_motion`). Any values there are a motion, and a constraint couples
neighbours only. The descent minimises

    weight * time - sum log(1 - constraint / limit)

by Newton's method with the Gauss-Newton part of the barrier's Hessian. That is block tridiagonal
with blocks of 2 x 2, so that a step costs O(n). The speeds change along v^2, in which the
constraints are nearly linear. If the first motion is at or beyond a limit, all limits are raised at
first, and lowered again as the motion leaves them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import A_MIDDLE, J1, J2, V_MIDDLE, Cells, H, cell_phases
from cnc.kernels.planner.intervals import SumLimits

Floats = NDArray[np.float64]

STEPS = 40
"""Largest number of Newton steps for one weight."""

HALVINGS = 20
"""Largest number of lengths that are tried for one step."""

CENTRED = 0.1
"""The descent for one weight ends when a step would gain less than this for each cell."""

NEAR = 0.99999
"""Limits are raised if the first motion uses more than this share of one."""

LIFT = 0.003
"""Limits are raised by this share at least."""

HIGH = 1e6
"""Limits raised by this share do not bind."""

TOUCH = 1e-4
"""Relative: a motion may exceed a limit by this."""


class NewtonSystem(NamedTuple):
    """The linear system of a Newton step over n cells.

    Attributes:
        diagonal: (n + 1, 2, 2): blocks of the Hessian, of which the upper halves count.
        upper: (n + 1, 2, 2): the blocks beside the diagonal.
        gradient: (n + 1, 2).
        step: (n + 1, 2): the solution.
    """

    diagonal: Floats
    upper: Floats
    gradient: Floats
    step: Floats


@njit
def start_with_time(weight: float, h: float, dx: Floats, rest: Floats, block: Floats) -> None:
    """Set gradient and Hessian of a cell to those of its time.

    Args:
        weight: of the time.
        h: half the duration of the cell, s.
        dx: (5, 4): the derivatives of :func:`cell_phases`.
        rest: (4,): receives the gradient.
        block: (4, 4): receives the Hessian.
    """
    curved = 6.0 * weight / h
    for m in range(4):
        rest[m] = 2.0 * weight * dx[H, m]
        for o in range(4):
            block[m, o] = curved * dx[H, m] * dx[H, o]


@njit
def constraint_slope(p: int, by_v: float, by_a: float, by_j: float, dx: Floats, c: Floats) -> None:
    """Compute the derivatives of a constraint by the variables of a cell.

    Args:
        p: the point: 0 for the start, 1 and 2 for the middle, 3 for the end.
        by_v: derivative of the constraint by the speed there.
        by_a: by the acceleration.
        by_j: by the jerk.
        dx: (5, 4): the derivatives of :func:`cell_phases`.
        c: (4,): receives the result.
    """
    jerk_row = J1 if p < 2 else J2
    for m in range(4):
        c[m] = by_j * dx[jerk_row, m]
    if p == 0:
        c[0] += by_v
        c[1] += by_a
    elif p == 3:
        c[2] += by_v
        c[3] += by_a
    else:
        for m in range(4):
            c[m] += by_v * dx[V_MIDDLE, m] + by_a * dx[A_MIDDLE, m]


@njit
def merit(
    first: int,
    last: int,
    cells: Cells,
    limits: SumLimits,
    weight: float,
    lift: float,
    slopes: bool,
    system: NewtonSystem,
) -> tuple[float, float, float]:
    """Evaluate the function that the descent minimises, over the cells [first, last).

    Args:
        first: the first cell of the range.
        last: the cell behind it.
        cells: the cells and the motion.
        limits: for the sums.
        weight: of the time.
        lift: share by which the limits are raised.
        slopes: whether to write the gradient and the blocks of the Hessian to ``system``.
        system: receives them.

    Returns:
        The value, the largest constraint, and the time; infinite beyond a raised limit.
    """
    v, a, share, q = cells.v, cells.a, cells.share, cells.q
    length, top = cells.length, cells.top
    limit_a, limit_j = limits.a, limits.j
    diagonal, upper, gradient = system.diagonal, system.upper, system.gradient
    x = np.empty(5)
    dx = np.empty((5, 4))
    c = np.empty(4)
    block = np.empty((4, 4))
    rest = np.empty(4)
    axes = q.shape[3]
    value = 0.0
    worst = 0.0
    time = 0.0
    if slopes:
        diagonal[first : last + 1] = 0.0
        upper[first:last] = 0.0
        gradient[first : last + 1] = 0.0
    for k in range(first, last):
        if not cell_phases(v[k], a[k], v[k + 1], a[k + 1], length[k], x, dx):
            return math.inf, math.inf, math.inf
        time += 2.0 * x[H]
        allowed = (1.0 + lift) * share[k]
        product = 1.0
        if slopes:
            start_with_time(weight, x[H], dx, rest, block)
        for p in range(4):
            # Start, end of the first phase, start of the second, end.
            if p == 0:
                speed = v[k]
                accel = a[k]
            elif p == 3:
                speed = v[k + 1]
                accel = a[k + 1]
            else:
                speed = x[V_MIDDLE]
                accel = x[A_MIDDLE]
            jerk = x[J1] if p < 2 else x[J2]
            place = (p + 1) // 2
            for i in range(axes):
                q1 = q[k, place, 0, i]
                q2 = q[k, place, 1, i]
                q3 = q[k, place, 2, i]
                for order in range(2):
                    if order == 0:
                        if p == 2 or limit_a[i] == math.inf:
                            continue
                        scale = 1.0 / (limit_a[i] * allowed)
                        taken = scale * (q1 * accel + q2 * speed * speed)
                        by_v = scale * 2.0 * q2 * speed
                        by_a = scale * q1
                        by_j = 0.0
                    else:
                        if limit_j[i] == math.inf:
                            continue
                        scale = 1.0 / (limit_j[i] * allowed)
                        taken = scale * (
                            q1 * jerk + 3.0 * q2 * speed * accel + q3 * speed * speed * speed
                        )
                        by_v = scale * 3.0 * (q2 * accel + q3 * speed * speed)
                        by_a = scale * 3.0 * q2 * speed
                        by_j = scale * q1
                    slack = 1.0 - taken * taken
                    worst = max(worst, abs(taken))
                    if not slack > 0.0:
                        return math.inf, math.inf, math.inf
                    product *= slack
                    if slopes:
                        constraint_slope(p, by_v, by_a, by_j, dx, c)
                        pull = 2.0 * taken / slack
                        stiff = 2.0 * (1.0 + taken * taken) / (slack * slack)
                        for m in range(4):
                            rest[m] += pull * c[m]
                            for o in range(m, 4):
                                block[m, o] += stiff * c[m] * c[o]
            if p == 1 or (p == 3 and k + 1 < last):
                taken = speed / (top[k, p // 2] * (1.0 + lift))
                slack = 1.0 - taken
                worst = max(worst, taken)
                if not slack > 0.0:
                    return math.inf, math.inf, math.inf
                product *= slack
                if slopes:
                    for m in range(4):
                        c[m] = taken / speed * dx[V_MIDDLE, m] if p == 1 else 0.0
                    if p == 3:
                        c[2] = taken / speed
                    for m in range(4):
                        rest[m] += c[m] / slack
                        for o in range(m, 4):
                            block[m, o] += c[m] * c[o] / (slack * slack)
        value -= math.log(product)
        if slopes:
            add_to_system(k, rest, block, system)
    return value + weight * time, worst * (1.0 + lift), time


@njit
def add_to_system(k: int, rest: Floats, block: Floats, system: NewtonSystem) -> None:
    """Add a cell's gradient ``rest`` (4,) and Hessian ``block`` (4, 4) to the system.

    Their variables are speed and acceleration at the cell's start and end.
    """
    diagonal, upper, gradient = system.diagonal, system.upper, system.gradient
    for m in range(4):
        gradient[k + m // 2, m % 2] += rest[m]
        for o in range(m, 4):
            if o < 2:
                diagonal[k, m, o] += block[m, o]
            elif m < 2:
                upper[k, m, o - 2] += block[m, o]
            else:
                diagonal[k + 1, m - 2, o - 2] += block[m, o]


@njit
def newton_step(first: int, last: int, system: NewtonSystem) -> float:
    """Solve the block tridiagonal system with fixed ends; its matrices are overwritten.

    Returns:
        The slope of the merit along the step.
    """
    diagonal, upper, gradient = system.diagonal, system.upper, system.gradient
    step = system.step
    slope = 0.0
    step[first] = 0.0
    step[last] = 0.0
    for k in range(first + 1, last):
        step[k, 0], step[k, 1] = gradient[k, 0], gradient[k, 1]
        if k > first + 1:
            p00 = diagonal[k - 1, 0, 0]
            p01 = diagonal[k - 1, 0, 1]
            p11 = diagonal[k - 1, 1, 1]
            det = p00 * p11 - p01 * p01
            u00 = upper[k - 1, 0, 0]
            u01 = upper[k - 1, 0, 1]
            u10 = upper[k - 1, 1, 0]
            u11 = upper[k - 1, 1, 1]
            l00 = (u00 * p11 - u10 * p01) / det
            l01 = (u10 * p00 - u00 * p01) / det
            l10 = (u01 * p11 - u11 * p01) / det
            l11 = (u11 * p00 - u01 * p01) / det
            diagonal[k, 0, 0] -= l00 * u00 + l01 * u10
            diagonal[k, 0, 1] -= l00 * u01 + l01 * u11
            diagonal[k, 1, 1] -= l10 * u01 + l11 * u11
            step[k, 0] -= l00 * step[k - 1, 0] + l01 * step[k - 1, 1]
            step[k, 1] -= l10 * step[k - 1, 0] + l11 * step[k - 1, 1]
    for k in range(last - 1, first, -1):
        r0 = -step[k, 0]
        r1 = -step[k, 1]
        if k + 1 < last:
            r0 -= upper[k, 0, 0] * step[k + 1, 0] + upper[k, 0, 1] * step[k + 1, 1]
            r1 -= upper[k, 1, 0] * step[k + 1, 0] + upper[k, 1, 1] * step[k + 1, 1]
        p00 = diagonal[k, 0, 0]
        p01 = diagonal[k, 0, 1]
        p11 = diagonal[k, 1, 1]
        det = p00 * p11 - p01 * p01
        step[k, 0] = (p11 * r0 - p01 * r1) / det
        step[k, 1] = (p00 * r1 - p01 * r0) / det
        slope += step[k, 0] * gradient[k, 0] + step[k, 1] * gradient[k, 1]
    return slope


@njit
def centre(first: int, last: int, cells: Cells, limits: SumLimits, weight: float) -> float:
    """Move speed and acceleration at the cuts inside [first, last] to the minimum for one weight.

    Args:
        first: the first cell of the range.
        last: the cell behind it.
        cells: the cells; ``v`` and ``a`` change.
        limits: for the sums.
        weight: of the time, per cell and relative to the time at the start.

    Returns:
        The largest constraint: more than 1 if the limits could not be kept.
    """
    v, a = cells.v, cells.a
    system = NewtonSystem(
        np.zeros((last + 1, 2, 2)),
        np.zeros((last + 1, 2, 2)),
        np.zeros((last + 1, 2)),
        np.zeros((last + 1, 2)),
    )
    step = system.step
    v2 = v.copy()
    a2 = a.copy()
    trial = Cells(cells.s, v2, a2, cells.length, cells.top, cells.share, cells.q)
    _, worst, time = merit(first, last, cells, limits, 0.0, HIGH, False, system)
    if not time < math.inf:
        return math.inf
    lift = 0.0 if worst < NEAR else 1.5 * max(worst - 1.0, 0.0) + LIFT
    weight *= (last - first) / time
    for _ in range(STEPS):
        before, worst, _ = merit(first, last, cells, limits, weight, lift, True, system)
        slope = newton_step(first, last, system)
        if not slope < 0.0:
            break
        part = 1.0
        moved = False
        for _ in range(HALVINGS):
            for k in range(first + 1, last):
                v2[k] = math.sqrt(max(v[k] * (v[k] + 2.0 * part * step[k, 0]), 0.0))
                a2[k] = a[k] + part * step[k, 1]
            after, reached, _ = merit(first, last, trial, limits, weight, lift, False, system)
            if after < before + 0.1 * part * slope:
                moved = True
                break
            part *= 0.5
        if not moved:
            break
        worst = reached
        for k in range(first + 1, last):
            v[k] = v2[k]
            a[k] = a2[k]
        if lift > 0.0:
            if worst < NEAR:
                lift = 0.0
            elif part > 0.4:
                lift -= 0.5 * (1.0 + lift - worst)
        elif -slope < CENTRED * (last - first):
            break
    return worst if lift == 0.0 else max(worst, 1.0 + TOUCH)
