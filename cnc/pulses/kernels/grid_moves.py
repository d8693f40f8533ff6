"""Data that the generators of grid moves share, and the rule that gives the next grid point.

A grid move is one row of a buffer: the axes that step together, each by one BLU.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_arclen
from cnc.path.kernels.curve import Floats, Ints, curve_eval, curve_range

Steps = NDArray[np.int8]
Lines = NDArray[np.int32]

SLACK = 5e-10
"""BLU. Far below any distance that matters, and above the rounding of positions up to 100 000
BLU.
"""
SLACK_PER_BLU = 2e-15
"""Added to SLACK for each BLU of distance from the origin, since rounding grows with the position.
"""


class Piece(NamedTuple):
    """One piece of a path.

    Attributes:
        kind: LINE, ARC or SPAN.
        data: float64: the records of the path.
        at: index in ``data`` at which the record of the piece begins.
        s0: path coordinate at the start of the piece, mm.
    """

    kind: int
    data: Floats
    at: int
    s0: float


class Grid(NamedTuple):
    """The grid of a machine and the grid point reached.

    Attributes:
        scale: (n,): steps per mm.
        point: (n,) int64: the grid point in steps. Generators move it along.
    """

    scale: Floats
    point: Ints


class Moves(NamedTuple):
    """A buffer of grid moves.

    Attributes:
        step: (rows, n) int8: -1, 0 or 1 for each axis.
        s: (rows,): path coordinate at which the move is due, mm.
    """

    step: Steps
    s: Floats


@njit
def slack(p: float) -> float:
    """Return the largest rounding error (BLU) that a position of p BLU may have."""
    return SLACK + SLACK_PER_BLU * abs(p)


@njit
def grid_after(g: int, p: float) -> int:
    """Return the grid point of an axis that was at grid point g and has moved to p BLU.

    It is g unless p is beyond the half-grid line next to g by more than the slack.
    """
    margin = 0.5 + slack(p)
    if p > g + margin:
        return math.ceil(p - margin)
    if p < g - margin:
        return math.floor(p + margin)
    return g


# Grid moves by which the grid point catches up with the curve.
#
# They are needed where the motion rests off the grid, where a piece begins a whole BLU ahead of the
# grid point, and where an axis would have to make two steps at once.
#
# 3 - - - - - - - - o- -
#                 ,':
# 2 - - - - - - o' - - -
#              /:   :
# 1 - ---o----' : - : -
#                   u
#
# An axis that is more than a step and a half behind at u would have to make two steps there. So a
# row for the first step is written where the axis is exactly that far behind: there the grid points
# after one step and after two are equally near. This place belongs to the curve. It depends neither
# on earlier rows nor on the place where a piece is cut.


@njit
def _write_row(
    piece: Piece, u: float, grid: Grid, here: Floats, error: float, rows: int, moves: Moves
) -> tuple[int, float]:
    """Write the row that rounds the grid point to the curve at u, if a step is needed.

    Returns:
        The number of rows, and the largest error so far.
    """
    kind, data, at, s0 = piece
    scale, point = grid
    step, s = moves
    u0, _ = curve_range(kind, data, at)
    curve_eval(kind, data, at, u, here)
    steps = False
    for i in range(len(point)):
        p = here[0, i] * scale[i]
        sign = min(max(grid_after(point[i], p) - point[i], -1), 1)
        steps = steps or sign != 0
        step[rows, i] = sign
        point[i] += sign
        if steps:
            error = max(error, abs(point[i] - p))
    if steps:
        s[rows] = s0 + (curve_arclen(kind, data, at, u0, u) if u > u0 else 0.0)
        rows += 1
    return rows, error


@njit
def _two_behind(piece: Piece, u: float, grid: Grid, here: Floats) -> int:
    """Return the first axis that is two steps behind the curve at u; -1 if there is none."""
    scale, point = grid
    curve_eval(piece.kind, piece.data, piece.at, u, here)
    behind = -1
    for i in range(len(point) - 1, -1, -1):
        if abs(grid_after(point[i], here[0, i] * scale[i]) - point[i]) > 1:
            behind = i
    return behind


@njit
def prepare(
    piece: Piece,
    low: float,
    u: float,
    upto: float,
    grid: Grid,
    here: Floats,
    error: float,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float, bool]:
    """Write the first row without which an axis would have to make two steps in a row at u.

    Args:
        piece: the piece.
        low: the row lies after this parameter.
        u: parameter of the row to prepare for.
        upto: a row beyond this parameter is not written.
        grid: the grid and its point, moved along.
        here: (4, n): work space.
        error: largest |grid point - position| so far, BLU.
        rows: number of rows in ``moves``.
        moves: the buffer.

    Returns:
        The number of rows, the parameter of the row (``low`` without a row), the largest error so
        far, and whether the buffer was large enough.
    """
    kind, data, at, _ = piece
    scale, point = grid
    done = True
    axis = _two_behind(piece, u, grid, here)
    if axis >= 0:
        place = u
        while axis >= 0:
            sign = 1.0 if here[0, axis] * scale[axis] > point[axis] else -1.0
            line = (point[axis] + 1.5 * sign) / scale[axis]
            near = low
            high = place
            middle = 0.5 * (near + high)
            while near < middle < high:
                curve_eval(kind, data, at, middle, here)
                if sign * (here[0, axis] - line) >= 0.0:
                    high = middle
                else:
                    near = middle
                middle = 0.5 * (near + high)
            axis = _two_behind(piece, high, grid, here) if high < place else -1
            place = high
        if place <= upto:
            done = rows < len(moves.s)
            if done:
                rows, error = _write_row(piece, place, grid, here, error, rows, moves)
                low = place
    return rows, low, error, done


@njit
def round_to(
    piece: Piece,
    low: float,
    u: float,
    grid: Grid,
    here: Floats,
    error: float,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float, bool]:
    """Write the rows that bring the grid point to the rounded position at u.

    Arguments and results are those of :func:`prepare`.
    """
    scale, point = grid
    done = True
    before = -1
    while done and rows > before:
        before = rows
        rows, low, error, done = prepare(piece, low, u, u, grid, here, error, rows, moves)
    if done:
        curve_eval(piece.kind, piece.data, piece.at, u, here)
        for i in range(len(point)):
            done = done and grid_after(point[i], here[0, i] * scale[i]) == point[i]
        if not done and rows < len(moves.s):
            rows, error = _write_row(piece, u, grid, here, error, rows, moves)
            done = True
        low = u if done else low
    return rows, low, error, done


@njit
def enter(
    piece: Piece, u: float, grid: Grid, here: Floats, error: float, rows: int, moves: Moves
) -> tuple[int, float, bool]:
    """Write the row at the start u of a piece, where the piece before left an axis a BLU behind.

    Such an axis did not lead there.

    Returns:
        The number of rows, the largest error so far, and whether the buffer was large enough.
    """
    scale, point = grid
    curve_eval(piece.kind, piece.data, piece.at, u, here)
    behind = False
    for i in range(len(point)):
        p = here[0, i] * scale[i]
        behind = behind or abs(p - point[i]) >= 1.0 - slack(p)
    done = True
    if behind:
        rows, _, error, done = round_to(piece, u, u, grid, here, error, rows, moves)
    return rows, error, done
