"""The straight moves beside a corner: their directions and bounds, and what is left of them."""

from __future__ import annotations

import math

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    ARC,
    ARC_BODY,
    LENGTH,
    METRIC,
    METRICS,
    ROW,
    SPAN,
    START,
    TABLE,
    U1,
    Floats,
)
from cnc.kernels.planner.limits import UNSEEN

SHARPEST = math.sin(math.radians(135.0) / 2.0)
"""Sine of half the largest turn at which the motion doesn't stop on the corner."""

LEGS_SHARE = 0.49
"""The part of a move that either of its corners may take."""

REST = 1e-9
"""mm, mm/s: what rounding leaves of a distance and a speed of nothing."""


@njit
def directions(
    data_a: Floats, at_a: int, data_b: Floats, at_b: int, u: Floats
) -> tuple[float, float]:
    """Directions of two lines, per mm of path, into ``u`` (2, n).

    Returns sin(theta/2) and the sine that counts for the tolerance: no less than the former, more
    where axes that don't measure the path turn more; both 2 where the lines are measured over
    different axes.
    """
    n = u.shape[1]
    for i in range(n):
        u[0, i] = (data_a[at_a + START + n + i] - data_a[at_a + START + i]) / data_a[at_a + LENGTH]
        u[1, i] = (data_b[at_b + START + n + i] - data_b[at_b + START + i]) / data_b[at_b + LENGTH]
    squared = 0.0
    same = data_a[at_a + METRICS] == data_b[at_b + METRICS]
    for m in range(int(data_a[at_a + METRICS])):
        same = same and data_a[at_a + METRIC + m] == data_b[at_b + METRIC + m]
        i = int(data_a[at_a + METRIC + m])
        squared += (u[1, i] - u[0, i]) ** 2
    if not same:
        return 2.0, 2.0
    sine = 0.5 * math.sqrt(squared)
    widest = sine
    for i in range(n):
        widest = max(widest, 0.5 * abs(u[1, i] - u[0, i]))
    return sine, widest


@njit
def line_bounds(
    u: Floats, feed: float, rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats
) -> tuple[float, float, float]:
    """Largest speed (mm/s), acceleration and jerk along a line of direction ``u`` (n,), no faster
    than ``feed``.
    """
    v = feed
    a = rules[0]
    j = rules[1]
    for i in range(len(u)):
        if u[i] != 0.0:
            v = min(v, axis_v[i] / abs(u[i]))
            a = min(a, axis_a[i] / abs(u[i]))
            j = min(j, axis_j[i] / abs(u[i]))
    return v, a * (1.0 - UNSEEN), j * (1.0 - 2.0 * UNSEEN)


@njit
def write_line(data: Floats, at: int, like: int, from_start: float, from_end: float) -> int:
    """Write what is left of the line at ``like`` without so much at its start and end (mm); returns
    the index behind the record.
    """
    n = int(data[like])
    length = data[like + LENGTH]
    for k in range(START):
        data[at + k] = data[like + k]
    for i in range(n):
        start = data[like + START + i]
        end = data[like + START + n + i]
        rate = (end - start) / length
        data[at + START + i] = start + from_start * rate if from_start > 0.0 else start
        data[at + START + n + i] = end - from_end * rate if from_end > 0.0 else end
    data[at + LENGTH] = data[at + U1] = length - from_start - from_end
    return at + START + 2 * n


@njit
def record_end(kind: int, data: Floats, at: int) -> int:
    """Index behind the record of a piece."""
    n = int(data[at])
    body = at + START + 2 * n
    end = body
    if kind == ARC:
        end = body + ARC_BODY
        if data[at + TABLE] != 0.0:
            end += 3 + ROW * int(data[end])
    elif kind == SPAN:
        turning = at + int(data[body + 1])
        end = turning + n
        for i in range(n):
            end += int(data[turning + i])
    return end
