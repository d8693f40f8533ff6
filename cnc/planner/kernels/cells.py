"""A plan cut into cells for refinement.

A cell is a stretch of path for the descent of :mod:`cnc.planner.kernels.descent`, about as long in
time as the cells near it, and shorter in tight bends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import Phases, phase_at
from cnc.planner.kernels.intervals import (
    SAMPLES,
    SCRATCH,
    Intervals,
    SumLimits,
    derivatives,
    interval_at,
    largest_shares,
)
from cnc.planner.kernels.scurve import phase_time

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]

# Cells of a plan under refinement, and the motion through one.
#
#       s0      s1      s2
#       +---+---+---+---+---
#        j1  j2  j1  j2
#        h   h   h   h
#
# Cells lie between cuts at fixed arc lengths. Speed and acceleration at the cuts determine the
# motion: two phases of equal duration h and constant jerk lead through a cell. With d = s1 - s0
# they follow in closed form:
#
#     h (v0 + v1) - h^2 (a1 - a0) / 3 = d,
#     j1 = (v1 - v0) / h^2 - 2 a0 / h - (a1 - a0) / (2 h),   j2 = (a1 - a0) / h - j1.
#
# So any values at the cuts are a continuous motion with exact constant-jerk phases.

H, J1, J2, V_MIDDLE, A_MIDDLE = range(5)
"""Entries of the solution of a cell: half its duration, the jerks of its two phases, speed and
acceleration between them.
"""


OPEN = 0.0
"""Stands for the length of a cell that leads to rest by one phase, wherever that ends."""

CLOSED = -math.inf
"""Stands for a fixed place of the last cut."""


class Cells(NamedTuple):
    """A row of cells, and the motion through them.

    Attributes:
        s: (n + 1,): arc length at the cuts, mm.
        v: (n + 1,): speed there, mm/s.
        a: (n + 1,): acceleration there, mm/s^2.
        length: (n,): mm.
        top: (n, 2): speed bounds in the middle and at the end of each cell, mm/s.
        share: (n,): share of the limits of acceleration and jerk that a cell may use.
        pace: (n,): share of its speed bounds that it may use; ``top`` includes it.
        q: (n, 3, 3, axes + 1): q', q'', q''' at the start, in the middle and at the end; the last
            column is for the path itself.
        rest_before: CLOSED where the last cut has a fixed place. Else the last cell is one phase of
            constant jerk to rest: its length is OPEN, ``s[n]`` follows from the motion, and this
            is the place before which it rests, mm.
    """

    s: Floats
    v: Floats
    a: Floats
    length: Floats
    top: Floats
    share: Floats
    pace: Floats
    q: Floats
    rest_before: float


@njit
def phase_to_rest(v: float, a: float, x: Floats, slope: Floats) -> bool:
    """Compute one phase of constant jerk to rest, as :func:`cell_phases` does two phases.

    Args:
        v: speed at its start, mm/s.
        a: acceleration there.
        x: (5,): receives the entries H, J1, J2, V_MIDDLE, A_MIDDLE.
        slope: (5, 4): receives the derivatives of x by v and a. Those by the state at rest are 0.

    Returns:
        Whether there is such a phase: the motion has to slow.
    """
    if not v > 0.0 > a:
        return False
    for i in range(5):
        for k in range(4):
            slope[i, k] = 0.0
    x[H], slope[H, 0], slope[H, 1] = -v / a, -1.0 / a, v / (a * a)
    x[J1], slope[J1, 0], slope[J1, 1] = 0.5 * a * a / v, -0.5 * a * a / (v * v), a / v
    x[J2], slope[J2, 0], slope[J2, 1] = x[J1], slope[J1, 0], slope[J1, 1]
    x[V_MIDDLE], slope[V_MIDDLE, 0] = 0.25 * v, 0.25
    x[A_MIDDLE], slope[A_MIDDLE, 1] = 0.5 * a, 0.5
    return True


@njit
def length_to_rest(v: float, a: float) -> float:
    """Return the length of the phase of :func:`phase_to_rest`, mm."""
    return -2.0 / 3.0 * v * v / a


@njit
def cell_phases(
    v0: float, a0: float, v1: float, a1: float, d: float, x: Floats, slope: Floats
) -> bool:
    """Compute the two phases through a cell of length ``d``.

    Args:
        v0: speed at its start, mm/s.
        a0: acceleration there.
        v1: speed at its end.
        a1: acceleration there.
        d: mm; OPEN for a phase to rest.
        x: (5,): receives the entries H, J1, J2, V_MIDDLE, A_MIDDLE.
        slope: (5, 4): receives the derivatives of x by v0, a0, v1, a1.

    Returns:
        Whether the motion exists and goes forward throughout.
    """
    if d == OPEN:
        return phase_to_rest(v0, a0, x, slope)
    da = a1 - a0
    total = v0 + v1
    square = total * total - 4.0 / 3.0 * d * da
    if not (square > 0.0 and total > 0.0):
        return False
    root = math.sqrt(square)
    h = 2.0 * d / (total + root)
    r = 1.0 / h
    slope[H, 0] = slope[H, 2] = -h / root
    slope[H, 3] = h * h / (3.0 * root)
    slope[H, 1] = -slope[H, 3]
    dv = v1 - v0
    j1 = (dv * r - 2.0 * a0 - 0.5 * da) * r
    j2 = da * r - j1
    by_h = (-2.0 * dv * r + 2.0 * a0 + 0.5 * da) * r * r
    for i in range(4):
        slope[J1, i] = by_h * slope[H, i]
    slope[J1, 0] -= r * r
    slope[J1, 1] -= 1.5 * r
    slope[J1, 2] += r * r
    slope[J1, 3] -= 0.5 * r
    for i in range(4):
        slope[J2, i] = -da * r * r * slope[H, i] - slope[J1, i]
    slope[J2, 1] -= r
    slope[J2, 3] += r
    middle = a0 + h * j1
    for i in range(4):
        slope[V_MIDDLE, i] = middle * slope[H, i] + 0.5 * h * h * slope[J1, i]
        slope[A_MIDDLE, i] = j1 * slope[H, i] + h * slope[J1, i]
    slope[V_MIDDLE, 0] += 1.0
    slope[V_MIDDLE, 1] += h
    slope[A_MIDDLE, 1] += 1.0
    v_middle = v0 + h * (a0 + 0.5 * h * j1)
    x[H] = h
    x[J1] = j1
    x[J2] = j2
    x[V_MIDDLE] = v_middle
    x[A_MIDDLE] = middle
    # The speed is lowest where the acceleration rises through 0.
    lowest = v_middle
    if a0 < 0.0 < middle:
        lowest = v0 - a0 * a0 / (2.0 * j1)
    elif middle < 0.0 < a1:
        lowest = v_middle - middle * middle / (2.0 * j2)
    return lowest > 0.0


@njit
def empty_cells(n: int, columns: int, rest_before: float = CLOSED) -> Cells:
    """Return arrays for ``n`` cells; each may use all of the limits.

    ``columns``: number of axes, and 1 for the path. ``rest_before``: as of :class:`Cells`.
    """
    return Cells(
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty(n),
        np.empty((n, 2)),
        np.ones(n),
        np.ones(n),
        np.empty((n, 3, 3, columns)),
        rest_before,
    )


@njit
def copy_part(source: Floats, first: int, count: int, target: Floats, at: int) -> None:
    """Copy ``count`` numbers from ``first`` on to ``target``, from ``at`` on.

    An assignment of arrays would compile several times as much.
    """
    for k in range(count):
        target[at + k] = source[first + k]


@njit
def with_motion(cells: Cells, v: Floats, a: Floats) -> Cells:
    """Return the same cells with another motion."""
    share, pace = cells.share, cells.pace
    return Cells(cells.s, v, a, cells.length, cells.top, share, pace, cells.q, cells.rest_before)


@njit
def duration_of(cells: Cells) -> float:
    """Return the duration of the motion through all cells, s; infinite if there is none."""
    x = np.empty(5)
    slope = np.empty((5, 4))
    v, a = cells.v, cells.a
    total = 0.0
    for m in range(len(cells.length)):
        if not cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, slope):
            return math.inf
        total += 2.0 * x[H]
    return total


# Stretches of a plan that refinement may make faster.
#
# Two kinds of phases are not refined: stretches of constant speed at junctions, and the middle of a
# cruise at the largest speed.

FASTEST = 0.985
"""A speed above this part of its bound gains almost nothing from refinement."""

STEEPEST = 0.85
"""The same for acceleration and jerk, as parts of their bounds on a straight path."""

STEEPEST_ON_BENDS = 0.97
"""The same for acceleration, as a part of the bound that the bends leave: it is never too high."""


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
def separate(phases: Phases, intervals: Intervals, rows: Phases, fixed: Flags) -> int:
    """Copy ``phases`` to ``rows``, a long cruise in three parts, and mark those that stay as is.

    Args:
        phases: (p,): the plan.
        intervals: the intervals of the path.
        rows: (3 p,): receives the copy.
        fixed: (3 p,): receives whether a row stays as is.

    Returns:
        The number of rows.
    """
    end, top, flat = intervals.end, intervals.top, intervals.flat
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
def slows_again(rows: Phases, r: int, last: int) -> float:
    """Return the duration, s, of the ramp that begins to slow behind row ``r``; 0 without one.

    Row ``r`` ends a deceleration.
    """
    behind = r + 1
    while behind < last and rows[behind]["j"] == 0.0 and rows[behind]["a"] == 0.0:
        behind += 1
    if behind < last and rows[behind]["a"] == 0.0 and rows[behind]["j"] < 0.0:
        return float(rows[behind]["duration"])
    return 0.0


@njit
def left_by_bends(row: np.void, finish: float, intervals: Intervals, limits: SumLimits) -> float:
    """Return the acceleration that is possible throughout a phase beside that of the bends, mm/s^2.

    Args:
        row: the phase, of constant acceleration.
        finish: arc length at its end, mm.
        intervals: the intervals of the path.
        limits: for the sums.
    """
    end, samples = intervals.end, intervals.samples
    axes = samples.shape[3]
    s, v, a = row["s"], row["v"], row["a"]
    lowest = limits.a[axes]
    begin = s
    k = interval_at(s, np.searchsorted(end, s), end)
    while True:
        # The square of the speed where it is highest.
        square = v * v + 2.0 * a * ((min(end[k], finish) if a > 0.0 else begin) - s)
        for i in range(axes):
            slope, bend = abs(samples[k, 2, 0, i]), abs(samples[k, 2, 1, i])
            if slope != 0.0:
                lowest = min(lowest, (limits.a[i] - bend * square) / slope)
        if not (k + 1 < len(end) and end[k] < finish):
            return float(lowest)
        begin = end[k]
        k += 1


@njit
def possible_gain(
    rows: Phases, first: int, last: int, intervals: Intervals, limits: SumLimits
) -> float:
    """Return an estimate of the time that refinement can save on the rows [first, last), s.

    A row can gain if its speed is below the speed bounds, or if its jerk or acceleration is clearly
    below the limits that would hold on a straight path, or its acceleration below what the bends
    leave. So can one that ends its deceleration below the speed bounds, those behind it too, where
    the motion decelerates again behind it.
    """
    end, top, samples = intervals.end, intervals.top, intervals.samples
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
        if a < 0.0 < j:
            # At a stop the sum may be negative by rounding, and the bound of the speed there is 0.
            reached = max(v + row["duration"] * 0.5 * a, 0.0)
            if k + 1 < len(end) and end[k] - finish < NEAR_END:
                lowest = min(lowest, top[k + 1])
            if reached < FASTEST * lowest:
                both = min(row["duration"], slows_again(rows, r, last))
                total += both * (1.0 - reached / lowest)
        if j != 0.0 and abs(j) < STEEPEST * highest:
            total += row["duration"] * (1.0 - (abs(j) / highest) ** (1.0 / 3.0))
        if j == 0.0 and a != 0.0:
            most = float(highest)
            if abs(a) >= STEEPEST * most:
                most = left_by_bends(row, finish, intervals, limits)
                if abs(a) >= STEEPEST_ON_BENDS * most:
                    continue
            total += row["duration"] * (1.0 - math.sqrt(abs(a) / most))
    return total


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
    s: float, reached: float, k: int, v: float, intervals: Intervals, limits: SumLimits
) -> float:
    """Return how far the path is even enough for one cell.

    Args:
        s: arc length at the start of the cell, mm.
        reached: where the cell would end.
        k: the interval at its start.
        v: the speed in it, mm/s.
        intervals: the intervals of the path.
        limits: for the sums.

    Returns:
        ``reached``, or the end of the first interval by which q'' v^2 or q''' v^3 differ from those
        at the start of the cell by the share UNEVEN of a limit.
    """
    end, samples = intervals.end, intervals.samples
    extent = intervals.sampled[k, 1] - intervals.sampled[k, 0]
    m = 0
    if extent > 0.0:
        m = min(int((SAMPLES - 1) * (s - intervals.sampled[k, 0]) / extent + 0.5), SAMPLES - 1)
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
    stretch: Stretch, intervals: Intervals, limits: SumLimits, cells: Cells, write: bool
) -> int:
    """Cut the motion of a stretch into cells.

    Args:
        stretch: of the plan.
        intervals: the intervals of the path.
        limits: for the sums.
        cells: receives arc length, speed and acceleration at the cuts.
        write: whether to write them, or only to count.

    Returns:
        The number of cells.
    """
    end = intervals.end
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
            even = even_until(s0, reached, k, REACHED * v0, intervals, limits)
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
                if even_until(here, reached, k, REACHED * v, intervals, limits) >= reached:
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
def describe(cells: Cells, intervals: Intervals) -> None:
    """Compute length, speed bounds and derivatives of the path of each cell from its cuts."""
    end, top = intervals.end, intervals.top
    s, cell_top, q = cells.s, cells.top, cells.q
    place_rest(cells)
    k = interval_at(s[0], np.searchsorted(end, s[0]), end)
    for m in range(len(cells.length)):
        cells.length[m] = s[m + 1] - s[m]
        k = interval_at(s[m], k, end)
        derivatives(k, s[m], intervals, q[m, 0])
        middle = 0.5 * (s[m] + s[m + 1])
        k = interval_at(middle, k, end)
        derivatives(k, middle, intervals, q[m, 1])
        if cells.rest_before != CLOSED and m + 1 == len(cells.length):
            cells.length[m] = OPEN
        cell_top[m, 0] = cells.pace[m] * top[k]
        k = interval_at(s[m + 1], k, end)
        cell_top[m, 1] = cells.pace[m] * top[k]
        if k > 0 and s[m + 1] <= end[k - 1]:
            k -= 1
            cell_top[m, 1] = min(cell_top[m, 1], cells.pace[m] * top[k])
        derivatives(k, s[m + 1], intervals, q[m, 2])


@njit
def matters(intervals: Intervals, k: int, limits: SumLimits) -> bool:
    """Return whether the path or its bounds jump at the end of interval ``k``."""
    if intervals.share[k] != intervals.share[k + 1]:
        return True
    if abs(intervals.top[k + 1] - intervals.top[k]) > STEP * min(
        intervals.top[k], intervals.top[k + 1]
    ):
        return True
    v = REACHED * min(intervals.speed[k], intervals.speed[k + 1])
    v = min(v, intervals.top[k], intervals.top[k + 1])
    before, after = intervals.samples[k, SAMPLES - 1], intervals.samples[k + 1, 0]
    for i in range(intervals.samples.shape[3]):
        if abs(after[1, i] - before[1, i]) * v * v > JUMP * limits.a[i]:
            return True
        if abs(after[2, i] - before[2, i]) * v * v * v > JUMP * limits.j[i]:
            return True
    return False


@njit
def with_knots(cells: Cells, stretch: Stretch, intervals: Intervals, limits: SumLimits) -> Cells:
    """Return the cells with cuts where q'' or q''' jumps; cuts near to these are left out.

    Only arc length, speed and acceleration at the cuts are set.
    """
    end, s, rows = intervals.end, cells.s, stretch.rows
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
            if k + 1 < len(end) and matters(intervals, k, limits):
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
def plan_cells(stretch: Stretch, intervals: Intervals, limits: SumLimits) -> Cells:
    """Return the cells of a stretch of the plan, with the plan's motion and nothing else set."""
    columns = len(limits.a)
    number = place_cuts(stretch, intervals, limits, empty_cells(0, columns), False)
    cells = empty_cells(number, columns)
    place_cuts(stretch, intervals, limits, cells, True)
    cells.s[number], cells.v[number], cells.a[number] = stretch.end_s, stretch.end_v, 0.0
    return with_phases(with_knots(cells, stretch, intervals, limits), stretch, intervals, limits)


@njit
def far_beyond(
    cells: Cells, m: int, x: Floats, place: int, intervals: Intervals, limits: SumLimits
) -> bool:
    """Return whether cell ``m`` exceeds a limit by far.

    Args:
        cells: the cells with a motion.
        m: the cell.
        x: (5,): the motion of the cell, of :func:`cell_phases`.
        place: an interval near its start.
        intervals: the intervals of the path.
        limits: for the sums.
    """
    scratch = np.empty((SCRATCH, len(limits.a)))
    s, v, a = cells.s[m], cells.v[m], cells.a[m]
    half = phase_at(x[H], s, v, a, x[J1])[0]
    worst, _, place = largest_shares(x[H], s, v, a, x[J1], half, place, intervals, limits, scratch)
    if worst > FAR:
        return True
    worst, _, _ = largest_shares(
        x[H],
        half,
        x[V_MIDDLE],
        x[A_MIDDLE],
        x[J2],
        cells.s[m + 1],
        place,
        intervals,
        limits,
        scratch,
    )
    return bool(worst > FAR)


@njit
def with_phases(cells: Cells, stretch: Stretch, intervals: Intervals, limits: SumLimits) -> Cells:
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
    place = interval_at(cells.s[0], np.searchsorted(intervals.end, cells.s[0]), intervals.end)
    for m in range(n):
        out.s[count], out.v[count], out.a[count] = cells.s[m], cells.v[m], cells.a[m]
        count += 1
        while r < stretch.last and rows[r]["s"] <= cells.s[m] + NEAR_END:
            r += 1
        if r == stretch.last or rows[r]["s"] >= cells.s[m + 1] - NEAR_END:
            continue
        v, a = cells.v, cells.a
        if cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, slope):
            place = interval_at(cells.s[m], place, intervals.end)
            if not far_beyond(cells, m, x, place, intervals, limits):
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
