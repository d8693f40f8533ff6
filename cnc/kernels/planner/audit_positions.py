"""Positions of a plan at many instants, for the audit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.curve import (
    LENGTH,
    ROW,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    curve_eval,
    is_plain_quintic,
)
from cnc.kernels.path.pieces import Pieces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

KEPT = 3
"""Positions before an instant that its differences take."""
INSTANTS = 256
"""Most instants that are examined together."""


class Run(NamedTuple):
    """Instants that follow each other. Entry 0 is the instant before them.

    Attributes:
        s: (INSTANTS + 1,): arc length, mm; entry 0 is negative where there is none before.
        piece: (INSTANTS + 1,): the piece.
        stopped: (INSTANTS + 1,): whether the motion has stopped since the instant before.
        position: (axes, KEPT + INSTANTS): positions, those of KEPT instants before included, mm.
        timed: (pieces,): whether a piece is timed.
        bounds: (axes + 1, BOUNDS): scratch, like the others.
        weight: see bounds.
        q: (4, axes): see bounds.
        last: (5, axes): see bounds.
    """

    s: Floats
    piece: Ints
    stopped: Flags
    position: Floats
    timed: Flags
    bounds: Floats
    weight: Floats
    q: Floats
    last: Floats


@njit
def span_point(data: Floats, at: int, u: float, weight: Floats, out: Floats) -> None:
    """Write the position at ``u`` of a span to the last row of ``out``.

    It computes no derivatives, which would take most of the time.

    Args:
        data: the records.
        at: index of the record of the span.
        u: its parameter.
        weight: (degree + 1,): scratch for the Bernstein polynomials.
        out: (rows, axes).
    """
    n = out.shape[1]
    start = at + START
    k = start + 2 * n
    p = int(data[k])
    k += SPAN_BODY
    x = (u - data[at + U0]) / (data[at + U1] - data[at + U0])
    y = 1.0 - x
    row = out.shape[0] - 1
    if is_plain_quintic(data, at):
        xx, yy = x * x, y * y
        w0, w1, w2 = y * yy * yy, 5.0 * x * yy * yy, 10.0 * xx * y * yy
        w3, w4, w5 = 10.0 * x * xx * yy, 5.0 * xx * xx * y, x * xx * xx
        for i in range(n):
            k += p + 1
            low = w0 * data[k] + w1 * data[k + 1] + w2 * data[k + 2]
            high = w3 * data[k + 3] + w4 * data[k + 4] + w5 * data[k + 5]
            out[row, i] = data[start + i] + (low + high)
        return
    # C(p, m) x^m from one end, times y^(p - m) from the other: no step loses digits.
    rising = 1.0
    for m in range(p + 1):
        weight[m] = rising
        rising *= x * (p - m) / (m + 1)
    falling = 1.0
    divisor = 0.0
    for m in range(p, -1, -1):
        weight[m] *= falling
        falling *= y
        divisor += weight[m] * data[k + m]
    inverse = 1.0 / divisor
    for i in range(n):
        k += p + 1
        total = 0.0
        for m in range(p + 1):
            total += weight[m] * data[k + m]
        out[row, i] = data[start + i] + total * inverse


@njit
def _quintic_positions(data: Floats, at: int, s0: float, first: int, last: int, run: Run) -> None:
    """Write the positions at the instants first .. last - 1 of a span that is_plain_quintic.

    The row of the table of the arc length is that of the instant before, or near it. ``s0``: arc
    length at the start of the span, mm.
    """
    s, position = run.s, run.position
    n = position.shape[0]
    start = at + START
    body = start + 2 * n + SPAN_BODY
    u0, u1, length = data[at + U0], data[at + U1], data[at + LENGTH]
    table = at + int(data[at + TABLE])
    bottom = table + 1
    top = bottom + (int(data[table]) - 1) * ROW
    r = bottom
    per_row = 1.0 / (data[r + ROW] - data[r])
    for k in range(first, last):
        local = min(max(s[k] - s0, 0.0), length)
        if (r < top and local >= data[r + ROW]) or (r > bottom and local < data[r]):
            while r < top and local >= data[r + ROW]:
                r += ROW
            while r > bottom and local < data[r]:
                r -= ROW
            per_row = 1.0 / (data[r + ROW] - data[r])
        x = (local - data[r]) * per_row
        xx = x * x
        low = data[r + 2] + data[r + 3] * x + (data[r + 4] + data[r + 5] * x) * xx
        high = data[r + 6] + data[r + 7] * x + data[r + 8] * xx
        u = min(max(data[r + 1] + (low + high * (xx * xx)) * x, data[r + 1]), data[r + ROW + 1])
        x = (u - u0) / (u1 - u0) if local < length else 1.0
        y = 1.0 - x
        xx, yy = x * x, y * y
        w0, w1, w2 = y * yy * yy, 5.0 * x * yy * yy, 10.0 * xx * y * yy
        w3, w4, w5 = 10.0 * x * xx * yy, 5.0 * xx * xx * y, x * xx * xx
        c = body
        for i in range(n):
            c += 6
            low = w0 * data[c] + w1 * data[c + 1] + w2 * data[c + 2]
            high = w3 * data[c + 3] + w4 * data[c + 4] + w5 * data[c + 5]
            position[i, KEPT - 1 + k] = data[start + i] + (low + high)


@njit
def write_positions(pieces: Pieces, piece_s: Floats, count: int, run: Run) -> None:
    """Write the positions of ``count`` instants, whose arc lengths and pieces are known."""
    data, position, weight, q = pieces.data, run.position, run.weight, run.q
    first = 1
    while first <= count:
        piece = run.piece[first]
        last = first + 1
        while last <= count and run.piece[last] == piece:
            last += 1
        kind, at = pieces.kind[piece], pieces.at[piece]
        s0, length = piece_s[piece], piece_s[piece + 1] - piece_s[piece]
        if kind == SPAN and data[at + TABLE] != 0.0 and is_plain_quintic(data, at):
            _quintic_positions(data, at, s0, first, last, run)
        else:
            for k in range(first, last):
                local = min(max(run.s[k] - s0, 0.0), length)
                u = curve_inv_arclen(kind, data, at, local)
                if kind == SPAN:
                    span_point(data, at, u, weight, q)
                else:
                    curve_eval(kind, data, at, u, q)
                row = q.shape[0] - 1 if kind == SPAN else 0
                for i in range(position.shape[0]):
                    position[i, KEPT - 1 + k] = q[row, i]
        first = last
