r"""Where the motion at corners may begin and end, and which corners are passed together.

A motion past a corner reaches about as far as the ramp beside it. Where the reaches of two corners
meet, their motions depend on each other: the corners form a chain.

          reach              reach          reach   reach
        |------->o<---------|             |----->o<------|
        _________           ______________                ________
                 \_________/              \______________/
               corner    corner                corner
               '--- one chain --'             another chain
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import LINE, Floats
from cnc.planner.kernels.arrays import LimitArrays, PathArrays, PlanArrays
from cnc.planner.kernels.legs import (
    LEGS_SHARE,
    REST,
    REVERSED,
    STRAIGHTEST,
    LineBounds,
    Turn,
    corner_time,
    directions,
    line_bounds,
)
from cnc.planner.kernels.scurve import ramp_time

NEAR = 4.0
"""A motion reaches at least so many times :func:`corner_time` before and behind a corner."""

SHARP = math.sin(math.radians(120.0) / 2.0)
"""Sine of half the turn from which on the motion is so slow that it reaches no farther."""

MOST_CORNERS = 8
"""Largest number of corners of a chain."""

MOST_TIME, MOST_RAMPS = 0.4, 2.5
"""A chain of stops that takes more seconds, and more times the ramp to its feed, ends. An
override may wait for the end of a chain that has begun. Legs of less than BRIEF do not count.
"""

BRIEF = 5.0
"""In tolerances. A motion past corners takes about half the time of the stops for a shorter leg."""

SPARE = 0.01
"""Part of the reach by which more of a plan is held back: its start has to stay as it is."""


class Chain(NamedTuple):
    """Corners that are passed together, the first and the last stop among them.

    Attributes:
        first: piece before the first corner.
        last: piece before the last corner.
        begin: time at which the motion there may begin, s.
        end: time at which it ends, s.
        final: whether no later plan can change this.
    """

    first: int
    last: int
    begin: float
    end: float
    final: bool


@njit
def state_at(t: float, k: int, plan: PlanArrays) -> tuple[float, float, float]:
    """Return arc length, speed and acceleration at time ``t`` by phase ``k``."""
    dt = t - plan.t[k]
    v, a, j = plan.v[k], plan.a[k], plan.j[k]
    s = plan.s[k] + dt * (v + dt * (0.5 * a + dt * j / 6.0))
    return s, v + dt * (a + 0.5 * dt * j), a + dt * j


@njit
def phase_of_time(t: float, plan: PlanArrays) -> int:
    """Return the phase at time ``t``."""
    return min(max(int(np.searchsorted(plan.t, t, side="right")) - 1, 0), len(plan.j) - 1)


@njit
def time_of(s: float, plan: PlanArrays) -> float:
    """Return the first time at which the motion is at arc length ``s``."""
    k = min(max(int(np.searchsorted(plan.s, s, side="left")) - 1, 0), len(plan.j) - 1)
    low, high = plan.t[k], plan.t[k + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        if state_at(middle, k, plan)[0] < s:
            low = middle
        else:
            high = middle
    return float(high)


@njit
def leaves_path(path: PathArrays, b: int) -> bool:
    """Return whether the motion may leave the path at the end of piece ``b``."""
    return bool(
        0 <= b < len(path.pieces.kind)
        and path.tolerance[b] > 0.0
        and not path.stop_after[b]
        and path.pieces.kind[b] == LINE
    )


@njit
def rest_at(path: PathArrays, plan: PlanArrays, b: int) -> int:
    """Return the phase that begins with a rest on the corner behind piece ``b``, or -1.

    It is -1, too, where the plan ends there, and where the corner is none to be passed.
    """
    following = b + 1 < len(path.pieces.kind) and path.pieces.kind[b + 1] == LINE
    if not (following and leaves_path(path, b)):
        return -1
    k = int(np.searchsorted(plan.s, plan.piece_s[b + 1] - REST))
    while 0 < k < len(plan.j) and plan.s[k] <= plan.piece_s[b + 1] + REST:
        if plan.v[k] == 0.0 and plan.a[k] == 0.0:
            return k
        k += 1
    return -1


@njit
def count_corners(path: PathArrays, plan: PlanArrays) -> int:
    """Return the number of stops on corners at which the motion may leave the path."""
    count = 0
    for b in range(len(path.pieces.kind)):
        if rest_at(path, plan, b) >= 0:
            count += 1
    return count


@njit
def legs_used(path: PathArrays, b: int, shared: bool) -> tuple[float, float]:
    """Return the lengths that a motion at the corner behind piece ``b`` may take of its legs, mm.

    A leg between two corners belongs to both. ``shared``: whether the first leg of the path begins
    with a corner that the motion passes.
    """
    before = leaves_path(path, b - 1) if b > 0 else shared
    share1 = LEGS_SHARE if before else 1.0
    share2 = LEGS_SHARE if leaves_path(path, b + 1) else 1.0
    return share1 * path.length[b], share2 * path.length[b + 1]


@njit
def _ramp(line: LineBounds) -> float:
    """Return the time of the ramp to the speed of a line; infinity without a bound."""
    return ramp_time(0.0, line.v, line.a, line.j) if line.v < math.inf else math.inf


@njit
def _reach(u: Floats, turn: Turn, bound: float, tolerance: float, limits: LimitArrays) -> float:
    """Return the time that a motion past a corner may reach on a leg of direction ``u``, s."""
    line = line_bounds(u, bound, limits)
    near = NEAR * corner_time(line.j, turn, tolerance)
    ramp = _ramp(line)
    if turn.sine >= SHARP or not ramp < math.inf:
        return 1.5 * near
    return near + ramp


@njit
def reach_of(
    path: PathArrays, b: int, bound: Floats, limits: LimitArrays, u: Floats
) -> tuple[float, float]:
    """Return the times before and behind the stop behind piece ``b`` that may change, s.

    They are 0 where the corner stays a stop. ``u`` (2, axes) receives the directions of its legs.
    """
    data, at = path.pieces.data, path.pieces.at
    turn = directions(data, at[b], data, at[b + 1], u)
    if not STRAIGHTEST < turn.sine < REVERSED:
        return 0.0, 0.0
    eps = path.tolerance[b]
    before = _reach(u[0], turn, bound[b], eps, limits)
    return before, _reach(u[1], turn, bound[b + 1], eps, limits)


@njit
def passes_corner(
    path: PathArrays, plan: PlanArrays, b: int, bound: Floats, limits: LimitArrays
) -> bool:
    """Return whether the motion may pass the stop on the corner behind piece ``b``."""
    if rest_at(path, plan, b) < 0:
        return False
    return reach_of(path, b, bound, limits, np.empty((2, len(limits.axis_jerk))))[0] > 0.0


@njit
def chain_from(
    path: PathArrays,
    plan: PlanArrays,
    b: int,
    shared: bool,
    bound: Floats,
    limits: LimitArrays,
    most: int,
) -> Chain:
    """Return the chain of which the corner behind piece ``b`` is the first.

    Args:
        path: of the motion.
        plan: its phases.
        b: the piece before the corner.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
        most: largest number of its corners.
    """
    u = np.empty((2, len(limits.axis_jerk)))
    rest = rest_at(path, plan, b)
    reach1, reach2 = reach_of(path, b, bound, limits, u)
    t, now = plan.t[rest], plan.t[-1]
    half = time_of(plan.piece_s[b + 1] - legs_used(path, b, shared)[0], plan)
    begin = max(t - reach1, half)
    line = line_bounds(u[1], bound[b + 1], limits)
    most_time = max(MOST_TIME, MOST_RAMPS * _ramp(line))
    brief = 0.0
    e = b
    while True:
        ends = plan.piece_s[e + 2]
        passed = plan.s[-1] > ends + REST
        following = rest_at(path, plan, e + 1)
        whole = e - b + 1 >= most or t - begin - brief > most_time
        if whole or following < 0:
            # The next corner is too late to count, or it is none.
            final = whole or passed or not leaves_path(path, e + 1)
            final = final or now - t > reach2 + _longest_reach(path, e + 1, bound, limits)
            break
        reach1, further = reach_of(path, e + 1, bound, limits, u)
        if reach1 == 0.0 or plan.t[following] - t >= reach1 + reach2:
            final = True
            break
        if path.length[e + 1] < BRIEF * path.tolerance[e]:
            brief += plan.t[following] - t
        t, reach2 = plan.t[following], further
        e += 1
    half_s = plan.piece_s[e + 1] + legs_used(path, e, shared)[1]
    end = t + reach2
    reached = plan.s[-1] >= half_s
    if reached:
        end = min(end, time_of(half_s, plan))
    return Chain(b, e, begin, end, final and (reached or end <= now))


@njit
def _longest_reach(path: PathArrays, b: int, bound: Floats, limits: LimitArrays) -> float:
    """Return the longest time that a motion may reach before a corner behind piece ``b``, s."""
    u = np.empty((2, len(limits.axis_jerk)))
    data, at = path.pieces.data, path.pieces.at[b]
    directions(data, at, data, at, u)
    straightest = Turn(STRAIGHTEST, STRAIGHTEST)
    return _reach(u[0], straightest, bound[b], path.tolerance[b], limits)


@njit
def first_undecided(
    path: PathArrays, plan: PlanArrays, shared: bool, bound: Floats, limits: LimitArrays
) -> float:
    """Return the time from which on a later plan may change the motion at a corner.

    That is the start of a chain that may go on, or of the motion at a stop that may follow.

    Args:
        path: of the motion.
        plan: its phases.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
    """
    last, now = len(path.length) - 1, plan.t[-1]
    time = now
    if leaves_path(path, last):
        before = leaves_path(path, last - 1) if last > 0 else shared
        share = LEGS_SHARE if before else 1.0
        begin = plan.piece_s[last + 1] - share * path.length[last]
        # The turn at the end of the last piece is not known, but the longest reach is.
        reach = _longest_reach(path, last, bound, limits)
        u = np.empty((2, len(limits.axis_jerk)))
        data, at = path.pieces.data, path.pieces.at[last]
        directions(data, at, data, at, u)
        fastest = max(line_bounds(u[0], bound[last], limits).v, plan.v[-1])
        soonest = now + (plan.piece_s[last + 1] - plan.s[-1]) / fastest
        time = min(time, max(soonest - reach * (1.0 + SPARE), time_of(begin, plan) - SPARE * reach))
    b = 0
    while b < last:
        if passes_corner(path, plan, b, bound, limits):
            chain = chain_from(path, plan, b, shared, bound, limits, MOST_CORNERS)
            if not chain.final:
                time = min(time, chain.begin - SPARE * (chain.end - chain.begin))
                break
            b = chain.last
        b += 1
    return max(time, plan.t[0])
