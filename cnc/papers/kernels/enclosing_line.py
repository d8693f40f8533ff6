"""The procedures of Samad & Wan Yusof (2002) as printed: enclosing lines, and Kiritsis's normals.

:mod:`cnc.pulses.kernels.enclosing_line` explains both, and the corrections that are left out here.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, curve_eval, curve_range
from cnc.pulses.kernels.grid_moves import Grid, Moves


@njit
def enclosing_line_as_printed(
    kind: int, data: Floats, at: int, grid: Grid, moves: Moves
) -> tuple[int, float]:
    """Carry out the procedure of figure 3 on a piece in two axes.

    It takes one step along the tangent, and treats no end. Tables 3 to 5 are corrected.

    Args:
        kind: kind of the piece.
        data: the records of the path.
        at: index of the piece's record.
        grid: the grid, with the rounded start as its point, moved along.
        moves: takes the iterations, null steps too; ``s`` takes the u of each.

    Returns:
        The number of iterations, and the largest distance |P - r(u)| in BLU.
    """
    scale, point = grid
    step, place = moves
    u, u1 = curve_range(kind, data, at)
    most = len(place)
    r = np.empty((4, 2))
    curve_eval(kind, data, at, u, r)
    rows = 0
    error = 0.0
    while rows < most:
        x = r[0, 0] * scale[0] - point[0]
        y = r[0, 1] * scale[1] - point[1]
        x1 = r[1, 0] * scale[0]
        y1 = r[1, 1] * scale[1]
        dx = 1.0 - x if x1 >= 0.0 else 1.0 + x
        dy = 1.0 - y if y1 >= 0.0 else 1.0 + y
        x1 = abs(x1)
        y1 = abs(y1)
        u += dx / x1 if x1 * dy - y1 * dx > 0.0 else dy / y1
        if not u <= u1:
            break
        curve_eval(kind, data, at, u, r)
        square = 0.0
        for i in range(2):
            off = r[0, i] * scale[i] - point[i]
            move = int(off > 0.5) - int(off < -0.5)
            step[rows, i] = move
            point[i] += move
            square += (off - move) * (off - move)
        place[rows] = u
        error = max(error, square)
        rows += 1
    return rows, np.sqrt(error)


@njit
def kiritsis_as_printed(
    kind: int, data: Floats, at: int, grid: Grid, moves: Moves
) -> tuple[int, float]:
    """Carry out equations 2 and 3 on a piece in two axes, with one step of Newton's iteration each.

    Arguments and results are those of :func:`enclosing_line_as_printed`.
    """
    scale, point = grid
    step, place = moves
    u, u1 = curve_range(kind, data, at)
    most = len(place)
    near = np.empty((4, 2))
    r = np.empty((4, 2))
    tried = np.empty((4, 2))
    curve_eval(kind, data, at, u, r)
    rows = 0
    error = 0.0
    while rows < most:
        sx = 1 if r[1, 0] >= 0.0 else -1
        sy = 1 if r[1, 1] >= 0.0 else -1
        x0 = r[0, 0] * scale[0] - point[0]
        y0 = r[0, 1] * scale[1] - point[1]
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
            nx = px - (tried[0, 0] * scale[0] - point[0])
            ny = py - (tried[0, 1] * scale[1] - point[1])
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
        point[0] += step[rows, 0]
        point[1] += step[rows, 1]
        place[rows] = u
        error = max(error, least)
        rows += 1
    return rows, math.sqrt(error)
