"""Where the motion at a corner may begin and end."""

from __future__ import annotations

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, Floats
from cnc.kernels.planner.legs import (
    LEGS_SHARE,
    REST,
    REVERSED,
    STRAIGHTEST,
    Turn,
    corner_time,
    directions,
    line_bounds,
)
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.plan_arrays import PlanArrays

REACH = 4.0
"""The motion is replaced for so many times :func:`corner_time` before and behind a stop."""

SPARE = 0.01
"""Part of the reach by which more of a plan is held back: its start has to stay as it is."""


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
    """Return the phase that begins with a rest on the corner behind piece ``b``, or -1."""
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
    """Return the lengths that the motion at the corner behind piece ``b`` may take of its legs, mm.

    A leg between two corners belongs to both. ``shared``: whether the first leg of the path begins
    with a corner that the motion passes.
    """
    before = leaves_path(path, b - 1) if b > 0 else shared
    share1 = LEGS_SHARE if before else 2.0 * LEGS_SHARE
    share2 = LEGS_SHARE if leaves_path(path, b + 1) else 2.0 * LEGS_SHARE
    return share1 * path.length[b], share2 * path.length[b + 1]


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
    before = corner_time(line_bounds(u[0], bound[b], limits).j, turn, path.tolerance[b])
    after = corner_time(line_bounds(u[1], bound[b + 1], limits).j, turn, path.tolerance[b])
    return REACH * before, REACH * after


@njit
def first_undecided(
    path: PathArrays, plan: PlanArrays, shared: bool, bound: Floats, limits: LimitArrays
) -> float:
    """Return the time from which on a later plan may change the motion at a corner.

    That is the start of the motion at the last stop on a corner, if the plan ends before that
    motion does, or of that at a stop that may follow.

    Args:
        path: of the motion.
        plan: its phases.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
    """
    u = np.empty((2, len(limits.axis_jerk)))
    last, now = len(path.length) - 1, plan.t[-1]
    time = now
    if leaves_path(path, last):
        # The turn at the end of the last piece is not known, but the longest reach is.
        data, at = path.pieces.data, path.pieces.at[last]
        directions(data, at, data, at, u)
        line = line_bounds(u[0], bound[last], limits)
        straightest = Turn(STRAIGHTEST, STRAIGHTEST)
        reach = REACH * corner_time(line.j, straightest, path.tolerance[last])
        before = leaves_path(path, last - 1) if last > 0 else shared
        share = LEGS_SHARE if before else 2.0 * LEGS_SHARE
        begin = plan.piece_s[last + 1] - share * path.length[last]
        fastest = max(line.v, plan.v[-1])
        soonest = now + (plan.piece_s[last + 1] - plan.s[-1]) / fastest
        time = min(time, max(soonest - reach * (1.0 + SPARE), time_of(begin, plan) - SPARE * reach))
    b = last - 1
    if b >= 0:
        rest = rest_at(path, plan, b)
        reach1, reach2 = reach_of(path, b, bound, limits, u) if rest >= 0 else (0.0, 0.0)
        if reach1 > 0.0:
            length1, length2 = legs_used(path, b, shared)
            corner = plan.piece_s[b + 1]
            if plan.t[rest] + reach2 > now and plan.s[-1] < corner + length2:
                sooner = plan.t[rest] - reach1 * (1.0 + SPARE)
                begin = time_of(corner - length1, plan) - SPARE * reach1
                time = min(time, max(sooner, begin))
    return max(time, plan.t[0])
