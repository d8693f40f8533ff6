r"""Look-ahead over a window of intervals with constant bounds.

The path is cut into intervals k with bounds on speed V[k], tangential acceleration A[k, .] and jerk
J[k, .]. The last two are for levels of speed: slower motion on a curve leaves more of an axis to
the tangential part. The plan is a chain of *nodes* at zero acceleration joined by seven-phase
profiles (:mod:`cnc.planner.kernels.scurve`):

      v                 ____________________
        V   ___________|                    |_____
           |         __------____                 |
           |      __/  profile   \__              |
        ---|___--/                  \\--___________|
             o node                     o node

1. Forced nodes come first: stops, and junctions that are crossed at constant speed.
2. A span between two nodes gets the fastest profile for its ends and length. If the speeds of its
   ends are too far apart for the distance, the faster one is lowered.
3. If the profile exceeds the speed bound of an interval, the lowest such bound becomes a node: its
   whole plateau in a valley, one end of it on a flank. Both new spans go back to step 2.

A span whose bounds on acceleration and jerk are uneven is cut where that saves time: each part has
its own bounds.

Since the lowest bound comes first, a node stands where the path itself forces a low speed, and a
profile spans everything that does not bind. Every profile is legal on every interval that it
crosses, so the chain is legal. It is fast because it has few nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import Phases, write_phase
from cnc.planner.kernels.intervals import Intervals
from cnc.planner.kernels.scurve import (
    peak_speed,
    ramp_distance,
    ramp_distance_to_speed,
    ramp_time,
    reachable_speed,
    write_profile,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Profiles over a span of intervals: the fastest one, its violations, and the best cut.

WORTHWHILE = 0.005
"""A cut has to save this part of the time of the span."""

SLACK = 1e-12
"""Relative; a distance or a speed may exceed its bound by this rounding error."""


class Profile(NamedTuple):
    """A profile over a span.

    Attributes:
        peak: largest speed, mm/s.
        accel: mm/s^2.
        jerk: mm/s^3.
        time: duration, s; infinite if no ramp between the ends fits.
    """

    peak: float
    accel: float
    jerk: float
    time: float


@njit
def level_of(ratio: float, levels: int) -> int:
    """Return the lowest level of speed that covers ``ratio`` of an interval's speed bound.

    The levels fall evenly from 1 (:data:`cnc.planner.kernels.intervals.LEVELS`).
    """
    if ratio >= 1.0:
        return 0
    return min(int((1.0 - ratio) * 10.0 + 1e-9), levels - 1)


@njit
def span_bounds(intervals: Intervals, first: int, last: int, v: float) -> tuple[float, float]:
    """Return the least acceleration and jerk bounds over the intervals [first, last).

    They hold for motion no faster than ``v``.
    """
    speed, accel, jerk = intervals.speed, intervals.accel, intervals.jerk
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
    """Return the duration of the ramps v0 -> peak -> v1 and the cruise between them."""
    if peak <= 0.0:
        return math.inf
    cruise = distance - ramp_distance(v0, peak, a, j) - ramp_distance(peak, v1, a, j)
    return ramp_time(v0, peak, a, j) + ramp_time(peak, v1, a, j) + max(cruise, 0.0) / peak


@njit
def best_profile(
    intervals: Intervals, first: int, last: int, v0: float, v1: float, distance: float, top: float
) -> Profile:
    """Return the fastest profile over the intervals [first, last) for some choice of its peak.

    The bounds that hold at an interval's full speed hold at any lower one, so they are tried first.
    A lower peak may leave more of an axis to the acceleration, but it has a lower jerk bound.

    Args:
        intervals: the intervals.
        first: the first of them in the range.
        last: the one behind the range.
        v0: speed at the start, mm/s.
        v1: speed at the end.
        distance: length of the span, mm.
        top: largest speed, mm/s.
    """
    least = max(v0, v1)
    best = Profile(least, 0.0, 0.0, math.inf)
    tight_a, tight_j = span_bounds(intervals, first, last, math.inf)
    for m in range(-1, intervals.accel.shape[1]):
        cap = max(least, top * (1.0 - 0.1 * max(m, 0)))
        a, j = tight_a, tight_j
        if m >= 0:
            a, j = span_bounds(intervals, first, last, cap)
            if a == tight_a and j == tight_j:
                continue
        if ramp_distance(v0, v1, a, j) <= distance * (1.0 + SLACK):
            peak = peak_speed(v0, v1, distance, cap, a, j)
            time = profile_time(v0, v1, distance, peak, a, j)
            if time < best.time:
                best = Profile(peak, a, j, time)
        if cap == least:
            break
    return best


@njit
def best_cut(
    bound_s: Floats, intervals: Intervals, first: int, last: int, v0: float, v1: float, time: float
) -> tuple[int, float]:
    """Return the best bound at which to cut a span of uneven bounds in two, and the speed there.

    It is (-1, 0) if no cut saves time. Bounds are tight where the path bends, mostly towards the
    ends of a span: the places tried are 1, 2, 4 ... intervals from either end.

    Args:
        bound_s: (n + 1,): arc lengths at the ends of the intervals, mm.
        intervals: the n intervals.
        first: the first interval of the span.
        last: the interval behind it.
        v0: speed at its start, mm/s.
        v1: speed at its end.
        time: its duration without a cut, s.
    """
    speed = intervals.speed
    best_at = -1
    speed_there = 0.0
    best = time * (1.0 - WORTHWHILE)
    step = 1
    while step < last - first:
        for side in range(2):
            at = first + step if side == 0 else last - step
            limit = min(speed[at - 1], speed[at])
            a0, j0 = span_bounds(intervals, first, at, math.inf)
            a1, j1 = span_bounds(intervals, at, last, math.inf)
            d0 = bound_s[at] - bound_s[first]
            d1 = bound_s[last] - bound_s[at]
            v = min(limit, reachable_speed(v0, d0, a0, j0), reachable_speed(v1, d1, a1, j1))
            if ramp_distance(v0, v, a0, j0) > d0 * (1.0 + SLACK) or ramp_distance(
                v, v1, a1, j1
            ) > d1 * (1.0 + SLACK):
                continue
            top0 = max(v0, v, speed[first:at].max())
            top1 = max(v, v1, speed[at:last].max())
            before = best_profile(intervals, first, at, v0, v, d0, top0)
            after = best_profile(intervals, at, last, v, v1, d1, top1)
            if before.time + after.time < best:
                best = before.time + after.time
                best_at = at
                speed_there = v
        step *= 2
    return best_at, speed_there


@njit
def lowest_violation(
    bound_s: Floats, speed: Floats, first: int, last: int, v0: float, v1: float, profile: Profile
) -> int:
    """Return the interval in [first, last) with the lowest speed bound that the profile exceeds.

    It is -1 if there is none.
    """
    peak, a, j = profile.peak, profile.accel, profile.jerk
    start = bound_s[first]
    end = bound_s[last]
    violated = -1
    lowest = peak * (1.0 - SLACK)
    for k in range(first, last):
        v = speed[k]
        if v >= lowest:
            continue
        # The profile exceeds v from the place where its rise reaches v to where its fall does.
        rise = start if v0 >= v else start + ramp_distance_to_speed(v0, peak, a, j, v)
        fall = end if v1 >= v else end - ramp_distance_to_speed(v1, peak, a, j, v)
        tolerance = SLACK * (end - start) + 1e-15 * abs(end)
        if min(fall, bound_s[k + 1]) - max(rise, bound_s[k]) > tolerance:
            violated = k
            lowest = v
    return violated


PLANNED = 0
START_TOO_FAST = 1
NOT_FINISHED = 2
"""Status of a plan. START_TOO_FAST: by these bounds the motion cannot slow in time from its start.
NOT_FINISHED: the search did not end, which is an error in this module.
"""

UNUSED = -1
FIXED = 0
FORCED = 1
FOUND = 2
CUT = 3
"""Kinds of nodes: the start, those that the path forces, those at a bound that was exceeded, and
those where an uneven span was cut.
"""

UNEVEN = 0.7
"""A span is cut only if some of its bounds are below this part of the largest."""

CUTS = 3
"""A span is cut so often at a place. At the first time its ends may be too fast still; but the same
few cuts could be made and taken back without an end.
"""

CUT_WORK = 16
"""Spans are cut until this times the number of all intervals was examined for it.

A quarter of it gave 39 random programs the same times, and others needed less than half of it. Each
cut may examine most of the intervals, so their number alone does not bound the work.
"""


class Chain(NamedTuple):
    """Nodes of a plan and the spans behind them, as a linked list in arrays of one size.

    Attributes:
        first: the bound at which a node begins: bound k is the start of interval k.
        last: the bound at which it ends.
        following: the next node; -1 for none.
        preceding: the node before; -1 for none.
        kind: UNUSED, FIXED, FORCED, FOUND or CUT.
        v: speed at the node, mm/s.
        cap: largest speed in the span behind the node, mm/s.
        peak: largest speed in the profile of that span, mm/s.
        accel: its acceleration.
        jerk: its jerk.
        stack: spans to be examined, by their node.
        queued: whether a span is on the stack.
        taken_back: how often a cut at each bound was taken back.
    """

    first: Ints
    last: Ints
    following: Ints
    preceding: Ints
    kind: Ints
    v: Floats
    cap: Floats
    peak: Floats
    accel: Floats
    jerk: Floats
    stack: Ints
    queued: NDArray[np.bool_]
    taken_back: Ints


@njit
def push(chain: Chain, pending: int, i: int) -> int:
    """Put the span behind node ``i`` on the stack, unless it is there; return the new height.

    Node -1, and the last one, have no span.
    """
    if i < 0 or chain.following[i] < 0 or chain.queued[i]:
        return pending
    chain.queued[i] = True
    chain.stack[pending] = i
    return pending + 1


@njit
def forced_nodes(intervals: Intervals, v_start: float) -> tuple[Chain, int]:
    """Return a chain of the start, the forced nodes and the end, and the number of its nodes."""
    n = len(intervals.speed)
    space = 2 * n + 4
    chain = Chain(
        np.zeros(space, np.int64),
        np.zeros(space, np.int64),
        np.full(space, -1, np.int64),
        np.full(space, -1, np.int64),
        np.full(space, UNUSED, np.int64),
        np.zeros(space),
        np.full(space, math.inf),
        np.zeros(space),
        np.zeros(space),
        np.zeros(space),
        np.zeros(space, np.int64),
        np.zeros(space, np.bool_),
        np.zeros(n + 1, np.int64),
    )
    count = 1
    chain.kind[0] = FIXED
    chain.v[0] = v_start
    for k in range(n):
        if intervals.flat[k]:
            chain.first[count] = k
            chain.last[count] = k + 1
            chain.kind[count] = FORCED
            chain.v[count] = intervals.speed[k]
            count += 1
    chain.first[count] = n
    chain.last[count] = n
    chain.kind[count] = FORCED
    count += 1
    for i in range(count):
        chain.following[i] = i + 1 if i + 1 < count else -1
        chain.preceding[i] = i - 1
    return chain, count


@njit
def lower(chain: Chain, pending: int, i: int, v: float) -> int:
    """Lower the speed of node ``i``, examine the spans beside it again; return the new height."""
    chain.v[i] = v
    pending = push(chain, pending, chain.preceding[i])
    return push(chain, pending, i)


@njit
def node_at(
    bound_s: Floats, intervals: Intervals, chain: Chain, i: int, worst: int
) -> tuple[int, int, float]:
    """Return the node at the bound of interval ``worst``, which the span behind ``i`` exceeds.

    Returns:
        The bounds at which it begins and ends, and its speed; (-1, -1, bound) if the whole span
        has the bound.
    """
    speed = intervals.speed
    k = chain.following[i]
    first = chain.last[i]
    last = chain.first[k]
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
        return -1, -1, bound
    new_first = left if higher_left else right
    new_last = right if higher_right else left
    a, j = span_bounds(intervals, first, new_first, math.inf)
    v = min(bound, reachable_speed(chain.v[i], bound_s[new_first] - bound_s[first], a, j))
    a, j = span_bounds(intervals, new_last, last, math.inf)
    v = min(v, reachable_speed(chain.v[k], bound_s[last] - bound_s[new_last], a, j))
    return new_first, new_last, v


@njit
def insert(chain: Chain, free: int, i: int, first: int, last: int, v: float, kind: int) -> None:
    """Insert node ``free`` of a kind behind node ``i``."""
    k = chain.following[i]
    chain.first[free] = first
    chain.last[free] = last
    chain.v[free] = v
    chain.kind[free] = kind
    chain.following[free] = k
    chain.preceding[free] = i
    chain.following[i] = free
    chain.preceding[k] = free
    chain.cap[i] = math.inf
    chain.cap[free] = math.inf


@njit
def retreat(
    bound_s: Floats,
    intervals: Intervals,
    chain: Chain,
    pending: int,
    free: int,
    i: int,
    faster: int,
    slower: int,
) -> tuple[int, int]:
    """Take back the faster end of the span behind node ``i``, through which no profile leads.

    A node at a bound that was exceeded is removed: at the lower speed perhaps none is. So is a cut.
    The speed of a forced node is lowered.

    Returns:
        The height of the stack, and the first node that may be free.
    """
    before = chain.preceding[faster]
    if chain.kind[faster] == FOUND or chain.kind[faster] == CUT:
        if chain.kind[faster] == CUT:
            chain.taken_back[chain.first[faster]] += 1
        after = chain.following[faster]
        chain.following[before] = after
        chain.preceding[after] = before
        chain.kind[faster] = UNUSED
        free = min(free, faster)
    else:
        first, last = chain.last[i], chain.first[chain.following[i]]
        a, j = span_bounds(intervals, first, last, math.inf)
        reached = reachable_speed(chain.v[slower], bound_s[last] - bound_s[first], a, j)
        chain.v[faster] = max(chain.v[slower], min(chain.v[faster], reached))
        pending = push(chain, pending, faster)
    chain.cap[before] = math.inf
    return push(chain, pending, before), free


@njit
def write_chain(bound_s: Floats, chain: Chain, phases: Phases) -> int:
    """Write the phases of a finished chain; return their number."""
    written = 0
    i = 0
    while i >= 0:
        start = bound_s[chain.first[i]]
        end = bound_s[chain.last[i]]
        v = chain.v[i]
        if end > start:
            write_phase(phases, written, (end - start) / v, start, v, 0.0, 0.0)
            written += 1
        k = chain.following[i]
        if k >= 0 and chain.first[k] > chain.last[i]:
            written = write_profile(
                v,
                chain.v[k],
                end,
                bound_s[chain.first[k]],
                chain.peak[i],
                chain.accel[i],
                chain.jerk[i],
                phases,
                written,
            )
        i = k
    return written


@njit
def largest(limits: Floats, first: int, last: int) -> float:
    """Return the largest limit at the beginning of the intervals first .. last - 1."""
    most = limits[first, 0]
    for k in range(first + 1, last):
        most = max(most, limits[k, 0])
    return float(most)


@njit
def plan_window(
    start: float, intervals: Intervals, v_start: float, phases: Phases
) -> tuple[int, int]:
    """Plan a window from speed ``v_start`` and zero acceleration to rest at its end.

    Args:
        start: arc length at the start, mm.
        intervals: the n intervals behind the start.
        v_start: mm/s.
        phases: (8 n + 16,): space for the result.

    Returns:
        The status (PLANNED, START_TOO_FAST or NOT_FINISHED) and the number of phases.
    """
    speed, accel, jerk = intervals.speed, intervals.accel, intervals.jerk
    n = len(speed)
    bound_s = np.empty(n + 1)
    bound_s[0] = start
    for k in range(n):
        bound_s[k + 1] = intervals.end[k]
    chain, free = forced_nodes(intervals, v_start)
    kind, v, cap = chain.kind, chain.v, chain.cap
    pending = 0
    for i in range(free - 1, -1, -1):
        pending = push(chain, pending, i)
    examined = 0
    # A span is examined again when a neighbour changes, a few times at most; this bound is never
    # reached without an error in the search.
    for _ in range(1000 * (n + 4)):
        if pending == 0:
            break
        pending -= 1
        i = chain.stack[pending]
        chain.queued[i] = False
        if kind[i] == UNUSED:
            continue
        k = chain.following[i]
        first = chain.last[i]
        last = chain.first[k]
        faster, slower = (i, k) if v[i] > v[k] else (k, i)
        distance = bound_s[last] - bound_s[first]
        if last == first:
            if v[i] == v[k]:
                continue
            if kind[faster] == FIXED:
                return START_TOO_FAST, 0
            pending = lower(chain, pending, faster, v[slower])
            continue
        top = max(min(speed[first:last].max(), cap[i]), v[faster])
        profile = best_profile(intervals, first, last, v[i], v[k], distance, top)
        chain.peak[i] = profile.peak
        chain.accel[i] = profile.accel
        chain.jerk[i] = profile.jerk
        if profile.time == math.inf and v[faster] > 0.0:
            if kind[faster] == FIXED:
                return START_TOO_FAST, 0
            pending, free = retreat(bound_s, intervals, chain, pending, free, i, faster, slower)
            continue
        worst = lowest_violation(bound_s, speed, first, last, v[i], v[k], profile)
        if worst < 0:
            if examined > CUT_WORK * n or (
                profile.accel >= UNEVEN * largest(accel, first, last)
                and profile.jerk >= UNEVEN * largest(jerk, first, last)
            ):
                continue
            examined += last - first
            new_first, new_v = best_cut(bound_s, intervals, first, last, v[i], v[k], profile.time)
            new_last, new_kind = new_first, CUT
            if new_first < 0 or chain.taken_back[new_first] >= CUTS:
                continue
        else:
            new_first, new_last, new_v = node_at(bound_s, intervals, chain, i, worst)
            new_kind = FOUND
            if new_first < 0:
                if new_v >= v[faster]:
                    cap[i] = new_v
                elif kind[faster] == FIXED:
                    return START_TOO_FAST, 0
                else:
                    # The bound is below the speed at an end of its own span.
                    pending = lower(chain, pending, faster, new_v)
                pending = push(chain, pending, i)
                continue
        while free < len(kind) and kind[free] != UNUSED:
            free += 1
        if free >= len(kind):
            return NOT_FINISHED, 0
        insert(chain, free, i, new_first, new_last, new_v, new_kind)
        pending = push(chain, pending, free)
        pending = push(chain, pending, i)
    if pending > 0:
        return NOT_FINISHED, 0
    return PLANNED, write_chain(bound_s, chain, phases)
