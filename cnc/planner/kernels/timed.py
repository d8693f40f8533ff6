r"""Timed pieces: the path where a motion passes a stop on a corner.

Such a motion (:mod:`cnc.planner.kernels.corner_stops`) is given by time, not along a path: in each
of its steps every axis has a constant jerk. So its position is a cubic of time: a SPAN of degree 3
and weight 1 whose parameter is proportional to the time.

        ------.__     C
                 `\
                   \   one piece for each step
                    |
                    |

Such a record has no table of the arc length: its entry TABLE is 0. The plan's coordinate along the
piece is its parameter, and one phase without acceleration crosses it; under a clock that changes
(:mod:`cnc.planner.corner_hold`), phases of constant jerk do. There |dr/du| is not 1, so speed,
tangential acceleration and jerk follow from the derivatives.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import GAUSS_W, GAUSS_X
from cnc.path.kernels.curve import (
    LENGTH,
    METRIC,
    METRICS,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
    curve_eval,
    curve_eval_s,
)

ACCURACY = 1e-10
"""Relative: largest difference between the length of a part and that of its two halves, all by
Gauss-Legendre of 6 points. The halves are 2^12 times as accurate. Where one axis has much less jerk
than the other, the speed changes abruptly.
"""

HALVINGS = 50
"""Of a part of a timed piece, to the place of the least speed: to the last digits."""

SMALLEST = 1e-6
"""Smallest part of a timed piece that is measured by itself, relative."""

TIMED_SIZE = START + SPAN_BODY + 4
TIMED_SIZE_PER_AXIS = 2 + 4 + 1 + 2
"""A record of n axes has at most TIMED_SIZE + n TIMED_SIZE_PER_AXIS numbers."""


@njit
def is_timed(kind: int, data: Floats, at: int) -> bool:
    """Return whether the coordinate along the piece is proportional to time, not arc length."""
    return kind == SPAN and data[at + TABLE] == 0.0


@njit
def timed_motion(
    data: Floats, at: int, q: Floats, rate: float, change: float, sudden: float
) -> tuple[float, float, float, float]:
    """Return speed, tangential acceleration, tangential jerk and normal acceleration.

    With r the position and v = |r'|: v' = r'.r'' / v and v'' = (r''.r'' + r'.r''' - v'^2) / v. By
    time, the speed is v u', the acceleration v' u'^2 + v u'' and the jerk v'' u'^3 + 3 v' u' u'' +
    v u'''.

    Args:
        data: the records.
        at: index of the record of the timed piece.
        q: (4, axes): its derivatives by its parameter u.
        rate: u' = du/dt.
        change: u''.
        sudden: u'''.
    """
    d11 = 0.0
    d12 = 0.0
    d22 = 0.0
    d13 = 0.0
    for m in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + m])
        d11 += q[1, i] * q[1, i]
        d12 += q[1, i] * q[2, i]
        d22 += q[2, i] * q[2, i]
        d13 += q[1, i] * q[3, i]
    if d11 == 0.0:
        return 0.0, math.sqrt(d22) * rate * rate, 0.0, 0.0
    speed = math.sqrt(d11)
    along = d12 / speed
    return (
        speed * rate,
        along * rate * rate + speed * change,
        (d22 + d13 - along * along) / speed * rate**3
        + 3.0 * along * rate * change
        + speed * sudden,
        math.sqrt(max(d22 - along * along, 0.0)) * rate * rate,
    )


@njit
def speeding_up(data: Floats, at: int, q: Floats) -> float:
    """Return r'.r'', which is negative where the motion slows down.

    Args:
        data: the records.
        at: index of the record of the timed piece.
        q: (4, axes): its derivatives.
    """
    total = 0.0
    for m in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + m])
        total += q[1, i] * q[2, i]
    return total


@njit
def slowest_between(kind: int, data: Floats, at: int, low: float, high: float, q: Floats) -> None:
    """Write the derivatives (4, axes) at the place of the least speed between two parameters.

    The motion slows down at the first, and speeds up at the second.
    """
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        curve_eval_s(kind, data, at, middle, q)
        if speeding_up(data, at, q) < 0.0:
            low = middle
        else:
            high = middle


@njit
def timed_length(kind: int, data: Floats, at: int, u: float, q: Floats) -> float:
    """Return the path length from the start to parameter ``u``, mm; q (4, axes) is scratch."""
    here = data[at + U0]
    step = u - here
    smallest = SMALLEST * step
    total = 0.0
    whole = _part_length(kind, data, at, here, step, q)
    while step > 0.0:
        half = 0.5 * step
        first = _part_length(kind, data, at, here, half, q)
        both = first + _part_length(kind, data, at, here + half, half, q)
        if abs(both - whole) <= ACCURACY * both or step <= smallest:
            total += both
            here += step
            step = min(2.0 * step, u - here)
            whole = _part_length(kind, data, at, here, step, q)
        else:
            step = half
            whole = first
    return total


@njit
def _part_length(kind: int, data: Floats, at: int, u: float, step: float, q: Floats) -> float:
    """Return the length of [u, u + step], mm, by one Gauss-Legendre rule."""
    total = 0.0
    for k in range(6):
        curve_eval(kind, data, at, u + 0.5 * step * (1.0 + GAUSS_X[k]), q)
        squared = 0.0
        for m in range(int(data[at + METRICS])):
            squared += q[1, int(data[at + METRIC + m])] ** 2
        total += GAUSS_W[k] * math.sqrt(squared)
    return 0.5 * step * total


@njit
def write_cubic(
    data: Floats, at: int, like: int, start: Floats, first: Floats, second: Floats, end: Floats
) -> int:
    """Write the record of a cubic on [0, 1] without its length, table and turning points.

    Args:
        data: the records.
        at: index of the new record.
        like: index of a record with the same metric axes.
        start: (axes,): its start.
        end: (axes,): its end.
        first: (axes,): its second Bernstein coefficient, measured from the start.
        second: (axes,): its third.

    Returns:
        The index behind it.
    """
    n = len(start)
    body = at + START + 2 * n
    for k in range(START):
        data[at + k] = data[like + k]
    data[at + U0] = 0.0
    data[at + U1] = 1.0
    data[at + TABLE] = 0.0
    data[body] = 3.0
    for k in range(4):
        data[body + SPAN_BODY + k] = 1.0
    for i in range(n):
        data[at + START + i] = start[i]
        data[at + START + n + i] = end[i]
        row = body + SPAN_BODY + 4 * (i + 1)
        data[row] = 0.0
        data[row + 1] = first[i]
        data[row + 2] = second[i]
        data[row + 3] = end[i] - start[i]
    return body + SPAN_BODY + 4 * (n + 1)


@njit
def write_turns(data: Floats, at: int, to: int) -> int:
    """Write the turning points of a cubic's record, the last part of it, from index ``to`` on.

    Returns:
        The index behind them.
    """
    n = int(data[at])
    body = at + START + 2 * n
    extent = data[at + U1] - data[at + U0]
    data[body + 1] = to - at
    counts = to
    to += n
    for i in range(n):
        # An axis turns where a (1-x)^2 + 2 b x (1-x) + c x^2 changes sign.
        row = body + SPAN_BODY + 4 * (i + 1)
        a = data[row + 1]
        b = data[row + 2] - a
        c = data[row + 3] - data[row + 2]
        under = b * b - a * c
        data[counts + i] = 0.0
        if under > 0.0:
            # With y = x / (1 - x): c y^2 + 2 b y + a = 0, in the form without cancellation.
            big = -(b + math.copysign(math.sqrt(under), b))
            y1 = a / big
            y2 = big / c if c != 0.0 else math.inf
            for y in (min(y1, y2), max(y1, y2)):
                if 0.0 < y < math.inf:
                    data[to] = y / (1.0 + y) * extent
                    data[counts + i] += 1.0
                    to += 1
    return to


@njit
def write_timed(
    data: Floats,
    at: int,
    like: int,
    start: Floats,
    first: Floats,
    second: Floats,
    end: Floats,
    q: Floats,
) -> int:
    """Write the record of a timed piece: the arguments of :func:`write_cubic`.

    The parameter is scaled to the length of the piece, so that coordinates behind it are path
    lengths again. q (4, axes): scratch.

    Returns:
        The index behind it.
    """
    behind = write_cubic(data, at, like, start, first, second, end)
    extent = timed_length(SPAN, data, at, 1.0, q)
    data[at + U1] = extent
    data[at + LENGTH] = extent
    return write_turns(data, at, behind)
