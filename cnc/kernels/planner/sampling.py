"""Samples of an interval of path, and the bounds that follow from them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.curve import LINE, curve_eval_s
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.intervals import SAMPLES
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import TURNING_SHARE

Floats = NDArray[np.float64]

VARIATION = 0.05
"""Largest variation of the bounds between neighbouring samples of an interval, relative to the
limits.
"""

BRIEF_VARIATION = 0.1
"""Largest variation of the speed bound along the path in an interval that takes less than a period,
where no time can be lost.
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
