"""The straight moves beside a corner, its legs: directions, bounds, and shortened records."""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import (
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
    Pieces,
)
from cnc.planner.kernels.arrays import LimitArrays
from cnc.planner.kernels.limits import UNSEEN

SHARPEST = math.sin(math.radians(135.0) / 2.0)
"""Sine of half the largest turn that a blend makes."""

STRAIGHTEST = math.sin(math.radians(5.0) / 2.0)
REVERSED = math.sin(math.radians(179.0) / 2.0)
"""Sine of half the smallest and the largest turn of a corner whose stop the motion passes."""

LEGS_SHARE = 0.49
"""The part of a move that either of its corners may take."""

REST = 1e-9
"""mm, mm/s: rounding error of a distance and a speed of 0."""


class Turn(NamedTuple):
    """The turn by theta at a corner.

    Attributes:
        sine: sin(theta/2); 2 if the two moves are measured over different axes.
        widest: the sine that counts for the tolerance: at least ``sine``, and more if axes that do
            not measure the path turn more.
    """

    sine: float
    widest: float


class LineBounds(NamedTuple):
    """Largest speed (mm/s), acceleration and jerk along a straight move."""

    v: float
    a: float
    j: float


@njit
def directions(data_a: Floats, at_a: int, data_b: Floats, at_b: int, u: Floats) -> Turn:
    """Return the turn from one line to another, and write their directions.

    Args:
        data_a: records that contain the first line.
        at_a: index of its record.
        data_b: records that contain the second line.
        at_b: index of its record.
        u: (2, axes): receives the directions, per mm of path.
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
        return Turn(2.0, 2.0)
    sine = 0.5 * math.sqrt(squared)
    widest = sine
    for i in range(n):
        widest = max(widest, 0.5 * abs(u[1, i] - u[0, i]))
    return Turn(sine, widest)


@njit
def line_bounds(u: Floats, feed: float, limits: LimitArrays) -> LineBounds:
    """Return the bounds of a line of direction ``u`` (axes,), no faster than ``feed`` mm/s."""
    v = feed
    a = limits.tangential_acceleration
    j = limits.tangential_jerk
    for i in range(len(u)):
        if u[i] != 0.0:
            v = min(v, limits.axis_velocity[i] / abs(u[i]))
            a = min(a, limits.axis_acceleration[i] / abs(u[i]))
            j = min(j, limits.axis_jerk[i] / abs(u[i]))
    return LineBounds(v, a * (1.0 - UNSEEN), j * (1.0 - 2.0 * UNSEEN))


@njit
def corner_time(jerk: float, turn: Turn, tolerance: float) -> float:
    r"""Return the time by which a ramp from rest could begin before the ramp to rest ends, s.

    The two ramps of jerk J would be added for a time tau. At its middle both are J (tau/2)^3 / 6
    from the corner, so the motion is 2 sin(theta/2) times that from it:

        tau = (24 eps / (J sin(theta/2)))^(1/3).
    """
    return float((24.0 * tolerance / (jerk * turn.widest)) ** (1.0 / 3.0))


@njit
def write_line(data: Floats, at: int, like: int, from_start: float, from_end: float) -> int:
    """Write the record of a line, shortened.

    Args:
        data: the records.
        at: index of the new record.
        like: index of the record of the whole line.
        from_start: length taken off its start, mm.
        from_end: length taken off its end, mm.

    Returns:
        The index behind the new record.
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
def record_end(pieces: Pieces, k: int) -> int:
    """Return the index behind the record of piece ``k``."""
    kind, data, at = pieces.kind[k], pieces.data, pieces.at[k]
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
