"""Search for the fastest legal motion through a row of cells, which does not give up.

The descent of :mod:`cnc.planner.kernels.descent` needs a motion strictly inside the limits, and it
holds the limits at four points of a cell. So the search

1. slows the clock first: if the motion is made in 1 / l of its speed, velocity, acceleration and
   jerk of every axis fall to l, l^2 and l^3 of theirs;
2. raises the weight of the time in steps, which are shorter where one fails, and keeps the motion
   of the last step;
3. examines the motion between the points when the weight is large enough. Cells that exceed a
   limit there are cut or allowed less (:mod:`cnc.planner.kernels.examination`), and the descent
   goes on from the last motion that was kept. Where that is not inside the limits at the new cuts
   it goes on from the one of a lower weight, or anew from the first one;
4. slows the clock until the motion is legal, if it runs out of tries.

A motion that starts or ends at speed keeps that speed: towards such an end the clock is slowed less
and less. Cells that are not inside their limits at first are left to the descent, which raises the
limits of these cells for a while.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import phase_at
from cnc.planner.kernels.cells import (
    A_MIDDLE,
    J1,
    J2,
    V_MIDDLE,
    Cells,
    H,
    cell_phases,
    copy_part,
    describe,
    duration_of,
    with_motion,
)
from cnc.planner.kernels.descent import HIGH, NEAR, centre, merit, system_for
from cnc.planner.kernels.examination import Shares, examine, passable, tighten, with_cuts
from cnc.planner.kernels.intervals import TOUCH, Intervals, SumLimits
from cnc.planner.kernels.scurve import phase_time

Floats = NDArray[np.float64]

FIRST_WEIGHT, WEIGHT_STEP, LAST_WEIGHT = 12.0, 15.0, 2700.0
"""The weight of the time, per cell and relative to the time: in the first step of the descent
between rests, its factor from one step to the next, and in the last step.
"""

SMALL_STEP = 6.0
"""The factor in a second search, where the first finds no legal motion."""

LEAST_STEP = 2.0
"""Least factor by which the weight is raised."""

INWARD_WEIGHT = 2.0
"""The weight for a motion that is not inside the limits, or not far enough to raise the weight."""

CHECKED_WEIGHT = 100.0
"""From this weight on the motion is good enough to be examined between the points of the cells.
Until DOUBTFUL tries have failed only that of the last step is examined.
"""

DOUBTFUL = 4
"""Failed tries from which on each step is examined: an examination costs as much as a descent."""

EXAMINATION = 5e-6
"""s; computing time of an examination by the number of cells."""

TRIES = 12
"""Largest number of steps of the descent that may fail."""

OUTSIDE = 5
"""Steps after which a motion that was never inside the limits is given up."""

START = 0.93
"""Part of its speed to which a motion between rests is slowed at first."""

SLOWER = 0.9
"""Part of its speed to which it is slowed when the descent does not get inside the limits."""

INSIDE = 0.97
"""Largest share of a limit that the first motion may use."""

SLOWINGS = 12
"""Largest number of times that the clock is slowed to reach a share of the limits."""

END_CELLS = 8
"""Cells beside an end at speed in which the clock is slowed less."""


@njit
def copy_motion(v: Floats, a: Floats, to_v: Floats, to_a: Floats) -> None:
    """Copy the speeds and accelerations of a motion."""
    copy_part(v, 0, len(v), to_v, 0)
    copy_part(a, 0, len(a), to_a, 0)


@njit
def slow_clock(cells: Cells, part: float) -> None:
    """Make the motion at ``part`` of its speed; towards an end at speed the part rises to 1."""
    v, a = cells.v, cells.a
    n = len(v)
    near = max(min(END_CELLS, n // 3), 1)
    starts_moving, ends_moving = v[0] > 0.0, v[n - 1] > 0.0
    for k in range(n):
        scale = part
        if starts_moving and k < near:
            scale = max(scale, 1.0 - (1.0 - part) * k / near)
        if ends_moving and n - 1 - k < near:
            scale = max(scale, 1.0 - (1.0 - part) * (n - 1 - k) / near)
        v[k] *= scale
        a[k] *= scale * scale


@njit
def largest_share(cells: Cells, limits: SumLimits) -> float:
    """Return the largest share of a limit that the motion uses at the points of the cells."""
    n = len(cells.length)
    return merit(0, n, cells, limits, 0.0, False, system_for(n, HIGH))[1]


@njit
def slow_until(cells: Cells, limits: SumLimits, share: float) -> float:
    """Slow the clock until no point uses more than ``share`` of a limit; return the largest."""
    for _ in range(SLOWINGS):
        used = largest_share(cells, limits)
        if used <= share:
            return used
        part = 0.7
        if used < math.inf:
            part = max(min((share / used) ** (1.0 / 3.0) * 0.999, 0.995), 0.5)
        slow_clock(cells, part)
    return largest_share(cells, limits)


@njit
def slowed_to_legal(cells: Cells, intervals: Intervals, limits: SumLimits) -> bool:
    """Slow the clock until the motion is legal between the points too; return whether it is."""
    n = len(cells.length)
    shares = Shares(np.empty(n), np.empty(n))
    for _ in range(2 * SLOWINGS):
        used = examine(cells, intervals, limits, shares)
        if used <= 1.0 + TOUCH:
            return True
        slow_clock(cells, min(used ** (-1.0 / 3.0), 0.9999) if used < math.inf else 0.8)
    return False


@njit
def moved_to(cells: Cells, motion: Cells) -> bool:
    """Give the cells the motion of others over the same path.

    Args:
        cells: their speeds and accelerations change, except at both ends.
        motion: cells with a motion, which may be cut elsewhere.

    Returns:
        Whether that motion leads through each of the others. It is changed a little by cuts that
        are not between two of its phases.
    """
    x = np.empty(5)
    dx = np.empty((5, 4))
    s, v, a = motion.s, motion.v, motion.a
    m = 0
    for k in range(1, len(cells.length)):
        place = cells.s[k]
        while m + 1 < len(motion.length) and s[m + 1] <= place:
            m += 1
        if not cell_phases(v[m], a[m], v[m + 1], a[m + 1], motion.length[m], x, dx):
            return False
        start, speed, accel, jerk = s[m], v[m], a[m], x[J1]
        half = phase_at(x[H], start, speed, accel, jerk)[0]
        if place > half:
            start, speed, accel, jerk = half, x[V_MIDDLE], x[A_MIDDLE], x[J2]
        t = phase_time(speed, accel, jerk, x[H], place - start)
        _, cells.v[k], cells.a[k] = phase_at(t, start, speed, accel, jerk)
    return True


@njit
def inside_instead(first: Cells, last: Cells, limits: SumLimits) -> bool:
    """Return whether one motion is inside the limits in the cells in which another is not.

    Args:
        first: the cells with the one motion.
        last: the cells with the other.
        limits: for the sums.

    Returns:
        False also if the other is inside the limits everywhere.
    """
    n = len(last.length)
    at_first, at_last = system_for(n, HIGH), system_for(n, HIGH)
    if merit(0, n, first, limits, 0.0, False, at_first)[1] == math.inf:
        return False
    used = merit(0, n, last, limits, 0.0, False, at_last)[1]
    if used < NEAR or used == math.inf:
        return False
    inside = True
    for m in range(n):
        inside = inside and (at_last.used[m] < NEAR or at_first.used[m] < NEAR)
    return inside


@njit
def begun_with(motion: Cells, cells: Cells, limits: SumLimits) -> tuple[bool, Cells]:
    """Return whether the descent shall begin with another motion, and the cells with that motion.

    See :func:`inside_instead`. ``motion``: cells with it, which may be cut elsewhere.
    """
    begun = with_motion(cells, cells.v.copy(), cells.a.copy())
    inside = moved_to(begun, motion) and inside_instead(begun, cells, limits)
    return inside, begun


@njit
def after_violation(
    cells: Cells, tried: Cells, shares: Shares, intervals: Intervals, limits: SumLimits
) -> Cells:
    """Cut the cells that exceed a limit between their points, or allow them less.

    Args:
        cells: the cells with the motion that was kept last; it changes.
        tried: the same cells with the motion that exceeds limits.
        shares: of that motion.
        intervals: the intervals of the path.
        limits: for the sums.

    Returns:
        The cells, with the motion that was kept.
    """
    at = np.empty((len(cells.length), 2, 3))
    cuts = tighten(cells, intervals, limits, shares, tried, at)
    if cuts > 0:
        cells = passable(with_cuts(cells, at, cuts, intervals), intervals)
    else:
        describe(cells, intervals)
    return cells


@njit
def fastest(
    cells: Cells, intervals: Intervals, limits: SumLimits, left: Floats
) -> tuple[bool, Cells]:
    """Bring the motion through the cells near to the least time.

    Args:
        cells: the cells with any motion; it changes.
        intervals: the intervals of the path.
        limits: for the sums.
        left: (1,): computing time that is left, s; it is lowered. Without it nothing is sought.

    Returns:
        Whether a legal motion was found; the cells, cut where necessary, with that motion.
    """
    again = Cells(
        cells.s,
        cells.v.copy(),
        cells.a.copy(),
        cells.length,
        cells.top,
        cells.share.copy(),
        cells.pace.copy(),
        cells.q,
        cells.rest_before,
    )
    solved, solution = search(cells, intervals, limits, WEIGHT_STEP, left)
    if not solved:
        describe(again, intervals)
        solved, solution = search(again, intervals, limits, SMALL_STEP, left)
    return solved, solution


@njit
def search(
    cells: Cells, intervals: Intervals, limits: SumLimits, weight_step: float, left: Floats
) -> tuple[bool, Cells]:
    """Search as :func:`fastest` does, with one factor from a weight of the time to the next."""
    cells = passable(cells, intervals)
    moving = cells.v[0] > 0.0 or cells.v[-1] > 0.0
    if not moving:
        slow_clock(cells, START)
        slow_until(cells, limits, INSIDE)
    good = with_motion(cells, cells.v.copy(), cells.a.copy())
    first = with_motion(cells, cells.v.copy(), cells.a.copy())
    middle = with_motion(cells, cells.v.copy(), cells.a.copy())
    good_weight = reached = middle_weight = 0.0
    lowest = INWARD_WEIGHT if moving else FIRST_WEIGHT
    weight = lowest
    tries = failed = 0
    kept = with_motion(cells, cells.v.copy(), cells.a.copy())
    shares = Shares(np.empty(len(cells.length)), np.empty(len(cells.length)))
    most = OUTSIDE
    while reached < LAST_WEIGHT and tries <= most and left[0] > 0.0:
        copy_motion(kept.v, kept.a, cells.v, cells.a)
        legal = centre(0, len(cells.length), cells, limits, weight, False, left) <= 1.0
        used = 0.0
        examined = weight == LAST_WEIGHT or (tries >= DOUBTFUL and weight >= CHECKED_WEIGHT)
        if examined:
            used = examine(cells, intervals, limits, shares)
            left[0] -= EXAMINATION * len(cells.length)
        if legal:
            most = TRIES
        if legal and used <= 1.0 + TOUCH:
            if examined:
                good = with_motion(cells, cells.v.copy(), cells.a.copy())
                good_weight = weight
            copy_motion(cells.v, cells.a, kept.v, kept.a)
            if weight < CHECKED_WEIGHT:
                middle, middle_weight = with_motion(cells, cells.v.copy(), cells.a.copy()), weight
            reached = weight
            weight = min(weight * weight_step, LAST_WEIGHT)
            continue
        tries += 1
        if used <= 1.0 + TOUCH:
            if weight > LEAST_STEP * LEAST_STEP * reached > 0.0:
                weight = math.sqrt(weight * reached)
            else:
                # The descent goes on towards the inside from where it ended, or a little slower.
                weight, reached = INWARD_WEIGHT, 0.0
                failed += 1
                if failed % 3 == 0:
                    slow_clock(cells, SLOWER)
                copy_motion(cells.v, cells.a, kept.v, kept.a)
            continue
        cells = after_violation(kept, cells, shares, intervals, limits)
        weight = max(weight / weight_step, lowest)
        inside, begun = begun_with(middle, cells, limits)
        if inside and middle_weight > 0.0:
            cells, weight = begun, middle_weight * weight_step
        else:
            inside, begun = begun_with(first, cells, limits)
            if inside:
                cells, weight = begun, lowest
        n = len(cells.length)
        if n + 1 != len(kept.v):
            shares = Shares(np.empty(n), np.empty(n))
        kept = with_motion(cells, cells.v.copy(), cells.a.copy())
        reached = 0.0
    slower = good_weight < LAST_WEIGHT and not moving and slowed_to_legal(kept, intervals, limits)
    if slower and (good_weight == 0.0 or duration_of(kept) < duration_of(good)):
        return True, kept
    return good_weight > 0.0, good
