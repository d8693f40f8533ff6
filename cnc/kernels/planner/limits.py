"""Bounds on speed, tangential acceleration and jerk along pieces of path, constant on short
intervals.

At a point of the path q(s), with speed v, tangential acceleration a and jerk j, each axis i moves
with

    velocity      q_i' v
    acceleration  q_i'' v^2 + q_i' a
    jerk          q_i''' v^3 + 3 q_i'' v a + q_i' j

The curvature alone bounds v: sqrt(aN rho) for the normal acceleration aN, and (2/T) sqrt(h (2 rho -
h)) so that the chord of one period T stays within h of the curve (Hui, Wei, Gao 2013, equations 6
and 7 mended, as speeds); sqrt(24 delta) rho / T keeps that chord shorter than its arc by no more
than the part delta, the step deviation. The rest of each axis's limit is handed to a, then j.

A junction of two pieces may turn by a small angle or change its curvature at once. Sampled with
period T, a jump dv of an axis's velocity shows as an acceleration dv / T and a jerk dv / T^2, a
jump da of its acceleration as a jerk 3/4 da / T at most (the third difference is a mean weighted by
the quadratic B-spline, whose largest value is 3/4). A junction is crossed at the speed that keeps
these within the limits, constant for two periods either side so that nothing adds to it; a real
corner is a stop.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    LINE,
    METRIC,
    METRICS,
    curve_eval_s,
    curve_inv_arclen,
    curve_range,
)
from cnc.kernels.planner.scurve import reachable_speed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

LEVELS = 7
"""Levels of speed for the acceleration and jerk bounds: 1, 0.9 ... 0.4 of an interval's speed
bound.
"""

ACCEL_SHARE = 0.75
JERK_SHARE = 0.4
"""The part of an axis's limit that speed alone may take up on a curve; the rest is left to change
speed.
"""

TURNING_SHARE = 0.6
"""The part of an axis's jerk left by speed that acceleration while turning (3 q'' v a) may take
up.
"""

VARIATION = 0.02
"""How much the bounds may vary between neighbouring samples of one interval, relative to the
limits.
"""

BRIEF_VARIATION = 0.1
"""How much the speed bound may vary along the path in an interval that takes less than a period:
there is no time to lose in it.
"""

TURN = 0.1
"""Largest turn of the direction within an interval, rad."""

IN_SIGHT = 1.25
"""How far above the feed the other bounds on speed are followed: one that comes from above this
dips below the feed at no place unseen.
"""

REFINED = 1.6
"""How much faster than with room for changes of speed in any direction an interval may be crossed
in the end: it is cut for that speed.
"""

SAMPLES = 5
SHORTEST = 5e-8
"""mm; intervals are not made shorter than this, where curvature grows without bound towards a cusp.
A bend of less radius is a stop.
"""

BENT_SHARE = 1.0 / 16.0
"""The part of the jerk for the last way to a stop in such a bend. From a distance d the motion
stops with v = (9/2 J d^2)^(1/3) and a = (6 J^2 d)^(1/3); where the radius is d, q''' v^3 + 3 q'' v
a + q' j comes to 14.5 J, whatever d is.
"""

FLAT_PERIODS = 2.0
"""Periods at constant speed either side of a junction."""

FLAT_SHARE = 0.4
"""The part of a piece that the flat stretch at one of its ends may take."""

CORNER = 0.1
"""rad; a sharper turn is a stop: crossed at (jerk limit T^2) / CORNER it would save next to no
time.
"""

UNSEEN = 5e-4
"""The part of a limit that a jump may take without a flat stretch; the planner keeps that part of
the jerk limits free.
"""


@njit
def speed_bounds(
    data: Floats,
    at: int,
    q: Floats,
    feed: float,
    rules: Floats,
    axis_v: Floats,
    axis_a: Floats,
    axis_j: Floats,
) -> tuple[float, float]:
    """Largest speeds at a point of the piece at ``at``, from its derivatives by arc length ``q``
    (4, n).

    The first leaves each axis its shares of acceleration and jerk for changes of speed, whatever
    their direction; no motion is faster than the second.
    """
    top = feed
    curvature = curvature_of(data, at, q)
    if curvature > 0.0:
        radius = 1.0 / curvature
        top = min(top, math.sqrt(rules[2] * radius))
        # A half circle's chord leaves it by the radius, and no chord by more.
        sagitta = min(rules[3], radius)
        top = min(top, 2.0 / rules[4] * math.sqrt(sagitta * (2.0 * radius - sagitta)))
        top = min(top, math.sqrt(24.0 * (1.0 - UNSEEN) * rules[5]) * radius / rules[4])
    bend = 0.0
    twist = 0.0
    for i in range(q.shape[1]):
        if q[1, i] != 0.0:
            top = min(top, axis_v[i] / abs(q[1, i]))
        bend = max(bend, abs(q[2, i]) / axis_a[i])
        twist = max(twist, abs(q[3, i]) / axis_j[i])
    v = top
    if bend * v * v > ACCEL_SHARE:
        v = math.sqrt(ACCEL_SHARE / bend)
    if twist * v * v * v > JERK_SHARE:
        v = (JERK_SHARE / twist) ** (1.0 / 3.0)
    return v, top


@njit
def curvature_of(data: Floats, at: int, q: Floats) -> float:
    """Of the piece at ``at``, 1/mm, from its derivatives by arc length ``q`` (4, n)."""
    squared = 0.0
    for m in range(int(data[at + METRICS])):
        squared += q[2, int(data[at + METRIC + m])] ** 2
    return math.sqrt(squared)


@njit
def tangential_bounds(
    first: Floats,
    second: Floats,
    third: Floats,
    v: float,
    rules: Floats,
    axis_a: Floats,
    axis_j: Floats,
) -> tuple[float, float]:
    """Acceleration and jerk bounds at speeds up to ``v`` from bounds on |q'|, |q''|, |q'''| of each
    axis.
    """
    a = rules[0]
    j = rules[1]
    for i in range(len(first)):
        left = axis_a[i] - second[i] * v * v
        if first[i] > 0.0:
            a = min(a, left / first[i])
        if second[i] > 0.0 and v > 0.0:
            a = min(a, TURNING_SHARE * (axis_j[i] - third[i] * v * v * v) / (3.0 * second[i] * v))
    for i in range(len(first)):
        if first[i] > 0.0:
            left = axis_j[i] - third[i] * v * v * v
            if second[i] > 0.0:
                left -= 3.0 * second[i] * v * a
            j = min(j, left / first[i])
    return a, j


@njit
def junction(
    data: Floats,
    at: int,
    before: Floats,
    after: Floats,
    v: float,
    rules: Floats,
    axis_a: Floats,
    axis_j: Floats,
) -> tuple[float, bool]:
    """Speed for a junction between two pieces, given the derivatives (4, n) on both sides and the
    speed ``v`` wanted.

    data, at: either piece, for its metric axes. Returns (speed, flat): 0 for a stop; flat where the
    motion must be at constant speed.
    """
    period = rules[4]
    squared = 0.0
    for m in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + m])
        squared += (after[1, i] - before[1, i]) ** 2
    turn = math.sqrt(squared)
    # Per unit of speed (linear) and of speed squared: the part of a limit that the jump takes up.
    by_v = 0.0
    by_v2 = 0.0
    if turn > 0.0:
        by_v = turn / min(min(rules[0], rules[2]) * period, rules[1] * period * period)
        # The chord across the corner cuts it by (v T / 2) sin(turn / 2).
        by_v = max(by_v, turn * period / (4.0 * rules[3]))
    for i in range(before.shape[1]):
        jump = abs(after[1, i] - before[1, i])
        if jump > 0.0:
            by_v = max(by_v, jump / min(axis_a[i] * period, axis_j[i] * period * period))
        bend = abs(after[2, i] - before[2, i])
        if bend > 0.0:
            by_v2 = max(by_v2, 0.75 * bend / (axis_j[i] * period))
    # The step across a corner is shorter than the path by turn^2 / 8 at least.
    if turn > CORNER or turn * turn > 8.0 * rules[5]:
        return 0.0, True
    if by_v * v + by_v2 * v * v <= UNSEEN:
        return v, False
    # What the curves themselves take up at constant speed is there as well. The sum rises with the
    # speed: bisect.
    low = 0.0
    high = v
    for _ in range(60):
        taken = by_v * v + by_v2 * v * v
        for i in range(before.shape[1]):
            bend = max(abs(before[2, i]), abs(after[2, i]))
            twist = max(abs(before[3, i]), abs(after[3, i]))
            taken = max(taken, by_v * v + bend * v * v / axis_a[i])
            taken = max(taken, by_v * v + by_v2 * v * v + twist * v * v * v / axis_j[i])
        if taken <= 1.0 - UNSEEN:
            low = v
            if v == high:
                break
        else:
            high = v
        v = 0.5 * (low + high)
    v = low
    return v, True


@njit
def interval_samples(kind: int, data: Floats, at: int, start: float, end: float, q: Floats) -> None:
    """Derivatives by arc length at SAMPLES points of [start, end] into ``q`` (SAMPLES, 4, n)."""
    if kind == LINE:
        curve_eval_s(kind, data, at, 0.0, q[0])
        for m in range(1, SAMPLES):
            q[m] = q[0]
        return
    for m in range(SAMPLES):
        s = start + (end - start) * m / (SAMPLES - 1)
        curve_eval_s(kind, data, at, curve_inv_arclen(kind, data, at, s), q[m])


@njit
def bounds_vary(
    q: Floats,
    v: float,
    spacing: float,
    speed: Floats,
    rules: Floats,
    axis_a: Floats,
    axis_j: Floats,
) -> bool:
    """Whether an interval with these samples, ``spacing`` apart, is too long for constant bounds at
    speeds up to ``v``.

    Besides the samples' own variation this looks for what lies between them: a derivative's
    integral by the trapezoidal rule must give the change of the derivative below it.
    """
    lowest = speed[0]
    highest = speed[0]
    for m in range(1, SAMPLES):
        lowest = min(lowest, speed[m])
        highest = max(highest, speed[m])
    per_axis = False
    for i in range(q.shape[2]):
        per_axis = per_axis or axis_a[i] < math.inf or axis_j[i] < math.inf
    brief = not per_axis and (SAMPLES - 1) * spacing < lowest * rules[4]
    if highest - lowest > (BRIEF_VARIATION if brief else VARIATION) * lowest:
        return True
    turn = TURN / (SAMPLES - 1) if per_axis else TURN
    for m in range(1, SAMPLES):
        for i in range(q.shape[2]):
            if abs(q[m, 1, i] - q[m - 1, 1, i]) > turn:
                return True
            if abs(abs(q[m, 2, i]) - abs(q[m - 1, 2, i])) * v * v > VARIATION * axis_a[i]:
                return True
            if abs(abs(q[m, 3, i]) - abs(q[m - 1, 3, i])) * v * v * v > VARIATION * axis_j[i]:
                return True
            unseen = 1.5 * abs(
                (q[m, 1, i] - q[m - 1, 1, i]) / spacing - 0.5 * (q[m, 2, i] + q[m - 1, 2, i])
            )
            if unseen * v * v > VARIATION * min(rules[2], axis_a[i]):
                return True
            unseen = 1.5 * abs(
                (q[m, 2, i] - q[m - 1, 2, i]) / spacing - 0.5 * (q[m, 3, i] + q[m - 1, 3, i])
            )
            if unseen * v * v * v > VARIATION * axis_j[i]:
                return True
    return False


@njit
def write_interval(
    start: float, end: float, v: float, top: float, flat: bool, first: Floats, second: Floats, third: Floats, q: Floats,
    rules: Floats, axis_a: Floats, axis_j: Floats, share: float, count: int,
    out_end: Floats, out_speed: Floats, out_top: Floats, out_accel: Floats, out_jerk: Floats, out_flat: Flags,
    out_sampled: Floats, out_samples: Floats,
) -> int:  # fmt: skip
    """Append an interval, with its bounds at every level of speed, a share of them, and the path's
    derivatives; returns the new count.
    """
    out_end[count] = end
    out_speed[count] = v * (1.0 - 1e-9)
    out_top[count] = top * (1.0 - 1e-9)
    out_flat[count] = flat
    out_sampled[count, 0] = start
    out_sampled[count, 1] = end
    for m in range(SAMPLES):
        for order in range(3):
            for i in range(q.shape[2]):
                out_samples[count, m, order, i] = q[m, order + 1, i]
    for m in range(LEVELS):
        a, j = tangential_bounds(first, second, third, v * (1.0 - 0.1 * m), rules, axis_a, axis_j)
        out_accel[count, m] = share * a * (1.0 - 1e-6)
        out_jerk[count, m] = share * j * (1.0 - 2.0 * UNSEEN)
    return count + 1


@njit
def lowest_between(speed: Floats) -> float:
    """A bound for the speeds between the samples too: below the lowest by part of what they
    vary.
    """
    lowest = speed[0]
    highest = speed[0]
    for m in range(1, SAMPLES):
        lowest = min(lowest, speed[m])
        highest = max(highest, speed[m])
    return lowest - 0.125 * min(highest - lowest, lowest)


@njit
def gather(q: Floats, speed: Floats, first: Floats, second: Floats, third: Floats) -> float:
    """Fold the samples into bounds on |q'|, |q''|, |q'''| of each axis; returns the speed bound of
    the interval.

    Between samples a bound may be passed by a fraction of its variation from sample to sample: that
    much is added.
    """
    for i in range(q.shape[2]):
        first[i] = second[i] = third[i] = 0.0
        for m in range(SAMPLES):
            first[i] = max(first[i], abs(q[m, 1, i]))
            second[i] = max(second[i], abs(q[m, 2, i]))
            third[i] = max(third[i], abs(q[m, 3, i]))
        for m in range(1, SAMPLES):
            first[i] = max(first[i], abs(q[m, 1, i]) + 0.25 * abs(q[m, 1, i] - q[m - 1, 1, i]))
            second[i] = max(second[i], abs(q[m, 2, i]) + 0.25 * abs(q[m, 2, i] - q[m - 1, 2, i]))
            third[i] = max(third[i], abs(q[m, 3, i]) + 0.25 * abs(q[m, 3, i] - q[m - 1, 3, i]))
    return lowest_between(speed)


@njit
def joint(
    kind_a: int, data_a: Floats, at_a: int, length_a: float, feed_a: float,
    kind_b: int, data_b: Floats, at_b: int, length_b: float, feed_b: float,
    rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats, q: Floats,
) -> tuple[float, bool]:  # fmt: skip
    """Speed at the junction of piece a and the piece b after it, and whether it is flat (see
    :func:`junction`). q: scratch (2+, 4, n).
    """
    differ = data_a[at_a + METRICS] != data_b[at_b + METRICS]
    for m in range(int(data_a[at_a + METRICS])):
        differ = differ or data_a[at_a + METRIC + m] != data_b[at_b + METRIC + m]
    singular = curve_eval_s(kind_a, data_a, at_a, curve_range(kind_a, data_a, at_a)[1], q[0])
    singular += curve_eval_s(kind_b, data_b, at_b, curve_range(kind_b, data_b, at_b)[0], q[1])
    if (
        singular != 0
        or differ
        or max(curvature_of(data_a, at_a, q[0]), curvature_of(data_b, at_b, q[1])) * SHORTEST > 1.0
    ):
        return 0.0, True
    v_a, top_a = speed_bounds(data_a, at_a, q[0], feed_a, rules, axis_v, axis_a, axis_j)
    v_b, top_b = speed_bounds(data_b, at_b, q[1], feed_b, rules, axis_v, axis_a, axis_j)
    v = min(v_a, v_b)
    top = min(top_a, top_b)
    room = FLAT_SHARE * min(length_a, length_b) / (FLAT_PERIODS * rules[4])
    speed, flat = junction(data_a, at_a, q[0], q[1], v, rules, axis_a, axis_j)
    if not flat and top > v:
        # A refined motion may be as fast as that.
        flat = junction(data_a, at_a, q[0], q[1], top, rules, axis_a, axis_j)[1]
    return (min(speed, room), True) if flat else (speed, False)


@njit
def attainable_speed(
    kind: int,
    data: Floats,
    at: int,
    length: float,
    feed: float,
    rules: Floats,
    axis_v: Floats,
    axis_a: Floats,
    axis_j: Floats,
    q: Floats,
) -> float:
    """A speed that no motion exceeds on a curve: ``feed``, or what it can gain over the piece
    beside its slowest place. q: scratch.

    Most of a short curve about a tight bend would allow speeds that are out of reach there; bounds
    on them needn't be known.
    """
    interval_samples(kind, data, at, 0.0, length, q)
    lowest = feed
    for m in range(SAMPLES):
        lowest = min(lowest, speed_bounds(data, at, q[m], feed, rules, axis_v, axis_a, axis_j)[1])
    squared = 0.0
    for i in range(len(axis_a)):
        squared += axis_a[i] * axis_a[i]
    return min(feed, math.sqrt(lowest * lowest + 2.0 * min(rules[0], math.sqrt(squared)) * length))


@njit
def chunk_intervals(
    kind: Ints, at: Ints, data: Floats, length: Floats, feed: Floats, stop_after: Flags,
    v_in: float, flat_in: bool, v_out: float, flat_out: bool, rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats,
    out_end: Floats, out_speed: Floats, out_top: Floats, out_accel: Floats, out_jerk: Floats, out_flat: Flags,
    out_sampled: Floats, out_samples: Floats,
) -> int:  # fmt: skip
    """Cut the pieces of a chunk into intervals with constant bounds.

    feed (m,): mm/s, inf where only the axes limit it. v_in, flat_in, v_out, flat_out: the junctions
    with the chunks before and after. rules: tangential acceleration, jerk, normal acceleration,
    chord error, period, step deviation. out_*: room for where each interval ends (arc length from
    the chunk's start), its speed bounds (see :func:`speed_bounds`), its bounds by level of speed,
    its flatness, from where to where it was sampled, and q', q'', q''' at SAMPLES points. Returns
    the number of intervals, or -1 where there was no room for them.
    """
    axes = len(axis_v)
    q = np.zeros((SAMPLES, 4, axes))
    speed = np.zeros(SAMPLES)
    tops = np.zeros(SAMPLES)
    first = np.zeros(axes)
    second = np.zeros(axes)
    third = np.zeros(axes)
    count = 0
    base = 0.0
    v_before, flat_before = v_in, flat_in
    for k in range(len(kind)):
        if k + 1 < len(kind):
            v_after, flat_after = joint(
                kind[k], data, at[k], length[k], feed[k], kind[k + 1], data, at[k + 1], length[k + 1], feed[k + 1],
                rules, axis_v, axis_a, axis_j, q,
            )  # fmt: skip
        else:
            v_after, flat_after = v_out, flat_out
        if stop_after[k]:
            v_after, flat_after = 0.0, True
        shape = kind[k]
        flat_from = FLAT_PERIODS * rules[4] * v_before if flat_before else 0.0
        flat_to = length[k] - (FLAT_PERIODS * rules[4] * v_after if flat_after else 0.0)
        fastest = feed[k]
        if shape != LINE:
            fastest = attainable_speed(
                shape, data, at[k], length[k], fastest, rules, axis_v, axis_a, axis_j, q
            )
        start = 0.0
        step = length[k]
        while start < length[k]:
            if count + 2 > len(out_end):
                return -1
            # Flat stretches are cut like the others: what touches has one speed.
            flat = start < flat_from or start >= flat_to
            limit = flat_from if start < flat_from else flat_to if start < flat_to else length[k]
            end = min(start + step, limit)
            if limit - end < 1e-9 * length[k]:
                end = limit
            while True:
                interval_samples(shape, data, at[k], start, end, q)
                for m in range(SAMPLES):
                    speed[m], tops[m] = speed_bounds(
                        data, at[k], q[m], IN_SIGHT * fastest, rules, axis_v, axis_a, axis_j
                    )
                v = min(fastest, gather(q, speed, first, second, third))
                top = min(fastest, lowest_between(tops))
                if shape == LINE or end - start <= SHORTEST:
                    break
                if not bounds_vary(
                    q,
                    min(top, REFINED * v),
                    (end - start) / (SAMPLES - 1),
                    speed,
                    rules,
                    axis_a,
                    axis_j,
                ):
                    break
                end = start + 0.5 * (end - start)
            share = 1.0
            if end - start <= SHORTEST:
                sharp = (
                    v_before == 0.0
                    and start == 0.0
                    and curvature_of(data, at[k], q[0]) * SHORTEST > 1.0
                )
                sharp = sharp or (
                    v_after == 0.0
                    and end == length[k]
                    and curvature_of(data, at[k], q[SAMPLES - 1]) * SHORTEST > 1.0
                )
                if sharp:
                    # All that matters of the bend is in the share.
                    q[:, 2:] = 0.0
                    share = BENT_SHARE
                    gather(q, speed, first, second, third)
                    a, j = tangential_bounds(first, second, third, 0.0, rules, axis_a, axis_j)
                    v = top = min(fastest, reachable_speed(0.0, end - start, share * a, share * j))
            if flat:
                v = min(v, v_before if start < flat_from else v_after)
            step = 2.0 * (end - start)
            count = write_interval(
                base + start, base + end, v, top, flat, first, second, third, q, rules, axis_a, axis_j, share, count,
                out_end, out_speed, out_top, out_accel, out_jerk, out_flat, out_sampled, out_samples,
            )  # fmt: skip
            start = end
        if flat_after and v_after == 0.0:
            if count + 1 > len(out_end):
                return -1
            # The path at the stop is the path at the end of the interval before.
            for m in range(SAMPLES - 1):
                q[m] = q[SAMPLES - 1]
            second[:] = 0.0
            third[:] = 0.0
            count = write_interval(
                base + length[k], base + length[k], 0.0, 0.0, True, first, second, third, q, rules, axis_a, axis_j, 1.0, count,
                out_end, out_speed, out_top, out_accel, out_jerk, out_flat, out_sampled, out_samples,
            )  # fmt: skip
        base += length[k]
        v_before, flat_before = v_after, flat_after
    return count
