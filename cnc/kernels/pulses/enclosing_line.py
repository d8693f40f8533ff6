"""Reference pulses by enclosing lines (Samad & Wan Yusof 2002), in any number of axes.

The paper is in Jurnal Teknologi 37(D), 2002.

A square (in space: a cube) with sides of 2 BLU lies about the grid point P. The interpolator finds
the point r at which the curve leaves it; the grid point nearest to r is the next one.

      A4      A3  L2  A2
        +------+--o---+
        |      |,'    |
     L3 |      P      | L1
        |    ,'       |
        +--,---+------+
      A6      A7  L4  A8

Only those sides lie ahead to which the tangent points (Table 1). In the paper the tangent also
predicts the side that comes first: that of the axis with the smallest d / |r'|, with d the distance
to its side. In the plane that is the sign of the geometric factor |x'| dy - |y'| dx (Tables 2 and
3, "abs" corrected there). One step along the tangent gives u on that side (Table 4, corrected: u
only grows), off by the bend of the curve.

Here r is exact. The sides are lines of the grid, and an axis meets its lines at places that do not
depend on the grid point. So the places of its next lines are found together, and the side that
comes first is that of the axis whose place is first. r is on the side, so the axis that leaves has
no error.

The other axes round: one with |D| > 1/2 steps as well, D = r - P (Table 5, corrected). Since r is
on the border of the square there is no null step. Since no axis is beyond its side every |D| after
the step is at most 1/2.

Windows end where an axis turns back inside the square, at a cusp, and at a start or end off the
grid (:mod:`cnc.kernels.pulses.monotone`). No axis turns inside a window, and the square stays the
same from one window to the next.

A row is due where r is on the side, so the machine reaches the next grid point when the curve
passes it.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.pulses.grid_moves import Moves, slack
from cnc.kernels.pulses.polynomial import (
    approach,
    derivatives,
    estrin,
    is_constant,
    value,
    value_less,
)

CLOSE = 1e-8
"""BLU: largest distance of an axis from its line at a row."""
BEYOND = 2.0
"""A place behind the end of every window."""
PLACES = 32
"""Most places of an axis that are found at once."""
REACH = 1.0 / 64.0
"""Range of the inverse series, in parts of its radius of convergence, at which its error is about
CLOSE.
"""


@njit
def _reached(c: Floats, line: float, sign: float, low: float, high: float) -> float:
    """Return the x in [low, high] where an axis of constant heading ``sign`` is at ``line`` (BLU).

    It is ``low`` if the axis is there, and ``high`` if it never gets there.
    """
    first = low
    x = low
    while True:
        f = sign * value_less(c, line, x)
        if abs(f) <= CLOSE or x >= high or (f > 0.0 and x == first):
            break
        f1, f2, f3 = derivatives(c, x)
        if f > 0.0:
            high = x
        else:
            low = x
        near = x + approach(f, sign * f1, sign * f2, sign * f3)
        if not low < near < high:
            near = 0.5 * (low + high)
            if not low < near < high:
                # neighbouring numbers: the line lies between them
                near = high
        x = near
    return x


@njit
def next_places(
    c: Floats, ahead: int, sign: float, low: float, goal: float, places: Floats, off: Floats
) -> int:
    """Write the places in [low, 1] where an axis is at its next lines, one BLU apart.

    They come from the inverse series of the cubic about ``low`` and one step of Newton's iteration
    with the slope of that series. A place counts when the axis is at its line there.

    Args:
        c: (POLYNOMIAL,): the position of the axis in the window, BLU.
        ahead: the first line, times the heading.
        sign: the heading, constant from ``low`` to 1.
        low: place behind which the lines lie.
        goal: position at x = 1 times the heading; beyond the first line.
        places: (PLACES,): takes the places.
        off: (PLACES,): work space.

    Returns:
        The number of places, at least 1.
    """
    f1, f2, f3 = derivatives(c, low)
    count = 0
    if sign * f1 > 0.0:
        inverse = 1.0 / f1
        p = 0.5 * f2 * inverse
        q = 2.0 * p * p - f3 * inverse / 6.0
        # One BLU takes ``rate``.
        rate = sign * inverse
        reach = REACH / (max(abs(p), math.sqrt(abs(q))) * rate)
        wanted = min(min(math.ceil(goal) - ahead, PLACES), 1 + int(min(reach, PLACES)))
        begin = ahead - sign * value(c, low)
        c0, c1, c2, c3, c4, c5, c6, c7 = c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7]
        for k in range(wanted):
            line = sign * (ahead + k)
            y = (begin + k) * rate
            x = low + y * (1.0 - y * (p - y * q))
            rise = rate * (1.0 - y * (2.0 * p - y * (3.0 * q)))
            x -= sign * estrin(c0 - line, c1, c2, c3, c4, c5, c6, c7, x) * rise
            x = min(max(x, low), 1.0)
            places[k] = x
            off[k] = abs(estrin(c0 - line, c1, c2, c3, c4, c5, c6, c7, x))
        while count < wanted and off[count] <= CLOSE:
            count += 1
    if count == 0:
        places[0] = _reached(c, sign * ahead, sign, low, 1.0)
        count = 1
    return count


@njit
def window_rows(
    poly: Floats,
    ends: Floats,
    x: float,
    grid: Ints,
    error: float,
    rows: int,
    limit: int,
    moves: Moves,
) -> tuple[int, float, float]:
    """Write the grid moves of a window in which no axis turns, from its place x on.

    Args:
        poly: polynomials of the axes in BLU, see :class:`cnc.kernels.pulses.windows.Window`.
        ends: (n,): positions at x = 1, BLU.
        x: place in the window from which the moves are wanted.
        grid: (n,): the grid point, moved along.
        error: largest |grid point - position| so far, BLU.
        rows: number of rows in ``moves``.
        limit: number of rows at which to stop.
        moves: the buffer; ``s`` takes the x of each row.

    Returns:
        The number of rows, the x up to which all moves are written (1 when the window is done), and
        the largest error so far.
    """
    step, s = moves
    n = len(grid)
    heading = np.empty(n, np.int64)
    goal = np.empty(n)  # the end along the heading, BLU
    places = np.empty((n, PLACES))
    off_line = np.empty(PLACES)
    first = np.empty(n, np.int64)  # line of the first place, times the heading
    count = np.zeros(n, np.int64)
    due = np.full(n, BEYOND)  # place at which the axis leaves the square
    stands = np.zeros(n, np.bool_)
    for i in range(n):
        heading[i] = np.sign(ends[i] - poly[i, 0])
        goal[i] = heading[i] * ends[i] - slack(ends[i])
        first[i] = heading[i] * grid[i] + 1
        if goal[i] > first[i]:
            count[i] = next_places(poly[i], first[i], heading[i], x, goal[i], places[i], off_line)
            due[i] = places[i, 0]
        stands[i] = is_constant(poly[i])
    begin = rows
    while True:
        near = due[0]
        for i in range(1, n):
            near = min(near, due[i])
        if near == BEYOND or rows >= limit:
            break
        x = near
        s[rows] = x
        for i in range(n):
            move = heading[i]
            if stands[i] and rows > begin:
                # as at the first row, and no step is left
                move = 0
            elif due[i] > near:
                position = value(poly[i], x)
                off = position - grid[i]
                margin = 0.5 + slack(position)
                # Table 5, see grid_after
                move = 0
                if off > margin:
                    move = 1
                elif off < -margin:
                    move = -1
                error = max(error, abs(off - move))
            step[rows, i] = move
            if move != 0:
                grid[i] += move
                ahead = heading[i] * grid[i] + 1
                due[i] = BEYOND
                if goal[i] > ahead:
                    if not 0 <= ahead - first[i] < count[i]:
                        first[i] = ahead
                        count[i] = next_places(
                            poly[i], ahead, heading[i], x, goal[i], places[i], off_line
                        )
                    due[i] = places[i, ahead - first[i]]
        rows += 1
    return rows, x if near < BEYOND else 1.0, error
