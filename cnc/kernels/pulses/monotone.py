"""A piece of path in windows in which no axis turns back, for the interpolators that go from grid
point to grid point.

A window (see :mod:`cnc.kernels.pulses.crossings`) here also ends wherever an axis turns. So each
axis has one heading in it, and where its end lies tells whether a line is reached inside:

      y ^      ,---o         o   ends of windows: turning points of x and of y,
        |    ,'     `.           and as far as one polynomial reaches
        |   o         o
        |  /          |          The interpolators of :mod:`cnc.kernels.pulses.enclosing_line` and :mod:`cnc.kernels.pulses.kiritsis` write the rows of
        +---------------> x      a window; the grid point goes along from one to the next, at most one BLU from the curve.

A piece may end off the grid: the next one goes on from the grid point that is left. Rows don't
depend on where a piece is cut.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    MAX_TURNING_POINTS,
    Floats,
    Ints,
    curve_arclen,
    curve_eval,
    curve_range,
    curve_turning_points,
)
from cnc.kernels.pulses.catch_up import enter
from cnc.kernels.pulses.crossings import POLYNOMIAL, next_window, place_rows
from cnc.kernels.pulses.enclosing_line import window_rows as enclosing_line_window
from cnc.kernels.pulses.kiritsis import window_rows as kiritsis_window

WIDTH = 0
"""Place in the state that is kept while a piece is under way: the width of the next window, 0 when
the piece is entered.
"""


@njit
def all_turning_points(kind: int, data: Floats, at: int, n: int, turns: Floats) -> None:
    """The places where any of n axes turns, in order, then inf, into turns (n MAX_TURNING_POINTS +
    1,).
    """
    of_axis = np.empty(MAX_TURNING_POINTS)
    count = 0
    for i in range(n):
        for k in range(curve_turning_points(kind, data, at, i, of_axis)):
            turns[count] = of_axis[k]
            count += 1
    turns[count] = math.inf
    turns[:count].sort()


@njit
def _rows(
    by_normal: bool, kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats,
    rows: int, step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """The rows of a piece, by Kiritsis or by enclosing lines: see :func:`enclosing_line_rows`."""
    n = len(grid)
    room = len(reach)
    poly = np.empty((n + 1, POLYNOMIAL))
    ra = np.empty((4, n))
    rb = np.empty((4, n))
    rc = np.empty((4, n))
    lengths = np.empty((2, 4))
    ends = np.empty(n)
    turns = np.empty(n * MAX_TURNING_POINTS + 1)
    all_turning_points(kind, data, at, n, turns)
    u0, _ = curve_range(kind, data, at)
    error = 0.0
    full = False
    if u == u0:
        rows, error, done = enter(kind, data, at, u, s0, scale, grid, rc, error, rows, step, reach)
        full = not done
    curve_eval(kind, data, at, u, ra)
    lengths[0, 0] = curve_arclen(kind, data, at, u0, u)
    width = state[WIDTH] if state[WIDTH] > 0.0 else upto - u
    turn = 0
    while u < upto and not full:
        while turns[turn] <= u:
            turn += 1
        ub, width, by_table = next_window(
            kind, data, at, u, min(turns[turn], upto), width, scale, ra, rb, rc, lengths, poly
        )
        for i in range(n):
            ends[i] = rb[0, i] * scale[i]
        first = rows
        if by_normal:
            rows, x, error = kiritsis_window(poly, ends, 0.0, grid, error, rows, room, step, reach)
        else:
            rows, x, error = enclosing_line_window(
                poly, ends, 0.0, grid, error, rows, room, step, reach
            )
        place_rows(kind, data, at, u, ub, s0, by_table, poly, first, rows, reach)
        full = x < 1.0
        u = u + x * (ub - u) if full else ub
        lengths[0, 0] = lengths[1, 0]
        ra, rb = rb, ra
    state[WIDTH] = width
    return rows, u, error


@njit
def enclosing_line_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats,
    rows: int, step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of a piece from u to ``upto``, from row ``rows`` on, as many as there is
    room for.

    scale (n,): steps per mm. grid (n,): grid point, carried on; where the piece is entered at most
    a BLU and a half from the curve in each axis. state (32,): zeros when the piece is entered, kept
    while it is under way. step (room, n) gets the rows, reach (room,) the path coordinate of each
    in mm, s0 at the start of the piece. Returns the number of rows, the u up to which all is done,
    and the largest |grid - position| in BLU of any of these rows.
    """
    return _rows(False, kind, data, at, u, upto, s0, scale, grid, state, rows, step, reach)


@njit
def kiritsis_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats,
    rows: int, step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """The same as :func:`enclosing_line_rows`, by the shortest normal."""
    return _rows(True, kind, data, at, u, upto, s0, scale, grid, state, rows, step, reach)
