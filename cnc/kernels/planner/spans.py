"""Profiles over a span of intervals: the fastest one, its violations, and the best cut."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.intervals import Intervals
from cnc.kernels.planner.scurve import (
    peak_speed,
    ramp_distance,
    ramp_distance_to_speed,
    ramp_time,
    reachable_speed,
)

Floats = NDArray[np.float64]

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

    The levels fall evenly from 1 (:data:`cnc.kernels.planner.intervals.LEVELS`).
    """
    if ratio >= 1.0:
        return 0
    return min(int((1.0 - ratio) * 10.0 + 1e-9), levels - 1)


@njit
def span_bounds(known: Intervals, first: int, last: int, v: float) -> tuple[float, float]:
    """Return the least acceleration and jerk bounds over the intervals [first, last).

    They hold for motion no faster than ``v``.
    """
    speed, accel, jerk = known.speed, known.accel, known.jerk
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
    known: Intervals, first: int, last: int, v0: float, v1: float, distance: float, top: float
) -> Profile:
    """Return the fastest profile over the intervals [first, last) for some choice of its peak.

    The bounds that hold at an interval's full speed hold at any lower one, so they are tried first.
    A lower peak may leave more of an axis to the acceleration, but it has a lower jerk bound.

    Args:
        known: the intervals.
        first: the first of them in the range.
        last: the one behind the range.
        v0: speed at the start, mm/s.
        v1: speed at the end.
        distance: length of the span, mm.
        top: largest speed, mm/s.
    """
    least = max(v0, v1)
    best = Profile(least, 0.0, 0.0, math.inf)
    tight_a, tight_j = span_bounds(known, first, last, math.inf)
    for m in range(-1, known.accel.shape[1]):
        cap = max(least, top * (1.0 - 0.1 * max(m, 0)))
        a, j = tight_a, tight_j
        if m >= 0:
            a, j = span_bounds(known, first, last, cap)
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
    bound_s: Floats, known: Intervals, first: int, last: int, v0: float, v1: float, time: float
) -> tuple[int, float]:
    """Return the best bound at which to cut a span of uneven bounds in two, and the speed there.

    It is (-1, 0) if no cut saves time. Bounds are tight where the path bends, mostly towards the
    ends of a span: the places tried are 1, 2, 4 ... intervals from either end.

    Args:
        bound_s: (n + 1,): arc lengths at the ends of the intervals, mm.
        known: the n intervals.
        first: the first interval of the span.
        last: the interval behind it.
        v0: speed at its start, mm/s.
        v1: speed at its end.
        time: its duration without a cut, s.
    """
    speed = known.speed
    found = -1
    speed_there = 0.0
    best = time * (1.0 - WORTHWHILE)
    step = 1
    while step < last - first:
        for side in range(2):
            at = first + step if side == 0 else last - step
            limit = min(speed[at - 1], speed[at])
            a0, j0 = span_bounds(known, first, at, math.inf)
            a1, j1 = span_bounds(known, at, last, math.inf)
            d0 = bound_s[at] - bound_s[first]
            d1 = bound_s[last] - bound_s[at]
            v = min(limit, reachable_speed(v0, d0, a0, j0), reachable_speed(v1, d1, a1, j1))
            if ramp_distance(v0, v, a0, j0) > d0 * (1.0 + SLACK) or ramp_distance(
                v, v1, a1, j1
            ) > d1 * (1.0 + SLACK):
                continue
            top0 = max(v0, v, speed[first:at].max())
            top1 = max(v, v1, speed[at:last].max())
            before = best_profile(known, first, at, v0, v, d0, top0)
            after = best_profile(known, at, last, v, v1, d1, top1)
            if before.time + after.time < best:
                best = before.time + after.time
                found = at
                speed_there = v
        step *= 2
    return found, speed_there


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
    found = -1
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
            found = k
            lowest = v
    return found
