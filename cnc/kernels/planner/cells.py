"""A plan cut into cells for refinement.

A cell is a stretch of path for the descent of :mod:`cnc.kernels.planner.descent`, about as long in
time as the cells near it, and shorter in tight bends.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import (
    A_MIDDLE,
    CLOSED,
    J1,
    J2,
    OPEN,
    V_MIDDLE,
    Cells,
    H,
    cell_phases,
    copy_part,
    empty_cells,
    length_to_rest,
)
from cnc.kernels.planner.intervals import (
    SAMPLES,
    SCRATCH,
    Intervals,
    SumLimits,
    derivatives,
    interval_at,
    largest_shares,
)
from cnc.kernels.planner.phases import phase_at
from cnc.kernels.planner.scurve import phase_time
from cnc.kernels.planner.stretches import Stretch

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]

RAMP_CELLS = 5
"""Cells in the longest jerk phase of a stretch; the others are about as long in time."""

PLATEAU = 0.3
"""This part of the longest phase of constant acceleration counts as a jerk phase."""

SPANNED = 6
"""Largest number of ends of intervals inside a cell."""

UNEVEN = 0.5
"""Largest share of a limit by which the path may differ within a cell, at the speed that a cell may
reach.
"""

FINEST = 64.0
"""A cell in a tight bend may be this much shorter in time than the others."""

SHORTEST_CELL = 1e-8
"""mm; a phase of less length becomes part of the cell before."""

COARSEST = 4.0
"""A cell in the middle of a cruise may be this much longer than the others."""

TINY = 0.15
"""A phase shorter than this part of a cell becomes part of the cell before."""


FAR = 1.5
"""A cell is cut at the ends of the plan's phases if it exceeds a limit by this factor."""

REACHED = 1.6
"""The refinement may be this much faster than the bound that leaves acceleration for any direction.
"""

JUMP = 0.01
"""A cell is cut at a knot where the jump of q'' v^2 or q''' v^3 is this share of a limit."""

STEP = 0.04
"""A cell is cut where the speed bound changes by this share at once."""

NEAR_KNOT = 0.35
"""Part of a cell within which a knot takes the place of a cut."""

NEAR_END = 1e-9
"""mm; a knot this near to an end of a stretch, or to another, is not a cut."""


@njit
def even_until(
    s: float, reached: float, k: int, v: float, known: Intervals, limits: SumLimits
) -> float:
    """Return how far the path is even enough for one cell.

    Args:
        s: arc length at the start of the cell, mm.
        reached: where the cell would end.
        k: the interval at its start.
        v: the speed in it, mm/s.
        known: the intervals of the path.
        limits: for the sums.

    Returns:
        ``reached``, or the end of the first interval by which q'' v^2 or q''' v^3 differ from those
        at the start of the cell by the share UNEVEN of a limit.
    """
    end, samples = known.end, known.samples
    extent = known.sampled[k, 1] - known.sampled[k, 0]
    m = 0
    if extent > 0.0:
        m = min(int((SAMPLES - 1) * (s - known.sampled[k, 0]) / extent + 0.5), SAMPLES - 1)
    first = k
    while k + 1 < len(end) and end[k] < reached:
        for i in range(samples.shape[3]):
            bend = abs(samples[k, SAMPLES - 1, 1, i] - samples[first, m, 1, i])
            twist = abs(samples[k, SAMPLES - 1, 2, i] - samples[first, m, 2, i])
            if max(bend * v * v / limits.a[i], twist * v * v * v / limits.j[i]) > UNEVEN:
                return float(end[k])
        k += 1
    return reached


@njit
def place_cuts(
    stretch: Stretch, known: Intervals, limits: SumLimits, cells: Cells, write: bool
) -> int:
    """Cut the motion of a stretch into cells.

    Args:
        stretch: of the plan.
        known: the intervals of the path.
        limits: for the sums.
        cells: receives arc length, speed and acceleration at the cuts.
        write: whether to write them, or only to count.

    Returns:
        The number of cells.
    """
    end = known.end
    rows, first, last = stretch.rows, stretch.first, stretch.last
    ramp = 0.0
    whole = 0.0
    for r in range(first, last):
        duration = rows[r]["duration"]
        whole += duration
        if rows[r]["j"] != 0.0:
            ramp = max(ramp, duration)
        elif rows[r]["a"] != 0.0:
            ramp = max(ramp, PLATEAU * duration)
    usual = (ramp if ramp > 0.0 else 0.25 * whole) / RAMP_CELLS
    count = 0
    k = interval_at(rows[first]["s"], np.searchsorted(end, rows[first]["s"]), end)
    for r in range(first, last):
        row = rows[r]
        duration, s0, v0, a0, j = row["duration"], row["s"], row["v"], row["a"], row["j"]
        if duration < TINY * usual and r > first:
            reached = phase_at(duration, s0, v0, a0, j)[0]
            even = even_until(s0, reached, k, REACHED * v0, known, limits)
            if even >= reached or reached < s0 + SHORTEST_CELL:
                continue
        steady = a0 == 0.0 and j == 0.0
        least = duration / max(math.ceil(duration / usual), 1.0)
        t = 0.0
        while True:
            here, v, a = phase_at(t, s0, v0, a0, j)
            if write:
                cells.s[count] = here
                cells.v[count] = v
                cells.a[count] = a
            count += 1
            k = interval_at(here, k, end)
            size = min(least + 0.3 * min(t, duration - t), COARSEST * least) if steady else least
            while size > least / 16.0:
                reached = phase_at(t + size, s0, v0, a0, j)[0]
                if k + SPANNED >= len(end) or reached <= end[k + SPANNED]:
                    break
                size *= 0.5
            while size > least / FINEST:
                reached = phase_at(t + size, s0, v0, a0, j)[0]
                if even_until(here, reached, k, REACHED * v, known, limits) >= reached:
                    break
                size *= 0.5
            if t + 1.4 * size >= duration:
                break
            t += size
    return count


@njit
def place_rest(cells: Cells) -> None:
    """Set the arc length at an open end to the one at which the motion rests."""
    n = len(cells.length)
    v, a = cells.v[n - 1], cells.a[n - 1]
    if cells.rest_before != CLOSED and v > 0.0 > a:
        cells.s[n] = cells.s[n - 1] + length_to_rest(v, a)


@njit
def describe(cells: Cells, known: Intervals) -> None:
    """Compute length, speed bounds and derivatives of the path of each cell from its cuts."""
    end, top = known.end, known.top
    s, cell_top, q = cells.s, cells.top, cells.q
    place_rest(cells)
    k = interval_at(s[0], np.searchsorted(end, s[0]), end)
    for m in range(len(cells.length)):
        cells.length[m] = s[m + 1] - s[m]
        k = interval_at(s[m], k, end)
        derivatives(k, s[m], known, q[m, 0])
        middle = 0.5 * (s[m] + s[m + 1])
        k = interval_at(middle, k, end)
        derivatives(k, middle, known, q[m, 1])
        if cells.rest_before != CLOSED and m + 1 == len(cells.length):
            cells.length[m] = OPEN
        cell_top[m, 0] = cells.pace[m] * top[k]
        k = interval_at(s[m + 1], k, end)
        cell_top[m, 1] = cells.pace[m] * top[k]
        if k > 0 and s[m + 1] <= end[k - 1]:
            k -= 1
            cell_top[m, 1] = min(cell_top[m, 1], cells.pace[m] * top[k])
        derivatives(k, s[m + 1], known, q[m, 2])


@njit
def matters(known: Intervals, k: int, limits: SumLimits) -> bool:
    """Return whether the path or its bounds jump at the end of interval ``k``."""
    if known.share[k] != known.share[k + 1]:
        return True
    if abs(known.top[k + 1] - known.top[k]) > STEP * min(known.top[k], known.top[k + 1]):
        return True
    v = REACHED * min(known.speed[k], known.speed[k + 1])
    v = min(v, known.top[k], known.top[k + 1])
    before, after = known.samples[k, SAMPLES - 1], known.samples[k + 1, 0]
    for i in range(known.samples.shape[3]):
        if abs(after[1, i] - before[1, i]) * v * v > JUMP * limits.a[i]:
            return True
        if abs(after[2, i] - before[2, i]) * v * v * v > JUMP * limits.j[i]:
            return True
    return False


@njit
def with_knots(cells: Cells, stretch: Stretch, known: Intervals, limits: SumLimits) -> Cells:
    """Return the cells with cuts where q'' or q''' jumps; cuts near to these are left out.

    Only arc length, speed and acceleration at the cuts are set.
    """
    end, s, rows = known.end, cells.s, stretch.rows
    n = len(cells.length)
    first = np.searchsorted(end, s[0] + NEAR_END)
    last = np.searchsorted(end, s[n] - NEAR_END)
    out = empty_cells(n + max(last - first, 0), cells.q.shape[3])
    out.s[0], out.v[0], out.a[0] = s[0], cells.v[0], cells.a[0]
    count = 1
    at_knot = False
    k = first
    r = stretch.first
    for m in range(1, n + 1):
        while k < last and end[k] < s[m] + NEAR_KNOT * (s[m] - s[m - 1]):
            if k + 1 < len(end) and matters(known, k, limits):
                while r + 1 < stretch.last and rows[r + 1]["s"] <= end[k]:
                    r += 1
                row = rows[r]
                t = phase_time(row["v"], row["a"], row["j"], row["duration"], end[k] - row["s"])
                _, v, a = phase_at(t, row["s"], row["v"], row["a"], row["j"])
                close = NEAR_KNOT * (s[m] - s[m - 1])
                if not at_knot and count > 1 and end[k] - out.s[count - 1] < close:
                    count -= 1
                if end[k] > out.s[count - 1] + NEAR_END:
                    out.s[count], out.v[count], out.a[count] = end[k], v, a
                    count += 1
                    at_knot = True
            k += 1
        if m == n:
            break
        close = NEAR_KNOT * min(s[m] - s[m - 1], s[m + 1] - s[m])
        if s[m] > out.s[count - 1] + (close if at_knot else 0.0):
            out.s[count], out.v[count], out.a[count] = s[m], cells.v[m], cells.a[m]
            count += 1
            at_knot = False
    out.s[count], out.v[count], out.a[count] = s[n], cells.v[n], cells.a[n]
    return part_of(out, 0, count)


@njit
def plan_cells(stretch: Stretch, known: Intervals, limits: SumLimits) -> Cells:
    """Return the cells of a stretch of the plan, with the plan's motion and nothing else set."""
    columns = len(limits.a)
    number = place_cuts(stretch, known, limits, empty_cells(0, columns), False)
    cells = empty_cells(number, columns)
    place_cuts(stretch, known, limits, cells, True)
    cells.s[number], cells.v[number], cells.a[number] = stretch.end_s, stretch.end_v, 0.0
    return with_phases(with_knots(cells, stretch, known, limits), stretch, known, limits)


@njit
def far_beyond(
    cells: Cells, m: int, x: Floats, place: int, known: Intervals, limits: SumLimits
) -> bool:
    """Return whether cell ``m`` exceeds a limit by far.

    Args:
        cells: the cells with a motion.
        m: the cell.
        x: (5,): the motion of the cell, of :func:`cell_phases`.
        place: an interval near its start.
        known: the intervals of the path.
        limits: for the sums.
    """
    scratch = np.empty((SCRATCH, len(limits.a)))
    s, v, a = cells.s[m], cells.v[m], cells.a[m]
    half = phase_at(x[H], s, v, a, x[J1])[0]
    worst, _, place = largest_shares(x[H], s, v, a, x[J1], half, place, known, limits, scratch)
    if worst > FAR:
        return True
    worst, _, _ = largest_shares(
        x[H], half, x[V_MIDDLE], x[A_MIDDLE], x[J2], cells.s[m + 1], place, known, limits, scratch
    )
    return bool(worst > FAR)


@njit
def with_phases(cells: Cells, stretch: Stretch, known: Intervals, limits: SumLimits) -> Cells:
    """Return the cells, cut at the ends of the plan's phases where they differ too much from it.

    A cell within one phase has the motion of that phase. Through another, there may be no motion,
    or one that exceeds the limits by far.
    """
    rows = stretch.rows
    n = len(cells.length)
    x = np.empty(5)
    slope = np.empty((5, 4))
    out = empty_cells(n + stretch.last - stretch.first, cells.q.shape[3])
    count = 0
    r = stretch.first
    place = interval_at(cells.s[0], np.searchsorted(known.end, cells.s[0]), known.end)
    for m in range(n):
        out.s[count], out.v[count], out.a[count] = cells.s[m], cells.v[m], cells.a[m]
        count += 1
        while r < stretch.last and rows[r]["s"] <= cells.s[m] + NEAR_END:
            r += 1
        if r == stretch.last or rows[r]["s"] >= cells.s[m + 1] - NEAR_END:
            continue
        v, a = cells.v, cells.a
        if cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, slope):
            place = interval_at(cells.s[m], place, known.end)
            if not far_beyond(cells, m, x, place, known, limits):
                continue
        while r < stretch.last and rows[r]["s"] < cells.s[m + 1] - NEAR_END:
            if rows[r]["s"] > out.s[count - 1] + NEAR_END:
                out.s[count], out.v[count], out.a[count] = rows[r]["s"], rows[r]["v"], rows[r]["a"]
                count += 1
            r += 1
    out.s[count], out.v[count], out.a[count] = cells.s[n], cells.v[n], cells.a[n]
    return part_of(out, 0, count)


@njit
def part_of(cells: Cells, first: int, last: int) -> Cells:
    """Return copies of the cells [first, last), without what follows from the path."""
    out = empty_cells(last - first, cells.q.shape[3], cells.rest_before)
    n = last - first
    copy_part(cells.s, first, n + 1, out.s, 0)
    copy_part(cells.v, first, n + 1, out.v, 0)
    copy_part(cells.a, first, n + 1, out.a, 0)
    for m in range(n):
        out.length[m] = out.s[m + 1] - out.s[m]
    return out
