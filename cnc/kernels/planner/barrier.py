"""Derivatives of the time and of the barrier of the limits within a cell.

The barrier of a limit is -log(1 - share^2). Its derivatives are by speed, acceleration and jerk at
a point first. One change of variables for each point then gives those by the speeds and
accelerations at the ends of the cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import A_MIDDLE, J1, J2, V_MIDDLE, H
from cnc.kernels.planner.intervals import SumLimits

Floats = NDArray[np.float64]


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
