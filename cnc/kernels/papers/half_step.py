"""Half-step deviation in integers (Shu et al. 2019): a circle about the origin.

Both the centre and the radius are on the grid.

The deviation F and its differences are those of :mod:`cnc.kernels.papers.point_by_point`. The
faster axis, y where |x| >= |y|, steps alone or with the other axis, whichever leaves the smaller
|F|: alone on a tie.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.papers.point_by_point import headings


@njit
def circle_by_half_steps(radius: int, turn: int, step: NDArray[np.int8]) -> int:
    """Write the steps of a full circle from (radius, 0) into step (rows, 2).

    turn: 1 counter-clockwise, -1 clockwise.

    Returns:
        The number of rows.
    """
    x = radius
    y = 0
    f = 0
    rows = 0
    while rows == 0 or x != radius or y != 0:
        dx, dy = headings(x, y)
        by_x = 2 * dx * x + 1
        by_y = 2 * dy * y + 1
        both = f + by_x + by_y
        if abs(x) >= abs(y):
            if abs(both) >= abs(f + by_y):
                dx = 0
        elif abs(both) >= abs(f + by_x):
            dy = 0
        f += (by_x if dx != 0 else 0) + (by_y if dy != 0 else 0)
        x += dx
        y += dy
        step[rows, 0] = dx
        step[rows, 1] = dy * turn
        rows += 1
    return rows
