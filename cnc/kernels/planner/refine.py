r"""The fastest motion near a plan: an interior-point descent over constant-jerk phases, legal in
every axis.

The plan of :mod:`cnc.kernels.planner.lookahead` keeps to bounds that combine the largest speed with
the largest acceleration of a stretch and the worst directions of both. On a curve that costs up to
half of the time, because velocity, acceleration and jerk of an axis,

    q' v,    q'' v^2 + q' a,    q''' v^3 + 3 q'' v a + q' j,

partly cancel: out of a tight bend -kappa^2 v^3 leaves room for j. Here the exact sums are held
within their limits.

    plan ──► cells (cnc.kernels.planner.cells) ──► rounds of descent (cnc.kernels.planner.descent) ──► phases
                                              ^  heavier time, tighter cells   |
                                              '── between the points of each ◄─'  (cnc.kernels.planner.intervals)

The weight of the time rises from round to round until the barrier costs little. The descent holds
the limits at four points of a cell; what it misses between them is looked for when it is near its
end, and the cell is allowed less in the rounds that follow.

Why this and not the classic sequential linear program over v^2 on a grid: there each step has to be
turned into phases, which breaks limits between the grid's points; here every step is a motion.
Against a fine nonlinear optimum with the same limits it takes 0.3 to 0.5 % longer, for 8 us a cell
on a curve that binds; a plan in which no curve costs time isn't touched.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cells import can_gain, describe, place_cuts, separate
from cnc.kernels.planner.descent import HIGH, TOUCH, cell_phases, centre, merit
from cnc.kernels.planner.intervals import interval_at, phase_worst
from cnc.kernels.planner.limits import UNSEEN

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

WINDOW = 400
"""Cells that are refined together; of a longer stretch the first half is kept each time, and the
rest refined with what follows.
"""

FIRST_WEIGHT = 2.0
LAST_WEIGHT = 2592.0
WEIGHT_STEP = 6.0
"""The weight of the time, per cell and the time itself: to begin with, at the end, and from one
round to the next.
"""

CHECKED_FROM = 50.0
"""From this weight on the motion is good enough to see what the constraints miss between their
points.
"""

MARGIN = 5e-5
JERK_MARGIN = 2.0 * UNSEEN
"""Parts of the limits kept free: for the interpolation of the path's derivatives, for jumps of
curvature that show in differences.
"""

ROUNDS = 20
SETBACKS = 4
"""Rounds at most: five, and again for cells whose limits had to be tightened; and how often that is
done to better a legal motion.
"""

TIGHT = 0.8
"""A cell that takes up less than this of every limit isn't looked at more closely."""

WORTHWHILE = 0.002
"""The part of a stretch's time that has to be saved."""


@njit
def tighten(
    first: int, last: int, s: Floats, v: Floats, a: Floats, d: Floats, cell_top: Floats, share: Floats, q: Floats, end: Floats, top: Floats,
    sampled: Floats, samples: Floats, limit_a: Floats, limit_j: Floats,
) -> float:  # fmt: skip
    """Look between the points at which constraints are held. Where more is taken up there, the cell
    is allowed less from now on.

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
        one, fast_one, k = phase_worst(
            h,
            s[m],
            v[m],
            a[m],
            x[1],
            half,
            k,
            end,
            top,
            sampled,
            samples,
            limit_a,
            limit_j,
            scratch,
        )
        two, fast_two, k = phase_worst(
            h,
            half,
            x[3],
            x[4],
            x[2],
            s[m + 1],
            k,
            end,
            top,
            sampled,
            samples,
            limit_a,
            limit_j,
            scratch,
        )
        seen = max(one, two)
        fastest = max(fast_one, fast_two)
        largest = max(largest, seen, fastest)
        if fastest > 1.0:
            cell_top[m] /= fastest * (1.0 + TOUCH)
        if seen > TIGHT:
            _, held, _ = merit(
                m,
                m + 1,
                v,
                a,
                d,
                cell_top,
                share,
                q,
                limit_a,
                limit_j,
                0.0,
                HIGH,
                False,
                no_blocks,
                no_blocks,
                no_gradient,
            )
            held = max(held * share[m], TIGHT)
            if seen > held * (1.0 + TOUCH):
                share[m] = min(share[m], (1.0 - TOUCH) * held / seen)
    return largest


@njit
def descend(
    first: int, last: int, s: Floats, v: Floats, a: Floats, d: Floats, cell_top: Floats, share: Floats, q: Floats, end: Floats, top: Floats,
    sampled: Floats, samples: Floats, limit_a: Floats, limit_j: Floats,
) -> bool:  # fmt: skip
    """Bring the cells [first, last) near to the least time, from any motion; whether a legal one
    was found.
    """
    weight = FIRST_WEIGHT
    good = 0.0
    setbacks = 0
    good_v = v[first : last + 1].copy()
    good_a = a[first : last + 1].copy()
    for _ in range(ROUNDS):
        legal = centre(first, last, v, a, d, cell_top, share, q, limit_a, limit_j, weight) <= 1.0
        if weight > CHECKED_FROM:
            seen = tighten(
                first,
                last,
                s,
                v,
                a,
                d,
                cell_top,
                share,
                q,
                end,
                top,
                sampled,
                samples,
                limit_a,
                limit_j,
            )
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
def write_cell(
    s: float,
    v0: float,
    a0: float,
    v1: float,
    a1: float,
    d: float,
    x: Floats,
    dx: Floats,
    out: Floats,
    count: int,
) -> int:
    """Append the phases of a cell to ``out``, one in which the acceleration changes its sign in
    two; returns the new count.
    """
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
            out[count] = (
                x[0] - t,
                s + t * (v + t * (0.5 * a + t * j / 6.0)),
                v + 0.5 * t * a,
                0.0,
                j,
            )
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

    phases (p, 5): rows of duration, s, v, a, j. end, top, flat (n,): where the intervals that it
    runs over end, the speed that no motion over them exceeds, and whether they are crossed at
    constant speed. sampled (n, 2): from where to where their ``samples`` (n, 5, 3, axes) of q',
    q'', q''' reach. axis_a, axis_j (axes,), tangential_a, tangential_j: limits in mm/s^2 and
    mm/s^3, infinite where there is none. rough: the plan itself need not be legal. Returns whether
    the result is, and its phases.
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
        if not apart[first] and (
            rough or can_gain(rows, first, last, end, top, samples, limit_a, limit_j)
        ):
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
                refined = descend(
                    done,
                    until,
                    s,
                    v,
                    a,
                    d,
                    cell_top,
                    share,
                    q,
                    end,
                    top,
                    sampled,
                    samples,
                    limit_a,
                    limit_j,
                )
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
