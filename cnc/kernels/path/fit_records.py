"""Spans of a fitted chain to records: turning points in closed form, straight stretches as lines,
feeds that change inside a span.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import measure
from cnc.kernels.path.bspline import NEGLIGIBLE, RECORD_ROOM, ROOM_PER_AXIS
from cnc.kernels.path.curve import (
    AXES,
    LENGTH,
    LINE,
    METRIC,
    METRICS,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
    Ints,
)
from cnc.kernels.path.fit import AT, ENDS, ON, POLYLINE, Flags, T, span_distance

STRAIGHT = 1e-9
"""mm. Control points this near to even spacing on a line make a line."""


@njit
def _head(data: Floats, at: int, n: int, metric: Ints, here: Floats, end: Floats) -> int:
    """Axes, metric, start and end of a record; returns the index behind them. ``here`` moves on to
    the end.
    """
    data[at + AXES] = n
    data[at + METRICS] = metric.shape[0]
    for c in range(3):
        data[at + METRIC + c] = metric[c] if c < metric.shape[0] else -1
    data[at + TABLE] = 0.0
    data[at + U0] = 0.0
    for c in range(n):
        data[at + START + c] = here[c]
        data[at + START + n + c] = end[c]
        here[c] = end[c]
    return at + START + 2 * n


@njit
def _line(data: Floats, at: int, n: int, metric: Ints, here: Floats, end: Floats) -> int:
    """A line from ``here`` to ``end``; returns the index behind it, or ``at`` where there is no
    motion.
    """
    square = 0.0
    for c in metric:
        square += (end[c] - here[c]) ** 2
    after = at
    if square > NEGLIGIBLE * NEGLIGIBLE:
        after = _head(data, at, n, metric, here, end)
        data[at + U1] = data[at + LENGTH] = math.sqrt(square)
    return after


@njit
def _turns(q0: float, q1: float, q2: float, extent: float, data: Floats, to: int) -> int:
    """The u where q0 (1-t)^2 + 2 q1 t (1-t) + q2 t^2 changes its sign inside (0, 1), in order, from
    data[to] on; returns how many.
    """
    a = q0 - 2.0 * q1 + q2
    b = q1 - q0
    root = b * b - a * q0
    count = 0
    if root > 0.0:
        q = -(b + math.copysign(math.sqrt(root), b))
        first = q0 / q if q != 0.0 else -1.0
        second = q / a if a != 0.0 else -1.0
        if first > second:
            first, second = second, first
        for t in (first, second):
            if 1e-12 < t < 1.0 - 1e-12:
                data[to + count] = t * extent
                count += 1
    return count


@njit
def _span(
    kind: int, b: Floats, ta: float, tb: float, h: float, metric: Ints, here: Floats, end: Floats, accuracy: float, work: Floats,
    data: Floats, at: int,
) -> int:  # fmt: skip
    """The part [ta, tb] of the cubic with Bezier points b (4, n) over h, as a record of this kind
    (SPAN); returns the index behind it.
    """
    n = b.shape[1]
    to = _head(data, at, n, metric, here, end)
    data[at + U1] = (tb - ta) * h
    data[to] = 3.0
    form = to + SPAN_BODY
    for j in range(4):
        data[form + j] = 1.0
    for c in range(n):
        # blossoms at (ta, ta, ta), (ta, ta, tb) .. from the differences, measured from the start
        q0 = b[1, c] - b[0, c]
        q1 = b[2, c] - b[1, c]
        q2 = b[3, c] - b[2, c]
        k = form + 4 * (c + 1)
        data[k] = 0.0
        total = 0.0
        for j in range(3):
            x = tb if j > 1 else ta
            y = ta if j < 1 else tb
            slope = (1.0 - x) * ((1.0 - y) * q0 + y * q1) + x * ((1.0 - y) * q1 + y * q2)
            total += (tb - ta) * slope
            data[k + j + 1] = total
    to = measure(kind, data, at, form + 4 * (n + 1), accuracy, work)
    data[at + START + 2 * n + 1] = to - at
    after = to + n
    for c in range(n):
        k = form + 4 * (c + 1)
        reach = max(abs(data[k + 1]), abs(data[k + 2]), abs(data[k + 3]))
        count = 0
        # an axis that moves by rounding alone doesn't turn
        if reach > 4e-15 * max(abs(data[at + START + c]), abs(data[at + START + n + c])):
            count = _turns(
                data[k + 1],
                data[k + 2] - data[k + 1],
                data[k + 3] - data[k + 2],
                data[at + U1],
                data,
                after,
            )
        data[to + c] = count
        after += count
    return after


@njit
def _point(b: Floats, t: float, out: Floats) -> None:
    """The cubic at t into out (n,)."""
    left = 1.0 - t
    for c in range(b.shape[1]):
        out[c] = left * left * (left * b[0, c] + 3.0 * t * b[1, c]) + t * t * (
            3.0 * left * b[2, c] + t * b[3, c]
        )


@njit
def _even(b: Floats) -> bool:
    """Whether the control points lie evenly spaced on a line."""
    off = 0.0
    for c in range(b.shape[1]):
        off = max(off, abs(b[1, c] - (2.0 * b[0, c] + b[3, c]) / 3.0))
        off = max(off, abs(b[2, c] - (b[0, c] + 2.0 * b[3, c]) / 3.0))
    return off <= STRAIGHT


@njit
def _in_line(a: Floats, b: Floats, c: Floats, metric: Ints) -> bool:
    """Whether b (n,) lies on the line from a to c, evenly in all axes."""
    ab = ac = 0.0
    for k in metric:
        ab += (b[k] - a[k]) ** 2
        ac += (c[k] - a[k]) ** 2
    part = math.sqrt(ab / ac) if ac > 0.0 else 2.0
    off = 0.0
    for k in range(a.shape[0]):
        off = max(off, abs(b[k] - a[k] - part * (c[k] - a[k])))
    return part < 1.0 and off <= STRAIGHT


@njit
def write_pieces(
    knots: Floats, p: Floats, bezier: Floats, x: Floats, along: Floats, feed: Floats, line: Ints, first: int, last: int,
    metric: Ints, metrics: Flags, here: Floats, accuracy: float,
    data: Floats, kind_out: Ints, at_out: Ints, length_out: Floats, feed_out: Floats, line_out: Ints, joint_out: Flags,
) -> tuple[int, int, int]:  # fmt: skip
    """Records of the spans from ``first`` to before ``last``, as many as there is room for.

    feed, line (m - 1,): of the move from each vertex on. here (n,): where the motion is, moved
    along. Of each piece come out its kind, the place of its record in ``data``, its length, feed
    and line, and whether the spline is broken behind it. Returns (next span, pieces, numbers used).
    """
    n = x.shape[1]
    work = np.empty((4, n))
    end = np.empty(n)
    line_end = np.empty(n)
    pieces = 0
    used = 0
    pending = False  # a straight stretch from here to line_end
    line_kind, span_kind = LINE, SPAN
    room = RECORD_ROOM + n * ROOM_PER_AXIS
    k = first
    full = False
    while k < last and not full:
        inner = int(knots[k, AT]) + 1
        behind = int(knots[k + 1, AT]) - int(knots[k + 1, ON])
        cuts = 0
        for i in range(inner, behind + 1):
            cuts += feed[i] != feed[i - 1]
        parts = behind - inner + 2 if knots[k, POLYLINE] != 0.0 else cuts + 1
        need = 2 * room + (parts * (START + 2 * n) if knots[k, POLYLINE] != 0.0 else parts * room)
        full = used + need > data.shape[0] or pieces + parts + 1 > at_out.shape[0]
        if full:
            break
        straight = knots[k, POLYLINE] == 0.0 and _even(bezier[k])
        h = knots[k + 1, T] - knots[k, T]
        ta = 0.0
        tau = 0.0
        move = inner - 1
        for i in range(inner, behind + 2):
            # parts end at a feed that changes, or at every vertex where the spline is given up, and
            # with the span
            whole = i > behind
            if knots[k, POLYLINE] != 0.0:
                for c in range(n):
                    end[c] = p[k + 1, c] if whole else x[i, c]
            else:
                if not whole and feed[i] == feed[move]:
                    continue
                if not whole:
                    tau = min(max((along[i] - knots[k, T]) / h, ta), 1.0)
                    for _n in range(3):
                        _, tau = span_distance(bezier[k], tau, x[i], metrics, True)
                        tau = min(max(tau, ta), 1.0)
                    _point(bezier[k], tau, end)
                    if tau - ta < 1e-6 or 1.0 - tau < 1e-6:
                        move = i
                        continue
                else:
                    tau = 1.0
                    for c in range(n):
                        end[c] = bezier[k, 3, c]
            if pending and not (
                straight
                and feed_out[pieces] == feed[move]
                and _in_line(here, line_end, end, metric)
            ):
                at = _line(data, used, n, metric, here, line_end)
                if at > used:
                    kind_out[pieces], at_out[pieces], length_out[pieces] = (
                        line_kind,
                        used,
                        data[used + LENGTH],
                    )
                    joint_out[pieces] = ta == 0.0 and knots[k, ENDS] != 0.0
                    pieces += 1
                used = at
                pending = False
            if not pending:
                feed_out[pieces] = feed[move]
                line_out[pieces] = line[move]
            if straight:
                pending = True
                line_end[:] = end
            else:
                at = used
                if knots[k, POLYLINE] != 0.0:
                    used = _line(data, at, n, metric, here, end)
                    kind_out[pieces] = line_kind
                else:
                    used = _span(
                        span_kind,
                        bezier[k],
                        ta,
                        tau,
                        h,
                        metric,
                        here,
                        end,
                        accuracy,
                        work,
                        data,
                        at,
                    )
                    kind_out[pieces] = span_kind
                if used > at:
                    at_out[pieces], length_out[pieces] = at, data[at + LENGTH]
                    joint_out[pieces] = knots[k, POLYLINE] != 0.0 or (
                        whole and knots[k + 1, ENDS] != 0.0
                    )
                    pieces += 1
            ta = tau
            move = i
        k += 1
    if pending:
        at = _line(data, used, n, metric, here, line_end)
        if at > used:
            kind_out[pieces], at_out[pieces], length_out[pieces] = (
                line_kind,
                used,
                data[used + LENGTH],
            )
            joint_out[pieces] = knots[k, ENDS] != 0.0
            pieces += 1
        used = at
    return k, pieces, used
