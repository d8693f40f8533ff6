"""Half-step deviation (Shu et al. 2019) on the data of the paper: lines and circles.

The line begins at the origin, and the circle is about it, both on the grid.

:mod:`cnc.kernels.pulses.half_step` interpolates lines and arcs of a path anywhere, and this line,
too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.kernels.papers.half_step import circle_by_half_steps
from cnc.kernels.path.curve import LINE
from cnc.kernels.pulses.grid_moves import Grid, Moves, Piece
from cnc.kernels.pulses.half_step import half_step_rows
from cnc.papers.algorithms.grid_points import Points, checked_end, checked_radius, points
from cnc.path.records import line_records


def line(end: ArrayLike) -> Points:
    """Return the grid points (m + 1, n) from the origin to ``end`` (n,), integers.

    There is one for each step of the longest axis (equations 8 to 10).
    """
    target = checked_end(end)
    record = line_records(
        np.zeros(len(target)), target[None].astype(np.float64), np.zeros(len(target), np.int64)
    )
    rows = int(np.abs(target).max())
    moves = Moves(np.empty((rows, len(target)), np.int8), np.empty(rows))
    grid = Grid(np.ones(len(target)), np.zeros(len(target), np.int64))
    piece = Piece(LINE, record.data, 0, 0.0)
    rows, _, _ = half_step_rows(piece, 0.0, float(record.length[0]), grid, 0, moves)
    return points(np.zeros(len(target), np.int64), moves.step[:rows])


def circle(radius: int, *, clockwise: bool = False) -> Points:
    """Return the grid points (m + 1, 2) of a full turn about the origin from (radius, 0).

    Each is the nearer one of the two candidates of its octant.
    """
    step: NDArray[np.int8] = np.empty((8 * checked_radius(radius), 2), np.int8)
    rows = circle_by_half_steps(radius, -1 if clockwise else 1, step)
    return points(np.array([radius, 0]), step[:rows])
