"""Point-by-point comparison, the baseline of Shu et al. 2019: each move is of one axis, so that a
path is 4-connected.

The method asks on which side of the curve the grid point P is, by the sign of a deviation F, and
steps towards the curve or along it. That keeps P within a whole BLU only. Moved by half a step it
keeps half a BLU, which is how pieces of path are done here:

        +-----------+           F asked at the corner C of the cell about P, (x - 1/2, y + 1/2) for an arc that goes left and up: with the
      C o     ,'    |           corner inside the circle the arc leaves the cell at the top, so y steps, else at the left, so x steps.
        |    '      |
        |   :   P   |           In other words, an axis steps where the curve crosses its next half-grid line, whichever is first. So the
        |   '.      |           rows are those of :mod:`cnc.kernels.pulses.crossing_rows`, with one axis a row where the curve passes through a
        +-----'-----+           corner; and any number of axes may move, on any curve.

As the paper has it, in integers on its line and circle, the method is in
:mod:`cnc.kernels.papers.comparison`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints, curve_inv_arclen, curve_range
from cnc.kernels.pulses.crossing_rows import crossing_rows


@njit
def point_by_point_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of a piece from u to ``upto``, from row ``rows`` on, as many as there is
    room for.

    s0: path coordinate (mm) of the piece's start. scale (n,): steps per mm. grid (n,) is carried
    on. state: not needed here. step (room, n) gets the rows, reach (room,) the path coordinate of
    each. Returns the number of rows, the u up to which all is done (``upto`` when through), and the
    largest |grid - position| (BLU) over axes and rows.
    """
    n = len(grid)
    room = len(reach)
    first = rows
    u0, _ = curve_range(kind, data, at)
    rows, u, error = crossing_rows(
        kind, data, at, u, upto, s0, scale, grid, state, rows, step, reach
    )
    count = first
    for row in range(first, rows):
        for i in range(n):
            count += 1 if step[row, i] != 0 else 0
    # from the last to the first, so that no row is written over before it is read; what there is no
    # room for is taken back
    moves = np.empty(n, np.int8)
    taken = min(count, room)
    target = count
    for row in range(rows - 1, first - 1, -1):
        place = reach[row]
        for i in range(n):
            moves[i] = step[row, i]
        for i in range(n - 1, -1, -1):
            if moves[i] != 0:
                target -= 1
                if target < room:
                    for k in range(n):
                        step[target, k] = 0
                    step[target, i] = moves[i]
                    reach[target] = place
                else:
                    grid[i] -= moves[i]
    if count > room:
        u = min(curve_inv_arclen(kind, data, at, reach[room - 1] - s0), np.nextafter(upto, u0))
    return taken, u, error
