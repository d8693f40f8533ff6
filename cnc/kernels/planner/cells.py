"""A plan cut into cells to be refined: what of it may gain, where the cuts lie, and what holds
between them.

A cell is a stretch of path for the descent of :mod:`cnc.kernels.planner.descent`, about as long in
time as those near it. Stretches of constant speed at junctions and the middle of a cruise that
can't be faster stay apart.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.intervals import derivatives, interval_at

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

RAMP_CELLS = 5
PLATEAU = 0.3
"""Cells in the longest jerk phase of a stretch, or in this part of its longest phase of constant
acceleration; the others are about as long in time.
"""

SPANNED = 6
"""Intervals that a cell may reach over."""

COARSEST = 4.0
"""How much longer than the others a cell in the middle of a cruise may be."""

TINY = 0.15
"""A phase shorter than this part of a cell is made part of its neighbours' cells."""

FASTEST = 0.985
STEEPEST = 0.85
"""Speed, and acceleration or jerk, above these parts of their bounds on a straight path: there is
next to nothing to gain.
"""


@njit
def separate(
    phases: Floats, end: Floats, top: Floats, flat: Flags, rows: Floats, apart: Flags
) -> int:
    """Copy the phases to ``rows``, a long cruise in three; ``apart`` marks those that stay as they
    are. Returns how many there are.

    Those are stretches of constant speed at junctions, and the middle of a cruise that can't be
    faster. rows (3 p, 5), apart (3 p,): room for them.
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
def can_gain(
    rows: Floats,
    first: int,
    last: int,
    end: Floats,
    top: Floats,
    samples: Floats,
    limit_a: Floats,
    limit_j: Floats,
) -> bool:
    """Whether the motion of some row is slower than the speed bounds, or the ramp's limits on a
    straight path, would let it be.
    """
    axes = samples.shape[3]
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
def place_cuts(
    rows: Floats, first: int, last: int, end: Floats, s: Floats, v: Floats, a: Floats, write: bool
) -> int:
    """Cut the motion of the rows [first, last) into cells: arc length, speed and acceleration at
    the cuts.

    They are written only where ``write`` says so. Returns the number of cells.
    """
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
    cells: int,
    s: Floats,
    end: Floats,
    top: Floats,
    sampled: Floats,
    samples: Floats,
    d: Floats,
    cell_top: Floats,
    q: Floats,
) -> None:
    """Length of each cell, speed bounds (middle, end) and derivatives of the path (start, middle,
    end) in it.
    """
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
