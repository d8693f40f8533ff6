"""Examination of a motion between the points at which the descent holds the limits.

A cell that exceeds a limit there is cut in two, or it is allowed less:

- It takes up clearly more between its points than at them: it is cut in the middle of its time. The
  motion stays the same, and its points are closer.
- It takes up about as much at them: its share of the limits is reduced.
- It passes the speed bound of an interval in its inside: it is cut at the end of that interval, or
  its share of the speed bounds is reduced.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import phase_at
from cnc.planner.kernels.cells import (
    A_MIDDLE,
    J1,
    J2,
    OPEN,
    V_MIDDLE,
    Cells,
    H,
    cell_phases,
    describe,
    empty_cells,
    place_rest,
)
from cnc.planner.kernels.descent import HIGH, merit, system_for
from cnc.planner.kernels.intervals import (
    SCRATCH,
    TOUCH,
    Intervals,
    SumLimits,
    interval_at,
    largest_shares,
)
from cnc.planner.kernels.scurve import phase_time

Floats = NDArray[np.float64]

UNHELD = 1.001
"""A cell is cut if it takes up this much more between its points than at them."""

TIGHT = 0.8
"""A cell that takes up less than this at its points counts as if it took up this much."""

CLEARLY = 1.01
"""A cell is cut at the end of an interval if it exceeds a speed bound by this factor."""

LOWERED = 0.998
"""A cell whose share of the speed bounds is below this is cut there too: to lower it further would
not help where the speed is too high between the places at which the bounds are held.
"""

LEAST_SHARE = 0.3
"""A cell is never allowed less of the limits than this."""

SHORTEST = 1e-8
"""mm; shorter cells are not cut."""

APART = 1e-10
"""mm; least distance of a cut from the ends of its cell."""


class Shares(NamedTuple):
    """Largest shares that each of n cells uses between its points; infinite without a motion.

    Attributes:
        sums: (n,): of the limits of acceleration and jerk.
        speed: (n,): of the speed bounds.
    """

    sums: Floats
    speed: Floats


@njit
def examine(cells: Cells, intervals: Intervals, limits: SumLimits, shares: Shares) -> float:
    """Compute the shares of all cells; return the largest."""
    s, v, a = cells.s, cells.v, cells.a
    x = np.empty(5)
    dx = np.empty((5, 4))
    scratch = np.empty((SCRATCH, cells.q.shape[3]))
    k = interval_at(s[0], np.searchsorted(intervals.end, s[0]), intervals.end)
    largest = 0.0
    place_rest(cells)
    for m in range(len(cells.length)):
        if not cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, dx):
            shares.sums[m] = shares.speed[m] = largest = math.inf
            continue
        h = x[H]
        half = phase_at(h, s[m], v[m], a[m], x[J1])[0]
        shares.sums[m], shares.speed[m], k = largest_shares(
            h, s[m], v[m], a[m], x[J1], half, k, intervals, limits, scratch
        )
        sums, speed, k = largest_shares(
            h, half, x[V_MIDDLE], x[A_MIDDLE], x[J2], s[m + 1], k, intervals, limits, scratch
        )
        shares.sums[m] = max(shares.sums[m], sums)
        shares.speed[m] = max(shares.speed[m], speed)
        largest = max(largest, shares.sums[m], shares.speed[m])
    return largest


@njit
def crossing(cells: Cells, m: int, intervals: Intervals, at: Floats) -> bool:
    """Find the end of an interval inside cell ``m`` at which it exceeds a speed bound the most.

    Args:
        cells: the cells.
        m: the cell.
        intervals: the intervals of the path.
        at: (3,): receives arc length, speed and acceleration there.

    Returns:
        Whether there is an end of an interval in the cell.
    """
    end, top = intervals.end, intervals.top
    s0, v0, a0, s1 = cells.s[m], cells.v[m], cells.a[m], cells.s[m + 1]
    x = np.empty(5)
    dx = np.empty((5, 4))
    if not cell_phases(v0, a0, cells.v[m + 1], cells.a[m + 1], cells.length[m], x, dx):
        return False
    half = phase_at(x[H], s0, v0, a0, x[J1])[0]
    largest = 0.0
    k = np.searchsorted(end, s0 + APART)
    while k + 1 < len(end) and end[k] < s1 - APART:
        start, v, a, j = s0, v0, a0, x[J1]
        if end[k] > half:
            start, v, a, j = half, x[V_MIDDLE], x[A_MIDDLE], x[J2]
        t = phase_time(v, a, j, x[H], end[k] - start)
        _, speed, accel = phase_at(t, start, v, a, j)
        share = speed / max(min(top[k], top[k + 1]), 1e-9)
        if share > largest:
            largest = share
            at[0], at[1], at[2] = end[k], max(speed, 1e-9), accel
        k += 1
    return largest > 0.0


@njit
def halfway(cells: Cells, m: int, at: Floats) -> bool:
    """Write the motion in the middle of the time of cell ``m`` to ``at``, as :func:`crossing`."""
    x = np.empty(5)
    dx = np.empty((5, 4))
    s, v, a = cells.s[m], cells.v[m], cells.a[m]
    if not cell_phases(v, a, cells.v[m + 1], cells.a[m + 1], cells.length[m], x, dx):
        return False
    at[0], at[1], at[2] = phase_at(x[H], s, v, a, x[J1])
    return bool(s + APART < at[0] < cells.s[m + 1] - APART)


@njit
def tighten(
    cells: Cells, intervals: Intervals, limits: SumLimits, shares: Shares, tried: Cells, at: Floats
) -> int:
    """Find cuts of the cells that exceed a limit between their points, or allow them less.

    Args:
        cells: the cells with the motion that is to be kept; their shares change.
        intervals: the intervals of the path.
        limits: for the sums.
        shares: of the motion that exceeds limits.
        tried: the cells with that motion.
        at: (n, 2, 3): receives arc length, speed and acceleration at up to two cuts of each cell;
            NaN where there is none.

    Returns:
        The number of cuts.
    """
    system = system_for(len(cells.length), HIGH)
    place_rest(cells)
    cuts = 0
    for m in range(len(cells.length)):
        at[m, 0, 0] = at[m, 1, 0] = math.nan
        sums, speed = shares.sums[m], shares.speed[m]
        largest = max(sums, speed)
        if not (largest > 1.0 + TOUCH) or largest == math.inf:
            continue
        _, held, _ = merit(m, m + 1, tried, limits, 0.0, False, system)
        held = max(held * cells.share[m], TIGHT)
        wanted = largest > UNHELD * held and cells.s[m + 1] - cells.s[m] > SHORTEST
        if sums > 1.0 + TOUCH and not wanted:
            cells.share[m] = max(cells.share[m] * (1.0 - 2.0 * TOUCH) / sums, LEAST_SHARE)
        if speed > 1.0 + TOUCH:
            again = cells.pace[m] < LOWERED
            if (speed > CLEARLY or again) and crossing(cells, m, intervals, at[m, 0]):
                # Between these cuts the motion has one phase each, so it stays the same.
                cuts += 1
                if halfway(cells, m, at[m, 1]) and abs(at[m, 1, 0] - at[m, 0, 0]) > APART:
                    cuts += 1
                    if at[m, 1, 0] < at[m, 0, 0]:
                        for i in range(3):
                            at[m, 0, i], at[m, 1, i] = at[m, 1, i], at[m, 0, i]
                else:
                    at[m, 1, 0] = math.nan
                continue
            at[m, 0, 0] = math.nan
            if not wanted or speed < CLEARLY:
                wanted = False
                part = 1.0 / (speed * (1.0 + 2.0 * TOUCH))
                cells.pace[m] *= part
                if m > 0 and again:
                    cells.pace[m - 1] *= part
                elif m > 0:
                    cells.pace[m - 1] = min(cells.pace[m - 1], max(cells.pace[m], part))
        if wanted and halfway(cells, m, at[m, 0]):
            cuts += 1
        elif wanted:
            at[m, 0, 0] = math.nan
    return cuts


@njit
def with_cuts(cells: Cells, at: Floats, cuts: int, intervals: Intervals) -> Cells:
    """Return the cells with ``cuts`` further cuts, those of :func:`tighten`."""
    n = len(cells.length)
    out = empty_cells(n + cuts, cells.q.shape[3], cells.rest_before)
    count = 0
    for m in range(n):
        out.s[count], out.v[count], out.a[count] = cells.s[m], cells.v[m], cells.a[m]
        out.share[count], out.pace[count] = cells.share[m], cells.pace[m]
        count += 1
        for i in range(2):
            if not math.isnan(at[m, i, 0]):
                out.s[count], out.v[count], out.a[count] = at[m, i, 0], at[m, i, 1], at[m, i, 2]
                out.share[count], out.pace[count] = cells.share[m], cells.pace[m]
                count += 1
    out.s[count], out.v[count], out.a[count] = cells.s[n], cells.v[n], cells.a[n]
    describe(out, intervals)
    return out


@njit
def without_cut(cells: Cells, cut: int, intervals: Intervals) -> Cells:
    """Return the cells without the cut ``cut``, which is not an end."""
    n = len(cells.length)
    out = empty_cells(n - 1, cells.q.shape[3], cells.rest_before)
    for m in range(n + 1):
        to = m if m < cut else m - 1
        if m != cut:
            out.s[to], out.v[to], out.a[to] = cells.s[m], cells.v[m], cells.a[m]
        if m < n:
            to = min(to, n - 2)
            out.share[to] = min(cells.share[m], out.share[to])
            out.pace[to] = min(cells.pace[m], out.pace[to])
    describe(out, intervals)
    return out


@njit
def passable(cells: Cells, intervals: Intervals) -> Cells:
    """Return cells through each of which a motion leads.

    The acceleration beside a rest is changed so that one phase of constant jerk leads there; else a
    cut is left out.
    """
    x = np.empty(5)
    dx = np.empty((5, 4))
    m = 0
    changed = -1
    while m < len(cells.length):
        v, a, d = cells.v, cells.a, cells.length[m]
        if cell_phases(v[m], a[m], v[m + 1], a[m + 1], d, x, dx):
            m += 1
            continue
        n = len(cells.length)
        if v[m + 1] == 0.0 and v[m] > 0.0 and d != OPEN and m > 0 and changed != m:
            a[m] = -2.0 * v[m] * v[m] / (3.0 * d)
            changed = m
            m -= 1
        elif v[m] == 0.0 and v[m + 1] > 0.0 and m + 1 < n and changed != m:
            a[m + 1] = 2.0 * v[m + 1] * v[m + 1] / (3.0 * d)
            changed = m
        elif n <= 1:
            return cells
        else:
            cells = without_cut(cells, max(m, 1), intervals)
            changed = -1
            m = max(m - 2, 0)
    return cells
