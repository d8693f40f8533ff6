"""Reference pulses by the shortest normal (Kiritsis 1994).

The source is Computer-Aided Design 26(11), 1994, as equations 2 and 3 of Samad & Wan Yusof, 2002.

This is the baseline beside :mod:`cnc.kernels.pulses.enclosing_line`. The tangent at r, the point of
the curve at the last step, gives the quadrant in which the path goes on. There the grid point P has
three neighbours ahead, 2^n - 1 in n axes:

       P2 o-----o P3
          |    ,'         u_i = u - (P_i - r) . r' / ((P_i - r) . r'' - r' . r')   (2, corrected)
          |  ,' |
        P o,----o P1      |n_i|^2 = |P_i - r(u_i)|^2                               (3)
        ,'
       r

The distance of each neighbour from the curve is measured along the normal through it. One step of
Newton's iteration for (P_i - r(u)) . r'(u) = 0 from the last u gives u_i. The nearest neighbour is
the next grid point.

Correction to the paper: where the nearest neighbour is more than half a BLU from the curve in some
axis, u_i is refined by further steps. Where it stays so far, or u_i lies behind the last u, the
curve bends away within a BLU. Then no neighbour ahead may be near the curve, and the step is that
of the enclosing line.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.pulses.enclosing_line import window_rows as enclosing_line
from cnc.kernels.pulses.grid_moves import SLACK, Moves, slack
from cnc.kernels.pulses.polynomial import derivatives, value

TRIES = 4
"""Most steps of Newton's iteration for the chosen neighbour."""


@njit
def _look(poly: Floats, x: float, now: Floats) -> None:
    """Write the position of each axis at x and its first two derivatives into now (n, 3)."""
    for i in range(len(now)):
        now[i, 0] = value(poly[i], x)
        now[i, 1], now[i, 2], _ = derivatives(poly[i], x)


@njit
def _foot(grid: Ints, ahead: Ints, mask: int, x: float, now: Floats) -> float:
    """Return the place where the normal through neighbour ``mask`` meets the curve (equation 2).

    It takes one step from x. The result is infinite where there is none.
    """
    above = 0.0
    below = 0.0
    for i in range(len(grid)):
        off = grid[i] + (ahead[i] if mask >> i & 1 else 0) - now[i, 0]
        above += off * now[i, 1]
        below += now[i, 1] * now[i, 1] - off * now[i, 2]
    return x + above / below if below > 0.0 else math.inf


@njit
def _apart(grid: Ints, ahead: Ints, mask: int, now: Floats) -> float:
    """Return the largest distance in any axis (BLU) of neighbour ``mask`` from the curve."""
    apart = 0.0
    for i in range(len(grid)):
        apart = max(apart, abs(grid[i] + (ahead[i] if mask >> i & 1 else 0) - now[i, 0]))
    return apart


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
    """Write the grid moves of a window in which no axis turns.

    Arguments and results are those of :func:`cnc.kernels.pulses.enclosing_line.window_rows`.
    """
    step, s = moves
    n = len(grid)
    now = np.empty((n, 3))
    ahead = np.empty(n, np.int64)
    still = 0
    farthest = 0.0
    for i in range(n):
        ahead[i] = int(np.sign(ends[i] - poly[i, 0]))
        farthest = max(farthest, abs(poly[i, 0]), abs(ends[i]))
        if ahead[i] == 0:
            still |= 1 << i
    half = 0.5 + slack(farthest)
    _look(poly, x, now)
    through = False
    while not through and rows < limit:
        best = 0
        least = math.inf
        near = math.inf
        for mask in range(1, 1 << n):
            foot = _foot(grid, ahead, mask, x, now) if mask & still == 0 else math.inf
            if foot < math.inf:
                normal = 0.0
                for i in range(n):
                    neighbour = grid[i] + (ahead[i] if mask >> i & 1 else 0)
                    off = neighbour - value(poly[i], foot)
                    normal += off * off
                if normal < least - SLACK:
                    least = normal
                    best = mask
                    near = foot
        apart = math.inf
        tries = 0
        while apart > half and x <= near <= 1.0 and tries < TRIES:
            _look(poly, near, now)
            apart = _apart(grid, ahead, best, now)
            tries += 1
            if apart > half:
                near = _foot(grid, ahead, best, near, now)
        if apart <= half:
            x = near
            for i in range(n):
                step[rows, i] = ahead[i] if best >> i & 1 else 0
                grid[i] += step[rows, i]
            s[rows] = x
            error = max(error, apart)
            rows += 1
        else:
            before = rows
            rows, x, error = enclosing_line(poly, ends, x, grid, error, rows, rows + 1, moves)
            through = rows == before
            if not through:
                x = s[before]
                _look(poly, x, now)
    return rows, 1.0 if through else x, error
