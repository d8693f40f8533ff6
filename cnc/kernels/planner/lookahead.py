r"""Look-ahead over a window of intervals with constant bounds.

The path is cut into intervals k with bounds on speed V[k], tangential acceleration A[k, .] and jerk
J[k, .] (the last two for levels of speed: slower motion on a curve leaves more of an axis to the
tangential part). The plan is a chain of *nodes* at zero acceleration joined by seven-phase profiles
(:mod:`cnc.kernels.planner.scurve`):

      v                 ____________________            1. Forced nodes first: stops, and junctions that are crossed at constant speed.
        V   ___________|                    |_____      2. A span between two nodes gets the fastest profile for its ends and length. Ends
           |         __------____                 |        too far apart in speed for their distance: the faster one is lowered.
           |      __/  profile   \__              |     3. If the profile breaks the speed bound of an interval, the lowest such bound
        ---|___--/                  \\--___________|        becomes a node: its whole plateau in a valley, one end of it on a flank.
             o node                     o node             Both new spans go back to 2.

       A span whose bounds on acceleration and jerk are uneven is cut where that saves time: each
       part has the bounds of its own.

Lowest bound first means that a node stands where the path itself forces a low speed, and a profile
spans everything that doesn't bind. Every profile is legal on every interval that it crosses, so the
chain is legal; taking fewer nodes is what makes it fast.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.scurve import (
    peak_speed,
    ramp_distance,
    ramp_distance_to_speed,
    ramp_time,
    reachable_speed,
    write_profile,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PLANNED = 0
START_TOO_FAST = 1
NOT_FINISHED = 2

FREE = -1
FIXED = 0
FORCED = 1
FOUND = 2

UNEVEN = 0.7
"""A span whose bounds are below this part of the widest in it may gain from being cut."""

WORTHWHILE = 0.005
"""The part of its time that a cut has to save."""

SLACK = 1e-12
"""Relative: what rounding may add to a distance or a speed before it counts as too much."""


@njit
def level_of(ratio: float, levels: int) -> int:
    """Index of the lowest level of speed that still covers ``ratio`` of an interval's speed bound;
    levels fall evenly from 1.
    """
    if ratio >= 1.0:
        return 0
    return min(int((1.0 - ratio) * 10.0 + 1e-9), levels - 1)


@njit
def span_bounds(
    speed: Floats, accel: Floats, jerk: Floats, first: int, last: int, v: float
) -> tuple[float, float]:
    """Least acceleration and jerk bounds over the intervals [first, last) for motion no faster than
    ``v``.
    """
    levels = accel.shape[1]
    least_a = math.inf
    least_j = math.inf
    for k in range(first, last):
        m = level_of(v / speed[k], levels) if speed[k] > 0.0 else 0
        least_a = min(least_a, accel[k, m])
        least_j = min(least_j, jerk[k, m])
    return least_a, least_j


@njit
def profile_time(v0: float, v1: float, distance: float, peak: float, a: float, j: float) -> float:
    """Duration of the ramps v0 -> peak -> v1 and the cruise between them."""
    if peak <= 0.0:
        return math.inf
    cruise = distance - ramp_distance(v0, peak, a, j) - ramp_distance(peak, v1, a, j)
    return ramp_time(v0, peak, a, j) + ramp_time(peak, v1, a, j) + max(cruise, 0.0) / peak


@njit
def best_profile(
    speed: Floats,
    accel: Floats,
    jerk: Floats,
    first: int,
    last: int,
    v0: float,
    v1: float,
    distance: float,
    top: float,
) -> tuple[float, float, float, float]:
    """Fastest profile over the choice of a top speed: a lower one may leave more acceleration.
    Returns (peak, accel, jerk, time).

    The time is infinite where no ramp between the ends fits. The bounds that hold at an interval's
    full speed hold at any lower one, so they are the first to be tried; a lower top speed may leave
    more of an axis to the acceleration, at the cost of the jerk bound.
    """
    least = max(v0, v1)
    best = (least, 0.0, 0.0, math.inf)
    tight_a, tight_j = span_bounds(speed, accel, jerk, first, last, math.inf)
    for m in range(-1, accel.shape[1]):
        cap = max(least, top * (1.0 - 0.1 * max(m, 0)))
        a, j = tight_a, tight_j
        if m >= 0:
            a, j = span_bounds(speed, accel, jerk, first, last, cap)
            if a == tight_a and j == tight_j:
                continue
        if ramp_distance(v0, v1, a, j) <= distance * (1.0 + SLACK):
            peak = peak_speed(v0, v1, distance, cap, a, j)
            time = profile_time(v0, v1, distance, peak, a, j)
            if time < best[3]:
                best = (peak, a, j, time)
        if cap == least:
            break
    return best


@njit
def best_split(
    bound_s: Floats,
    speed: Floats,
    accel: Floats,
    jerk: Floats,
    first: int,
    last: int,
    v0: float,
    v1: float,
    time: float,
) -> tuple[int, float]:
    """Where a span of uneven bounds is best cut in two, each part with its own bounds, and the
    speed there; (-1, 0) if that saves nothing.

    Bounds are tight where the path bends, mostly towards the ends of a span: the places tried are
    1, 2, 4 ... intervals from either end.
    """
    found = -1
    speed_there = 0.0
    best = time * (1.0 - WORTHWHILE)
    step = 1
    while step < last - first:
        for side in range(2):
            at = first + step if side == 0 else last - step
            limit = min(speed[at - 1], speed[at])
            a0, j0 = span_bounds(speed, accel, jerk, first, at, math.inf)
            a1, j1 = span_bounds(speed, accel, jerk, at, last, math.inf)
            d0 = bound_s[at] - bound_s[first]
            d1 = bound_s[last] - bound_s[at]
            v = min(limit, reachable_speed(v0, d0, a0, j0), reachable_speed(v1, d1, a1, j1))
            if ramp_distance(v0, v, a0, j0) > d0 * (1.0 + SLACK) or ramp_distance(
                v, v1, a1, j1
            ) > d1 * (1.0 + SLACK):
                continue
            before = best_profile(
                speed, accel, jerk, first, at, v0, v, d0, max(v0, v, speed[first:at].max())
            )
            after = best_profile(
                speed, accel, jerk, at, last, v, v1, d1, max(v, v1, speed[at:last].max())
            )
            if before[3] + after[3] < best:
                best = before[3] + after[3]
                found = at
                speed_there = v
        step *= 2
    return found, speed_there


@njit
def lowest_violation(
    bound_s: Floats,
    speed: Floats,
    first: int,
    last: int,
    v0: float,
    v1: float,
    peak: float,
    a: float,
    j: float,
) -> int:
    """The interval in [first, last) with the lowest speed bound that the profile breaks, or -1."""
    start = bound_s[first]
    end = bound_s[last]
    found = -1
    lowest = peak * (1.0 - SLACK)
    for k in range(first, last):
        v = speed[k]
        if v >= lowest:
            continue
        # The profile is above v between the point where the rise passes v and the point where the
        # fall does.
        rise = start if v0 >= v else start + ramp_distance_to_speed(v0, peak, a, j, v)
        fall = end if v1 >= v else end - ramp_distance_to_speed(v1, peak, a, j, v)
        tolerance = SLACK * (end - start) + 1e-15 * abs(end)
        if min(fall, bound_s[k + 1]) - max(rise, bound_s[k]) > tolerance:
            found = k
            lowest = v
    return found


@njit
def push(todo: Ints, queued: NDArray[np.int8], pending: int, i: int) -> int:
    """Put span ``i`` on the stack of spans to look at, once; returns the new height."""
    if i < 0 or queued[i]:
        return pending
    queued[i] = 1
    todo[pending] = i
    return pending + 1


@njit
def plan_window(
    bound_s: Floats,
    speed: Floats,
    accel: Floats,
    jerk: Floats,
    flat: NDArray[np.bool_],
    v_start: float,
    phases: Floats,
) -> tuple[int, int]:
    """Plan the window from speed ``v_start`` (zero acceleration) to rest at its end.

    bound_s (n + 1,): arc length at the intervals' ends; speed (n,); accel, jerk (n, levels); flat
    (n,): crossed at constant speed (a stop is a flat interval of no length at speed 0). phases (8 n
    + 16, 5): room for the result, rows of duration, s, v, a, j.

    Returns (status, phase count). START_TOO_FAST: by these bounds the motion can't be slowed in
    time from the fixed start.
    """
    n = len(speed)
    room = 2 * n + 4
    lo = np.zeros(room, np.int64)
    hi = np.zeros(room, np.int64)
    following = np.full(room, -1, np.int64)
    preceding = np.full(room, -1, np.int64)
    kind = np.full(room, FREE, np.int64)
    todo = np.zeros(room, np.int64)
    queued = np.zeros(room, np.int8)
    v = np.zeros(room)
    cap = np.full(room, math.inf)
    peak = np.zeros(room)
    span_a = np.zeros(room)
    span_j = np.zeros(room)

    count = 1
    kind[0] = FIXED
    v[0] = v_start
    for k in range(n):
        if flat[k]:
            lo[count] = k
            hi[count] = k + 1
            kind[count] = FORCED
            v[count] = speed[k]
            count += 1
    lo[count] = hi[count] = n
    kind[count] = FORCED
    count += 1
    pending = 0
    for i in range(count - 1, -1, -1):
        following[i] = i + 1 if i + 1 < count else -1
        preceding[i] = i - 1
        if following[i] >= 0:
            pending = push(todo, queued, pending, i)
    free = count  # nodes that were taken out are used again
    splits = 0
    # A span is looked at again when a neighbour changes, a few times at most; the bound only guards
    # against a fault here.
    for _ in range(1000 * (n + 4)):
        if pending == 0:
            break
        pending -= 1
        i = todo[pending]
        queued[i] = 0
        if kind[i] == FREE:
            continue
        k = following[i]
        first = hi[i]
        last = lo[k]
        faster, slower = (i, k) if v[i] > v[k] else (k, i)
        distance = bound_s[last] - bound_s[first]
        if last == first:
            if v[i] == v[k]:
                continue
            if kind[faster] == FIXED:
                return START_TOO_FAST, 0
            v[faster] = v[slower]
            pending = push(todo, queued, pending, preceding[faster])
            if following[faster] >= 0:
                pending = push(todo, queued, pending, faster)
            continue
        top = max(min(speed[first:last].max(), cap[i]), v[faster])
        peak[i], span_a[i], span_j[i], time = best_profile(
            speed, accel, jerk, first, last, v[i], v[k], distance, top
        )
        if time == math.inf and v[faster] > 0.0:
            if kind[faster] == FIXED:
                return START_TOO_FAST, 0
            before = preceding[faster]
            if kind[faster] == FOUND:
                # It stood where a bound was broken; with what is lower now there may be nothing to
                # break.
                after = following[faster]
                following[before] = after
                preceding[after] = before
                kind[faster] = FREE
                free = min(free, faster)
            else:
                a, j = span_bounds(speed, accel, jerk, first, last, math.inf)
                v[faster] = max(
                    v[slower], min(v[faster], reachable_speed(v[slower], distance, a, j))
                )
                if following[faster] >= 0:
                    pending = push(todo, queued, pending, faster)
            cap[before] = math.inf
            pending = push(todo, queued, pending, before)
            continue
        worst = lowest_violation(
            bound_s, speed, first, last, v[i], v[k], peak[i], span_a[i], span_j[i]
        )
        if worst < 0:
            if splits >= n or (
                span_a[i] >= UNEVEN * accel[first:last, 0].max()
                and span_j[i] >= UNEVEN * jerk[first:last, 0].max()
            ):
                continue
            new_lo, new_v = best_split(bound_s, speed, accel, jerk, first, last, v[i], v[k], time)
            new_hi = new_lo
            if new_lo < 0:
                continue
            splits += 1
        else:
            bound = speed[worst]
            left = worst
            while left > first and speed[left - 1] == bound:
                left -= 1
            right = worst + 1
            while right < last and speed[right] == bound:
                right += 1
            higher_left = left > first and speed[left - 1] > bound
            higher_right = right < last and speed[right] > bound
            if not higher_left and not higher_right:
                if bound >= v[faster]:
                    cap[i] = bound
                elif kind[faster] == FIXED:
                    return START_TOO_FAST, 0
                else:
                    # A bound below the speed at an end of its own span: the end must come down.
                    v[faster] = bound
                    pending = push(todo, queued, pending, preceding[faster])
                    if following[faster] >= 0:
                        pending = push(todo, queued, pending, faster)
                pending = push(todo, queued, pending, i)
                continue
            new_lo = left if higher_left else right
            new_hi = right if higher_right else left
            a, j = span_bounds(speed, accel, jerk, first, new_lo, math.inf)
            new_v = min(bound, reachable_speed(v[i], bound_s[new_lo] - bound_s[first], a, j))
            a, j = span_bounds(speed, accel, jerk, new_hi, last, math.inf)
            new_v = min(new_v, reachable_speed(v[k], bound_s[last] - bound_s[new_hi], a, j))
        while free < room and kind[free] != FREE:
            free += 1
        if free >= room:
            return NOT_FINISHED, 0
        lo[free] = new_lo
        hi[free] = new_hi
        v[free] = new_v
        kind[free] = FOUND
        following[free] = k
        preceding[free] = i
        following[i] = free
        preceding[k] = free
        cap[i] = cap[free] = math.inf
        pending = push(todo, queued, pending, free)
        pending = push(todo, queued, pending, i)
    if pending > 0:
        return NOT_FINISHED, 0

    written = 0
    i = 0
    while i >= 0:
        start = bound_s[lo[i]]
        end = bound_s[hi[i]]
        if end > start:
            phases[written, 0] = (end - start) / v[i]
            phases[written, 1] = start
            phases[written, 2] = v[i]
            phases[written, 3] = 0.0
            phases[written, 4] = 0.0
            written += 1
        k = following[i]
        if k >= 0 and lo[k] > hi[i]:
            written = write_profile(
                v[i], v[k], end, bound_s[lo[k]], peak[i], span_a[i], span_j[i], phases, written
            )
        i = k
    return PLANNED, written
