r"""The fastest motion near a plan, legal in every axis.

The plan of :mod:`cnc.planner.kernels.lookahead` keeps to bounds that combine the largest speed with
the largest acceleration of a stretch and the worst directions of both. On a curve that costs up to
half of the time, because velocity, acceleration and jerk of an axis,

    q' v,    q'' v^2 + q' a,    q''' v^3 + 3 q'' v a + q' j,

partly cancel: out of a tight bend -kappa^2 v^3 leaves more jerk for j. The refinement holds the
exact sums within their limits, by an interior-point descent over constant-jerk phases.

    plan ──► stretches ──► cells ──► windows ──► fastest motion of each ──► phases
             (cells.py)                          (fastest.py, descent.py, examination.py)

A stretch lies between two places at which the speed is fixed. Only stretches that may gain are
refined, in windows of cells that overlap: of each window the last cells are solved again together
with the next. A window without a legal result keeps the phases of the plan.

The classic alternative is a sequential linear program over v^2 on a grid. There each step has to be
turned into phases, which breaks limits between the points of the grid; here every step is a motion.
Compared with a fine nonlinear optimum under the same limits the result takes 0.3 to 0.5 % longer.
A plan in which nothing costs time is left as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import PHASE, LimitArrays, Phases, phase_at, write_phase
from cnc.planner.kernels.cells import (
    A_MIDDLE,
    J1,
    J2,
    V_MIDDLE,
    Cells,
    H,
    Stretch,
    cell_phases,
    copy_part,
    describe,
    empty_cells,
    part_of,
    plan_cells,
    possible_gain,
    separate,
)
from cnc.planner.kernels.fastest import fastest
from cnc.planner.kernels.intervals import SCRATCH, TOUCH, Intervals, SumLimits, largest_shares
from cnc.planner.kernels.limits import UNSEEN
from cnc.planner.kernels.scurve import phase_time

Floats = NDArray[np.float64]

WINDOW = 400
"""Cells that are refined together."""

OVERLAP = 100
"""Cells at the end of a window that are solved again with the next window."""

SEAM = 4
UNSEAMED = 25
SEAM_SHARE = 0.995
"""The cells behind the seam of two windows, and SEAM before it, use this share of their limits. The
next window begins with the motion behind the seam: so the first step of its descent starts strictly
inside the limits. The last UNSEAMED cells may use all: they lead to the state of the plan at the
end, which may be at a limit, and a motion that keeps away from the limit does not reach it.
"""

MARGIN = TOUCH
JERK_MARGIN = 2.0 * UNSEEN
"""Shares of the limits of acceleration and jerk that stay free. A motion may exceed the rest by
TOUCH, the path's derivatives are interpolated, and jumps of curvature show in differences.
"""

INSTANT = 1e-12
"""s; a shorter rest of a phase is left out."""

PROMISING = 0.005
"""A stretch is refined if this part of its time may be saved, by the estimate for each phase."""

NOTICEABLE = 0.001
"""It has to be this part of the time of the stretch and of the cruise before it, too: a refinement
of the turns of long rows would take most of the planning time and save 0.03 % of the motion.
"""

WORTHWHILE = 0.002
"""A refinement has to save this part of a stretch's time."""


@njit
def sum_limits(limits: LimitArrays) -> SumLimits:
    """Return the limits of each axis and of the path, less the margins."""
    axes = len(limits.axis_acceleration)
    a = np.empty(axes + 1)
    j = np.empty(axes + 1)
    for i in range(axes):
        a[i] = limits.axis_acceleration[i] * (1.0 - MARGIN)
        j[i] = limits.axis_jerk[i] * (1.0 - JERK_MARGIN)
    a[axes] = limits.tangential_acceleration * (1.0 - MARGIN)
    j[axes] = limits.tangential_jerk * (1.0 - MARGIN)
    return SumLimits(a, j, 1.0 / a, 1.0 / j)


@njit
def write_cell(cells: Cells, m: int, x: Floats, dx: Floats, out: Phases, count: int) -> int:
    """Append the phases of cell ``m`` to ``out``; return the new count.

    A phase in which the acceleration changes its sign becomes two. x (5,), dx (5, 4): scratch.
    """
    s, a1 = cells.s[m], cells.a[m + 1]
    cell_phases(cells.v[m], cells.a[m], cells.v[m + 1], a1, cells.length[m], x, dx)
    h = x[H]
    for p in range(2):
        v = cells.v[m] if p == 0 else x[V_MIDDLE]
        a = cells.a[m] if p == 0 else x[A_MIDDLE]
        j = x[J1] if p == 0 else x[J2]
        behind = x[A_MIDDLE] if p == 0 else a1
        write_phase(out, count, h, s, v, a, j)
        count += 1
        if a * behind < 0.0:
            t = -a / j
            out[count - 1]["duration"] = t
            turn = s + t * (v + t * (0.5 * a + t * j / 6.0))
            write_phase(out, count, h - t, turn, v + 0.5 * t * a, 0.0, j)
            count += 1
        s += h * (v + h * (0.5 * a + h * j / 6.0))
    return count


@njit
def write_cells(cells: Cells, first: int, last: int, out: Phases, count: int) -> int:
    """Append the phases of the cells [first, last) to ``out``; return the new count."""
    x = np.empty(5)
    dx = np.empty((5, 4))
    for m in range(first, last):
        count = write_cell(cells, m, x, dx, out, count)
    return count


@njit
def write_rows(
    stretch: Stretch, low: float, high: float, intervals: Intervals, limits: SumLimits, out: Phases
) -> tuple[int, bool]:
    """Write the phases of the plan between two arc lengths, as they are.

    Args:
        stretch: the stretch of the plan.
        low: arc length at the start, mm.
        high: arc length at the end.
        intervals: the intervals of the path.
        limits: for the sums.
        out: receives the phases.

    Returns:
        Their number, and whether they are legal. Only a rough plan may be illegal.
    """
    rows = stretch.rows
    scratch = np.empty((SCRATCH, len(limits.a)))
    count = 0
    place = 0
    legal = True
    for r in range(stretch.first, stretch.last):
        duration, s, v = rows[r]["duration"], rows[r]["s"], rows[r]["v"]
        a, j = rows[r]["a"], rows[r]["j"]
        stop = rows[r + 1]["s"] if r + 1 < stretch.last else stretch.end_s
        if stop <= low or s >= high:
            continue
        start = 0.0 if s >= low else phase_time(v, a, j, duration, low - s)
        if stop > high:
            duration = phase_time(v, a, j, duration, high - s)
        if duration - start < INSTANT:
            continue
        here, v, a = phase_at(start, s, v, a, j)
        write_phase(out, count, duration - start, max(here, low), v, a, j)
        count += 1
        if stretch.rough:
            worst, fastest, place = largest_shares(
                duration - start, here, v, a, j, min(stop, high), place, intervals, limits, scratch
            )
            legal = legal and max(worst, fastest) <= 1.0 + TOUCH
    return count, legal


@njit
def window_of(head: Cells, plan: Cells, first: int, last: int, intervals: Intervals) -> Cells:
    """Return the cells of ``head``, and behind them the cells [first, last) of the plan."""
    n = len(head.length)
    out = empty_cells(n + last - first, plan.q.shape[3])
    copy_part(head.s, 0, n + 1, out.s, 0)
    copy_part(head.v, 0, n + 1, out.v, 0)
    copy_part(head.a, 0, n + 1, out.a, 0)
    copy_part(plan.s, first + 1, last - first, out.s, n + 1)
    copy_part(plan.v, first + 1, last - first, out.v, n + 1)
    copy_part(plan.a, first + 1, last - first, out.a, n + 1)
    describe(out, intervals)
    return out


@njit
def with_space(out: Phases, count: int, more: int) -> Phases:
    """Return ``out`` with space for so many phases behind ``count``."""
    if count + more <= len(out):
        return out
    grown = np.empty(2 * (count + more), PHASE)
    for k in range(count):
        grown[k] = out[k]
    return grown


@njit
def _as_planned(stretch: Stretch, out: Phases, count: int) -> int:
    """Append the phases of a stretch of a legal plan to ``out``; return the new count."""
    for r in range(stretch.first, stretch.last):
        out[count] = stretch.rows[r]
        count += 1
    return count


@njit
def refine_stretch(
    stretch: Stretch,
    intervals: Intervals,
    limits: SumLimits,
    left: Floats,
    out: Phases,
    count: int,
) -> tuple[bool, Phases, int]:
    """Append the fastest motion over a stretch to ``out``, a window of cells at a time.

    Of each window the last cells are solved again together with the next ones. Where no legal
    motion is found so, the next ones are solved on their own, or in two parts. A window without a
    legal motion keeps the phases of the plan. So does the rest, where no computing time is left.

    Args:
        stretch: the stretch.
        intervals: the intervals of the plan.
        limits: the limits.
        left: (1,): computing time that is left, s; it is lowered.
        out: receives the phases.
        count: number of phases in it.

    Returns:
        Whether the motion is legal, ``out`` or a larger copy, and the new count.
    """
    rows = stretch.rows
    plan = plan_cells(stretch, intervals, limits)
    n = len(plan.length)
    if n < 2:
        out = with_space(out, count, stretch.last - stretch.first)
        written, legal = write_rows(
            stretch, rows[stretch.first]["s"], stretch.end_s, intervals, limits, out[count:]
        )
        return legal, out, count + written
    start, before = count, 0.0
    for r in range(stretch.first, stretch.last):
        before += rows[r]["duration"]
    most = stretch.last - stretch.first + 2
    legal = True
    head = part_of(plan, 0, 0)
    done = 0
    longest = WINDOW
    while done < n:
        if left[0] <= 0.0:
            out = with_space(out, count, 4 * len(head.length) + most)
            count = write_cells(head, 0, len(head.length), out, count)
            written, fits = write_rows(
                stretch, plan.s[done], plan.s[n], intervals, limits, out[count:]
            )
            count += written
            legal = legal and fits
            break
        size = max(longest - len(head.length), OVERLAP)
        until = n if n - done <= size + OVERLAP else done + size
        window = window_of(head, plan, done, until, intervals)
        size = len(window.length)
        seam_s = window.s[size]
        if until < n:
            seam = max(size - OVERLAP, size // 2)
            seam_s = window.s[seam]
            for m in range(max(seam - SEAM, 0), max(size - UNSEAMED, seam)):
                window.share[m] = window.pace[m] = SEAM_SHARE
            describe(window, intervals)
        solved, cells = fastest(window, intervals, limits, left)
        out = with_space(out, count, 4 * (len(cells.length) + len(head.length)) + most)
        if not solved and len(head.length) > 0:
            # The motion behind the seam stays, and the next window begins behind it.
            count = write_cells(head, 0, len(head.length), out, count)
            head = part_of(plan, done, done)
            continue
        if not solved and until - done > 2 * OVERLAP:
            # A window that ends elsewhere: at a cusp its end may leave nearly no room.
            longest = (until - done) // 2
            continue
        longest = WINDOW
        if not solved:
            written, fits = write_rows(
                stretch, plan.s[done], plan.s[until], intervals, limits, out[count:]
            )
            count += written
            legal = legal and fits
            head = part_of(plan, until, until)
        else:
            size = len(cells.length)
            finished = min(np.searchsorted(cells.s, seam_s), size)
            count = write_cells(cells, 0, finished, out, count)
            head = part_of(cells, finished, size)
        done = until
    after = 0.0
    for k in range(start, count):
        after += out[k]["duration"]
    if not stretch.rough and not after < before * (1.0 - WORTHWHILE):
        count = _as_planned(stretch, out, start)
    return legal, out, count


@njit
def refine(
    phases: Phases, intervals: Intervals, machine: LimitArrays, rough: bool, left: Floats
) -> tuple[bool, Phases]:
    """Make a plan faster where curves cost time.

    Args:
        phases: (p,): the plan.
        intervals: the intervals from its start to its end.
        machine: the limits.
        rough: whether the plan itself may be illegal. A stretch of it that is legal, and can hardly
            gain, stays as it is.
        left: (1,): computing time that is left, s; it is lowered.

    Returns:
        Whether the result is legal, and its phases; none if it is not.
    """
    limits = sum_limits(machine)
    rows = np.empty(3 * len(phases), PHASE)
    fixed = np.empty(3 * len(phases), np.bool_)
    total = separate(phases, intervals, rows, fixed)
    out = np.empty(4 * total + 256, PHASE)
    count = 0
    first = 0
    cruise = 0.0
    while first < total:
        last = first + 1
        if not fixed[first]:
            while last < total and not fixed[last] and rows[last]["v"] > 0.0:
                last += 1
        end_s = rows[last]["s"] if last < total else intervals.end[-1]
        end_v = rows[last]["v"] if last < total else 0.0
        stretch = Stretch(rows, first, last, end_s, end_v, rough)
        out = with_space(out, count, last - first)
        wanted = False
        if not fixed[first]:
            before = 0.0
            for r in range(first, last):
                before += rows[r]["duration"]
            gain = possible_gain(rows, first, last, intervals, limits)
            wanted = gain > max(PROMISING * before, NOTICEABLE * (before + cruise))
        fits = True
        kept = count
        if not wanted:
            written, fits = write_rows(
                stretch, rows[first]["s"], end_s, intervals, limits, out[count:]
            )
            count += written
        if wanted or not (fits or fixed[first]):
            fits, out, count = refine_stretch(stretch, intervals, limits, left, out, kept)
        if not fits:
            return False, out[:0]
        cruise = cruise + rows[first]["duration"] if fixed[first] else 0.0
        first = last
    return True, out[:count]
