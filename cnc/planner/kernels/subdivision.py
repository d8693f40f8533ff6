"""Pieces of a path cut into short intervals with constant bounds.

On each interval the bounds of :mod:`cnc.planner.kernels.limits` vary little. An interval starts
with the length of its piece and is halved until samples at five points show that. Constant bounds
make the look-ahead over thousands of intervals cheap (:mod:`cnc.planner.kernels.lookahead`), and
the samples let the refinement evaluate the exact limits (:mod:`cnc.planner.kernels.refine`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import LINE, Pieces, curve_eval_s
from cnc.planner.kernels.arrays import LimitArrays
from cnc.planner.kernels.intervals import LEVELS, SAMPLES, Intervals
from cnc.planner.kernels.limits import (
    SHORTEST,
    TURNING_SHARE,
    UNSEEN,
    Junction,
    curvature_of,
    piece_junction,
    speed_bounds,
)
from cnc.planner.kernels.scurve import reachable_speed

Floats = NDArray[np.float64]

# Samples of an interval of path, and the bounds that follow from them.

VARIATION = 0.05
"""Largest variation of the bounds between neighbouring samples of an interval, relative to the
limits.
"""

BRIEF_VARIATION = 0.1
"""Largest variation of the speed bound along the path in an interval that takes less than a period,
where no time can be lost.
"""

BRIEF, BRIEF_SHARE = 1e-3, 0.5
"""s; an interval that the motion crosses in less time at its speed bound is cut for this share of
the speed of others: there is hardly time to go faster in it. In five axes, where a tolerance of
0.5 um leaves corners of 0.01 mm, a third of the intervals and half the computing time are left.
"""

TURN = 0.1
"""Largest turn of the direction within an interval, rad."""


class Sampling(NamedTuple):
    """Samples of an interval under examination, and bounds derived from them.

    Attributes:
        q: (SAMPLES, 4, axes): derivatives of the path by arc length, of order 0 to 3.
        speed: (SAMPLES,): speed bounds that leave acceleration for any direction, mm/s.
        top: (SAMPLES,): speeds that no motion exceeds, mm/s.
        first: (axes,): bounds of |q'| over the interval.
        second: (axes,): bounds of |q''|.
        third: (axes,): bounds of |q'''|.
    """

    q: Floats
    speed: Floats
    top: Floats
    first: Floats
    second: Floats
    third: Floats


@njit
def tangential_bounds(sampling: Sampling, v: float, limits: LimitArrays) -> tuple[float, float]:
    """Return bounds on acceleration and jerk over the sampled interval at speeds up to ``v``."""
    first, second, third = sampling.first, sampling.second, sampling.third
    axis_a, axis_j = limits.axis_acceleration, limits.axis_jerk
    a = limits.tangential_acceleration
    j = limits.tangential_jerk
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
def sample(pieces: Pieces, k: int, start: float, end: float, q: Floats) -> None:
    """Write the derivatives at SAMPLES points of [start, end] of a piece to ``q``."""
    kind, data, at = pieces.kind[k], pieces.data, pieces.at[k]
    if kind == LINE:
        curve_eval_s(kind, data, at, 0.0, q[0])
        for m in range(1, SAMPLES):
            # An assignment of arrays compiles the text of an error message, for 3 CPU s.
            for i in range(q.shape[2]):
                q[m, 0, i], q[m, 1, i] = q[0, 0, i], q[0, 1, i]
                q[m, 2, i] = q[m, 3, i] = 0.0
        return
    for m in range(SAMPLES):
        s = start + (end - start) * m / (SAMPLES - 1)
        curve_eval_s(kind, data, at, curve_inv_arclen(kind, data, at, s), q[m])


@njit
def sample_first_half(pieces: Pieces, k: int, start: float, end: float, q: Floats) -> None:
    """Replace the samples of an interval by those of its first half [start, end], on a curve.

    Three of them are known.
    """
    kind, data, at = pieces.kind[k], pieces.data, pieces.at[k]
    for m in range(SAMPLES - 1, 0, -1):
        if m % 2 == 0:
            for order in range(4):
                for i in range(q.shape[2]):
                    q[m, order, i] = q[m // 2, order, i]
    for m in range(1, SAMPLES, 2):
        s = start + (end - start) * m / (SAMPLES - 1)
        curve_eval_s(kind, data, at, curve_inv_arclen(kind, data, at, s), q[m])


@njit
def sampled_speed(sampling: Sampling, spacing: float, limits: LimitArrays) -> float:
    """Return the speed up to which an interval is short enough for constant bounds, mm/s.

    It is 0 if the interval is too long at any speed. Besides the variation of the samples this
    estimates the variation between them: by the trapezoidal rule, the integral of a derivative must
    be the change of the derivative below it.

    Args:
        sampling: samples of the interval.
        spacing: distance of the samples, mm.
        limits: of the machine.
    """
    q, speed = sampling.q, sampling.speed
    axis_a, axis_j = limits.axis_acceleration, limits.axis_jerk
    lowest = speed[0]
    highest = speed[0]
    for m in range(1, SAMPLES):
        lowest = min(lowest, speed[m])
        highest = max(highest, speed[m])
    per_axis = False
    for i in range(q.shape[2]):
        per_axis = per_axis or axis_a[i] < math.inf or axis_j[i] < math.inf
    brief = not per_axis and (SAMPLES - 1) * spacing < lowest * limits.period
    if highest - lowest > (BRIEF_VARIATION if brief else VARIATION) * lowest:
        return 0.0
    turn = TURN / (SAMPLES - 1) if per_axis else TURN
    # The largest variations of acceleration and jerk, per v^2 and v^3, relative to the limits.
    by_v2 = 0.0
    by_v3 = 0.0
    for i in range(q.shape[2]):
        least_a = min(limits.normal_acceleration, axis_a[i])
        for m in range(1, SAMPLES):
            # A rotary axis may turn by many degrees on a millimetre.
            if abs(q[m, 1, i] - q[m - 1, 1, i]) > turn * max(1.0, abs(q[m, 1, i])):
                return 0.0
            by_v2 = max(by_v2, abs(abs(q[m, 2, i]) - abs(q[m - 1, 2, i])) / axis_a[i])
            by_v3 = max(by_v3, abs(abs(q[m, 3, i]) - abs(q[m - 1, 3, i])) / axis_j[i])
            unseen = 1.5 * abs(
                (q[m, 1, i] - q[m - 1, 1, i]) / spacing - 0.5 * (q[m, 2, i] + q[m - 1, 2, i])
            )
            by_v2 = max(by_v2, unseen / least_a)
            unseen = 1.5 * abs(
                (q[m, 2, i] - q[m - 1, 2, i]) / spacing - 0.5 * (q[m, 3, i] + q[m - 1, 3, i])
            )
            by_v3 = max(by_v3, unseen / axis_j[i])
    v = math.inf
    if by_v2 > 0.0:
        v = math.sqrt(VARIATION / by_v2)
    if by_v3 > 0.0:
        v = min(v, (VARIATION / by_v3) ** (1.0 / 3.0))
    return v


@njit
def lowest_between(speed: Floats) -> float:
    """Return a bound for the speeds between the samples too.

    It is below the lowest sample by part of their variation.
    """
    lowest = speed[0]
    highest = speed[0]
    for m in range(1, SAMPLES):
        lowest = min(lowest, speed[m])
        highest = max(highest, speed[m])
    return lowest - 0.125 * min(highest - lowest, lowest)


@njit
def bound_derivatives(sampling: Sampling, limits: LimitArrays) -> None:
    """Compute bounds of |q'|, |q''|, |q'''| of each axis from the samples; 0 without a limit.

    Between samples a derivative may exceed both by a fraction of their difference: that much is
    added.
    """
    q = sampling.q
    first, second, third = sampling.first, sampling.second, sampling.third
    for i in range(q.shape[2]):
        first[i] = second[i] = third[i] = 0.0
        if limits.axis_acceleration[i] == math.inf and limits.axis_jerk[i] == math.inf:
            continue
        for m in range(SAMPLES):
            first[i] = max(first[i], abs(q[m, 1, i]))
            second[i] = max(second[i], abs(q[m, 2, i]))
            third[i] = max(third[i], abs(q[m, 3, i]))
        for m in range(1, SAMPLES):
            first[i] = max(first[i], abs(q[m, 1, i]) + 0.25 * abs(q[m, 1, i] - q[m - 1, 1, i]))
            second[i] = max(second[i], abs(q[m, 2, i]) + 0.25 * abs(q[m, 2, i] - q[m - 1, 2, i]))
            third[i] = max(third[i], abs(q[m, 3, i]) + 0.25 * abs(q[m, 3, i] - q[m - 1, 3, i]))


MARGIN_OF_FEED = 1.25
"""The other bounds on speed are sampled up to this times the feed: a bound that is above the feed
at two samples may be below it between them.
"""

BENT_SHARE = 1.0 / 16.0
"""Share of the jerk for the last stretch before a stop in a bend of less radius than SHORTEST. From
a distance d the motion stops with v = (9/2 J d^2)^(1/3) and a = (6 J^2 d)^(1/3). Where the radius
is d, q''' v^3 + 3 q'' v a + q' j comes to 14.5 J for any d.
"""


@njit
def write_interval(
    start: float,
    end: float,
    v: float,
    top: float,
    flat: bool,
    share: float,
    sampling: Sampling,
    limits: LimitArrays,
    out: Intervals,
    count: int,
) -> int:
    """Append an interval to ``out``, with its bounds at every level of speed.

    Args:
        start: arc length at its start, mm.
        end: arc length at its end, mm.
        v: bound that leaves acceleration for any direction, mm/s.
        top: speed that no motion exceeds, mm/s.
        flat: whether it is crossed at constant speed.
        share: share of the limits of acceleration and jerk that the motion may use.
        sampling: samples of the interval.
        limits: of the machine.
        out: the intervals.
        count: number of intervals written so far.

    Returns:
        The new count.
    """
    q, samples = sampling.q, out.samples
    out.end[count] = end
    out.speed[count] = v * (1.0 - 1e-9)
    out.top[count] = top * (1.0 - 1e-9)
    out.flat[count] = flat
    out.share[count] = share
    out.sampled[count, 0] = start
    out.sampled[count, 1] = end
    for m in range(SAMPLES):
        for order in range(3):
            for i in range(q.shape[2]):
                samples[count, m, order, i] = q[m, order + 1, i]
    for m in range(LEVELS):
        a, j = tangential_bounds(sampling, v * (1.0 - 0.1 * m), limits)
        out.accel[count, m] = share * a * (1.0 - 1e-6)
        out.jerk[count, m] = share * j * (1.0 - 2.0 * UNSEEN)
    return count + 1


@njit
def attainable_speed(
    pieces: Pieces, k: int, length: float, feed: float, limits: LimitArrays, q: Floats
) -> float:
    """Return a speed that no motion exceeds on a curve, mm/s; ``q`` receives its samples.

    It is ``feed``, or the speed that the motion can gain over the piece from its slowest place.
    Most of a short curve about a tight bend would allow speeds that the motion cannot reach; bounds
    for them are not needed.
    """
    sample(pieces, k, 0.0, length, q)
    lowest = feed
    for m in range(SAMPLES):
        lowest = min(lowest, speed_bounds(pieces.data, pieces.at[k], q[m], feed, limits)[1])
    squared = 0.0
    for i in range(len(limits.axis_acceleration)):
        squared += limits.axis_acceleration[i] * limits.axis_acceleration[i]
    a = min(limits.tangential_acceleration, math.sqrt(squared))
    return min(feed, math.sqrt(lowest * lowest + 2.0 * a * length))


@njit
def empty_sampling(axes: int) -> Sampling:
    """Return arrays for samples."""
    return Sampling(
        np.zeros((SAMPLES, 4, axes)),
        np.zeros(SAMPLES),
        np.zeros(SAMPLES),
        np.zeros(axes),
        np.zeros(axes),
        np.zeros(axes),
    )


@njit
def bound_speeds(
    sampling: Sampling, data: Floats, at: int, fastest: float, limits: LimitArrays
) -> tuple[float, float]:
    """Compute the speed bounds at the samples, and the bounds of the derivatives.

    Args:
        sampling: the samples.
        data: the records.
        at: index of the record of the piece.
        fastest: largest speed, mm/s.
        limits: of the machine.

    Returns:
        The two speed bounds of the interval, mm/s.
    """
    for m in range(SAMPLES):
        sampling.speed[m], sampling.top[m] = speed_bounds(
            data, at, sampling.q[m], MARGIN_OF_FEED * fastest, limits
        )
    bound_derivatives(sampling, limits)
    v = min(fastest, lowest_between(sampling.speed))
    return v, min(fastest, lowest_between(sampling.top))


@njit
def is_sharp(data: Floats, at: int, q: Floats) -> bool:
    """Return whether the radius of the bend is less than SHORTEST, from its derivatives ``q``."""
    return curvature_of(data, at, q) * SHORTEST > 1.0


@njit
def write_stop(
    base: float, sampling: Sampling, limits: LimitArrays, out: Intervals, count: int
) -> int:
    """Write an interval without length at a stop ``base`` mm from the start of the chunk.

    The path there is the path at the end of the interval before.

    Returns:
        The number of intervals.
    """
    q = sampling.q
    for m in range(SAMPLES - 1):
        for i in range(q.shape[2]):
            q[m, 1, i], q[m, 2, i] = q[SAMPLES - 1, 1, i], q[SAMPLES - 1, 2, i]
            q[m, 3, i] = q[SAMPLES - 1, 3, i]
    sampling.second[:] = 0.0
    sampling.third[:] = 0.0
    count = write_interval(base, base, 0.0, 0.0, True, 1.0, sampling, limits, out, count)
    out.reliable[count - 1] = math.inf
    return count


@njit
def speed_beside_sharp_stop(sampling: Sampling, length: float, limits: LimitArrays) -> float:
    """Return the speed, mm/s, at ``length`` mm from a stop in a bend, by BENT_SHARE of the limits.

    The share accounts for the bend, so the samples become those of a straight path.
    """
    sampling.q[:, 2:] = 0.0
    bound_derivatives(sampling, limits)
    a, j = tangential_bounds(sampling, 0.0, limits)
    return reachable_speed(0.0, length, BENT_SHARE * a, BENT_SHARE * j)


@njit
def chunk_intervals(
    pieces: Pieces,
    length: Floats,
    feed: Floats,
    stop_after: NDArray[np.bool_],
    before: Junction,
    after: Junction,
    limits: LimitArrays,
    refined: float,
    begin: float,
    out: Intervals,
) -> tuple[int, int]:
    """Cut the pieces of a chunk of path into intervals with constant bounds.

    Args:
        pieces: the curves.
        length: (n,): their arc lengths, mm.
        feed: (n,): the largest feed of each, mm/s; infinite where only the axes limit it.
        stop_after: (n,): whether the motion rests at the end of the piece.
        before: the junction with the chunk before.
        after: the junction with the chunk behind.
        limits: of the machine.
        refined: an interval is cut for this times the speed bound that leaves acceleration for any
            direction: the refinement may cross it so much faster. Brief ones: see BRIEF.
        begin: arc length at the start of the first piece, mm.
        out: space for the intervals.

    Returns:
        The number of pieces that were cut, and of their intervals. Where these are not all pieces,
        ``out`` has no space for the intervals of the next.
    """
    data = pieces.data
    sampling = empty_sampling(len(limits.axis_velocity))
    q = sampling.q
    count = complete = 0
    base = begin
    entry = before
    for k in range(len(length)):
        leave = after
        if k + 1 < len(length):
            shorter = min(length[k], length[k + 1])
            leave = piece_junction(
                pieces, k, feed[k], pieces, k + 1, feed[k + 1], shorter, limits, q
            )
        if stop_after[k]:
            leave = Junction(0.0, True, 1.0, 0.0)
        line, at, whole = pieces.kind[k] == LINE, pieces.at[k], length[k]
        beside_from = entry.reach
        beside_to = whole - leave.reach
        fastest = feed[k]
        sampled = not line
        if sampled:
            # The samples of the whole piece stay in q.
            fastest = attainable_speed(pieces, k, whole, fastest, limits, q)
        start = 0.0
        step = whole
        while start < whole:
            if count + 2 > len(out.end):
                return k, complete
            # Stretches of constant speed are cut like the others; those that touch have one speed.
            flat, share, limit = False, 1.0, beside_to
            if start < beside_from:
                flat, share, limit = entry.flat, entry.share, beside_from
            elif start >= beside_to:
                flat, share, limit = leave.flat, leave.share, whole
            end = min(start + step, limit)
            if limit - end < 1e-9 * whole:
                end = limit
            if not (sampled and end == whole):
                sample(pieces, k, start, end, q)
            sampled = False
            reliable = math.inf
            while True:
                v, top = bound_speeds(sampling, data, at, fastest, limits)
                if line:
                    break
                reliable = sampled_speed(sampling, (end - start) / (SAMPLES - 1), limits)
                # A bend may be sharper than the shortest interval shows.
                if end - start <= SHORTEST:
                    break
                faster = refined if end - start > BRIEF * v else BRIEF_SHARE * refined
                if reliable > 0.0 and reliable >= min(top, faster * v):
                    break
                reliable = math.inf
                end = start + 0.5 * (end - start)
                sample_first_half(pieces, k, start, end, q)
            if end - start <= SHORTEST and (
                (entry.speed == 0.0 and start == 0.0 and is_sharp(data, at, q[0]))
                or (leave.speed == 0.0 and end == whole and is_sharp(data, at, q[SAMPLES - 1]))
            ):
                share = BENT_SHARE
                v = top = min(fastest, speed_beside_sharp_stop(sampling, end - start, limits))
            if flat:
                v = min(v, entry.speed if start < beside_from else leave.speed)
            step = 2.0 * (end - start)
            count = write_interval(
                base + start, base + end, v, top, flat, share, sampling, limits, out, count
            )
            out.reliable[count - 1] = reliable
            start = end
        base += whole
        if leave.flat and leave.speed == 0.0:
            count = write_stop(base, sampling, limits, out, count)
        complete = count
        entry = leave
    return len(length), complete
