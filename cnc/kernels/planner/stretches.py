"""Stretches of a plan that refinement may make faster.

Two kinds of phases are not refined: stretches of constant speed at junctions, and the middle of a
cruise at the largest speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.intervals import Intervals, SumLimits, interval_at
from cnc.kernels.planner.phases import Phases, phase_at

Flags = NDArray[np.bool_]

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
def left_by_bends(row: np.void, finish: float, known: Intervals, limits: SumLimits) -> float:
    """Return the acceleration that is possible throughout a phase beside that of the bends, mm/s^2.

    Args:
        row: the phase, of constant acceleration.
        finish: arc length at its end, mm.
        known: the intervals of the path.
        limits: for the sums.
    """
    end, samples = known.end, known.samples
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
    rows: Phases, first: int, last: int, known: Intervals, limits: SumLimits
) -> float:
    """Return an estimate of the time that refinement can save on the rows [first, last), s.

    A row can gain if its speed is below the speed bounds, or if its jerk or acceleration is clearly
    below the limits that would hold on a straight path, or its acceleration below what the bends
    leave. So can one that ends its deceleration below the
    speed bounds, where the motion decelerates again behind it.
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
        if a < 0.0 < j:
            # At a stop the sum may be negative by rounding, and the bound of the speed there is 0.
            reached = max(v + row["duration"] * 0.5 * a, 0.0)
            if reached < FASTEST * lowest:
                both = min(row["duration"], slows_again(rows, r, last))
                total += both * (1.0 - reached / lowest)
        if j != 0.0 and abs(j) < STEEPEST * highest:
            total += row["duration"] * (1.0 - (abs(j) / highest) ** (1.0 / 3.0))
        if j == 0.0 and a != 0.0:
            most = float(highest)
            if abs(a) >= STEEPEST * most:
                most = left_by_bends(row, finish, known, limits)
                if abs(a) >= STEEPEST_ON_BENDS * most:
                    continue
            total += row["duration"] * (1.0 - math.sqrt(abs(a) / most))
    return total
