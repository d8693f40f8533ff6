"""Rows by which a grid point catches up with a curve: at an end off the grid, and where an axis would have to make two steps at once.

4 - - - - - - - - - - o     An axis that is two steps behind in the row at u was one step behind where the curve passed its next grid
                   ,'       line: a row there, in which it is exact.
3 - - - - - - - o'
             ,' :     :
2 - - - ---o- - : - - :     u ->
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.crossings import grid_after
from cnc.kernels.curve import Floats, Ints, curve_arclen, curve_eval, curve_range
from cnc.kernels.jit import njit


@njit
def _write_row(
    kind: int, data: Floats, at: int, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float]:  # fmt: skip
    """The row that rounds the grid point to the curve at u, if it is needed. Returns the number of rows and the error so far."""
    u0, _ = curve_range(kind, data, at)
    curve_eval(kind, data, at, u, here)
    moves = False
    for i in range(len(grid)):
        p = here[0, i] * scale[i]
        sign = min(max(grid_after(grid[i], p) - grid[i], -1), 1)
        moves = moves or sign != 0
        step[rows, i] = sign
        grid[i] += sign
        if moves:
            error = max(error, abs(grid[i] - p))
    if moves:
        reach[rows] = s0 + (curve_arclen(kind, data, at, u0, u) if u > u0 else 0.0)
        rows += 1
    return rows, error


@njit
def _two_behind(kind: int, data: Floats, at: int, u: float, scale: Floats, grid: Ints, here: Floats) -> int:
    """The first axis that is two steps behind the curve at u, -1 if there is none."""
    curve_eval(kind, data, at, u, here)
    behind = -1
    for i in range(len(grid) - 1, -1, -1):
        if abs(grid_after(grid[i], here[0, i] * scale[i]) - grid[i]) > 1:
            behind = i
    return behind


@njit
def prepare(
    kind: int, data: Floats, at: int, low: float, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows without which an axis would have to make two steps in a row at u: where it passes its next grid line after ``low``.

    Returns the number of rows, the place of the last of them (``low`` if there is none), the error so far, and whether room was left.
    """
    axis = _two_behind(kind, data, at, u, scale, grid, here)
    while axis >= 0 and rows < len(reach):
        place = u
        while axis >= 0:
            sign = 1.0 if here[0, axis] * scale[axis] > grid[axis] else -1.0
            line = (grid[axis] + sign) / scale[axis]
            near = low
            high = place
            middle = 0.5 * (near + high)
            while near < middle < high:
                curve_eval(kind, data, at, middle, here)
                if sign * (here[0, axis] - line) >= 0.0:
                    high = middle
                else:
                    near = middle
                middle = 0.5 * (near + high)
            axis = _two_behind(kind, data, at, high, scale, grid, here) if high < place else -1
            place = high
        rows, error = _write_row(kind, data, at, place, s0, scale, grid, here, error, rows, step, reach)
        low = place
        axis = _two_behind(kind, data, at, u, scale, grid, here)
    return rows, low, error, axis < 0


@njit
def round_to(
    kind: int, data: Floats, at: int, low: float, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows after which the grid point is the curve's, rounded, at u: see :func:`prepare`, which returns the same."""
    rows, low, error, done = prepare(kind, data, at, low, u, s0, scale, grid, here, error, rows, step, reach)
    if done:
        curve_eval(kind, data, at, u, here)
        for i in range(len(grid)):
            done = done and grid_after(grid[i], here[0, i] * scale[i]) == grid[i]
        if not done and rows < len(reach):
            rows, error = _write_row(kind, data, at, u, s0, scale, grid, here, error, rows, step, reach)
            done = True
        low = u if done else low
    return rows, low, error, done
