r"""The shortest ramp to rest on a path whose bounds vary.

The descent of :mod:`cnc.planner.kernels.fastest` finds the fastest motion to a given place. Here
the place of rest is free: the last cell is one phase of constant jerk to rest, and speed and
acceleration at its start are unknowns as at the other cuts. Where it ends follows from them:

      v |--+--+__
        |        `+_                  cuts at fixed places
        |           `+_
        |              \_             last cell
        +---------------`--_---- s
                            rest

As the ramp becomes shorter, the last cell does, until the motion can hardly rest any nearer. Then
the last cell is begun at an earlier cut. At first it takes a large part of the ramp, so that the
place of rest can move far. Its constant jerk costs time where the path bends, so it becomes smaller
with the weight of the time.

A search may begin with a ramp that exceeds limits: then the limits of all cells are raised by the
same share, and lowered as the motion comes back inside.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import PHASE, LimitArrays, Phases, phase_at
from cnc.planner.kernels.cells import (
    A_MIDDLE,
    J1,
    J2,
    NEAR_END,
    V_MIDDLE,
    Cells,
    H,
    cell_phases,
    describe,
    duration_of,
    empty_cells,
    length_to_rest,
    matters,
    part_of,
    place_rest,
    with_motion,
)
from cnc.planner.kernels.descent import centre
from cnc.planner.kernels.examination import Shares, examine, passable
from cnc.planner.kernels.fastest import LAST_WEIGHT, after_violation, largest_share
from cnc.planner.kernels.intervals import (
    SCRATCH,
    TOUCH,
    Intervals,
    SumLimits,
    interval_at,
    largest_shares,
)
from cnc.planner.kernels.refine import sum_limits, write_cells
from cnc.planner.kernels.scurve import phase_time

# Cells of a ramp to rest, for the search of :mod:`cnc.planner.kernels.stopping`.
#
# Phases that are long are cut evenly, and at knots of the path. Short ones make one cell where the
# motion through it is legal: so a legal ramp stays the same motion, or a legal one. The last cell
# is open: one phase of constant jerk to rest.

Floats = NDArray[np.float64]

State = tuple[float, float, float]
"""Arc length, mm; speed, mm/s; acceleration, mm/s^2."""

CELLS = 48
"""Cells of a ramp at first; more where the path needs them."""

SMALLER = 0.72
"""Part to which the last cell is made smaller."""

SHORTEST_END = 0.002
"""The last cell takes this part of a ramp's time at least."""

LARGER = 1.3
"""A last cell that takes this much more than it should is cut."""

ALLOWED = 1.0 + 0.9 * TOUCH
"""Share of the limits that a ramp may use: it may start with the motion of a plan at its limits."""

JOINED = 1.0 + 0.5 * TOUCH
"""Phases make one cell where the motion through it uses at most this share of the limits."""


class Place(NamedTuple):
    """A place in a ramp: the row of a phase, and the time since its start, s."""

    row: int
    t: float


@njit
def time_of(ramp: Phases) -> float:
    """Return the time of a ramp, s."""
    time = 0.0
    for r in range(len(ramp)):
        time += ramp[r]["duration"]
    return time


@njit
def state_at(ramp: Phases, place: Place) -> State:
    """Return arc length, speed and acceleration at a place."""
    row = ramp[place.row]
    return phase_at(place.t, row["s"], row["v"], row["a"], row["j"])


@njit
def place_at(ramp: Phases, time: float) -> Place:
    """Return the place at a time from the start of a ramp."""
    r = 0
    while r + 1 < len(ramp) and time >= ramp[r]["duration"]:
        time -= ramp[r]["duration"]
        r += 1
    return Place(r, time)


@njit
def uses(
    duration: float,
    start: State,
    jerk: float,
    s_end: float,
    k: int,
    known: Intervals,
    limits: SumLimits,
) -> float:
    """Return the largest share of a limit that a phase uses.

    Args:
        duration: s.
        start: the state at its start.
        jerk: mm/s^3.
        s_end: arc length at its end, mm.
        k: an interval near its start.
        known: the intervals of the path.
        limits: for the sums.
    """
    scratch = np.empty((SCRATCH, len(limits.a)))
    s, v, a = start
    sums, speed, _ = largest_shares(duration, s, v, a, jerk, s_end, k, known, limits, scratch)
    return max(sums, speed)


@njit
def may_rest(start: State, before: float, known: Intervals, limits: SumLimits) -> bool:
    """Return whether one phase to rest from a state is legal, and ends before a place."""
    s, v, a = start
    if not v > 0.0 > a:
        return False
    rest = s + length_to_rest(v, a)
    k = interval_at(s, int(np.searchsorted(known.end, s)), known.end)
    jerk = 0.5 * a * a / v
    return rest < before and uses(-2.0 * v / a, start, jerk, rest, k, known, limits) <= JOINED


@njit
def last_cut(
    ramp: Phases, before: float, part: float, known: Intervals, limits: SumLimits
) -> Place:
    """Return where the last cell of a ramp begins.

    It takes less than ``part`` of the time where one phase to rest from there is not legal, and
    more where the ramp has to rest earlier than it does.

    Args:
        ramp: its phases.
        before: place before which it has to rest, mm.
        part: of its time.
        known: the intervals of the path.
        limits: for the sums.
    """
    whole = time_of(ramp)
    place = place_at(ramp, (1.0 - part) * whole)
    if state_at(ramp, place)[0] >= before:
        while part < 1.0 and state_at(ramp, place)[0] >= before:
            part /= SMALLER
            place = place_at(ramp, max(1.0 - part, 0.0) * whole)
        return place
    while part > SHORTEST_END and not may_rest(state_at(ramp, place), before, known, limits):
        part *= SMALLER
        place = place_at(ramp, (1.0 - part) * whole)
    return place


@njit
def next_knot(s: float, k: int, known: Intervals, limits: SumLimits) -> float:
    """Return the place behind ``s`` at which the path or its bounds jump; else infinity.

    ``k``: the interval of ``s``.
    """
    while k + 1 < len(known.end):
        if known.end[k] > s + NEAR_END and matters(known, k, limits):
            return float(known.end[k])
        k += 1
    return math.inf


@njit
def joins(start: State, end: State, k: int, known: Intervals, limits: SumLimits) -> bool:
    """Return whether a legal motion leads through one cell.

    Args:
        start: the state at its start.
        end: the state at its end.
        k: an interval near its start.
        known: the intervals of the path.
        limits: for the sums.
    """
    x = np.empty(5)
    slope = np.empty((5, 4))
    s, v, a = start
    if not cell_phases(v, a, end[1], end[2], end[0] - s, x, slope):
        return False
    half = phase_at(x[H], s, v, a, x[J1])[0]
    if uses(x[H], start, x[J1], half, k, known, limits) > JOINED:
        return False
    middle = (half, x[V_MIDDLE], x[A_MIDDLE])
    return uses(x[H], middle, x[J2], end[0], k, known, limits) <= JOINED


@njit
def next_cut(
    ramp: Phases,
    place: Place,
    last: Place,
    usual: float,
    k: int,
    known: Intervals,
    limits: SumLimits,
) -> Place:
    """Return where a cell ends that begins at a place.

    Args:
        ramp: its phases.
        place: where the cell begins.
        last: where the last cell begins.
        usual: the longest time of a cell, s.
        k: the interval at its start.
        known: the intervals of the path.
        limits: for the sums.
    """
    r = place.row
    left = (last.t if r == last.row else ramp[r]["duration"]) - place.t
    start = state_at(ramp, place)
    knot = next_knot(start[0], k, known, limits)
    if left > usual:
        cut = Place(r, place.t + left / math.ceil(left / usual))
        if knot < state_at(ramp, cut)[0] - NEAR_END:
            row = ramp[r]
            t = phase_time(row["v"], row["a"], row["j"], row["duration"], knot - row["s"])
            return Place(r, t)
        return cut
    if r == last.row:
        return last
    # Short phases make one cell where the motion through it is legal.
    cut = Place(r + 1, 0.0)
    time = left
    while r + 1 < last.row:
        r += 1
        time += ramp[r]["duration"]
        end = Place(r + 1, 0.0)
        if time > usual or state_at(ramp, end)[0] > knot + NEAR_END:
            break
        if joins(start, state_at(ramp, end), k, known, limits):
            cut = end
    return cut


@njit
def cut_anew(
    ramp: Phases, rest: float, before: float, part: float, known: Intervals, limits: SumLimits
) -> Cells:
    """Return cells of a ramp to rest.

    Args:
        ramp: its phases.
        rest: where it rests, mm.
        before: place before which it has to rest, mm.
        part: of its time that the last cell takes, or less.
        known: the intervals of the path.
        limits: for the sums.
    """
    usual = time_of(ramp) / CELLS
    last = last_cut(ramp, before, part, known, limits)
    cells = empty_cells(len(ramp) + 2 * CELLS + len(known.end), len(limits.a), before)
    place = Place(0, 0.0)
    count = 0
    k = 0
    while True:
        cells.s[count], cells.v[count], cells.a[count] = state_at(ramp, place)
        k = interval_at(cells.s[count], k, known.end)
        count += 1
        if place.row > last.row or (place.row == last.row and place.t >= last.t):
            break
        place = next_cut(ramp, place, last, usual, k, known, limits)
    cells.s[count], cells.v[count], cells.a[count] = rest, 0.0, 0.0
    cells = part_of(cells, 0, count)
    for m in range(count):
        cells.share[m] = cells.pace[m] = ALLOWED
    describe(cells, known)
    return passable(cells, known)


@njit
def times_left(cells: Cells) -> Floats:
    """Return the time from the start of each cell to rest, (n,)."""
    n = len(cells.length)
    x = np.empty(5)
    slope = np.empty((5, 4))
    left = np.empty(n)
    time = 0.0
    for m in range(n - 1, -1, -1):
        v, a = cells.v, cells.a
        cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, slope)
        time += 2.0 * x[H]
        left[m] = time
    return left


@njit
def with_end(cells: Cells, part: float, known: Intervals, limits: SumLimits) -> Cells:
    """Return the cells of a ramp with a last cell that takes about ``part`` of its time.

    It begins at a cut from which one phase to rest is legal. A last cell that takes more is cut.
    """
    left = times_left(cells)
    wanted = part * left[0]
    last = len(cells.length) - 1
    first = last
    for m in range(last - 1, 0, -1):
        if left[m] > wanted:
            break
        if may_rest((cells.s[m], cells.v[m], cells.a[m]), cells.rest_before, known, limits):
            first = m
    more = 0
    if first == last and left[last] > LARGER * wanted:
        more = math.ceil((left[last] - wanted) * CELLS / left[0])
    n = first + more + 1
    out = empty_cells(n, cells.q.shape[3], cells.rest_before)
    s, v, a = cells.s[first], cells.v[first], cells.a[first]
    for m in range(n):
        if m < first:
            out.s[m], out.v[m], out.a[m] = cells.s[m], cells.v[m], cells.a[m]
            out.share[m], out.pace[m] = cells.share[m], cells.pace[m]
        else:
            t = (left[last] - wanted) * (m - first) / max(more, 1)
            out.s[m], out.v[m], out.a[m] = phase_at(t, s, v, a, 0.5 * a * a / v)
            out.share[m] = out.pace[m] = ALLOWED
    out.s[n], out.v[n], out.a[n] = cells.s[last + 1], 0.0, 0.0
    describe(out, known)
    return out


CENTRINGS = 4
"""Descents in which a ramp has to get inside the limits."""

LIGHT, HEAVY = 0.2, 60.0
"""Weights of the time, as in the descent: while a ramp gets inside the limits, and the first one
while it becomes shorter.
"""

FAR, NEAR_BY = 0.5, 0.25
"""Parts of a ramp's time that the last cell takes at first."""

SHORT_END = 0.1
"""The last cell becomes smaller until it would take less than this part. The weight is inverse to
the cube of the part: the length of the last cell goes with that cube.
"""

GAIN = 0.15
"""The last cell is made smaller where a ramp becomes shorter by less than this part of the cube of
its part.
"""

TRIES = 6
"""Largest number of times that the cells of a ramp are cut for one weight."""

MOST = 60
"""Largest number of descents."""


@njit
def inside(cells: Cells, known: Intervals, limits: SumLimits) -> bool:
    """Bring a motion inside the limits at the points of its cells; return whether it is there."""
    uncounted = np.zeros(1)
    for _ in range(CENTRINGS):
        if largest_share(cells, limits) <= 1.0:
            return True
        centre(0, len(cells.length), cells, limits, LIGHT, True, uncounted)
        describe(cells, known)
    return largest_share(cells, limits) <= 1.0


@njit
def made_shorter(
    cells: Cells, weight: float, known: Intervals, limits: SumLimits
) -> tuple[bool, Cells]:
    """Bring a ramp near to the least time for one weight.

    Returns:
        Whether there is a legal one, and its cells, cut where it would exceed a limit between the
        points.
    """
    uncounted = np.zeros(1)
    for _ in range(TRIES):
        if not inside(cells, known, limits):
            return False, cells
        kept = with_motion(cells, cells.v.copy(), cells.a.copy())
        if centre(0, len(cells.length), cells, limits, weight, True, uncounted) > 1.0:
            return False, cells
        shares = Shares(np.empty(len(cells.length)), np.empty(len(cells.length)))
        if examine(cells, known, limits, shares) <= 1.0 + TOUCH:
            return True, cells
        cells = after_violation(kept, cells, shares, known, limits)
    return False, cells


@njit
def phases_of(cells: Cells) -> Phases:
    """Return the phases of the motion through cells."""
    out = np.empty(4 * len(cells.length), PHASE)
    return out[: write_cells(cells, 0, len(cells.length), out, 0)]


@njit
def shortest_ramp(
    phases: Phases, rest: float, before: float, part: float, known: Intervals, machine: LimitArrays
) -> tuple[bool, Phases, float]:
    """Return the shortest legal ramp to rest that the search finds.

    Args:
        phases: (p,): a ramp to start with. It may exceed limits.
        rest: arc length of its end, mm.
        before: place before which it has to rest, mm.
        part: of its time that the last cell takes at first: FAR where the place of rest may be far
            from the best one, NEAR_BY where the ramp is short already.
        known: the intervals from its start to the place before which it rests.
        machine: the limits.

    Returns:
        Whether there is one, its phases, and the arc length of its end.
    """
    limits = sum_limits(machine)
    cells = cut_anew(phases, rest, before, part, known, limits)
    time = math.inf
    for _ in range(MOST):
        weight = min(HEAVY * (FAR / part) ** 3, LAST_WEIGHT)
        legal, cells = made_shorter(cells, weight, known, limits)
        after = duration_of(cells) if legal else math.inf
        if after < time:
            place_rest(cells)
            phases, rest = phases_of(cells), cells.s[-1]
        elif time == math.inf:
            break
        if after > (1.0 - GAIN * part * part * part) * time:
            part *= SMALLER
            if part < SHORT_END:
                break
        time = min(after, time)
        if not legal:
            cells = cut_anew(phases, rest, before, part, known, limits)
        cells = with_end(cells, part, known, limits)
    return time < math.inf, phases, rest
