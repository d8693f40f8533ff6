"""A plan cut into cells for refinement.

A cell is a stretch of path for the descent of :mod:`cnc.kernels.planner.descent`, about as long in
time as the cells near it. Two kinds of phases are not refined: stretches of constant speed at
junctions, and the middle of a cruise at the largest speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import Cells, cell_phases, copy_part, empty_cells
from cnc.kernels.planner.intervals import (
    SAMPLES,
    Intervals,
    SumLimits,
    derivatives,
    interval_at,
)
from cnc.kernels.planner.phases import Phases, phase_at
from cnc.kernels.planner.scurve import phase_time

Flags = NDArray[np.bool_]

RAMP_CELLS = 5
"""Cells in the longest jerk phase of a stretch; the others are about as long in time."""

PLATEAU = 0.3
"""This part of the longest phase of constant acceleration counts as a jerk phase."""

SPANNED = 6
"""Largest number of ends of intervals inside a cell."""

COARSEST = 4.0
"""A cell in the middle of a cruise may be this much longer than the others."""

TINY = 0.15
"""A phase shorter than this part of a cell becomes part of the cell before."""

FASTEST = 0.985
"""A speed above this part of its bound gains almost nothing from refinement."""

STEEPEST = 0.85
"""The same for acceleration and jerk, as parts of their bounds on a straight path."""


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


class Stretch(NamedTuple):
    """Rows of a plan that are refined together.

    Attributes:
        rows: the phases of the plan.
        first: the first of them in the stretch.
        last: the one behind it.
        end_s: arc length at its end, mm.
        end_v: speed there, mm/s; the acceleration is 0.
        rough: whether the plan itself may be illegal.
    """

    rows: Phases
    first: int
    last: int
    end_s: float
    end_v: float
    rough: bool


@njit
def separate(phases: Phases, known: Intervals, rows: Phases, fixed: Flags) -> int:
    """Copy ``phases`` to ``rows``, a long cruise in three parts, and mark those that stay as is.

    Args:
        phases: (p,): the plan.
        known: the intervals of the path.
        rows: (3 p,): receives the copy.
        fixed: (3 p,): receives whether a row stays as is.

    Returns:
        The number of rows.
    """
    end, top, flat = known.end, known.top, known.flat
    count = 0
    k = 0
    for i in range(len(phases)):
        row = phases[i]
        rows[count] = row
        fixed[count] = False
        if row["a"] == 0.0 and row["j"] == 0.0 and row["v"] > 0.0:
            start, v = row["s"], row["v"]
            finish = start + row["duration"] * v
            k = interval_at(0.5 * (start + finish), k, end)
            fixed[count] = flat[k]
            if not flat[k]:
                k = interval_at(start, k, end)
                fastest = v >= FASTEST * top[k]
                while fastest and k + 1 < len(end) and end[k] < finish:
                    k += 1
                    fastest = v >= FASTEST * top[k]
                if fastest:
                    before = ramp_beside(phases, i, -1)
                    after = ramp_beside(phases, i, 1)
                    spare = row["duration"] - before - after
                    if spare > 0.0:
                        if before > 0.0:
                            rows[count]["duration"] = before
                            count += 1
                            rows[count] = row
                            rows[count]["s"] += before * v
                        rows[count]["duration"] = spare
                        fixed[count] = True
                        if after > 0.0:
                            count += 1
                            rows[count] = row
                            rows[count]["duration"] = after
                            rows[count]["s"] = finish - after * v
                            fixed[count] = False
        count += 1
    return count


@njit
def ramp_beside(phases: Phases, i: int, direction: int) -> float:
    """Return the duration, s, of the ramp behind (1) or before (-1) phase ``i``."""
    total = 0.0
    m = i + direction
    while 0 <= m < len(phases) and (phases[m]["a"] != 0.0 or phases[m]["j"] != 0.0):
        total += phases[m]["duration"]
        m += direction
    return total


@njit
def possible_gain(
    rows: Phases, first: int, last: int, known: Intervals, limits: SumLimits
) -> float:
    """Return an estimate of the time that refinement can save on the rows [first, last), s.

    A row can gain if its speed is below the speed bounds, or if its jerk or acceleration is below
    the limits that would hold on a straight path.
    """
    end, top, samples = known.end, known.top, known.samples
    axes = samples.shape[3]
    total = 0.0
    k = interval_at(rows[first]["s"], np.searchsorted(end, rows[first]["s"]), end)
    for r in range(first, last):
        row = rows[r]
        s, v, a, j = row["s"], row["v"], row["a"], row["j"]
        finish = phase_at(row["duration"], s, v, a, j)[0]
        k = interval_at(s, k, end)
        lowest = top[k]
        highest = limits.j[axes] if j != 0.0 else limits.a[axes]
        while True:
            lowest = min(lowest, top[k])
            for i in range(axes):
                limit = limits.j[i] if j != 0.0 else limits.a[i]
                if samples[k, 2, 0, i] != 0.0:
                    highest = min(highest, limit / abs(samples[k, 2, 0, i]))
            if not (k + 1 < len(end) and end[k] < finish):
                break
            k += 1
        if a == 0.0 and v < FASTEST * lowest and (j == 0.0 or (j > 0.0 and v > 0.0 and r > first)):
            total += row["duration"] * (1.0 - v / lowest)
        if j != 0.0 and abs(j) < STEEPEST * highest:
            total += row["duration"] * (1.0 - (abs(j) / highest) ** (1.0 / 3.0))
        if j == 0.0 and a != 0.0 and abs(a) < STEEPEST * highest:
            total += row["duration"] * (1.0 - math.sqrt(abs(a) / highest))
    return total


@njit
def place_cuts(stretch: Stretch, known: Intervals, cells: Cells, write: bool) -> int:
    """Cut the motion of a stretch into cells.

    Args:
        stretch: of the plan.
        known: the intervals of the path.
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
            if t + 1.4 * size >= duration:
                break
            t += size
    return count


@njit
def describe(cells: Cells, known: Intervals) -> None:
    """Compute length, speed bounds and derivatives of the path of each cell from its cuts."""
    end, top = known.end, known.top
    s, cell_top, q = cells.s, cells.top, cells.q
    k = interval_at(s[0], np.searchsorted(end, s[0]), end)
    for m in range(len(cells.length)):
        cells.length[m] = s[m + 1] - s[m]
        k = interval_at(s[m], k, end)
        derivatives(k, s[m], known, q[m, 0])
        middle = 0.5 * (s[m] + s[m + 1])
        k = interval_at(middle, k, end)
        derivatives(k, middle, known, q[m, 1])
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
    number = place_cuts(stretch, known, empty_cells(0, columns), False)
    cells = empty_cells(number, columns)
    place_cuts(stretch, known, cells, True)
    cells.s[number], cells.v[number], cells.a[number] = stretch.end_s, stretch.end_v, 0.0
    return with_phases(with_knots(cells, stretch, known, limits), stretch)


@njit
def with_phases(cells: Cells, stretch: Stretch) -> Cells:
    """Return the cells, cut at the ends of the plan's phases where else no motion leads through.

    A cell within one phase has the motion of that phase.
    """
    rows = stretch.rows
    n = len(cells.length)
    x = np.empty(5)
    slope = np.empty((5, 4))
    out = empty_cells(n + stretch.last - stretch.first, cells.q.shape[3])
    count = 0
    r = stretch.first
    for m in range(n):
        out.s[count], out.v[count], out.a[count] = cells.s[m], cells.v[m], cells.a[m]
        count += 1
        while r < stretch.last and rows[r]["s"] <= cells.s[m] + NEAR_END:
            r += 1
        v, a = cells.v, cells.a
        if cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, slope):
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
    out = empty_cells(last - first, cells.q.shape[3])
    n = last - first
    copy_part(cells.s, first, n + 1, out.s, 0)
    copy_part(cells.v, first, n + 1, out.v, 0)
    copy_part(cells.a, first, n + 1, out.a, 0)
    for m in range(n):
        out.length[m] = out.s[m + 1] - out.s[m]
    return out
