"""Half steps and point-by-point comparison in integers (Shu et al. 2019): circles, and a line.

A circle is about the origin, with its radius on the grid.

Half steps have the deviation F and its differences of the point-by-point comparison below. The
faster axis, y where |x| >= |y|, steps alone or with the other axis, whichever leaves the smaller
|F|: alone on a tie.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

# Point-by-point comparison in integers (Shu et al. 2019): a line and a circle.
#
# The line begins at the origin.
#
# F is the deviation of the grid point: Xe Yi - Xi Ye of a line to (Xe, Ye) (equation 1), x^2 + y^2
# - R^2 of a circle. It is never computed anew, since a step changes it by a difference: -Ye or +Xe
# on the line (equations 6, 7), 2 x dx + 1 and 2 y dy + 1 on the circle. The paper leaves the circle
# to the reader.
#
#               ,--+--.
#        2    ,'   |   `.   1
#     -x, -y |     |     | -x, +y
#          --+-----+-----+--
#     +x, -y |     |     | +x, +y
#        3    `.   |   ,'   4
#               `--+--'
#
# Counter-clockwise (the large circle of figure 6) x and y step along the tangent: one of them
# towards the centre, the other away from it. Outside the circle the inward step is taken, inside it
# the outward step. Clockwise is the mirror image: y changes its sign.
#
# Corrected: the moves of rules (1), (2) of section 3.1.1 by figure 6; the full circle ends at its
# start.


@njit
def line_by_points(xe: int, ye: int, step: NDArray[np.int8]) -> int:
    """Write the steps of a line from (0, 0) to (xe, ye) (equations 6 and 7, F >= 0 steps X).

    Returns:
        The number of rows, |xe| + |ye|.
    """
    rows = abs(xe) + abs(ye)
    f = 0
    for row in range(rows):
        along_x = f >= 0 and xe != 0
        step[row, 0] = (1 if xe > 0 else -1) if along_x else 0
        step[row, 1] = 0 if along_x else (1 if ye > 0 else -1)
        f += -abs(ye) if along_x else abs(xe)
    return rows


@njit
def circle_by_points(radius: int, turn: int, inward_on_circle: bool, step: NDArray[np.int8]) -> int:
    """Write the steps of a full circle from (radius, 0).

    Args:
        radius: in steps.
        turn: 1 counter-clockwise, -1 clockwise.
        inward_on_circle: direction of the step where F = 0. F > 0 steps inward, F < 0 outward.
        step: (rows, 2): takes the steps.

    Returns:
        The number of rows.
    """
    x = radius
    y = 0
    f = 0
    rows = 0
    while rows == 0 or x != radius or y != 0:
        dx, dy = headings(x, y)
        inward = f > 0 or (f == 0 and inward_on_circle)
        # x goes inward in the first and the third quadrant
        if (dx * x < 0) == inward:
            f += 2 * dx * x + 1
            x += dx
            dy = 0
        else:
            f += 2 * dy * y + 1
            y += dy
            dx = 0
        step[rows, 0] = dx
        step[rows, 1] = dy * turn
        rows += 1
    return rows


@njit
def headings(x: int, y: int) -> tuple[int, int]:
    """Return the directions of x and y counter-clockwise; a quadrant begins on its axis."""
    dx = -1 if y > 0 or (y == 0 and x > 0) else 1
    dy = 1 if x > 0 or (x == 0 and y < 0) else -1
    return dx, dy


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
