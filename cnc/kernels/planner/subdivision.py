"""Pieces of a path cut into short intervals with constant bounds.

On each interval the bounds of :mod:`cnc.kernels.planner.limits` vary little. An interval starts
with the length of its piece and is halved until samples at five points show that. Constant bounds
make the look-ahead over thousands of intervals cheap (:mod:`cnc.kernels.planner.lookahead`), and
the samples let the refinement evaluate the exact limits (:mod:`cnc.kernels.planner.refine`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.intervals import LEVELS, SAMPLES, Intervals
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import (
    SHORTEST,
    UNSEEN,
    Junction,
    curvature_of,
    piece_junction,
    speed_bounds,
)
from cnc.kernels.planner.sampling import (
    Sampling,
    bound_derivatives,
    lowest_between,
    sample,
    sample_first_half,
    sampled_speed,
    tangential_bounds,
)
from cnc.kernels.planner.scurve import reachable_speed

Floats = NDArray[np.float64]


MARGIN_OF_FEED = 1.25
"""The other bounds on speed are sampled up to this times the feed: a bound that is above the feed
at two samples may be below it between them.
"""

REFINED = 2.0
"""The refinement may cross an interval this much faster than the bound that leaves acceleration for
any direction. The interval is cut for that speed. Faster motion is compared with the path itself.
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
            direction: the refinement may cross it so much faster.
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
                if line or end - start <= SHORTEST:
                    break
                reliable = sampled_speed(sampling, (end - start) / (SAMPLES - 1), limits)
                if reliable > 0.0 and reliable >= min(top, refined * v):
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
