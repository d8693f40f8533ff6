"""Reference pulses by the shortest normal (Kiritsis, Computer-Aided Design 26(11), 1994; equations
2 and 3 of Samad & Wan Yusof, 2002).

The baseline beside :mod:`cnc.kernels.pulses.enclosing_line`. The tangent at r, the curve's point of
the last step, tells in which quadrant the path goes on; there the grid point P has three neighbours
ahead, 2^n - 1 in n axes:

       P2 o-----o P3          Each neighbour's distance from the curve is measured along the normal through it: one step of Newton's
          |    ,'             iteration for (P_i - r(u)) . r'(u) = 0 from the last u gives
          |  ,' |
        P o,----o P1              u_i = u - (P_i - r) . r' / ((P_i - r) . r'' - r' . r')                      (2, x_i mended as x_0)
        ,'                        |n_i|^2 = |P_i - r(u_i)|^2                                                  (3)
       r
                              and the nearest one is the next.

Mended beyond that: where the nearest is more than half a BLU from the curve in some axis, u_i is
refined by further steps. Where it stays so, or lies behind the last one, the curve bends away
within a BLU: none of the neighbours ahead may then be near it, and the step is that of the
enclosing line.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints, curve_eval, curve_range
from cnc.kernels.pulses.crossings import SLACK, risen, slack
from cnc.kernels.pulses.enclosing_line import window_rows as enclosing_line

TRIES = 4
"""Most steps of Newton's iteration for the neighbour that was chosen."""


@njit
def _look(poly: Floats, x: float, now: Floats) -> None:
    """Write where each axis is at x, and its first two derivatives there, into now (n, 3)."""
    x2 = x * x
    x4 = x2 * x2
    for i in range(len(now)):
        c = poly[i]
        now[i, 0] = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)
        now[i, 1] = (
            (c[8] + c[9] * x) + (c[10] + c[11] * x) * x2 + ((c[12] + c[13] * x) + c[14] * x2) * x4
        )
        now[i, 2] = (c[15] + c[16] * x) + (c[17] + c[18] * x) * x2 + (c[19] + c[20] * x) * x4


@njit
def _foot(grid: Ints, ahead: Ints, mask: int, x: float, now: Floats) -> float:
    """Equation 2: where the normal through the neighbour ``mask`` meets the curve, by one step from
    x; inf where it doesn't.
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
    """The largest distance in any axis, in BLU, of the neighbour ``mask`` from the curve's
    point.
    """
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
    room: int,
    step: NDArray[np.int8],
    reach: Floats,
) -> tuple[int, float, float]:
    """Write the grid moves of a window: see
    :func:`cnc.kernels.pulses.enclosing_line.window_rows`.
    """
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
    while not through and rows < room:
        best = 0
        least = math.inf
        near = math.inf
        for mask in range(1, 1 << n):
            foot = _foot(grid, ahead, mask, x, now) if mask & still == 0 else math.inf
            if foot < math.inf:
                normal = 0.0
                for i in range(n):
                    c = poly[i]
                    off = (
                        grid[i]
                        + (ahead[i] if mask >> i & 1 else 0)
                        - risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], foot)
                    )
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
            reach[rows] = x
            error = max(error, apart)
            rows += 1
        else:
            before = rows
            rows, x, error = enclosing_line(poly, ends, x, grid, error, rows, rows + 1, step, reach)
            through = rows == before
            if not through:
                x = reach[before]
                _look(poly, x, now)
    return rows, 1.0 if through else x, error


@njit
def as_printed(
    kind: int, data: Floats, at: int, scale: Floats, grid: Ints, step: NDArray[np.int8], place: Floats
) -> tuple[int, float]:  # fmt: skip
    """Equations 2 and 3 on a piece in two axes, one step of Newton's iteration each, no end
    treated.

    Takes and returns what :func:`cnc.kernels.pulses.enclosing_line.as_printed` does.
    """
    u, u1 = curve_range(kind, data, at)
    room = len(place)
    near = np.empty((4, 2))
    r = np.empty((4, 2))
    tried = np.empty((4, 2))
    curve_eval(kind, data, at, u, r)
    rows = 0
    error = 0.0
    while rows < room:
        sx = 1 if r[1, 0] >= 0.0 else -1
        sy = 1 if r[1, 1] >= 0.0 else -1
        x0 = r[0, 0] * scale[0] - grid[0]
        y0 = r[0, 1] * scale[1] - grid[1]
        x1 = r[1, 0] * scale[0]
        y1 = r[1, 1] * scale[1]
        x2 = r[2, 0] * scale[0]
        y2 = r[2, 1] * scale[1]
        least = math.inf
        best = 0
        u_best = u
        for k in range(1, 4):
            px = sx * (k & 1)
            py = sy * (k >> 1)
            ui = u - ((px - x0) * x1 + (py - y0) * y1) / (
                (px - x0) * x2 + (py - y0) * y2 - x1 * x1 - y1 * y1
            )
            curve_eval(kind, data, at, ui, tried)
            nx = px - (tried[0, 0] * scale[0] - grid[0])
            ny = py - (tried[0, 1] * scale[1] - grid[1])
            normal = nx * nx + ny * ny
            if normal < least:
                least = normal
                best = k
                u_best = ui
                near, tried = tried, near
        if not u_best <= u1:
            break
        u = u_best
        r, near = near, r
        step[rows, 0] = sx * (best & 1)
        step[rows, 1] = sy * (best >> 1)
        grid[0] += step[rows, 0]
        grid[1] += step[rows, 1]
        place[rows] = u
        error = max(error, least)
        rows += 1
    return rows, math.sqrt(error)
