"""Intervals of a path with constant bounds, and the share of the limits that a phase uses there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.scurve import phase_time

Floats = NDArray[np.float64]

LEVELS = 7
"""Levels of speed for the bounds on acceleration and jerk: 1, 0.9 ... 0.4 of the speed bound."""

SAMPLES = 5
"""Points at which the path is sampled in an interval, evenly spaced, its ends included."""

TOUCH = 1e-4
"""Relative: a motion may exceed a limit by this."""

PARTS = 8
"""A phase is examined at the ends of this many equal parts."""

SCRATCH = 7
"""Rows of scratch for the examination of a phase: the derivatives, and two values of each sum."""


class Intervals(NamedTuple):
    """A stretch of path as intervals with constant bounds.

    Attributes:
        end: (n,): arc length at the end of each, mm.
        speed: (n,): bound that leaves acceleration and jerk for a change of speed in any direction,
            mm/s.
        top: (n,): speed that no motion exceeds, mm/s.
        accel: (n, LEVELS): bounds on tangential acceleration at falling levels of speed, mm/s^2.
        jerk: (n, LEVELS): bounds on tangential jerk, mm/s^3.
        flat: (n,) bool: crossed at constant speed. A stop is a flat interval of length 0 and
            speed 0.
        share: (n,): share of the limits of acceleration and jerk that the motion may use.
        reliable: (n,): speed up to which the samples show the path closely enough, mm/s.
        sampled: (n, 2): arc lengths of the first and the last sample, mm.
        samples: (n, SAMPLES, 3, axes): the first three derivatives of the path by arc length.
    """

    end: Floats
    speed: Floats
    top: Floats
    accel: Floats
    jerk: Floats
    flat: NDArray[np.bool_]
    share: Floats
    reliable: Floats
    sampled: Floats
    samples: Floats


class SumLimits(NamedTuple):
    """Limits for the exact sums of acceleration and jerk; the last entry is for the path itself.

    Attributes:
        a: (axes + 1,): mm/s^2.
        j: (axes + 1,): mm/s^3.
        per_a: (axes + 1,): 1 / a.
        per_j: (axes + 1,): 1 / j.
    """

    a: Floats
    j: Floats
    per_a: Floats
    per_j: Floats


@njit
def interval_at(s: float, start: int, end: Floats) -> int:
    """Return the interval that contains arc length ``s``, searched from interval ``start``."""
    k = min(start, len(end) - 1)
    while k > 0 and s < end[k - 1]:
        k -= 1
    while k + 1 < len(end) and s >= end[k]:
        k += 1
    return k


@njit
def derivatives(k: int, s: float, intervals: Intervals, out: Floats) -> None:
    """Write q', q'', q''' at ``s`` in interval ``k`` to ``out`` (3, axes + 1).

    They follow the quartic through the five samples. The last column is for the path itself. All
    are divided by the share of the limits that the interval allows, so that they compare with the
    whole limits.
    """
    sampled, samples = intervals.sampled, intervals.samples
    axes = samples.shape[3]
    extent = sampled[k, 1] - sampled[k, 0]
    x = min(max((s - sampled[k, 0]) / extent, 0.0), 1.0) if extent > 0.0 else 0.0
    x *= 4.0
    unit = 1.0 / intervals.share[k]
    w0 = unit * (x - 1.0) * (x - 2.0) * (x - 3.0) * (x - 4.0) / 24.0
    w1 = -unit * x * (x - 2.0) * (x - 3.0) * (x - 4.0) / 6.0
    w2 = unit * x * (x - 1.0) * (x - 3.0) * (x - 4.0) / 4.0
    w3 = -unit * x * (x - 1.0) * (x - 2.0) * (x - 4.0) / 6.0
    w4 = unit * x * (x - 1.0) * (x - 2.0) * (x - 3.0) / 24.0
    for order in range(3):
        for i in range(axes):
            out[order, i] = (
                w0 * samples[k, 0, order, i]
                + w1 * samples[k, 1, order, i]
                + w2 * samples[k, 2, order, i]
                + w3 * samples[k, 3, order, i]
                + w4 * samples[k, 4, order, i]
            )
        out[order, axes] = unit if order == 0 else 0.0


@njit
def peak(before: float, here: float, after: float) -> float:
    """Return the largest absolute value of the parabola through three values, evenly spaced.

    It is the second value where the parabola has no peak between the first and the third.
    """
    bend = before - 2.0 * here + after
    if here * bend >= 0.0 or abs(after - before) > 2.0 * abs(bend):
        return abs(here)
    return abs(here) + (after - before) ** 2 / (8.0 * abs(bend))


@njit
def largest_shares(
    duration: float,
    s: float,
    v: float,
    a: float,
    j: float,
    s_end: float,
    k: int,
    intervals: Intervals,
    limits: SumLimits,
    q: Floats,
) -> tuple[float, float, int]:
    """Return the largest shares of the limits that a phase uses.

    The phase is examined at points throughout it, and on both sides of each end of an interval. A
    peak between three points is that of a parabola. The speed is examined where it is greatest too:
    at the instant without acceleration.

    Args:
        duration: of the phase, s.
        s: arc length at its start, mm.
        v: speed there.
        a: acceleration there.
        j: its jerk.
        s_end: arc length at its end, mm.
        k: an interval near its start.
        intervals: the intervals of the path.
        limits: for the sums.
        q: (SCRATCH, axes + 1): scratch.

    Returns:
        The share of the limits of acceleration and jerk, that of the speed bounds, and the interval
        in which the phase ends.
    """
    end, top = intervals.end, intervals.top
    per_a, per_j = limits.per_a, limits.per_j
    worst = 0.0
    fastest = 0.0
    t_before = 0.0
    s_before = s
    turn = -a / j if a * j < 0.0 else math.inf
    k = interval_at(s, k, end)
    m = 0
    while m <= PARTS:
        t_next = duration * m / PARTS
        turns = turn < t_next
        evenly = m
        if turns:
            t_next = turn
        s_next = (
            s_end
            if m == PARTS and not turns
            else s + t_next * (v + t_next * (0.5 * a + t_next * j / 6.0))
        )
        t = t_next
        here = s_next
        crossing = k + 1 < len(end) and end[k] < s_next
        if crossing or turns:
            evenly = -1
        if crossing:
            here = end[k]
            speed = v + t_before * (a + 0.5 * t_before * j)
            t = t_before + phase_time(
                speed, a + t_before * j, j, t_next - t_before, here - s_before
            )
        else:
            t_before = t_next
            s_before = s_next
            if turns:
                turn = math.inf
            else:
                m += 1
        speed = v + t * (a + 0.5 * t * j)
        accel = a + t * j
        for side in range(2):
            if side == 1:
                if not crossing:
                    break
                k += 1
            fastest = max(fastest, speed / top[k])
            derivatives(k, here, intervals, q)
            for i in range(q.shape[1]):
                taken = (q[0, i] * accel + q[1, i] * speed * speed) * per_a[i]
                sudden = (
                    q[0, i] * j + 3.0 * q[1, i] * speed * accel + q[2, i] * speed * speed * speed
                ) * per_j[i]
                worst = max(worst, abs(taken), abs(sudden))
                if evenly >= 0:
                    if evenly >= 2:
                        worst = max(worst, peak(q[3, i], q[4, i], taken))
                        worst = max(worst, peak(q[5, i], q[6, i], sudden))
                    q[3, i], q[4, i] = q[4, i], taken
                    q[5, i], q[6, i] = q[6, i], sudden
    return worst, fastest, k
