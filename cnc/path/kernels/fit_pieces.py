"""Pieces of a fitted chain: lines where it is straight, and spans, cut where the feed changes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import measure
from cnc.path.kernels.bspline import NUMBERS_PER_AXIS, RECORD_NUMBERS
from cnc.path.kernels.curve import (
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
from cnc.path.kernels.fit_proof import span_distance
from cnc.path.kernels.fit_spline import DEGREE, ORDER, Chain, Spline, bernstein
from cnc.path.kernels.span_shape import DEPTH, NEGLIGIBLE, STRIDE, split, write_polynomial_turns

# Records of lines and of quintic spans with weights of one.


class Writer(NamedTuple):
    """The records that are written, and the point reached.

    Attributes:
        data: float64: takes the records.
        metric: columns of the metric axes.
        here: (n,): the point reached, mm; moved along.
        accuracy: largest error of the inverse arc length, mm.
        derivatives: (4, n): work space.
        stack: work space of :func:`cnc.path.kernels.span_shape.sign_changes`, like scratch.
        scratch: see stack.
    """

    data: Floats
    metric: Ints
    here: Floats
    accuracy: float
    derivatives: Floats
    stack: Floats
    scratch: Floats


@njit
def new_writer(data: Floats, metric: Ints, here: Floats, accuracy: float) -> Writer:
    """Return a writer with work space of its own."""
    stack = np.empty((DEPTH + 4) * STRIDE)
    return Writer(
        data, metric, here, accuracy, np.empty((4, here.shape[0])), stack, np.empty(STRIDE)
    )


@njit
def _head(writer: Writer, at: int, end: Floats) -> int:
    """Write axes, metric axes, start and end of a record, and move on to the end.

    Returns:
        The index behind them.
    """
    data, metric, here = writer.data, writer.metric, writer.here
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
def write_line(writer: Writer, at: int, end: Floats) -> int:
    """Write a line to ``end``.

    Returns:
        The index behind it, or ``at`` where there is no motion.
    """
    data, metric, here = writer.data, writer.metric, writer.here
    square = 0.0
    for c in metric:
        square += (end[c] - here[c]) ** 2
    after = at
    if square > NEGLIGIBLE * NEGLIGIBLE:
        after = _head(writer, at, end)
        data[at + U1] = data[at + LENGTH] = math.sqrt(square)
    return after


@njit
def write_span(
    writer: Writer, kind: int, b: Floats, ta: float, tb: float, h: float, at: int, end: Floats
) -> int:
    """Write the part [ta, tb] of the quintic with Bezier points b (6, n) over h as a span to end.

    kind: SPAN.

    Returns:
        The index behind the record.
    """
    data, scratch = writer.data, writer.scratch
    n = b.shape[1]
    to = _head(writer, at, end)
    data[at + U1] = (tb - ta) * h
    data[to] = DEGREE
    form = to + SPAN_BODY
    for j in range(ORDER):
        data[form + j] = 1.0
    for c in range(n):
        k = form + ORDER * (c + 1)
        for j in range(ORDER):
            scratch[j] = b[j, c] - b[0, c]
        if ta > 0.0:
            split(scratch, 0, DEGREE, ta, data, k)
        if tb < 1.0:
            split(scratch, 0, DEGREE, (tb - ta) / (1.0 - ta), data, k)
        else:
            for j in range(ORDER):
                data[k + j] = scratch[j]
        for j in range(DEGREE, -1, -1):
            data[k + j] -= data[k]
    to = measure(kind, data, at, form + ORDER * (n + 1), writer.accuracy, writer.derivatives)
    data[at + START + 2 * n + 1] = to - at
    return write_polynomial_turns(data, at, to, writer.stack, scratch)


@njit
def span_point(b: Floats, t: float, scratch: Floats, out: Floats) -> None:
    """Write the quintic with Bezier points b (6, n) at t into out (n,)."""
    bernstein(t, scratch)
    for c in range(b.shape[1]):
        out[c] = 0.0
        for j in range(ORDER):
            out[c] += scratch[j] * b[j, c]


STRAIGHT = 1e-9
"""mm. Control points this near to even spacing on a line make a line."""
STATE = np.dtype([("pieces", np.int64), ("used", np.int64), ("pending", np.bool_)], align=True)
"""Pieces written, numbers used of the data, and whether a straight stretch is pending."""


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
        joint: tolerance of the joint behind it, mm; 0 where the spline goes on.
    """

    kind: Ints
    at: Ints
    length: Floats
    feed: Floats
    line: Ints
    joint: Floats


@njit
def joint_tolerances(chain: Chain, spline: Spline, tolerance: float) -> Floats:
    """Return the tolerance (K,) of the joint at each knot, mm; 0 where the spline goes on.

    A line beside a joint may be a little away from the vertices that do not count. That much less
    is left to the corner.
    """
    knots = spline.knots
    joints = np.zeros(knots.shape[0])
    for k in range(knots.shape[0]):
        if knots[k]["ends"]:
            joints[k] = tolerance
    for k in range(knots.shape[0] - 1):
        if not knots[k]["straight"] or not (knots[k]["ends"] or knots[k + 1]["ends"]):
            continue
        h = knots[k + 1]["t"] - knots[k]["t"]
        worst = 0.0
        behind = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
        for i in range(knots[k]["vertex"] + 1, behind + 1):
            tau = (chain.along[i] - knots[k]["t"]) / h
            _, tau = span_distance(spline.bezier[k], tau, chain.x[i], chain.metrics, True)
            tau = min(max(tau, 0.0), 1.0)
            off, _ = span_distance(spline.bezier[k], tau, chain.x[i], chain.metrics, False)
            worst = max(worst, off)
        left = tolerance - worst if worst > STRAIGHT else tolerance
        for end in range(k, k + 2):
            if knots[end]["ends"]:
                joints[end] = min(joints[end], left)
    return joints


@njit
def _even(b: Floats) -> bool:
    """Return whether the control points (6, n) lie evenly spaced on a line."""
    off = 0.0
    for c in range(b.shape[1]):
        for j in range(1, DEGREE):
            even = ((DEGREE - j) * b[0, c] + j * b[DEGREE, c]) / DEGREE
            off = max(off, abs(b[j, c] - even))
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
    joints: Floats,
    first: int,
    last: int,
    writer: Writer,
    out: Written,
) -> tuple[int, int, int]:
    """Write the spans from ``first`` to before ``last`` as records, until the arrays are full.

    Args:
        chain: the moves' vertices.
        spline: the spline.
        moves: feed and line of the moves.
        joints: (K,): tolerances of the joints at the knots, mm.
        first: first span.
        last: the span behind the last.
        writer: takes the records.
        out: takes the entries.

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
        _write_span(chain, spline, moves, joints, k, writer, out, state, end, line_end)
        k += 1
    if state[0]["pending"]:
        _write_pending(writer, out, state, line_end, joints[k])
    return k, state[0]["pieces"], state[0]["used"]


@njit
def _write_span(
    chain: Chain,
    spline: Spline,
    moves: Moves,
    joints: Floats,
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
        joints: (K,): tolerances of the joints at the knots, mm.
        k: index of the span.
        writer: takes the records.
        out: takes the entries.
        state: (1,) STATE.
        end: (n,): work space.
        line_end: (n,): end of the straight stretch that is pending; moved along.
    """
    knots, p, bezier = spline.knots, spline.p, spline.bezier
    x = chain.x
    feed = moves.feed
    n = x.shape[1]
    now = state[0]
    inner = knots[k]["vertex"] + 1
    behind = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
    polyline = knots[k]["polyline"]
    inner_joint = max(joints[k], joints[k + 1]) if polyline else 0.0
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
            # A broken spline goes through the vertex; its control point may differ by rounding.
            broken = knots[k + 1]["ends"] and knots[k + 1]["on"]
            for c in range(n):
                end[c] = x[knots[k + 1]["vertex"], c] if broken else bezier[k, DEGREE, c]
        else:
            if feed[i] == feed[move]:
                continue
            tau = min(max((chain.along[i] - knots[k]["t"]) / h, ta), 1.0)
            for _n in range(3):
                _, tau = span_distance(bezier[k], tau, x[i], chain.metrics, True)
                tau = min(max(tau, ta), 1.0)
            span_point(bezier[k], tau, writer.scratch, end)
            if tau - ta < 1e-6 or 1.0 - tau < 1e-6:
                move = i
                continue
        if now["pending"] and not (
            straight
            and out.feed[now["pieces"]] == feed[move]
            and _in_line(writer.here, line_end, end, chain.metric)
        ):
            _write_pending(writer, out, state, line_end, joints[k] if ta == 0.0 else 0.0)
        if not now["pending"]:
            out.feed[now["pieces"]] = feed[move]
            out.line[now["pieces"]] = moves.line[move]
        if straight:
            now["pending"] = True
            for c in range(n):
                line_end[c] = end[c]
        else:
            at = now["used"]
            if polyline:
                used = write_line(writer, at, end)
                out.kind[now["pieces"]] = line_kind
            else:
                used = write_span(writer, span_kind, bezier[k], ta, tau, h, at, end)
                out.kind[now["pieces"]] = span_kind
            now["used"] = used
            if used > at:
                _note(writer, out, state, at, joints[k + 1] if whole else inner_joint)
        ta = tau
        move = i


@njit
def _write_pending(
    writer: Writer, out: Written, state: NDArray[np.void], line_end: Floats, joint: float
) -> None:
    """Write the straight stretch that is pending, up to ``line_end`` (n,)."""
    now = state[0]
    at = now["used"]
    now["used"] = write_line(writer, at, line_end)
    now["pending"] = False
    if now["used"] > at:
        out.kind[now["pieces"]] = LINE
        _note(writer, out, state, at, joint)


@njit
def _note(writer: Writer, out: Written, state: NDArray[np.void], at: int, joint: float) -> None:
    """Write place, length and joint of the piece whose record is at ``at``."""
    now = state[0]
    out.at[now["pieces"]] = at
    out.length[now["pieces"]] = writer.data[at + LENGTH]
    out.joint[now["pieces"]] = joint
    now["pieces"] += 1
