"""A plan cut into cells for refinement.

A cell is a stretch of path for the descent of :mod:`cnc.kernels.planner.descent`, about as long in
time as the cells near it. Two kinds of phases are not refined: stretches of constant speed at
junctions, and the middle of a cruise at the largest speed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import Cells
from cnc.kernels.planner.intervals import Intervals, SumLimits, derivatives, interval_at
from cnc.kernels.planner.phases import Phases, phase_at

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
def can_gain(rows: Phases, first: int, last: int, known: Intervals, limits: SumLimits) -> bool:
    """Return whether refinement can make some row of [first, last) faster.

    That is so if the speed is below its bounds, or if a ramp is below the limits that would hold on
    a straight path.
    """
    end, top, samples = known.end, known.top, known.samples
    axes = samples.shape[3]
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
            return True
        if j != 0.0 and abs(j) < STEEPEST * highest:
            return True
        if j == 0.0 and a != 0.0 and abs(a) < STEEPEST * highest:
            return True
    return False


@njit
def place_cuts(
    rows: Phases, first: int, last: int, known: Intervals, cells: Cells, write: bool
) -> int:
    """Cut the motion of the rows [first, last) into cells.

    Args:
        rows: the phases.
        first: the first of them in the range.
        last: the one behind the range.
        known: the intervals of the path.
        cells: receives arc length, speed and acceleration at the cuts.
        write: whether to write them, or only to count.

    Returns:
        The number of cells.
    """
    end = known.end
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
    if write:
        row = rows[last - 1]
        s, v, _ = phase_at(row["duration"], row["s"], row["v"], row["a"], row["j"])
        cells.s[count] = s
        cells.v[count] = v
        cells.a[count] = 0.0
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
        cell_top[m, 0] = top[k]
        k = interval_at(s[m + 1], k, end)
        cell_top[m, 1] = top[k]
        if k > 0 and s[m + 1] <= end[k - 1]:
            k -= 1
            cell_top[m, 1] = min(cell_top[m, 1], top[k])
        derivatives(k, s[m + 1], known, q[m, 2])
