"""Reference pulses by point-by-point comparison, with one axis in each move.

This is the baseline of Shu et al. 2019. The grid points are 4-connected.

The method compares on which side of the curve the grid point P is, by the sign of a deviation F,
and steps towards the curve or along it. That keeps P within a whole BLU only. Moved by half a step
the method keeps half a BLU, and so it is used for pieces of path:

        +-----------+
      C o     ,'    |
        |    '      |
        |   :   P   |
        |   '.      |
        +-----'-----+

F is taken at the corner C of the cell about P, (x - 1/2, y + 1/2) for an arc that goes left and up.
With the corner inside the circle the arc leaves the cell at the top, so y steps; else at the left,
so x steps. In other words, an axis steps where the curve crosses its next half-grid line, whichever
comes first. So the rows are those of :mod:`cnc.kernels.pulses.crossings`, with one axis in each row
where the curve passes through a corner. Any number of axes may move, on any curve.

The method in integers on the line and the circle of the paper is in
:mod:`cnc.kernels.papers.point_by_point`.
"""

from __future__ import annotations

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.curve import curve_range
from cnc.kernels.pulses.crossings import crossing_rows
from cnc.kernels.pulses.grid_moves import Grid, Moves, Piece


@njit
def point_by_point_rows(
    piece: Piece, u: float, upto: float, grid: Grid, rows: int, moves: Moves
) -> tuple[int, float, float]:
    """Write the grid moves of a piece from u to ``upto``, until the buffer is full.

    Arguments and results are those of :func:`cnc.kernels.pulses.crossings.crossing_rows`.
    """
    kind, data, at, s0 = piece
    point = grid.point
    step, s = moves
    n = len(point)
    most = len(s)
    first = rows
    u0, _ = curve_range(kind, data, at)
    rows, u, error = crossing_rows(piece, u, upto, grid, rows, moves)
    count = first
    for row in range(first, rows):
        for i in range(n):
            count += 1 if step[row, i] != 0 else 0
    # From the last row to the first, so that each is read before it is overwritten. Steps beyond
    # the buffer are taken back.
    signs = np.empty(n, np.int8)
    taken = min(count, most)
    target = count
    for row in range(rows - 1, first - 1, -1):
        place = s[row]
        for i in range(n):
            signs[i] = step[row, i]
        for i in range(n - 1, -1, -1):
            if signs[i] != 0:
                target -= 1
                if target < most:
                    for k in range(n):
                        step[target, k] = 0
                    step[target, i] = signs[i]
                    s[target] = place
                else:
                    point[i] -= signs[i]
    if count > most:
        u = min(curve_inv_arclen(kind, data, at, s[most - 1] - s0), np.nextafter(upto, u0))
    return taken, u, error
