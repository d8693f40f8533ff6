r"""The fastest motion near a plan: an interior-point descent over constant-jerk phases, legal in every axis.

The plan of :mod:`cnc.kernels.lookahead` keeps to bounds that combine the largest speed with the largest acceleration of a stretch and the
worst directions of both. On a curve that costs up to half of the time, because velocity, acceleration and jerk of an axis,

    q' v,    q'' v^2 + q' a,    q''' v^3 + 3 q'' v a + q' j,

partly cancel: out of a tight bend -kappa^2 v^3 leaves room for j. Here the exact sums are held within their limits.

      s0      s1      s2        The path is cut into cells, at fixed arc lengths. What is looked for are speed and acceleration at the
      +---+---+---+---+---      cuts. Two phases of equal duration h and constant jerk lead through a cell; with d = s1 - s0 they follow
       j1  j2  j1  j2           in closed form:   h (v0 + v1) - h^2 (a1 - a0) / 3 = d,
       h   h   h   h                              j1 = (v1 - v0) / h^2 - 2 a0 / h - (a1 - a0) / (2 h),   j2 = (a1 - a0) / h - j1.

So any values at the cuts are a continuous motion with exact constant-jerk phases, and a constraint binds neighbours only. Minimised is

    weight * time - sum log(1 - constraint / limit)

by Newton's method with the Gauss-Newton part of the barrier's Hessian: block tridiagonal with blocks of 2 x 2, so that a step costs O(n).
The speeds move along v^2, in which the constraints are nearly linear. The weight rises until the barrier costs little. Where the plan to
begin with touches or breaks a limit, all limits are lifted for the time being, and lowered as the motion gets off them.

Why this and not the classic sequential linear program over v^2 on a grid: there each step has to be turned into phases, which breaks limits
between the grid's points; here every step is a motion. Against a fine nonlinear optimum with the same limits it takes 0.3 to 0.5 % longer,
for 8 us a cell on a curve that binds; a plan in which no curve costs time isn't touched.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

WINDOW = 400
"""Cells that are refined together; of a longer stretch the first half is kept each time, and the rest refined with what follows."""

RAMP_CELLS = 5
PLATEAU = 0.3
"""Cells in the longest jerk phase of a stretch, or in this part of its longest phase of constant acceleration; the others are about as long
in time."""

SPANNED = 6
"""Intervals that a cell may reach over."""

COARSEST = 4.0
"""How much longer than the others a cell in the middle of a cruise may be."""

TINY = 0.15
"""A phase shorter than this part of a cell is made part of its neighbours' cells."""

FIRST_WEIGHT = 2.0
LAST_WEIGHT = 2592.0
WEIGHT_STEP = 6.0
"""The weight of the time, per cell and the time itself: to begin with, at the end, and from one round to the next."""

CHECKED_FROM = 50.0
"""From this weight on the motion is good enough to see what the constraints miss between their points."""

STEPS = 40
HALVINGS = 20
"""Newton steps in a round at most, and trials along one."""

CENTRED = 0.1
"""A round ends when a step promises less than this per cell."""

NEAR = 0.99999
LIFT = 0.003
HIGH = 1e6
"""How much of a limit may be taken up to start without lifting, by how much they are lifted at least, and out of the way."""

MARGIN = 5e-5
JERK_MARGIN = 2e-3
"""Parts of the limits kept free: for the interpolation of the path's derivatives, for jumps of curvature that show in differences."""

DENSE = 4
"""Points in each phase at which the result is looked at again."""

ROUNDS = 20
SETBACKS = 4
"""Rounds at most: five, and again for cells whose limits had to be tightened; and how often that is done to better a legal motion."""

TIGHT = 0.8
"""A cell that takes up less than this of every limit isn't looked at more closely."""

TOUCH = 1e-4
"""Relative: a limit is broken where it is passed by more than this."""

FASTEST = 0.985
STEEPEST = 0.85
"""Speed, and acceleration or jerk, above these parts of their bounds on a straight path: there is next to nothing to gain."""

WORTHWHILE = 0.002
"""The part of a stretch's time that has to be saved."""


@njit
def cell_phases(v0: float, a0: float, v1: float, a1: float, d: float, x: Floats, slope: Floats) -> bool:
    """The two phases through a cell of length ``d``: x = h, j1, j2, speed and acceleration between them; False if none lead forward.

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
    """Value of what is minimised over the cells [first, last), the largest constraint, and the time; infinite beyond a (lifted) limit.

    top (cells, 2): speed bounds in the middle and at the end of each cell. q (cells, 3, 3, axes): derivatives of the path at its start, in
    its middle and at its end. share: part of the limits of acceleration and jerk that a cell may use.
    With ``slopes`` the gradient and the Hessian's blocks are written as well.
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
                        taken = scale * (q1 * jerk + 3.0 * q2 * speed * accel + q3 * speed * speed * speed)
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
def newton_step(first: int, last: int, diagonal: Floats, upper: Floats, gradient: Floats, step: Floats) -> float:
    """The step from the block tridiagonal system, its ends held; returns how fast the merit falls along it. The matrices are used up.

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
    """Move v and a at the cuts inside [first, last] to where time, at a weight per cell and time, and barrier balance.

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


@njit
def interval_at(s: float, start: int, end: Floats) -> int:
    """The interval that arc length ``s`` lies in, searched from interval ``start`` on, or back from there."""
    k = start
    while k > 0 and s < end[k - 1]:
        k -= 1
    while k + 1 < len(end) and s >= end[k]:
        k += 1
    return k


@njit
def derivatives(k: int, s: float, sampled: Floats, samples: Floats, out: Floats) -> None:
    """q', q'', q''' at ``s`` in interval ``k``, from the quartic through its five samples; the last column stands for the path itself."""
    axes = samples.shape[3]
    extent = sampled[k, 1] - sampled[k, 0]
    x = min(max((s - sampled[k, 0]) / extent, 0.0), 1.0) if extent > 0.0 else 0.0
    x *= 4.0
    w0 = (x - 1.0) * (x - 2.0) * (x - 3.0) * (x - 4.0) / 24.0
    w1 = -x * (x - 2.0) * (x - 3.0) * (x - 4.0) / 6.0
    w2 = x * (x - 1.0) * (x - 3.0) * (x - 4.0) / 4.0
    w3 = -x * (x - 1.0) * (x - 2.0) * (x - 4.0) / 6.0
    w4 = x * (x - 1.0) * (x - 2.0) * (x - 3.0) / 24.0
    for order in range(3):
        for i in range(axes):
            out[order, i] = (
                w0 * samples[k, 0, order, i]
                + w1 * samples[k, 1, order, i]
                + w2 * samples[k, 2, order, i]
                + w3 * samples[k, 3, order, i]
                + w4 * samples[k, 4, order, i]
            )
        out[order, axes] = 1.0 if order == 0 else 0.0


@njit
def phase_worst(
    duration: float, s: float, v: float, a: float, j: float, s_end: float, k: int, end: Floats, top: Floats, sampled: Floats,
    samples: Floats, limit_a: Floats, limit_j: Floats, q: Floats,
) -> tuple[float, float, int]:  # fmt: skip
    """The largest part of a limit that a phase takes up, at points throughout it and on both sides of each end of an interval.

    Returns that of the limits of acceleration and jerk, that of the speed bounds, and the interval in which the phase ends. q: scratch.
    """
    worst = 0.0
    fastest = 0.0
    t_before = 0.0
    s_before = s
    k = interval_at(s, k, end)
    m = 0
    while m <= DENSE:
        t_next = duration * m / DENSE
        s_next = s_end if m == DENSE else s + t_next * (v + t_next * (0.5 * a + t_next * j / 6.0))
        t = t_next
        here = s_next
        crossing = k + 1 < len(end) and end[k] < s_next
        if crossing:
            here = end[k]
            t = t_before + (t_next - t_before) * (here - s_before) / (s_next - s_before)
        else:
            t_before = t_next
            s_before = s_next
            m += 1
        speed = v + t * (a + 0.5 * t * j)
        accel = a + t * j
        for side in range(2):
            if side == 1:
                if not crossing:
                    break
                k += 1
            fastest = max(fastest, speed / top[k])
            derivatives(k, here, sampled, samples, q)
            for i in range(q.shape[1]):
                worst = max(worst, abs(q[0, i] * accel + q[1, i] * speed * speed) / limit_a[i])
                worst = max(worst, abs(q[0, i] * j + 3.0 * q[1, i] * speed * accel + q[2, i] * speed * speed * speed) / limit_j[i])
    return worst, fastest, k


@njit
def separate(phases: Floats, end: Floats, top: Floats, flat: Flags, rows: Floats, apart: Flags) -> int:
    """Copy the phases to ``rows``, a long cruise in three; ``apart`` marks those that stay as they are. Returns how many there are.

    Those are stretches of constant speed at junctions, and the middle of a cruise that can't be faster.
    """
    count = 0
    k = 0
    n = len(phases)
    for i in range(n):
        rows[count] = phases[i]
        apart[count] = False
        if phases[i, 3] == 0.0 and phases[i, 4] == 0.0 and phases[i, 2] > 0.0:
            finish = phases[i, 1] + phases[i, 0] * phases[i, 2]
            k = interval_at(0.5 * (phases[i, 1] + finish), k, end)
            apart[count] = flat[k]
            if not flat[k]:
                k = interval_at(phases[i, 1], k, end)
                fastest = phases[i, 2] >= FASTEST * top[k]
                while fastest and k + 1 < len(end) and end[k] < finish:
                    k += 1
                    fastest = phases[i, 2] >= FASTEST * top[k]
                if fastest:
                    before = 0.0
                    m = i - 1
                    while m >= 0 and (phases[m, 3] != 0.0 or phases[m, 4] != 0.0):
                        before += phases[m, 0]
                        m -= 1
                    after = 0.0
                    m = i + 1
                    while m < n and (phases[m, 3] != 0.0 or phases[m, 4] != 0.0):
                        after += phases[m, 0]
                        m += 1
                    spare = phases[i, 0] - before - after
                    if spare > 0.0:
                        if before > 0.0:
                            rows[count, 0] = before
                            count += 1
                            rows[count] = phases[i]
                            rows[count, 1] += before * phases[i, 2]
                        rows[count, 0] = spare
                        apart[count] = True
                        if after > 0.0:
                            count += 1
                            rows[count] = phases[i]
                            rows[count, 0] = after
                            rows[count, 1] = finish - after * phases[i, 2]
                            apart[count] = False
        count += 1
    return count


@njit
def can_gain(rows: Floats, first: int, last: int, end: Floats, top: Floats, samples: Floats, limit_a: Floats, limit_j: Floats) -> bool:
    """Whether the motion of some row is slower than the speed bounds, or the ramp's limits on a straight path, would let it be."""
    axes = samples.shape[3]
    k = 0
    k = interval_at(rows[first, 1], np.searchsorted(end, rows[first, 1]), end)
    for r in range(first, last):
        duration, s, v, a, j = rows[r, 0], rows[r, 1], rows[r, 2], rows[r, 3], rows[r, 4]
        finish = s + duration * (v + duration * (0.5 * a + duration * j / 6.0))
        k = interval_at(s, k, end)
        lowest = top[k]
        highest = limit_j[axes] if j != 0.0 else limit_a[axes]
        while True:
            lowest = min(lowest, top[k])
            for i in range(axes):
                limit = limit_j[i] if j != 0.0 else limit_a[i]
                if samples[k, 2, 0, i] != 0.0:
                    highest = min(highest, limit / abs(samples[k, 2, 0, i]))
            if not (k + 1 < len(end) and end[k] < finish):
                break
            k += 1
        if a == 0.0 and v < FASTEST * lowest and (j == 0.0 or (j > 0.0 and v > 0.0 and r > first)):
            return True
        if j != 0.0 and abs(j) < STEEPEST * highest:
            return True
        if j == 0.0 and a != 0.0 and abs(a) < STEEPEST * highest:
            return True
    return False


@njit
def place_cuts(rows: Floats, first: int, last: int, end: Floats, s: Floats, v: Floats, a: Floats, write: bool) -> int:
    """Cut the motion of the rows [first, last) into cells: arc length, speed and acceleration at the cuts. Returns the number of cells."""
    ramp = 0.0
    whole = 0.0
    for r in range(first, last):
        whole += rows[r, 0]
        if rows[r, 4] != 0.0:
            ramp = max(ramp, rows[r, 0])
        elif rows[r, 3] != 0.0:
            ramp = max(ramp, PLATEAU * rows[r, 0])
    usual = (ramp if ramp > 0.0 else 0.25 * whole) / RAMP_CELLS
    count = 0
    k = interval_at(rows[first, 1], np.searchsorted(end, rows[first, 1]), end)
    for r in range(first, last):
        duration, s0, v0, a0, j = rows[r, 0], rows[r, 1], rows[r, 2], rows[r, 3], rows[r, 4]
        if duration < TINY * usual and r > first:
            continue
        steady = a0 == 0.0 and j == 0.0
        least = duration / max(math.ceil(duration / usual), 1.0)
        t = 0.0
        while True:
            here = s0 + t * (v0 + t * (0.5 * a0 + t * j / 6.0))
            if write:
                s[count] = here
                v[count] = v0 + t * (a0 + 0.5 * t * j)
                a[count] = a0 + t * j
            count += 1
            k = interval_at(here, k, end)
            size = min(least + 0.3 * min(t, duration - t), COARSEST * least) if steady else least
            while size > least / 16.0:
                ahead = t + size
                reached = s0 + ahead * (v0 + ahead * (0.5 * a0 + ahead * j / 6.0))
                if k + SPANNED >= len(end) or reached <= end[k + SPANNED]:
                    break
                size *= 0.5
            if t + 1.4 * size >= duration:
                break
            t += size
    if write:
        r = last - 1
        duration, v0, a0, j = rows[r, 0], rows[r, 2], rows[r, 3], rows[r, 4]
        s[count] = rows[r, 1] + duration * (v0 + duration * (0.5 * a0 + duration * j / 6.0))
        v[count] = v0 + duration * (a0 + 0.5 * duration * j)
        a[count] = 0.0
    return count


@njit
def describe(
    cells: int, s: Floats, end: Floats, top: Floats, sampled: Floats, samples: Floats, d: Floats, cell_top: Floats, q: Floats
) -> None:
    """Length of each cell, speed bounds (middle, end) and derivatives of the path (start, middle, end) in it."""
    k = interval_at(s[0], np.searchsorted(end, s[0]), end)
    for m in range(cells):
        d[m] = s[m + 1] - s[m]
        k = interval_at(s[m], k, end)
        derivatives(k, s[m], sampled, samples, q[m, 0])
        middle = 0.5 * (s[m] + s[m + 1])
        k = interval_at(middle, k, end)
        derivatives(k, middle, sampled, samples, q[m, 1])
        cell_top[m, 0] = top[k]
        k = interval_at(s[m + 1], k, end)
        cell_top[m, 1] = top[k]
        if k > 0 and s[m + 1] <= end[k - 1]:
            k -= 1
            cell_top[m, 1] = min(cell_top[m, 1], top[k])
        derivatives(k, s[m + 1], sampled, samples, q[m, 2])


@njit
def tighten(
    first: int, last: int, s: Floats, v: Floats, a: Floats, d: Floats, cell_top: Floats, share: Floats, q: Floats, end: Floats, top: Floats,
    sampled: Floats, samples: Floats, limit_a: Floats, limit_j: Floats,
) -> float:  # fmt: skip
    """Look between the points at which constraints are held. Where more is taken up there, the cell is allowed less from now on.

    Returns the largest part of a limit that is taken up.
    """
    x = np.empty(5)
    dx = np.empty((5, 4))
    scratch = np.empty((3, q.shape[3]))
    no_blocks = np.empty((0, 2, 2))
    no_gradient = np.empty((0, 2))
    k = interval_at(s[first], np.searchsorted(end, s[first]), end)
    largest = 0.0
    for m in range(first, last):
        if not cell_phases(v[m], a[m], v[m + 1], a[m + 1], d[m], x, dx):
            return math.inf
        h = x[0]
        half = s[m] + h * (v[m] + h * (0.5 * a[m] + h * x[1] / 6.0))
        one, fast_one, k = phase_worst(h, s[m], v[m], a[m], x[1], half, k, end, top, sampled, samples, limit_a, limit_j, scratch)
        two, fast_two, k = phase_worst(h, half, x[3], x[4], x[2], s[m + 1], k, end, top, sampled, samples, limit_a, limit_j, scratch)
        seen = max(one, two)
        fastest = max(fast_one, fast_two)
        largest = max(largest, seen, fastest)
        if fastest > 1.0:
            cell_top[m] /= fastest * (1.0 + TOUCH)
        if seen > TIGHT:
            _, held, _ = merit(m, m + 1, v, a, d, cell_top, share, q, limit_a, limit_j, 0.0, HIGH, False, no_blocks, no_blocks, no_gradient)
            held = max(held * share[m], TIGHT)
            if seen > held * (1.0 + TOUCH):
                share[m] = min(share[m], (1.0 - TOUCH) * held / seen)
    return largest


@njit
def descend(
    first: int, last: int, s: Floats, v: Floats, a: Floats, d: Floats, cell_top: Floats, share: Floats, q: Floats, end: Floats, top: Floats,
    sampled: Floats, samples: Floats, limit_a: Floats, limit_j: Floats,
) -> bool:  # fmt: skip
    """Bring the cells [first, last) near to the least time, from any motion; whether a legal one was found."""
    weight = FIRST_WEIGHT
    good = 0.0
    setbacks = 0
    good_v = v[first : last + 1].copy()
    good_a = a[first : last + 1].copy()
    for _ in range(ROUNDS):
        legal = centre(first, last, v, a, d, cell_top, share, q, limit_a, limit_j, weight) <= 1.0
        if weight > CHECKED_FROM:
            seen = tighten(first, last, s, v, a, d, cell_top, share, q, end, top, sampled, samples, limit_a, limit_j)
            legal = legal and seen <= 1.0 + TOUCH
            if legal and weight > good:
                good = weight
                good_v[:] = v[first : last + 1]
                good_a[:] = a[first : last + 1]
            setbacks += not legal
            if good >= LAST_WEIGHT or (good > 0.0 and setbacks >= SETBACKS):
                break
        elif not legal:
            break
        # Where the barrier counts there is room to get off limits that have become tighter.
        weight = weight * WEIGHT_STEP if legal else FIRST_WEIGHT * WEIGHT_STEP
    v[first : last + 1] = good_v
    a[first : last + 1] = good_a
    return good > 0.0


@njit
def write_cell(s: float, v0: float, a0: float, v1: float, a1: float, d: float, x: Floats, dx: Floats, out: Floats, count: int) -> int:
    """Append the phases of a cell to ``out``, one in which the acceleration changes its sign in two; returns the new count."""
    cell_phases(v0, a0, v1, a1, d, x, dx)
    for p in range(2):
        t = x[0]
        v = v0 if p == 0 else x[3]
        a = a0 if p == 0 else x[4]
        j = x[1 + p]
        behind = x[4] if p == 0 else a1
        out[count] = (t, s, v, a, j)
        count += 1
        if a * behind < 0.0:
            t = -a / j
            out[count - 1, 0] = t
            out[count] = (x[0] - t, s + t * (v + t * (0.5 * a + t * j / 6.0)), v + 0.5 * t * a, 0.0, j)
            count += 1
        t = x[0]
        s += t * (v + t * (0.5 * a + t * j / 6.0))
    return count


@njit
def refine(
    phases: Floats, end: Floats, top: Floats, flat: Flags, sampled: Floats, samples: Floats, axis_a: Floats, axis_j: Floats,
    tangential_a: float, tangential_j: float, rough: bool,
) -> tuple[bool, Floats]:  # fmt: skip
    """Make a plan faster where curves cost time.

    phases (p, 5): rows of duration, s, v, a, j. end, top, flat (n,): the intervals that it runs over, with the speed that they may be
    crossed at by any motion. sampled (n, 2): from where to where their ``samples`` (n, 5, 3, axes) of q', q'', q''' reach. rough: the plan
    itself need not be legal. Returns whether the result is, and its phases.
    """
    axes = len(axis_a)
    limit_a = np.empty(axes + 1)
    limit_j = np.empty(axes + 1)
    for i in range(axes):
        limit_a[i] = axis_a[i] * (1.0 - MARGIN)
        limit_j[i] = axis_j[i] * (1.0 - JERK_MARGIN)
    limit_a[axes] = tangential_a * (1.0 - 1e-6)
    limit_j[axes] = tangential_j * (1.0 - 1e-6)
    rows = np.empty((3 * len(phases), 5))
    apart = np.empty(3 * len(phases), np.bool_)
    total = separate(phases, end, top, flat, rows, apart)
    out = np.empty((2 * total + 256, 5))
    count = 0
    x = np.empty(5)
    dx = np.empty((5, 4))
    q_here = np.empty((3, axes + 1))
    legal = True
    place = 0
    first = 0
    while first < total:
        last = first + 1
        if not apart[first]:
            while last < total and not apart[last] and rows[last, 2] > 0.0:
                last += 1
        cells = 0
        if not apart[first] and (rough or can_gain(rows, first, last, end, top, samples, limit_a, limit_j)):
            cells = place_cuts(rows, first, last, end, x, x, x, False)
        refined = False
        if cells > 1:
            s = np.empty(cells + 1)
            v = np.empty(cells + 1)
            a = np.empty(cells + 1)
            d = np.empty(cells)
            cell_top = np.empty((cells, 2))
            share = np.ones(cells)
            q = np.empty((cells, 3, 3, axes + 1))
            place_cuts(rows, first, last, end, s, v, a, True)
            if last < total:
                s[cells] = rows[last, 1]
                v[cells] = rows[last, 2]
            else:
                s[cells] = end[-1]
                v[cells] = 0.0
            describe(cells, s, end, top, sampled, samples, d, cell_top, q)
            refined = True
            done = 0
            while refined and done < cells:
                until = min(done + WINDOW, cells)
                refined = descend(done, until, s, v, a, d, cell_top, share, q, end, top, sampled, samples, limit_a, limit_j)
                done = until if until == cells else done + WINDOW // 2
            if refined:
                before = 0.0
                for r in range(first, last):
                    before += rows[r, 0]
                after = 0.0
                for m in range(cells):
                    cell_phases(v[m], a[m], v[m + 1], a[m + 1], d[m], x, dx)
                    after += 2.0 * x[0]
                refined = rough or after < before * (1.0 - WORTHWHILE)
        needed = count + 4 * cells + (last - first) + 2 * total
        if needed > len(out):
            grown = np.empty((2 * needed, 5))
            grown[:count] = out[:count]
            out = grown
        if refined:
            for m in range(cells):
                count = write_cell(s[m], v[m], a[m], v[m + 1], a[m + 1], d[m], x, dx, out, count)
        else:
            for r in range(first, last):
                out[count] = rows[r]
                count += 1
                if rough:
                    reached = rows[r + 1, 1] if r + 1 < total else end[-1]
                    worst, fastest, place = phase_worst(
                        rows[r, 0], rows[r, 1], rows[r, 2], rows[r, 3], rows[r, 4], reached, place,
                        end, top, sampled, samples, limit_a, limit_j, q_here,
                    )  # fmt: skip
                    legal = legal and max(worst, fastest) <= 1.0 + TOUCH
        first = last
    return legal, out[:count]
