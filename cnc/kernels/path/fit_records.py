"""Records of the spans of a fitted chain.

Turning points have a closed form, straight stretches become lines, and a span is cut where the feed
changes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import measure
from cnc.kernels.path.bspline import NEGLIGIBLE, NUMBERS_PER_AXIS, RECORD_NUMBERS
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
from cnc.kernels.path.fit import Chain, Flags, Knots, span_distance

STRAIGHT = 1e-9
"""mm. Control points this near to even spacing on a line make a line."""
STATE = np.dtype([("pieces", np.int64), ("used", np.int64), ("pending", np.bool_)], align=True)
"""Pieces written, numbers used of the data, and whether a straight stretch is pending."""


class Writer(NamedTuple):
    """The records that are written, and the point reached.

    Attributes:
        data: float64: takes the records.
        metric: columns of the metric axes.
        here: (n,): the point reached, mm; moved along.
        accuracy: largest error of the inverse arc length, mm.
        work: (4, n): work space.
    """

    data: Floats
    metric: Ints
    here: Floats
    accuracy: float
    work: Floats


class Spline(NamedTuple):
    """A fitted spline.

    Attributes:
        knots: (K,): its knots.
        p: (K, n): points of the polyline at the knots, mm.
        bezier: (K - 1, 4, n): Bezier points of its spans, mm.
    """

    knots: Knots
    p: Floats
    bezier: Floats


class Moves(NamedTuple):
    """The moves of a chain, one behind each vertex but the last.

    Attributes:
        feed: (m - 1,): mm/s.
        line: (m - 1,) int64: source line.
    """

    feed: Floats
    line: Ints


class Written(NamedTuple):
    """One entry for each piece.

    Attributes:
        kind: LINE or SPAN.
        at: index of its record in ``data``.
        length: mm.
        feed: mm/s.
        line: source line.
        joint: whether the spline is broken behind it.
    """

    kind: Ints
    at: Ints
    length: Floats
    feed: Floats
    line: Ints
    joint: Flags


@njit
def _head(writer: Writer, at: int, end: Floats) -> int:
    """Write axes, metric axes, start and end of a record, and move on to the end.

    Returns:
        The index behind them.
    """
    data, metric, here, _, _ = writer
    n = here.shape[0]
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
def _line(writer: Writer, at: int, end: Floats) -> int:
    """Write a line to ``end``.

    Returns:
        The index behind it, or ``at`` where there is no motion.
    """
    data, metric, here, _, _ = writer
    square = 0.0
    for c in metric:
        square += (end[c] - here[c]) ** 2
    after = at
    if square > NEGLIGIBLE * NEGLIGIBLE:
        after = _head(writer, at, end)
        data[at + U1] = data[at + LENGTH] = math.sqrt(square)
    return after


@njit
def _turns(q0: float, q1: float, q2: float, extent: float, data: Floats, to: int) -> int:
    """Write the u where q0 (1-t)^2 + 2 q1 t (1-t) + q2 t^2 changes its sign inside (0, 1).

    u is t times ``extent``. They come in order, from data[to] on.

    Returns:
        Their number.
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
    writer: Writer, kind: int, b: Floats, ta: float, tb: float, h: float, at: int, end: Floats
) -> int:
    """Write the part [ta, tb] of the cubic with Bezier points b (4, n) over h as a span to ``end``.

    kind: SPAN.

    Returns:
        The index behind the record.
    """
    data = writer.data
    n = b.shape[1]
    to = _head(writer, at, end)
    data[at + U1] = (tb - ta) * h
    data[to] = 3.0
    form = to + SPAN_BODY
    for j in range(4):
        data[form + j] = 1.0
    for c in range(n):
        # Blossoms at (ta, ta, ta), (ta, ta, tb) .. from the differences, measured from the start.
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
    to = measure(kind, data, at, form + 4 * (n + 1), writer.accuracy, writer.work)
    data[at + START + 2 * n + 1] = to - at
    after = to + n
    for c in range(n):
        k = form + 4 * (c + 1)
        reach = max(abs(data[k + 1]), abs(data[k + 2]), abs(data[k + 3]))
        count = 0
        # An axis that moves by rounding alone does not turn.
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
    """Write the cubic at t into out (n,)."""
    left = 1.0 - t
    for c in range(b.shape[1]):
        out[c] = left * left * (left * b[0, c] + 3.0 * t * b[1, c]) + t * t * (
            3.0 * left * b[2, c] + t * b[3, c]
        )


@njit
def _even(b: Floats) -> bool:
    """Return whether the control points lie evenly spaced on a line."""
    off = 0.0
    for c in range(b.shape[1]):
        off = max(off, abs(b[1, c] - (2.0 * b[0, c] + b[3, c]) / 3.0))
        off = max(off, abs(b[2, c] - (b[0, c] + 2.0 * b[3, c]) / 3.0))
    return off <= STRAIGHT


@njit
def _in_line(a: Floats, b: Floats, c: Floats, metric: Ints) -> bool:
    """Return whether b (n,) lies on the line from a to c, evenly in all axes."""
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
    chain: Chain,
    spline: Spline,
    moves: Moves,
    first: int,
    last: int,
    writer: Writer,
    out: Written,
) -> tuple[int, int, int]:
    """Write the spans from ``first`` to before ``last`` as records, until the arrays are full.

    Returns:
        The next span, the number of pieces, and the numbers used of ``writer.data``.
    """
    knots = spline.knots
    n = chain.x.shape[1]
    end = np.empty(n)
    line_end = np.empty(n)
    state = np.zeros(1, STATE)
    longest = RECORD_NUMBERS + n * NUMBERS_PER_AXIS
    k = first
    while k < last:
        inner = knots[k]["vertex"] + 1
        behind = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
        polyline = knots[k]["polyline"]
        cuts = 0
        for i in range(inner, behind + 1):
            cuts += moves.feed[i] != moves.feed[i - 1]
        parts = behind - inner + 2 if polyline else cuts + 1
        need = 2 * longest + (parts * (START + 2 * n) if polyline else parts * longest)
        if (
            state[0]["used"] + need > writer.data.shape[0]
            or state[0]["pieces"] + parts + 1 > out.at.shape[0]
        ):
            break
        _write_span(chain, spline, moves, k, writer, out, state, end, line_end)
        k += 1
    if state[0]["pending"]:
        _write_pending(writer, out, state, line_end, knots[k]["ends"])
    return k, state[0]["pieces"], state[0]["used"]


@njit
def _write_span(
    chain: Chain,
    spline: Spline,
    moves: Moves,
    k: int,
    writer: Writer,
    out: Written,
    state: NDArray[np.void],
    end: Floats,
    line_end: Floats,
) -> None:
    """Write span k. Its parts end where the feed changes, or at every vertex of a polyline.

    Args:
        chain: the moves' vertices.
        spline: the spline.
        moves: feed and line of the moves.
        k: index of the span.
        writer: takes the records.
        out: takes the entries.
        state: (1,) STATE.
        end: (n,): work space.
        line_end: (n,): end of the straight stretch that is pending; moved along.
    """
    knots, p, bezier = spline
    x = chain.x
    feed = moves.feed
    n = x.shape[1]
    now = state[0]
    inner = knots[k]["vertex"] + 1
    behind = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
    polyline = knots[k]["polyline"]
    straight = not polyline and _even(bezier[k])
    h = knots[k + 1]["t"] - knots[k]["t"]
    ta = 0.0
    tau = 0.0
    move = inner - 1
    line_kind, span_kind = LINE, SPAN  # variables: numba compiles a kernel anew for a constant
    for i in range(inner, behind + 2):
        whole = i > behind
        if polyline:
            for c in range(n):
                end[c] = p[k + 1, c] if whole else x[i, c]
        elif whole:
            tau = 1.0
            for c in range(n):
                end[c] = bezier[k, 3, c]
        else:
            if feed[i] == feed[move]:
                continue
            tau = min(max((chain.along[i] - knots[k]["t"]) / h, ta), 1.0)
            for _n in range(3):
                _, tau = span_distance(bezier[k], tau, x[i], chain.metrics, True)
                tau = min(max(tau, ta), 1.0)
            _point(bezier[k], tau, end)
            if tau - ta < 1e-6 or 1.0 - tau < 1e-6:
                move = i
                continue
        if now["pending"] and not (
            straight
            and out.feed[now["pieces"]] == feed[move]
            and _in_line(writer.here, line_end, end, chain.metric)
        ):
            _write_pending(writer, out, state, line_end, ta == 0.0 and knots[k]["ends"])
        if not now["pending"]:
            out.feed[now["pieces"]] = feed[move]
            out.line[now["pieces"]] = moves.line[move]
        if straight:
            now["pending"] = True
            line_end[:] = end
        else:
            at = now["used"]
            if polyline:
                used = _line(writer, at, end)
                out.kind[now["pieces"]] = line_kind
            else:
                used = _span(writer, span_kind, bezier[k], ta, tau, h, at, end)
                out.kind[now["pieces"]] = span_kind
            now["used"] = used
            if used > at:
                _note(writer, out, state, at, polyline or (whole and knots[k + 1]["ends"]))
        ta = tau
        move = i


@njit
def _write_pending(
    writer: Writer, out: Written, state: NDArray[np.void], line_end: Floats, joint: bool
) -> None:
    """Write the straight stretch that is pending, up to ``line_end`` (n,)."""
    now = state[0]
    at = now["used"]
    now["used"] = _line(writer, at, line_end)
    now["pending"] = False
    if now["used"] > at:
        out.kind[now["pieces"]] = LINE
        _note(writer, out, state, at, joint)


@njit
def _note(writer: Writer, out: Written, state: NDArray[np.void], at: int, joint: bool) -> None:
    """Write place, length and joint of the piece whose record is at ``at``."""
    now = state[0]
    out.at[now["pieces"]] = at
    out.length[now["pieces"]] = writer.data[at + LENGTH]
    out.joint[now["pieces"]] = joint
    now["pieces"] += 1
