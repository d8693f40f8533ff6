"""Reference pulses of a piece in windows in which no axis turns back.

The interpolators of :mod:`cnc.kernels.pulses.enclosing_line` and :mod:`cnc.kernels.pulses.kiritsis`
go from grid point to grid point. Their windows (:mod:`cnc.kernels.pulses.windows`) also end
wherever an axis turns. So each axis has one heading in a window, and the position of its end
decides whether a line is reached inside:

      y ^      ,---o         o   ends of windows: turning points of x and of y, and the ends of
        |    ,'     `.           the range of one polynomial
        |   o         o
        |  /          |          The rows of a window are written at once. The grid point goes
        +---------------> x      from one window to the next, at most one BLU from the curve.

A piece may end off the grid: the next piece goes on from the grid point reached. The rows do not
depend on the place where a piece is cut.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import MAX_TURNING_POINTS, Floats, curve_range
from cnc.kernels.path.extremes import curve_turning_points
from cnc.kernels.pulses.catch_up import enter
from cnc.kernels.pulses.enclosing_line import window_rows as enclosing_line_window
from cnc.kernels.pulses.grid_moves import Grid, Moves, Piece
from cnc.kernels.pulses.kiritsis import window_rows as kiritsis_window
from cnc.kernels.pulses.windows import (
    begin_window,
    following,
    new_window,
    next_window,
    place_rows,
)


@njit
def _all_turning_points(piece: Piece, n: int, turns: Floats) -> None:
    """Write the places where any of n axes turns, in order, then inf.

    ``turns`` takes n MAX_TURNING_POINTS + 1 numbers.
    """
    of_axis = np.empty(MAX_TURNING_POINTS)
    count = 0
    for i in range(n):
        for k in range(curve_turning_points(piece.kind, piece.data, piece.at, i, of_axis)):
            place = count
            while place > 0 and turns[place - 1] > of_axis[k]:
                turns[place] = turns[place - 1]
                place -= 1
            turns[place] = of_axis[k]
            count += 1
    turns[count] = math.inf


@njit
def monotone_rows(
    by_normal: bool,
    piece: Piece,
    u: float,
    upto: float,
    width: float,
    grid: Grid,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float, float]:
    """Write the grid moves of a piece from u to ``upto``, until the buffer is full.

    Args:
        by_normal: by the shortest normal (Kiritsis) if true, by enclosing lines if false.
        piece: the piece.
        u: parameter from which the moves are wanted.
        upto: parameter up to which they are wanted.
        width: width of the next window; 0 when the piece is entered.
        grid: the grid and its point, moved along. When the piece is entered the point is at most a
            BLU and a half from the curve in each axis.
        rows: number of rows in ``moves``.
        moves: the buffer.

    Returns:
        The number of rows, the u up to which all moves are written, the largest
        |grid point - position| (BLU) of any axis at any of these rows, and the width of the next
        window.
    """
    kind, data, at, _ = piece
    scale, point = grid
    n = len(point)
    ends = np.empty(n)
    turns = np.empty(n * MAX_TURNING_POINTS + 1)
    window = new_window(n)
    _all_turning_points(piece, n, turns)
    u0, _ = curve_range(kind, data, at)
    error = 0.0
    full = False
    if u == u0:
        rows, error, done = enter(piece, u, grid, window.inside, error, rows, moves)
        full = not done
    begin_window(piece, u, window)
    if width <= 0.0:
        width = upto - u
    turn = 0
    while u < upto and not full:
        while turns[turn] <= u:
            turn += 1
        ub, width, by_table = next_window(piece, u, min(turns[turn], upto), width, scale, window)
        for i in range(n):
            ends[i] = window.end[0, i] * scale[i]
        first = rows
        if by_normal:
            rows, x, error = kiritsis_window(
                window.poly, ends, 0.0, point, error, rows, len(moves.s), moves
            )
        else:
            rows, x, error = enclosing_line_window(
                window.poly, ends, 0.0, point, error, rows, len(moves.s), moves
            )
        place_rows(piece, u, ub, by_table, window, first, rows, moves.s)
        full = x < 1.0
        u = u + x * (ub - u) if full else ub
        window = following(window)
    return rows, u, error, width
