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

Only those sides lie ahead to which the tangent points (Table 1). The tangent meets first the side
of the axis with the smallest d / |r'|, with d the distance to its side. In the plane that is the
sign of the geometric factor |x'| dy - |y'| dx (Tables 2 and 3, "abs" corrected there). On that side
u is found (Table 4, corrected: u only grows). One step along the tangent, as printed, misses by the
bend of the curve. Here it starts Newton's iteration in a bracket. So r is on the side, and the axis
that leaves has no error.

The other axes round: one with |D| > 1/2 steps as well, D = r - P (Table 5, corrected). Since r is
on the border of the square there is no null step. Since no axis is beyond its side every |D| after
the step is at most 1/2.

Corrections to the paper: the tangent only predicts the side that comes first. If another axis is
beyond its side at the place found, that axis left before and takes the lead. Windows end where an
axis turns back inside the square, at a cusp, and at a start or end off the grid
(:mod:`cnc.kernels.pulses.monotone`). No axis turns inside a window, and the square stays the same
from one window to the next.

A row is due where r is on the side, so the machine reaches the next grid point when the curve
passes it.
"""

from __future__ import annotations

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.pulses.grid_moves import Moves, slack
from cnc.kernels.pulses.polynomial import approach, bends, derivatives, slope, value, value_less

CLOSE = 1e-8
"""BLU: largest distance of an axis from its line at a row."""
BEYOND = 2.0
"""A place behind the end of every window."""


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
    position = np.empty(n)
    rates = np.empty(n)
    heading = np.empty(n)
    goal = np.empty(n)  # the end along the heading, BLU
    for i in range(n):
        heading[i] = np.sign(ends[i] - poly[i, 0])
        goal[i] = heading[i] * ends[i] - slack(ends[i])
    near = x
    lead = -1
    line = 0.0
    high = BEYOND
    exact = False
    moving = False
    while True:
        for i in range(n):
            position[i] = value(poly[i], near)
            rates[i] = slope(poly[i], near)
        if moving:
            sought = -1
            if not exact and not (x <= near <= 1.0 and abs(position[lead] - line) <= CLOSE):
                sought = lead
            elif x < near < high:
                high = near
                for i in range(n):
                    if heading[i] * (position[i] - grid[i]) > 1.0 + CLOSE:
                        # This axis has left the square before.
                        sought = i
            if sought >= 0:
                lead = sought
                exact = True
                line = grid[lead] + heading[lead]
                near = _reached(poly[lead], line, heading[lead], x, min(high, 1.0))
                continue
            x = near
            s[rows] = x
            for i in range(n):
                off = position[i] - grid[i]
                margin = 0.5 + slack(position[i])
                # Table 5, see grid_after
                move = int(off > margin) - int(off < -margin)
                step[rows, i] = move
                grid[i] += move
                error = max(error, abs(off - move))
            rows += 1
        lead = -1
        lead_off = 0.0
        lead_rate = 0.0
        for i in range(n):
            sign = heading[i]
            if goal[i] - sign * grid[i] > 1.0:
                off = 1.0 - sign * (position[i] - grid[i])
                rate = abs(rates[i])
                # the geometric factor
                if lead < 0 or off * lead_rate < lead_off * rate:
                    lead = i
                    lead_off = off
                    lead_rate = rate
        moving = lead >= 0 and rows < limit
        if not moving:
            break
        sign = heading[lead]
        line = grid[lead] + sign
        second, third = bends(poly[lead], x)
        ahead = approach(min(-lead_off, 0.0), sign * rates[lead], sign * second, sign * third)
        near = min(x + ahead, BEYOND)
        exact = False
        high = BEYOND
    return rows, x if lead >= 0 else 1.0, error
