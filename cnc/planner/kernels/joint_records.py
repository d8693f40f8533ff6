"""Records of pieces whose joints are polynomials of degree 7 beside the axes of the tool tip."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import MAX_ROWS, measure
from cnc.path.kernels.curve import (
    AXES,
    LENGTH,
    LINE,
    METRICS,
    ROW,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
    Ints,
)
from cnc.path.kernels.span_shape import DEPTH, STRIDE, write_polynomial_turns

DEGREE = 7
ORDER = DEGREE + 1
LARGEST_TABLE = 3 + ROW * (MAX_ROWS + 1)
"""Numbers that must be free for the table of a record."""


class JointPieces(NamedTuple):
    """Pieces with n columns.

    Attributes:
        kind: (m,): LINE or SPAN.
        u0: (m,): parameter at the start.
        u1: (m,): parameter at the end.
        metric: (m, 4): the entries of the record that name the metric axes.
        start: (m, n): position.
        end: (m, n).
        form: (m, 8, n): Bernstein coefficients, measured from the start; unused for a line.
    """

    kind: Ints
    u0: Floats
    u1: Floats
    metric: Floats
    start: Floats
    end: Floats
    form: Floats


@njit
def joint_record_size(n: int) -> int:
    """Return the numbers that a record of n columns takes at most, without its table."""
    return START + 2 * n + SPAN_BODY + ORDER * (n + 1) + n * (1 + DEGREE)


@njit
def write_joint_records(
    pieces: JointPieces, first: int, accuracy: float, data: Floats, at: Ints, length: Floats
) -> tuple[int, int]:
    """Write records from piece ``first`` on until the array is full.

    Args:
        pieces: m pieces.
        first: the first to write.
        accuracy: largest error of the inverse arc length, mm.
        data: takes the records.
        at: (m,): takes the index of each record.
        length: (m,): takes the arc lengths, mm.

    Returns:
        The next piece, and the numbers used of ``data``.
    """
    n = pieces.start.shape[1]
    work = np.empty((4, n))
    stack = np.empty((DEPTH + 4) * STRIDE)
    scratch = np.empty(STRIDE)
    need = joint_record_size(n) + LARGEST_TABLE
    used = 0
    k = first
    while k < pieces.kind.shape[0] and used + need <= data.shape[0]:
        at[k] = used
        kind = pieces.kind[k]
        data[used + AXES] = n
        data[used + U0] = pieces.u0[k]
        data[used + U1] = pieces.u1[k]
        data[used + LENGTH] = pieces.u1[k] - pieces.u0[k]
        for c in range(4):
            data[used + METRICS + c] = pieces.metric[k, c]
        data[used + TABLE] = 0.0
        for c in range(n):
            data[used + START + c] = pieces.start[k, c]
            data[used + START + n + c] = pieces.end[k, c]
        behind = used + START + 2 * n
        if kind != LINE:
            behind = _write_body(pieces, k, kind, accuracy, data, used, (work, stack, scratch))
        length[k] = data[used + LENGTH]
        used = behind
        k += 1
    return k, used


@njit
def _write_body(
    pieces: JointPieces,
    k: int,
    kind: int,
    accuracy: float,
    data: Floats,
    at: int,
    space: tuple[Floats, Floats, Floats],
) -> int:
    """Write degree, coefficients, table and turning points of a span, and return what is behind."""
    work, stack, scratch = space
    n = pieces.start.shape[1]
    body = at + START + 2 * n
    data[body] = DEGREE
    form = body + SPAN_BODY
    for j in range(ORDER):
        data[form + j] = 1.0
        for c in range(n):
            data[form + ORDER * (c + 1) + j] = pieces.form[k, j, c]
    # A span without a table would stand for a piece whose parameter is the time.
    to = _straight_table(pieces, k, accuracy, data, at, form + ORDER * (n + 1))
    if to < 0:
        to = measure(kind, data, at, form + ORDER * (n + 1), accuracy, work)
    data[body + 1] = to - at
    return write_polynomial_turns(data, at, to, stack, scratch)


@njit
def _straight_table(
    pieces: JointPieces, k: int, accuracy: float, data: Floats, at: int, table: int
) -> int:
    """Write the table of a tip that moves straight and evenly: one row, u linear in s.

    Returns:
        The index behind the table; -1 if the tip does not move so, and nothing is written.
    """
    squared = 0.0
    for c in range(int(pieces.metric[k, 0])):
        column = int(pieces.metric[k, c + 1])
        way = pieces.form[k, DEGREE, column]
        squared += way * way
        for j in range(1, DEGREE):
            # The tip is within the largest distance of a coefficient from the even motion.
            if abs(pieces.form[k, j, column] - way * (j / DEGREE)) > 0.25 * accuracy:
                return -1
    length = math.sqrt(squared)
    if length <= accuracy:
        return -1
    data[at + TABLE] = table - at
    data[at + LENGTH] = length
    data[table] = 1.0
    row = table + 1
    data[row] = 0.0
    data[row + 1] = data[at + U0]
    data[row + 2] = data[at + U1] - data[at + U0]
    for j in range(3, ROW):
        data[row + j] = 0.0
    data[row + ROW] = length
    data[row + ROW + 1] = data[at + U1]
    return row + ROW + 2
