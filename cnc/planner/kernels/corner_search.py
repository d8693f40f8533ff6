"""The motion past a chain of corners, sought with the states of a plan beside it.

What the search ends with depends on rounding. So its input is rounded, to more than the rounding
errors of plans. But for rare cases the same motion is found wherever a plan is cut, and it need not
be sought twice: it is taken from the last searches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.planner.kernels.arrays import LimitArrays, PathArrays, PlanArrays
from cnc.planner.kernels.corner_guess import Slow, slow_motion, slow_state
from cnc.planner.kernels.corner_legs import GROUPS, MOST_DIRECTIONS, MOST_STEPS, basis_of, tube_of
from cnc.planner.kernels.corner_motion import fastest_motion
from cnc.planner.kernels.corner_places import (
    MOST_CORNERS,
    Chain,
    legs_used,
    phase_of_time,
    rest_at,
    state_at,
    time_of,
)
from cnc.planner.kernels.corner_rows import Rows
from cnc.planner.kernels.corner_tube import Tube, place_ends, set_knots
from cnc.planner.kernels.legs import REST, corner_time, directions, line_bounds
from cnc.planner.kernels.limits import FLAT_PERIODS

SOLUTIONS = 64
"""Motions that are kept."""

NUMBERS = 1536
"""Most numbers of the input of a motion that is kept."""

ROW = 0.4e-6
"""s; computing time of a row of a step of Newton's method."""


class Solutions(NamedTuple):
    """Results of searches, kept with their input.

    Attributes:
        input: (SOLUTIONS, NUMBERS): the input of each search; NaN for none.
        length: (SOLUTIONS,): number of these numbers.
        points: (SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS): its control points.
        spans: (SOLUTIONS, groups): logarithms of the durations of its groups.
        exists: (SOLUTIONS,): 1 if there is a motion, or 0.
        next: (1,): the one to be replaced next.
        promised: (1,): part of its duration that the next motion is expected to save.
        left: (1,): computing time that is left, s. Without it nothing is sought.
    """

    input: Floats
    length: Ints
    points: Floats
    spans: Floats
    exists: Ints
    next: Ints
    promised: Floats
    left: Floats


def new_solutions(left: Floats) -> Solutions:
    """Return space for solutions; ``left`` (1,): computing time for searches, s."""
    return Solutions(
        np.full((SOLUTIONS, NUMBERS), math.nan),
        np.zeros(SOLUTIONS, np.int64),
        np.empty((SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS)),
        np.empty((SOLUTIONS, GROUPS * (MOST_CORNERS + 1))),
        np.zeros(SOLUTIONS, np.int64),
        np.zeros(1, np.int64),
        np.ones(1),
        left,
    )


@njit
def solve(tube: Tube, rows: Rows, c: Floats, spans: Floats, solutions: Solutions) -> bool:
    """Make a first guess of the motion the fastest one; return whether there is one.

    Nothing is sought where no computing time is left.

    Args:
        tube: the legs, and the states at both ends.
        rows: space for the limits.
        c: (steps + 3, d): control points, replaced by those of the result.
        spans: (groups,): logarithms of the durations of the groups, replaced likewise.
        solutions: of earlier searches, receives the result.
    """
    wanted = np.empty(NUMBERS)
    count = _write_input(tube, c, spans, wanted)
    points, d = c.shape
    k = _same_search(wanted, count, solutions) if count else -1
    if k >= 0:
        c[:] = solutions.points[k, :points, :d]
        spans[:] = solutions.spans[k, : len(spans)]
        return bool(solutions.exists[k] > 0)
    if solutions.left[0] <= 0.0:
        return False
    rows.work[0] = 0
    exists = fastest_motion(tube, rows, c, spans)
    solutions.left[0] -= ROW * rows.work[0]
    if count:
        k = solutions.next[0]
        solutions.next[0] = (k + 1) % SOLUTIONS
        solutions.input[k] = wanted
        solutions.length[k] = count
        solutions.points[k, :points, :d] = c
        solutions.spans[k, : len(spans)] = spans
        solutions.exists[k] = 1 if exists else 0
    return bool(exists)


@njit
def _write_input(tube: Tube, c: Floats, spans: Floats, to: Floats) -> int:
    """Write all that the search depends on, but for the machine's limits; return the count.

    ``c`` comes last. The count is 0 where there is no space.
    """
    parts = (
        tube.feed,
        tube.along.ravel(),
        tube.start.ravel(),
        tube.ends.ravel(),
        tube.axes.ravel(),
        tube.travel.ravel(),
        spans,
        c.ravel(),
    )
    to[0] = tube.tolerance
    at = 1
    for part in parts:
        if at + len(part) > NUMBERS:
            return 0
        to[at : at + len(part)] = part
        at += len(part)
    return at


@njit
def _same_search(wanted: Floats, count: int, solutions: Solutions) -> int:
    """Return the index of the search with the same input, or -1."""
    for k in range(SOLUTIONS):
        same = solutions.length[k] == count
        i = 0
        while same and i < count:
            same = wanted[i] == solutions.input[k, i]
            i += 1
        if same:
            return k
    return -1


SIDE = 0.3
CLOSEST = 3.0
"""The outer groups of a leg take this part of its time, but no more than so many times
:func:`corner_time` of the corner beside.
"""

SLOW = 0.1
"""Part of the feed; motion that is slower may begin or end anywhere."""

UNTOUCHED = 1e-2
"""Part of the time on the first and the last leg that stays as it is, at their far ends."""

SHORTEST = 1e-6
"""s; each leg of a chain takes longer, or its corners stay stops."""

GAIN = 1e-3
"""Part of its duration that a motion has to save."""

OPEN = 0.03
"""Part of the speed at its start that a motion has to be able to keep, and of that at its end. Of
those that could keep up to 0.05 of it, a few still gain 1 % of a program's time.
"""

DIGITS = 27
"""Binary digits of the search's input."""

STATE_DIGITS = (36, 30, 27)
"""Those of position, velocity and acceleration at its ends, which stay. In short steps a position
counts much. Times have rounding errors of 1e-14 s, so those of the acceleration are the largest.
"""


class Motion(NamedTuple):
    """The motion past a chain of corners.

    Attributes:
        saved: time that it saves, s; 0 for stops.
        begin: time in the plan at which it begins, s.
        end: time in the plan at which it ends, s.
        before: distance of its start from the first corner, mm.
        after: distance of its end from the last corner, mm.
        basis: (d, axes): the directions in which its control points are given.
        tube: its legs, and their limits.
        t: (steps + 5,): the knots, from its start, s.
        c: (steps + 3, d): control points, from the first corner, mm.
    """

    saved: float
    begin: float
    end: float
    before: float
    after: float
    basis: Floats
    tube: Tube
    t: Floats
    c: Floats


@njit
def _rounded(value: float, scale: float, digits: int = DIGITS) -> float:
    """Return the value rounded to so many binary digits of the scale."""
    unit = 2.0 ** (math.floor(math.log2(scale)) - digits)
    return math.floor(value / unit + 0.5) * unit


@njit
def _times_of(
    path: PathArrays, plan: PlanArrays, chain: Chain, times: tuple[float, float]
) -> Floats:
    """Return the times of the start, of each stop of the chain and of the end."""
    corners = chain.last - chain.first + 1
    t = np.empty(corners + 2)
    t[0], t[corners + 1] = times
    for k in range(corners):
        t[k + 1] = plan.t[rest_at(path, plan, chain.first + k)]
    return t


@njit
def _first_points(tube: Tube, slow: Slow, rows: Rows, spans: Floats) -> Floats:
    """Return control points of a motion near the slow one.

    Args:
        tube: the legs, and the states at both ends.
        slow: the motion.
        rows: receives the knots.
        spans: (groups,): logarithms of its durations.
    """
    steps, d = len(tube.leg), tube.axes.shape[1]
    legs = len(tube.feed)
    c = np.empty((steps + 3, d))
    set_knots(tube, spans, rows.t)
    length = 1.0
    for leg in range(1, legs - 1):
        length += tube.reach[leg, 1]
    r, a = np.empty(d), np.empty(d)
    for k in range(steps + 3):
        # The polar form of a parabola at three parameters, from their mean.
        mean = (rows.t[k] + rows.t[k + 1] + rows.t[k + 2]) / 3.0
        x, y, z = rows.t[k] - mean, rows.t[k + 1] - mean, rows.t[k + 2] - mean
        slow_state(tube, slow, min(max(mean, 0.0), slow.passes[legs]), r, a)
        for q in range(d):
            c[k, q] = _rounded(r[q] + a[q] * (x * y + y * z + z * x) / 6.0, length)
    return c


@njit
def _write_ends(tube: Tube, ends: Floats, scales: tuple[float, float], exact: bool) -> None:
    """Write the states at both ends: ``ends`` (2, 3) along the first and the last leg.

    They are rounded to STATE_DIGITS of ``scales``, of length and time, if not ``exact``.
    """
    last = len(tube.feed) - 1
    for end in range(2):
        leg = last * end
        for order in range(3):
            value = ends[end, order]
            if not exact:
                value = _rounded(value, scales[0] / scales[1] ** order, STATE_DIGITS[order])
            for q in range(tube.axes.shape[1]):
                place = tube.start[leg, q] if order == 0 else 0.0
                tube.ends[end, order, q] = place + value * tube.along[leg, q]


@njit
def motion_between(
    path: PathArrays,
    plan: PlanArrays,
    chain: Chain,
    times: tuple[float, float],
    tube: Tube,
    basis: Floats,
    limits: LimitArrays,
    solutions: Solutions,
    rows: Rows,
) -> Motion:
    """Return the motion past a chain of corners between two times of the plan.

    Args:
        path: of the motion.
        plan: its phases.
        chain: the corners.
        times: of the start and of the end, s.
        tube: the legs.
        basis: their directions.
        limits: of the machine.
        solutions: of earlier searches.
        rows: space for the limits.
    """
    t = _times_of(path, plan, chain, times)
    legs = len(t) - 1
    corners = plan.piece_s[chain.first + 1 : chain.last + 2]
    s1, v1, a1 = state_at(t[0], phase_of_time(t[0], plan), plan)
    s2, v2, a2 = state_at(t[legs], phase_of_time(t[legs], plan), plan)
    ends = np.array([[s1 - corners[0], v1, a1], [s2 - corners[legs - 2], v2, a2]])
    none = Motion(
        0.0, t[0], t[legs], -ends[0, 0], ends[1, 0], basis, tube, rows.t, np.empty((0, 0))
    )
    if not (-ends[0, 0] > REST and ends[1, 0] > REST):
        return none
    scales = (corners[legs - 2] - corners[0] - ends[0, 0] + ends[1, 0], t[legs] - t[0])
    _write_ends(tube, ends, scales, False)
    slow = slow_motion(tube)
    spans = np.empty(GROUPS * legs)
    for leg in range(legs):
        whole = slow.passes[leg + 1] - slow.passes[leg]
        if not whole > SHORTEST:
            return none
        first, second = _sides(path, chain, leg, whole, limits)
        spans[GROUPS * leg] = math.log(_rounded(first, whole))
        spans[GROUPS * leg + 1] = math.log(_rounded(whole - first - second, whole))
        spans[GROUPS * leg + 2] = math.log(_rounded(second, whole))
    c = _first_points(tube, slow, rows, spans)
    if not solve(tube, rows, c, spans, solutions):
        return none
    set_knots(tube, spans, rows.t)
    _write_ends(tube, ends, scales, True)
    place_ends(tube, rows.t, c)
    steps = len(tube.leg)
    saved = t[legs] - t[0] - (rows.t[steps + 2] - rows.t[2])
    if saved < GAIN * (t[legs] - t[0]):
        return none
    return Motion(
        saved,
        t[0],
        t[legs],
        -ends[0, 0],
        ends[1, 0],
        basis,
        tube,
        rows.t[: steps + 5].copy(),
        c,
    )


@njit
def _sides(
    path: PathArrays, chain: Chain, leg: int, whole: float, limits: LimitArrays
) -> tuple[float, float]:
    """Return the durations of the first and of the last group of a leg that takes ``whole`` s."""
    data, at = path.pieces.data, path.pieces.at
    u = np.empty((2, len(limits.axis_jerk)))
    sides = (SIDE * whole, SIDE * whole)
    first, second = sides
    for side in range(2):
        b = chain.first + leg - 1 + side
        if chain.first <= b <= chain.last:
            turn = directions(data, at[b], data, at[b + 1], u)
            line = line_bounds(u[1 - side], 1.0, limits)
            near = CLOSEST * corner_time(line.j, turn, path.tolerance[b])
            if side == 0:
                first = min(first, near)
            else:
                second = min(second, near)
    return first, second


@njit
def _speed_at(t: float, plan: PlanArrays) -> float:
    return state_at(t, phase_of_time(t, plan), plan)[1]


@njit
def times_of_motion(
    path: PathArrays,
    plan: PlanArrays,
    chain: Chain,
    shared: bool,
    bound: Floats,
    limits: LimitArrays,
) -> tuple[float, float]:
    """Return the times of the plan at which the motion past a chain begins and ends, s.

    Where the motion crosses a junction at the far end of a leg, the plan's stretch of constant
    speed about it stays: a jump of the curvature there needs its share of the limits.

    Args:
        path: of the motion.
        plan: its phases.
        chain: the corners.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
    """
    t1 = plan.t[rest_at(path, plan, chain.first)]
    t2 = plan.t[rest_at(path, plan, chain.last)]
    before, behind = legs_used(path, chain.first, shared)[0], legs_used(path, chain.last, shared)[1]
    first, last = plan.piece_s[chain.first + 1] - before, plan.piece_s[chain.last + 1] + behind
    earliest, latest = max(time_of(first, plan), plan.t[0]), min(time_of(last, plan), plan.t[-1])
    steady = FLAT_PERIODS * limits.period
    at_first = at_last = 0.0
    if before == path.length[chain.first] and _speed_at(earliest, plan) > 0.0:
        at_first = min(steady, 0.5 * (t1 - earliest))
    if behind == path.length[chain.last + 1] and _speed_at(latest, plan) > 0.0:
        at_last = min(steady, 0.5 * (latest - t2))
    earliest += max(UNTOUCHED * (t1 - earliest), at_first)
    latest -= max(UNTOUCHED * (latest - t2), at_last)
    begin, end = max(chain.begin, earliest), min(chain.end, latest)
    slow = (SLOW * bound[chain.first], SLOW * bound[chain.last + 1])
    return _after_rise(begin, t1, slow[0], plan), _before_fall(end, t2, slow[1], plan)


@njit
def goes_on(times: tuple[float, float], plan: PlanArrays, limits: LimitArrays) -> tuple[bool, bool]:
    """Return whether the motion need not rest behind its start, and before its end.

    With the acceleration -a at the speed v and the jerk J along the path, the speed falls by
    a^2 / (2 J) in any case. Where that is nearly all of it, as on a leg that is shorter than the
    last part of the ramp to its end, the corner beside it stays a stop.
    """
    free = np.empty(2)
    for side in range(2):
        _, v, a = state_at(times[side], phase_of_time(times[side], plan), plan)
        falls = max(a if side else -a, 0.0)
        free[side] = v - falls * falls / (2.0 * limits.tangential_jerk) - OPEN * v
    return bool(free[0] >= 0.0), bool(free[1] >= 0.0)


@njit
def find_motion(
    path: PathArrays,
    plan: PlanArrays,
    chain: Chain,
    times: tuple[float, float],
    bound: Floats,
    limits: LimitArrays,
    travel: Floats,
    solutions: Solutions,
    rows: Rows,
) -> Motion:
    """Return the motion past a chain of corners.

    Args:
        path: of the motion.
        plan: its phases.
        chain: the corners.
        times: of the start and of the end, s.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
        travel: (2, axes): lowest and highest positions, mm.
        solutions: of earlier searches.
        rows: space for the limits.
    """
    along = np.zeros((MOST_CORNERS + 1, MOST_DIRECTIONS))
    basis = basis_of(path, chain.first, chain.last, along)
    tube = tube_of(path, chain, bound, limits, travel, basis, along)
    begins, ends = goes_on(times, plan, limits)
    if len(basis) == 0 or not (begins and ends):
        # Where no directions are common to all legs, their corners are passed one by one.
        return Motion(0.0, times[0], times[1], 0.0, 0.0, basis, tube, rows.t, np.empty((0, 0)))
    return motion_between(path, plan, chain, times, tube, basis, limits, solutions, rows)


@njit
def _after_rise(t: float, latest: float, slow: float, plan: PlanArrays) -> float:
    """Return the first time from ``t`` to ``latest`` at which the speed does not rise, or is slow.

    While it rises to the feed, little but the plan's motion is possible.
    """
    k = phase_of_time(t, plan)
    _, v, a = state_at(t, k, plan)
    if v <= slow:
        return t
    while a > 0.0 and k < len(plan.j):
        if plan.j[k] < 0.0 and t - a / plan.j[k] <= plan.t[k + 1]:
            t -= a / plan.j[k]
            break
        k += 1
        t, a = plan.t[k], plan.a[k]
    return min(t, latest)


@njit
def _before_fall(t: float, earliest: float, slow: float, plan: PlanArrays) -> float:
    """Return the last time from ``earliest`` to ``t`` at which it does not fall, or is slow."""
    k = phase_of_time(t, plan)
    _, v, a = state_at(t, k, plan)
    if v <= slow:
        return t
    while a < 0.0 and k > 0:
        if plan.j[k] < 0.0 and t - a / plan.j[k] >= plan.t[k]:
            t -= a / plan.j[k]
            break
        t, a = plan.t[k], plan.a[k]
        k -= 1
    return max(t, earliest)
