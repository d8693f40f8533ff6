"""Bounds on speed, tangential acceleration and jerk at a point of a path and at a junction.

At a point of the path q(s), with speed v, tangential acceleration a and jerk j, each axis i moves
with

    velocity      q_i' v
    acceleration  q_i'' v^2 + q_i' a
    jerk          q_i''' v^3 + 3 q_i'' v a + q_i' j

The curvature alone bounds v: sqrt(aN rho) for the normal acceleration aN, and (2/T) sqrt(h (2 rho -
h)) so that the chord of one period T stays within h of the curve (Hui, Wei, Gao 2013, equations 6
and 7 corrected, as speeds). sqrt(24 delta) rho / T keeps that chord shorter than its arc by at most
the relative difference delta, the step deviation. The rest of each axis's limit is given to a, then
to j.

At a junction of two pieces the direction may turn by a small angle, and the curvature may jump.
Sampled with period T, a jump dv of an axis's velocity shows as an acceleration dv / T and a jerk
dv / T^2. A jump da of its acceleration shows as a jerk of 3/4 da / T at most: the third difference
is a mean weighted by the quadratic B-spline, whose largest value is 3/4. The speed at a junction
keeps these within the limits. It is constant for two periods on either side, so that nothing adds
to the jump. At a corner the motion stops.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import METRIC, METRICS, Pieces, curve_eval_s, curve_range
from cnc.planner.kernels.arrays import LimitArrays

Floats = NDArray[np.float64]

ACCEL_SHARE = 0.75
JERK_SHARE = 0.4
"""Shares of an axis's limits that speed alone may use on a curve; the rest is left for changes of
speed.
"""

TURNING_SHARE = 0.6
"""Share of the jerk that speed leaves of an axis which 3 q'' v a, acceleration in a bend, may use.
"""

SHORTEST = 5e-8
"""mm; the least length of an interval, where curvature grows without bound towards a cusp. In a
bend of less radius the motion stops.
"""

FLAT_PERIODS = 2.0
"""Periods at constant speed on either side of a junction."""

FLAT_SHARE = 0.4
"""Share of a piece that the stretch of constant speed at one of its ends may take."""

CORNER = 0.1
"""rad; at a sharper turn the motion stops: crossed at (jerk limit T^2) / CORNER, it would save
almost no time.
"""

UNSEEN = 5e-4
"""Share of a limit that a jump may always use; the planner leaves that share of the jerk limits
free.
"""

GENTLE = 0.1
"""Share of a limit that a jump may use without a stretch of constant speed. Beside the jump the
motion uses no more than the rest.
"""


class Junction(NamedTuple):
    """How the motion passes from one piece of path to the next.

    Attributes:
        speed: mm/s; 0 for a stop.
        flat: whether the speed must be constant about the junction.
        share: share of the limits of acceleration and jerk that the motion may use about it.
        reach: length on either side to which the last two apply, mm.
    """

    speed: float
    flat: bool
    share: float
    reach: float


@njit
def speed_bounds(
    data: Floats, at: int, q: Floats, feed: float, limits: LimitArrays
) -> tuple[float, float]:
    """Return the largest speeds at a point of a piece, mm/s.

    The first leaves each axis its shares of acceleration and jerk for changes of speed in any
    direction. No motion exceeds the second.

    Args:
        data: the records.
        at: index of the record of the piece.
        q: (4, axes): the derivatives by arc length at the point, of order 0 to 3.
        feed: the largest feed, mm/s.
        limits: of the machine.
    """
    axis_v, axis_a, axis_j = limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk
    top = feed
    curvature = curvature_of(data, at, q)
    if curvature > 0.0:
        top = min(top, bend_speed(1.0 / curvature, limits))
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
def bend_speed(radius: float, limits: LimitArrays) -> float:
    """Return the largest speed that limits along the path allow in a bend of this radius, mm/s."""
    period = limits.period
    top = math.sqrt(limits.normal_acceleration * radius)
    # The chord of a half circle leaves it by the radius, and no chord by more.
    sagitta = min(limits.chord_error, radius)
    top = min(top, 2.0 / period * math.sqrt(sagitta * (2.0 * radius - sagitta)))
    return min(top, math.sqrt(24.0 * (1.0 - UNSEEN) * limits.step_deviation) * radius / period)


@njit
def curvature_of(data: Floats, at: int, q: Floats) -> float:
    """Return the curvature, 1/mm, of the piece at ``at`` from its derivatives ``q`` (4, axes)."""
    squared = 0.0
    for m in range(int(data[at + METRICS])):
        squared += q[2, int(data[at + METRIC + m])] ** 2
    return math.sqrt(squared)


@njit
def junction_speed(
    data: Floats,
    at: int,
    before: Floats,
    after: Floats,
    v: float,
    top: float,
    shorter: float,
    limits: LimitArrays,
) -> Junction:
    """Return the junction of two pieces.

    Args:
        data: the records.
        at: index of the record of either piece, for its metric axes.
        before: (4, axes): the derivatives by arc length before the junction.
        after: (4, axes): those behind it.
        v: the speed at which the pieces leave acceleration for any direction, mm/s.
        top: the speed that no motion exceeds there, mm/s.
        shorter: length of the shorter piece, mm.
        limits: of the machine.
    """
    axis_a, axis_j = limits.axis_acceleration, limits.axis_jerk
    period = limits.period
    squared = 0.0
    for m in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + m])
        squared += (after[1, i] - before[1, i]) ** 2
    turn = math.sqrt(squared)
    # The share of a limit that the jump uses, per unit of speed and of speed squared.
    by_v = 0.0
    by_v2 = 0.0
    if turn > 0.0:
        least_a = min(limits.tangential_acceleration, limits.normal_acceleration)
        by_v = turn / min(least_a * period, limits.tangential_jerk * period * period)
        # The chord across the corner cuts it by (v T / 2) sin(turn / 2).
        by_v = max(by_v, turn * period / (4.0 * limits.chord_error))
    for i in range(before.shape[1]):
        jump = abs(after[1, i] - before[1, i])
        if jump > 0.0:
            by_v = max(by_v, jump / min(axis_a[i] * period, axis_j[i] * period * period))
        bend = abs(after[2, i] - before[2, i])
        if bend > 0.0:
            by_v2 = max(by_v2, 0.75 * bend / (axis_j[i] * period))
    # The step across a corner is shorter than the path by turn^2 / 8 at least.
    if turn > CORNER or turn * turn > 8.0 * limits.step_deviation:
        return Junction(0.0, True, 1.0, 0.0)
    reach = FLAT_PERIODS * period * top
    taken = by_v * top + by_v2 * top * top
    if taken <= UNSEEN:
        return Junction(v, False, 1.0, 0.0)
    if taken <= GENTLE and reach <= FLAT_SHARE * shorter:
        return Junction(v, False, 1.0 - taken, reach)
    # At constant speed the curves use part of the limits as well. The sum rises with the speed, so
    # bisection finds the largest speed.
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
    v = min(low, FLAT_SHARE * shorter / (FLAT_PERIODS * period))
    return Junction(v, True, 1.0, FLAT_PERIODS * period * v)


@njit
def piece_junction(
    before: Pieces,
    a: int,
    feed_a: float,
    after: Pieces,
    b: int,
    feed_b: float,
    shorter: float,
    limits: LimitArrays,
    q: Floats,
) -> Junction:
    """Return the junction of piece ``a`` of ``before`` and piece ``b`` of ``after``, next to it.

    Args:
        before: the path of the first piece.
        a: its index.
        after: the path of the second piece.
        b: its index.
        feed_a: largest feed of the first piece, mm/s.
        feed_b: largest feed of the second.
        shorter: length of the shorter of them, mm.
        limits: of the machine.
        q: (2 or more, 4, axes): scratch.
    """
    data_a, at_a, kind_a = before.data, before.at[a], before.kind[a]
    data_b, at_b, kind_b = after.data, after.at[b], after.kind[b]
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
        return Junction(0.0, True, 1.0, 0.0)
    v_a, top_a = speed_bounds(data_a, at_a, q[0], feed_a, limits)
    v_b, top_b = speed_bounds(data_b, at_b, q[1], feed_b, limits)
    return junction_speed(
        data_a, at_a, q[0], q[1], min(v_a, v_b), min(top_a, top_b), shorter, limits
    )
