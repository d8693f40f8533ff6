"""The fastest motion through a row of cells: an interior-point descent over constant-jerk phases.

The unknowns are speed and acceleration at the cuts between cells
(:mod:`cnc.kernels.planner.cell_motion`). Any values there are a motion, and a constraint couples
neighbours only. The descent minimises

    weight * time - sum log(1 - constraint / limit)

by Newton's method with the Gauss-Newton part of the barrier's Hessian. That is block tridiagonal
with blocks of 2 x 2, so that a step costs O(n). The speeds change along v^2, in which the
constraints are nearly linear. Where the first motion is at or beyond a limit, limits are raised at
first, and lowered again as the motion leaves them (:mod:`cnc.kernels.planner.lifts`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.barrier import (
    add_bend,
    add_point,
    add_reach,
    point_barrier,
    start_with_time,
)
from cnc.kernels.planner.cell_motion import (
    A_MIDDLE,
    J1,
    J2,
    OPEN,
    V_MIDDLE,
    Cells,
    H,
    cell_phases,
    length_to_rest,
    with_motion,
)
from cnc.kernels.planner.intervals import SumLimits
from cnc.kernels.planner.lifts import (
    HIGH,
    TOUCH,
    NewtonSystem,
    lower_even_lifts,
    lower_lifts,
    start_lifts,
    system_for,
)

Floats = NDArray[np.float64]

STEPS = 40
"""Largest number of Newton steps for one weight."""

HALVINGS = 8
"""Largest number of lengths that are tried for one step."""

SHORT_STEP = 0.2
FIRST_DAMPING, DAMPING_STEP, MOST_DAMPING = 0.1, 5.0, 1e5
"""After a step of less than this part of its length the next one is damped, by these amounts."""

SLOWEST = 0.01
"""A step lowers the square of a speed to this share at most: no step leads back from rest."""

LEFT = 0.2
"""Part of the distance to the limits that a step leaves where the end is open: the jerk to rest
depends on speed and acceleration the most.
"""

CENTRED = 0.3
"""The descent for one weight ends when a step would gain less than this for each cell."""


@njit
def merit(
    first: int,
    last: int,
    cells: Cells,
    limits: SumLimits,
    weight: float,
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
        slopes: whether to write the gradient and the blocks of the Hessian to ``system``.
        system: has the lift of each cell; receives them, and the constraint of each cell.

    Returns:
        The value, the largest constraint, and the time; infinite beyond a raised limit.
    """
    v, a, q = cells.v, cells.a, cells.q
    x = np.empty(5)
    dx = np.empty((5, 4))
    block = np.empty((4, 4))
    rest = np.empty(4)
    gradient = np.empty(3)
    curved = np.empty((3, 3))
    value = 0.0
    worst = 0.0
    time = 0.0
    if slopes:
        system.diagonal[first : last + 1] = 0.0
        system.upper[first:last] = 0.0
        system.gradient[first : last + 1] = 0.0
    for k in range(first, last):
        if not cell_phases(v[k], a[k], v[k + 1], a[k + 1], cells.length[k], x, dx):
            return math.inf, math.inf, math.inf
        time += 2.0 * x[H]
        raised = 1.0 + system.lift[k]
        allowed = raised * cells.share[k]
        product = 1.0
        used = 0.0
        if slopes:
            start_with_time(weight, x[H], dx, rest, block)
        for p in range(4):
            # Start, end of the first phase, start of the second, end.
            speed, accel = x[V_MIDDLE], x[A_MIDDLE]
            if p == 0:
                speed, accel = v[k], a[k]
            elif p == 3:
                speed, accel = v[k + 1], a[k + 1]
            jerk = x[J1] if p < 2 else x[J2]
            left, taken = point_barrier(
                q[k, (p + 1) // 2], speed, accel, jerk, limits, allowed, slopes, gradient, curved
            )
            used = max(used, taken)
            if p == 1 or (p == 3 and k + 1 < last):
                scale = 1.0 / (cells.top[k, p // 2] * raised)
                slack = 1.0 - scale * speed
                used = max(used, scale * speed)
                left *= max(slack, 0.0)
                if slopes and slack > 0.0:
                    gradient[0] += scale / slack
                    curved[0, 0] += scale * scale / (slack * slack)
            if p == 0 and cells.length[k] == OPEN:
                room = cells.rest_before - cells.s[k]
                reach = length_to_rest(speed, accel) / (raised * room) if room > 0.0 else math.inf
                left *= max(1.0 - reach, 0.0)
                used = max(used, reach)
                if slopes and reach < 1.0:
                    add_reach(reach, speed, accel, gradient, curved)
            if not left > 0.0:
                return math.inf, math.inf, math.inf
            product *= left
            if slopes:
                add_point(p, gradient, curved, dx, rest, block)
                if cells.length[k] == OPEN:
                    add_bend(gradient[2], v[k], a[k], block)
        system.used[k] = used * raised
        worst = max(worst, used * raised)
        value -= math.log(product)
        if slopes:
            add_to_system(k, rest, block, system)
    return value + weight * time, worst, time


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
def newton_step(first: int, last: int, cells: Cells, damping: float, system: NewtonSystem) -> float:
    """Solve the block tridiagonal system with fixed ends; its matrices are overwritten.

    Args:
        first: the first cell of the range.
        last: the cell behind it.
        cells: the cells and the motion.
        damping: of steps that change a speed v, or an acceleration by v^2 over the length of a
            cell: about there the motion through the cell ends. 0 for Newton's step.
        system: the system.

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
        if damping > 0.0:
            square = cells.v[k] * cells.v[k]
            reach = min(cells.length[k - 1], cells.length[k]) / square
            diagonal[k, 0, 0] += damping / square
            diagonal[k, 1, 1] += damping * reach * reach
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
def centre(
    first: int, last: int, cells: Cells, limits: SumLimits, weight: float, even: bool
) -> float:
    """Move speed and acceleration at the cuts inside [first, last] to the minimum for one weight.

    Where the limits of all cells were raised, this ends once they are no longer.

    Args:
        first: the first cell of the range.
        last: the cell behind it.
        cells: the cells; ``v`` and ``a`` change.
        limits: for the sums.
        weight: of the time, per cell and relative to the time at the start.
        even: whether to raise the limits of all cells by the same share, if any.

    Returns:
        The largest constraint: more than 1 if the limits could not be kept.
    """
    v, a = cells.v, cells.a
    system = system_for(last, HIGH)
    step = system.step
    v2 = v.copy()
    a2 = a.copy()
    trial = with_motion(cells, v2, a2)
    _, worst, time = merit(first, last, cells, limits, 0.0, False, system)
    if not time < math.inf:
        return math.inf
    lifted = start_lifts(first, last, even, system)
    weight *= (last - first) / time
    damping = 0.0
    for _ in range(STEPS):
        before, worst, _ = merit(first, last, cells, limits, weight, True, system)
        tightest = HIGH
        if even:
            raised = 1.0 + system.lift[first]
            tightest = raised - LEFT * (raised - worst)
        slope = newton_step(first, last, cells, damping, system)
        if not slope < 0.0:
            break
        part = 1.0
        moved = False
        for _ in range(HALVINGS):
            for k in range(first + 1, last):
                v2[k] = math.sqrt(v[k] * max(v[k] + 2.0 * part * step[k, 0], SLOWEST * v[k]))
                a2[k] = a[k] + part * step[k, 1]
            after, reached, _ = merit(first, last, trial, limits, weight, False, system)
            if after < before + 0.1 * part * slope and reached <= tightest:
                moved = True
                break
            part *= 0.5
        if part < SHORT_STEP:
            if damping >= MOST_DAMPING:
                break
            damping = max(DAMPING_STEP * damping, FIRST_DAMPING)
        elif part == 1.0:
            damping = damping / DAMPING_STEP if damping > FIRST_DAMPING else 0.0
        if not moved:
            continue
        worst = reached
        for k in range(first + 1, last):
            v[k] = v2[k]
            a[k] = a2[k]
        if lifted and even:
            lifted = lower_even_lifts(first, last, part, system)
            if not lifted:
                break
        elif lifted:
            lifted = lower_lifts(first, last, part, system)
        elif -slope < CENTRED * (last - first) and part == 1.0:
            break
    return worst if not lifted else max(worst, 1.0 + TOUCH)
