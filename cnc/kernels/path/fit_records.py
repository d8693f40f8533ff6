"""Records of lines and of quintic spans with weights of one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import measure
from cnc.kernels.path.bernstein import DEPTH, STRIDE, split
from cnc.kernels.path.curve import (
    AXES,
    LENGTH,
    METRIC,
    METRICS,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
    Ints,
)
from cnc.kernels.path.fit_spline import DEGREE, ORDER, bernstein
from cnc.kernels.path.span_shape import NEGLIGIBLE, write_polynomial_turns


class Writer(NamedTuple):
    """The records that are written, and the point reached.

    Attributes:
        data: float64: takes the records.
        metric: columns of the metric axes.
        here: (n,): the point reached, mm; moved along.
        accuracy: largest error of the inverse arc length, mm.
        derivatives: (4, n): work space.
        stack: work space of :func:`cnc.kernels.path.bernstein.sign_changes`, like scratch.
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
