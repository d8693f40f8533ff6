r"""The fastest motion near a plan, legal in every axis.

The plan of :mod:`cnc.kernels.planner.lookahead` keeps to bounds that combine the largest speed with
the largest acceleration of a stretch and the worst directions of both. On a curve that costs up to
half of the time, because velocity, acceleration and jerk of an axis,

    q' v,    q'' v^2 + q' a,    q''' v^3 + 3 q'' v a + q' j,

partly cancel: out of a tight bend -kappa^2 v^3 leaves more jerk for j. The refinement holds the
exact sums within their limits, by an interior-point descent over constant-jerk phases.

    plan ──► cells ──► rounds of descent ──► phases
    (cells.py)     ^  heavier time, tighter cells   |   (descent.py)
                   '── between the points of each ◄─'   (intervals.py)

The weight of the time rises from round to round until the barrier costs little. The descent holds
the limits at four points of a cell. When it is near its end, the motion is checked between those
points, and a cell that exceeds a limit there is allowed less in the next rounds.

The classic alternative is a sequential linear program over v^2 on a grid. There each step has to be
turned into phases, which breaks limits between the points of the grid; here every step is a motion.
Compared with a fine nonlinear optimum under the same limits the result takes 0.3 to 0.5 % longer.
It costs 8 us a cell on a curve that binds; a plan in which no curve costs time is left as it is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import A_MIDDLE, J1, J2, V_MIDDLE, Cells, H, cell_phases
from cnc.kernels.planner.cells import can_gain, describe, place_cuts, separate
from cnc.kernels.planner.descent import HIGH, TOUCH, NewtonSystem, centre, merit
from cnc.kernels.planner.intervals import Intervals, SumLimits, interval_at, largest_shares
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import UNSEEN
from cnc.kernels.planner.phases import PHASE, Phases, write_phase

Floats = NDArray[np.float64]

WINDOW = 400
"""Cells that are refined together; of a longer stretch the first half is kept each time, and the
rest refined with the cells behind it.
"""

FIRST_WEIGHT = 2.0
LAST_WEIGHT = 2592.0
WEIGHT_STEP = 6.0
"""The weight of the time, per cell and relative to the time: in the first round, in the last, and
its factor from one round to the next.
"""

CHECKED_FROM = 50.0
"""From this weight on the motion is good enough to be checked between the points of the cells."""

MARGIN = 5e-5
JERK_MARGIN = 2.0 * UNSEEN
"""Shares of the limits of acceleration and jerk that stay free: for the interpolation of the path's
derivatives, and for jumps of curvature that show in differences.
"""

ROUNDS = 20
"""Largest number of rounds: five, and more for cells whose limits had to be tightened."""

SETBACKS = 4
"""Number of rounds with an illegal motion after which the last legal one is kept."""

TIGHT = 0.8
"""A cell that uses less than this share of every limit is not tightened."""

WORTHWHILE = 0.002
"""A refinement has to save this part of a stretch's time."""


@njit
def tighten(first: int, last: int, cells: Cells, known: Intervals, limits: SumLimits) -> float:
    """Examine the motion between the points at which the descent holds the constraints.

    A cell that uses more of a limit there is allowed less from now on.

    Returns:
        The largest share of a limit that is used.
    """
    s, v, a, share = cells.s, cells.v, cells.a, cells.share
    x = np.empty(5)
    dx = np.empty((5, 4))
    scratch = np.empty((3, cells.q.shape[3]))
    no_system = NewtonSystem(
        np.empty((0, 2, 2)), np.empty((0, 2, 2)), np.empty((0, 2)), np.empty((0, 2))
    )
    k = interval_at(s[first], np.searchsorted(known.end, s[first]), known.end)
    largest = 0.0
    for m in range(first, last):
        if not cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, dx):
            return math.inf
        h = x[H]
        half = s[m] + h * (v[m] + h * (0.5 * a[m] + h * x[J1] / 6.0))
        seen = 0.0
        fastest = 0.0
        for p in range(2):
            from_s = s[m] if p == 0 else half
            from_v = v[m] if p == 0 else x[V_MIDDLE]
            from_a = a[m] if p == 0 else x[A_MIDDLE]
            jerk = x[J1] if p == 0 else x[J2]
            until = half if p == 0 else s[m + 1]
            worst, fast, k = largest_shares(
                h, from_s, from_v, from_a, jerk, until, k, known, limits, scratch
            )
            seen = max(seen, worst)
            fastest = max(fastest, fast)
        largest = max(largest, seen, fastest)
        if fastest > 1.0:
            cells.top[m, 0] /= fastest * (1.0 + TOUCH)
            cells.top[m, 1] /= fastest * (1.0 + TOUCH)
        if seen > TIGHT:
            _, held, _ = merit(m, m + 1, cells, limits, 0.0, HIGH, False, no_system)
            held = max(held * share[m], TIGHT)
            if seen > held * (1.0 + TOUCH):
                share[m] = min(share[m], (1.0 - TOUCH) * held / seen)
    return largest


@njit
def descend(first: int, last: int, cells: Cells, known: Intervals, limits: SumLimits) -> bool:
    """Bring the motion of the cells [first, last) near to the least time, from any motion.

    Returns:
        Whether a legal motion was found.
    """
    v, a = cells.v, cells.a
    weight = FIRST_WEIGHT
    good = 0.0
    setbacks = 0
    good_v = v[first : last + 1].copy()
    good_a = a[first : last + 1].copy()
    for _ in range(ROUNDS):
        legal = centre(first, last, cells, limits, weight) <= 1.0
        if weight > CHECKED_FROM:
            seen = tighten(first, last, cells, known, limits)
            legal = legal and seen <= 1.0 + TOUCH
            if legal and weight > good:
                good = weight
                for k in range(last + 1 - first):
                    good_v[k] = v[first + k]
                    good_a[k] = a[first + k]
            setbacks += not legal
            if good >= LAST_WEIGHT or (good > 0.0 and setbacks >= SETBACKS):
                break
        elif not legal:
            break
        # A low weight lets the motion leave limits that have become tighter.
        weight = weight * WEIGHT_STEP if legal else FIRST_WEIGHT * WEIGHT_STEP
    for k in range(last + 1 - first):
        v[first + k] = good_v[k]
        a[first + k] = good_a[k]
    return good > 0.0


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
def sum_limits(limits: LimitArrays) -> SumLimits:
    """Return the limits of each axis and of the path, less the margins."""
    axes = len(limits.axis_acceleration)
    a = np.empty(axes + 1)
    j = np.empty(axes + 1)
    for i in range(axes):
        a[i] = limits.axis_acceleration[i] * (1.0 - MARGIN)
        j[i] = limits.axis_jerk[i] * (1.0 - JERK_MARGIN)
    a[axes] = limits.tangential_acceleration * (1.0 - 1e-6)
    j[axes] = limits.tangential_jerk * (1.0 - 1e-6)
    return SumLimits(a, j)


@njit
def empty_cells(n: int, axes: int) -> Cells:
    """Return arrays for ``n`` cells; each may use all of the limits."""
    return Cells(
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty(n),
        np.empty((n, 2)),
        np.ones(n),
        np.empty((n, 3, 3, axes + 1)),
    )


@njit
def duration_of(cells: Cells, x: Floats, dx: Floats) -> float:
    """Return the duration of the motion through all cells, s; x (5,), dx (5, 4): scratch."""
    v, a = cells.v, cells.a
    total = 0.0
    for m in range(len(cells.length)):
        cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, dx)
        total += 2.0 * x[H]
    return total


@njit
def refine(
    phases: Phases, known: Intervals, machine: LimitArrays, rough: bool
) -> tuple[bool, Phases]:
    """Make a plan faster where curves cost time.

    Args:
        phases: (p,): the plan.
        known: the intervals from its start to its end.
        machine: the limits.
        rough: whether the plan itself may be illegal.

    Returns:
        Whether the result is legal, and its phases.
    """
    limits = sum_limits(machine)
    axes = len(machine.axis_acceleration)
    finish = known.end[-1]
    rows = np.empty(3 * len(phases), PHASE)
    fixed = np.empty(3 * len(phases), np.bool_)
    total = separate(phases, known, rows, fixed)
    out = np.empty(2 * total + 256, PHASE)
    count = 0
    x = np.empty(5)
    dx = np.empty((5, 4))
    scratch = np.empty((3, axes + 1))
    cells = empty_cells(0, axes)
    legal = True
    place = 0
    first = 0
    while first < total:
        last = first + 1
        if not fixed[first]:
            while last < total and not fixed[last] and rows[last]["v"] > 0.0:
                last += 1
        number = 0
        if not fixed[first] and (rough or can_gain(rows, first, last, known, limits)):
            number = place_cuts(rows, first, last, known, cells, False)
        refined = False
        if number > 1:
            cells = empty_cells(number, axes)
            place_cuts(rows, first, last, known, cells, True)
            cells.s[number] = rows[last]["s"] if last < total else finish
            cells.v[number] = rows[last]["v"] if last < total else 0.0
            describe(cells, known)
            # A window at a time.
            refined = True
            done = 0
            while refined and done < number:
                until = min(done + WINDOW, number)
                refined = descend(done, until, cells, known, limits)
                done = until if until == number else done + WINDOW // 2
            if refined:
                before = 0.0
                for r in range(first, last):
                    before += rows[r]["duration"]
                after = duration_of(cells, x, dx)
                refined = rough or after < before * (1.0 - WORTHWHILE)
        needed = count + 4 * number + (last - first) + 2 * total
        if needed > len(out):
            grown = np.empty(2 * needed, PHASE)
            for k in range(count):
                grown[k] = out[k]
            out = grown
        if refined:
            for m in range(number):
                count = write_cell(cells, m, x, dx, out, count)
        else:
            for r in range(first, last):
                row = rows[r]
                out[count] = row
                count += 1
                if rough:
                    reached = rows[r + 1]["s"] if r + 1 < total else finish
                    worst, fastest, place = largest_shares(
                        row["duration"],
                        row["s"],
                        row["v"],
                        row["a"],
                        row["j"],
                        reached,
                        place,
                        known,
                        limits,
                        scratch,
                    )
                    legal = legal and max(worst, fastest) <= 1.0 + TOUCH
        first = last
    return legal, out[:count]
