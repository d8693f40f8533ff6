r"""The fastest motion through a row of cells: an interior-point descent over constant-jerk phases.

      s0      s1      s2        Cells lie between cuts, at fixed arc lengths. What is looked for are speed and acceleration at the
      +---+---+---+---+---      cuts. Two phases of equal duration h and constant jerk lead through a cell; with d = s1 - s0 they follow
       j1  j2  j1  j2           in closed form:   h (v0 + v1) - h^2 (a1 - a0) / 3 = d,
       h   h   h   h                              j1 = (v1 - v0) / h^2 - 2 a0 / h - (a1 - a0) / (2 h),   j2 = (a1 - a0) / h - j1.

So any values at the cuts are a continuous motion with exact constant-jerk phases, and a constraint
binds neighbours only. Minimised is

    weight * time - sum log(1 - constraint / limit)

by Newton's method with the Gauss-Newton part of the barrier's Hessian: block tridiagonal with
blocks of 2 x 2, so that a step costs O(n). The speeds move along v^2, in which the constraints are
nearly linear. Where the motion to begin with touches or breaks a limit, all limits are lifted for
the time being, and lowered as the motion gets off them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]

STEPS = 40
HALVINGS = 20
"""Newton steps for one weight at most, and trials along one."""

CENTRED = 0.1
"""The descent for one weight ends when a step promises less than this per cell."""

NEAR = 0.99999
LIFT = 0.003
HIGH = 1e6
"""How much of a limit may be taken up to start without lifting, by how much they are lifted at
least, and out of the way.
"""

TOUCH = 1e-4
"""Relative: a limit is broken where it is passed by more than this."""


@njit
def cell_phases(
    v0: float, a0: float, v1: float, a1: float, d: float, x: Floats, slope: Floats
) -> bool:
    """The two phases through a cell of length ``d``: x = h, j1, j2, speed and acceleration between
    them; False if none lead forward.

    slope (5, 4): derivatives of x by v0, a0, v1, a1.
    """
    da = a1 - a0
    total = v0 + v1
    square = total * total - 4.0 / 3.0 * d * da
    if not (square > 0.0 and total > 0.0):
        return False
    root = math.sqrt(square)
    h = 2.0 * d / (total + root)
    r = 1.0 / h
    slope[0, 0] = slope[0, 2] = -h / root
    slope[0, 3] = h * h / (3.0 * root)
    slope[0, 1] = -slope[0, 3]
    dv = v1 - v0
    j1 = (dv * r - 2.0 * a0 - 0.5 * da) * r
    j2 = da * r - j1
    by_h = (-2.0 * dv * r + 2.0 * a0 + 0.5 * da) * r * r
    for i in range(4):
        slope[1, i] = by_h * slope[0, i]
    slope[1, 0] -= r * r
    slope[1, 1] -= 1.5 * r
    slope[1, 2] += r * r
    slope[1, 3] -= 0.5 * r
    for i in range(4):
        slope[2, i] = -da * r * r * slope[0, i] - slope[1, i]
    slope[2, 1] -= r
    slope[2, 3] += r
    middle = a0 + h * j1
    for i in range(4):
        slope[3, i] = middle * slope[0, i] + 0.5 * h * h * slope[1, i]
        slope[4, i] = j1 * slope[0, i] + h * slope[1, i]
    slope[3, 0] += 1.0
    slope[3, 1] += h
    slope[4, 1] += 1.0
    x[0] = h
    x[1] = j1
    x[2] = j2
    x[3] = v0 + h * (a0 + 0.5 * h * j1)
    x[4] = middle
    # Where the acceleration rises through nothing the speed is lowest.
    lowest = x[3]
    if a0 < 0.0 < middle:
        lowest = v0 - a0 * a0 / (2.0 * j1)
    elif middle < 0.0 < a1:
        lowest = x[3] - middle * middle / (2.0 * j2)
    return lowest > 0.0


@njit
def merit(
    first: int, last: int, v: Floats, a: Floats, d: Floats, top: Floats, share: Floats, q: Floats, limit_a: Floats, limit_j: Floats,
    weight: float, lift: float, slopes: bool, diagonal: Floats, upper: Floats, gradient: Floats,
) -> tuple[float, float, float]:  # fmt: skip
    """Value of what is minimised over the cells [first, last), the largest constraint, and the
    time; infinite beyond a (lifted) limit.

    top (cells, 2): speed bounds in the middle and at the end of each cell. q (cells, 3, 3, axes):
    derivatives of the path at its start, in its middle and at its end. share: part of the limits of
    acceleration and jerk that a cell may use. With ``slopes`` the gradient and the Hessian's blocks
    are written as well.
    """
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
        if not cell_phases(v[k], a[k], v[k + 1], a[k + 1], d[k], x, dx):
            return math.inf, math.inf, math.inf
        time += 2.0 * x[0]
        allowed = (1.0 + lift) * share[k]
        product = 1.0
        if slopes:
            curved = 6.0 * weight / x[0]
            for m in range(4):
                rest[m] = 2.0 * weight * dx[0, m]
                for o in range(4):
                    block[m, o] = curved * dx[0, m] * dx[0, o]
        for p in range(4):
            # start, end of the first phase, start of the second, end
            if p == 0:
                speed = v[k]
                accel = a[k]
            elif p == 3:
                speed = v[k + 1]
                accel = a[k + 1]
            else:
                speed = x[3]
                accel = x[4]
            jerk = x[1] if p < 2 else x[2]
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
                        row = 1 if p < 2 else 2
                        for m in range(4):
                            c[m] = by_j * dx[row, m]
                        if p == 0:
                            c[0] += by_v
                            c[1] += by_a
                        elif p == 3:
                            c[2] += by_v
                            c[3] += by_a
                        else:
                            for m in range(4):
                                c[m] += by_v * dx[3, m] + by_a * dx[4, m]
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
                        c[m] = taken / speed * dx[3, m] if p == 1 else 0.0
                    if p == 3:
                        c[2] = taken / speed
                    for m in range(4):
                        rest[m] += c[m] / slack
                        for o in range(m, 4):
                            block[m, o] += c[m] * c[o] / (slack * slack)
        value -= math.log(product)
        if slopes:
            for m in range(4):
                gradient[k + m // 2, m % 2] += rest[m]
                for o in range(m, 4):
                    if o < 2:
                        diagonal[k, m, o] += block[m, o]
                    elif m < 2:
                        upper[k, m, o - 2] += block[m, o]
                    else:
                        diagonal[k + 1, m - 2, o - 2] += block[m, o]
    return value + weight * time, worst * (1.0 + lift), time


@njit
def newton_step(
    first: int, last: int, diagonal: Floats, upper: Floats, gradient: Floats, step: Floats
) -> float:
    """The step from the block tridiagonal system, its ends held; returns how fast the merit falls
    along it. The matrices are used up.

    diagonal (n + 1, 2, 2), of which the upper halves count; upper (n, 2, 2).
    """
    slope = 0.0
    step[first] = 0.0
    step[last] = 0.0
    for k in range(first + 1, last):
        step[k] = gradient[k]
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
    first: int, last: int, v: Floats, a: Floats, d: Floats, top: Floats, share: Floats, q: Floats, limit_a: Floats, limit_j: Floats,
    weight: float,
) -> float:  # fmt: skip
    """Move v and a at the cuts inside [first, last] to where time, at a weight per cell and time,
    and barrier balance.

    Returns the largest constraint: at most 1, or the limits could not be kept.
    """
    cells = last - first
    diagonal = np.zeros((last + 1, 2, 2))
    upper = np.zeros((last + 1, 2, 2))
    gradient = np.zeros((last + 1, 2))
    step = np.zeros((last + 1, 2))
    v2 = v.copy()
    a2 = a.copy()
    _, worst, time = merit(
        first, last, v, a, d, top, share, q, limit_a, limit_j, 0.0, HIGH, False, diagonal, upper, gradient
    )  # fmt: skip
    if not time < math.inf:
        return math.inf
    lift = 0.0 if worst < NEAR else 1.5 * max(worst - 1.0, 0.0) + LIFT
    weight *= cells / time
    for _ in range(STEPS):
        before, worst, _ = merit(
            first, last, v, a, d, top, share, q, limit_a, limit_j, weight, lift, True, diagonal, upper, gradient
        )  # fmt: skip
        slope = newton_step(first, last, diagonal, upper, gradient, step)
        if not slope < 0.0:
            break
        part = 1.0
        moved = False
        for _ in range(HALVINGS):
            for k in range(first + 1, last):
                v2[k] = math.sqrt(max(v[k] * (v[k] + 2.0 * part * step[k, 0]), 0.0))
                a2[k] = a[k] + part * step[k, 1]
            after, reached, _ = merit(
                first, last, v2, a2, d, top, share, q, limit_a, limit_j, weight, lift, False, diagonal, upper, gradient
            )  # fmt: skip
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
        elif -slope < CENTRED * cells:
            break
    return worst if lift == 0.0 else max(worst, 1.0 + TOUCH)
