"""The fastest motion through a row of cells: an interior-point descent over constant-jerk phases.

The unknowns are speed and acceleration at the cuts between cells
(:mod:`cnc.planner.kernels.cells`). Any values there are a motion, and a constraint couples
neighbours only. The descent minimises

    weight * time - sum log(1 - constraint / limit)

by Newton's method with the Gauss-Newton part of the barrier's Hessian. That is block tridiagonal
with blocks of 2 x 2, so that a step costs O(n). The speeds change along v^2, in which the
constraints are nearly linear. Where the first motion is at or beyond a limit, limits are raised at
first, and lowered again as the motion leaves them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.cells import (
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
from cnc.planner.kernels.intervals import TOUCH, SumLimits

Floats = NDArray[np.float64]

# The linear system of a step of the descent, and limits that are raised for a while.
#
# Where the first motion is at or beyond a limit, the descent raises the limits, and lowers them
# again as the motion leaves them. A motion between fixed ends has those of the cells raised that
# need it. For a ramp to rest those of all cells are raised by the same share: else what one cell
# uses too much would be pushed into another one.

NEAR, NEAREST = 0.99999, 1.0 - 1e-9
"""Limits are raised if the first motion uses more than the first share of one; more than the second
one where the limits of all cells are raised.
"""

LIFT, LEAST_LIFT = 0.003, 1e-5
"""Limits are raised by the first share at least; by the second one where those of all cells are."""

HIGH = 1e6
"""Limits raised by this share do not bind."""


class NewtonSystem(NamedTuple):
    """The linear system of a Newton step over n cells.

    Attributes:
        diagonal: (n + 1, 2, 2): blocks of the Hessian, of which the upper halves count.
        upper: (n + 1, 2, 2): the blocks beside the diagonal.
        gradient: (n + 1, 2).
        step: (n + 1, 2): the solution.
        lift: (n,): share by which the limits of each cell are raised.
        used: (n,): the largest constraint of each cell, as a share of the limit not raised.
    """

    diagonal: Floats
    upper: Floats
    gradient: Floats
    step: Floats
    lift: Floats
    used: Floats


@njit
def system_for(n: int, lift: float) -> NewtonSystem:
    """Return a system for ``n`` cells whose limits are all raised by ``lift``."""
    return NewtonSystem(
        np.zeros((n + 1, 2, 2)),
        np.zeros((n + 1, 2, 2)),
        np.zeros((n + 1, 2)),
        np.zeros((n + 1, 2)),
        np.full(n, lift),
        np.zeros(n),
    )


@njit
def start_lifts(first: int, last: int, even: bool, system: NewtonSystem) -> bool:
    """Raise the limits of the cells that are at or beyond them; return whether there are any.

    ``even``: raise those of all cells, by as much as the one that is farthest beyond needs.
    """
    highest = 0.0
    for k in range(first, last):
        system.lift[k] = 0.0
        if system.used[k] >= (NEAREST if even else NEAR):
            least = LEAST_LIFT if even else LIFT
            system.lift[k] = 1.5 * max(system.used[k] - 1.0, 0.0) + least
            highest = max(highest, system.lift[k])
    if even:
        system.lift[first:last] = highest
    return highest > 0.0


@njit
def lower_even_lifts(first: int, last: int, part: float, system: NewtonSystem) -> bool:
    """Lower the limits of all cells as :func:`lower_lifts` does those of each."""
    lift = system.lift[first]
    worst = 0.0
    for k in range(first, last):
        worst = max(worst, system.used[k])
    if worst < NEAREST:
        lift = 0.0
    elif part > 0.4:
        lift -= 0.5 * (1.0 + lift - worst)
    system.lift[first:last] = lift
    return lift > 0.0


@njit
def lower_lifts(first: int, last: int, part: float, system: NewtonSystem) -> bool:
    """Lower the raised limits after a step of length ``part``; return whether some stay raised."""
    lifted = False
    for k in range(first, last):
        lift = system.lift[k]
        if lift > 0.0:
            if system.used[k] < NEAR:
                system.lift[k] = 0.0
            else:
                lifted = True
                if part > 0.4:
                    system.lift[k] -= 0.5 * (1.0 + lift - system.used[k])
    return lifted


# Derivatives of the time and of the barrier of the limits within a cell.
#
# The barrier of a limit is -log(1 - share^2). Its derivatives are by speed, acceleration and jerk
# at a point first. One change of variables for each point then gives those by the speeds and
# accelerations at the ends of the cell.


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
def point_barrier(
    q: Floats,
    speed: float,
    accel: float,
    jerk: float,
    limits: SumLimits,
    allowed: float,
    slopes: bool,
    gradient: Floats,
    curved: Floats,
) -> tuple[float, float]:
    """Evaluate the limits of acceleration and jerk at a point of a cell.

    Args:
        q: (3, columns): q', q'', q''' there.
        speed: mm/s.
        accel: mm/s^2.
        jerk: mm/s^3.
        limits: for the sums.
        allowed: share of the limits that may be used.
        slopes: whether to compute the derivatives of the barrier.
        gradient: (3,): receives those by speed, acceleration and jerk.
        curved: (3, 3): receives the upper half of the Hessian.

    Returns:
        The product of 1 - share^2 of all limits, 0 beyond a limit; and the largest share.
    """
    product = 1.0
    worst = 0.0
    per_allowed = 1.0 / allowed
    # Sums kept in the arrays would be read and written again for each limit.
    g_v = g_a = g_j = 0.0
    c_vv = c_va = c_vj = c_aa = c_aj = c_jj = 0.0
    for i in range(q.shape[1]):
        q1, q2, q3 = q[0, i], q[1, i], q[2, i]
        if q1 == 0.0 and q2 == 0.0 and q3 == 0.0:
            continue
        per_a = per_allowed * limits.per_a[i]
        share_a = per_a * (q1 * accel + q2 * speed * speed)
        slack_a = 1.0 - share_a * share_a
        per_j = per_allowed * limits.per_j[i]
        share_j = per_j * (q1 * jerk + speed * (3.0 * q2 * accel + q3 * speed * speed))
        slack_j = 1.0 - share_j * share_j
        worst = max(worst, abs(share_a), abs(share_j))
        if not (slack_a > 0.0 and slack_j > 0.0):
            return 0.0, worst
        product *= slack_a * slack_j
        if slopes:
            inverse = 1.0 / (slack_a * slack_j)
            pull = 2.0 * share_a * slack_j * inverse
            stiff = 2.0 * (1.0 + share_a * share_a) * (slack_j * inverse) * (slack_j * inverse)
            by_v = 2.0 * per_a * q2 * speed
            by_a = per_a * q1
            g_v += pull * by_v
            g_a += pull * by_a
            c_vv += stiff * by_v * by_v
            c_va += stiff * by_v * by_a
            c_aa += stiff * by_a * by_a
            pull = 2.0 * share_j * slack_a * inverse
            stiff = 2.0 * (1.0 + share_j * share_j) * (slack_a * inverse) * (slack_a * inverse)
            by_v = 3.0 * per_j * (q2 * accel + q3 * speed * speed)
            by_a = 3.0 * per_j * q2 * speed
            by_j = per_j * q1
            g_v += pull * by_v
            g_a += pull * by_a
            g_j += pull * by_j
            c_vv += stiff * by_v * by_v
            c_va += stiff * by_v * by_a
            c_vj += stiff * by_v * by_j
            c_aa += stiff * by_a * by_a
            c_aj += stiff * by_a * by_j
            c_jj += stiff * by_j * by_j
    if slopes:
        gradient[0], gradient[1], gradient[2] = g_v, g_a, g_j
        curved[0, 0], curved[0, 1], curved[0, 2] = c_vv, c_va, c_vj
        curved[1, 1], curved[1, 2], curved[2, 2] = c_aa, c_aj, c_jj
    return product, worst


@njit
def add_point(
    p: int, gradient: Floats, curved: Floats, dx: Floats, rest: Floats, block: Floats
) -> None:
    """Add the derivatives at a point of a cell to those by the cell's variables.

    Args:
        p: the point: 0 for the start, 1 and 2 for the middle, 3 for the end.
        gradient: (3,): by speed, acceleration and jerk there.
        curved: (3, 3): the upper half of the Hessian.
        dx: (5, 4): the derivatives of :func:`cell_phases`.
        rest: (4,): receives the gradient.
        block: (4, 4): receives the upper half of the Hessian.
    """
    jerk_row = J1 if p < 2 else J2
    middle = p == 1 or p == 2
    for m in range(4):
        v_m = dx[V_MIDDLE, m] if middle else 0.0
        a_m = dx[A_MIDDLE, m] if middle else 0.0
        if (p == 0 and m == 0) or (p == 3 and m == 2):
            v_m = 1.0
        if (p == 0 and m == 1) or (p == 3 and m == 3):
            a_m = 1.0
        j_m = dx[jerk_row, m]
        rest[m] += gradient[0] * v_m + gradient[1] * a_m + gradient[2] * j_m
        by_v = curved[0, 0] * v_m + curved[0, 1] * a_m + curved[0, 2] * j_m
        by_a = curved[0, 1] * v_m + curved[1, 1] * a_m + curved[1, 2] * j_m
        by_j = curved[0, 2] * v_m + curved[1, 2] * a_m + curved[2, 2] * j_m
        for o in range(m, 4):
            total = by_j * dx[jerk_row, o]
            if middle:
                total += by_v * dx[V_MIDDLE, o] + by_a * dx[A_MIDDLE, o]
            elif p == 0:
                if o < 2:
                    total += by_v if o == 0 else by_a
            elif o >= 2:
                total += by_v if o == 2 else by_a
            block[m, o] += total


@njit
def add_reach(reach: float, speed: float, accel: float, gradient: Floats, curved: Floats) -> None:
    """Add the derivatives of the barrier of the place before which the motion has to rest.

    Args:
        reach: length of the phase to rest from the state at a point, as a share of the largest.
        speed: mm/s.
        accel: mm/s^2.
        gradient: (3,): as of :func:`point_barrier`.
        curved: (3, 3): as of :func:`point_barrier`.
    """
    by_v, by_a = 2.0 * reach / ((1.0 - reach) * speed), -reach / ((1.0 - reach) * accel)
    gradient[0] += by_v
    gradient[1] += by_a
    curved[0, 0] += by_v * by_v
    curved[0, 1] += by_v * by_a
    curved[1, 1] += by_a * by_a


@njit
def add_bend(by_jerk: float, v: float, a: float, block: Floats) -> None:
    """Add what the second derivatives of the jerk a^2 / (2 v) to rest add to those of the barrier.

    The jerk is convex, and far from linear. The other constraints are taken as linear.

    Args:
        by_jerk: the derivative of the barrier by the jerk.
        v: speed at the start of the phase to rest, mm/s.
        a: acceleration there.
        block: (4, 4): the upper half of the Hessian of the cell.
    """
    bend = max(by_jerk, 0.0) / v
    block[0, 0] += bend * (a / v) * (a / v)
    block[0, 1] -= bend * (a / v)
    block[1, 1] += bend


STEP = 0.5e-6
"""s; computing time of a step by the number of cells."""

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
    first: int,
    last: int,
    cells: Cells,
    limits: SumLimits,
    weight: float,
    even: bool,
    left: Floats,
) -> float:
    """Move speed and acceleration at the cuts inside [first, last] to the minimum for one weight.

    Where limits were raised, this ends once they are no longer.

    Args:
        first: the first cell of the range.
        last: the cell behind it.
        cells: the cells; ``v`` and ``a`` change.
        limits: for the sums.
        weight: of the time, per cell and relative to the time at the start.
        even: whether to raise the limits of all cells by the same share, if any.
        left: (1,): computing time that is left, s; the steps lower it.

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
        left[0] -= STEP * (last - first)
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
        if lifted:
            if even:
                lifted = lower_even_lifts(first, last, part, system)
            else:
                lifted = lower_lifts(first, last, part, system)
            if not lifted:
                break
        elif -slope < CENTRED * (last - first) and part == 1.0:
            break
    return worst if not lifted else max(worst, 1.0 + TOUCH)
