"""Rows by which a grid point catches up with a curve.

Where the motion rests off the grid, where a piece begins a whole BLU ahead of the grid point, and
where an axis would have to make two steps at once.

3 - - - - - - - - o- -     An axis that is more than a step and a half behind in the row at u would have to make two steps there. So
                ,':         there is a row for the first of them, where it is just that much behind and the grid points of the one
2 - - - - - - o' - - -      step and of two are equally near. That is a property of the curve: it does not depend on where a row was
             /:   :         before, nor on where a piece is cut.
1 - ---o----' : - : -
                  u
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints, curve_arclen, curve_eval, curve_range
from cnc.kernels.pulses.crossings import grid_after, slack


@njit
def _write_row(
    kind: int, data: Floats, at: int, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float]:  # fmt: skip
    """The row that rounds the grid point to the curve at u, if it is needed. Returns the number of
    rows and the error so far.
    """
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
def _two_behind(
    kind: int, data: Floats, at: int, u: float, scale: Floats, grid: Ints, here: Floats
) -> int:
    """The first axis that is two steps behind the curve at u, -1 if there is none."""
    curve_eval(kind, data, at, u, here)
    behind = -1
    for i in range(len(grid) - 1, -1, -1):
        if abs(grid_after(grid[i], here[0, i] * scale[i]) - grid[i]) > 1:
            behind = i
    return behind


@njit
def prepare(
    kind: int, data: Floats, at: int, low: float, u: float, upto: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float,
    rows: int, step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The first row without which an axis would have to make two steps in a row at u: where it is a
    step and a half behind, after ``low``.

    One beyond ``upto`` is left. Returns the number of rows, the place of the row (``low`` if there
    is none), the error so far, and whether room was left.
    """
    done = True
    axis = _two_behind(kind, data, at, u, scale, grid, here)
    if axis >= 0:
        place = u
        while axis >= 0:
            sign = 1.0 if here[0, axis] * scale[axis] > grid[axis] else -1.0
            line = (grid[axis] + 1.5 * sign) / scale[axis]
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
        if place <= upto:
            done = rows < len(reach)
            if done:
                rows, error = _write_row(
                    kind, data, at, place, s0, scale, grid, here, error, rows, step, reach
                )
                low = place
    return rows, low, error, done


@njit
def round_to(
    kind: int, data: Floats, at: int, low: float, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows after which the grid point is the curve's, rounded, at u: see :func:`prepare`, which
    returns the same.
    """
    done = True
    before = -1
    while done and rows > before:
        before = rows
        rows, low, error, done = prepare(
            kind, data, at, low, u, u, s0, scale, grid, here, error, rows, step, reach
        )
    if done:
        curve_eval(kind, data, at, u, here)
        for i in range(len(grid)):
            done = done and grid_after(grid[i], here[0, i] * scale[i]) == grid[i]
        if not done and rows < len(reach):
            rows, error = _write_row(
                kind, data, at, u, s0, scale, grid, here, error, rows, step, reach
            )
            done = True
        low = u if done else low
    return rows, low, error, done


@njit
def enter(
    kind: int, data: Floats, at: int, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, bool]:  # fmt: skip
    """The row at the start u of a piece, needed if the piece before left an axis a whole BLU
    behind, as one that was not its leader.

    Returns the number of rows, the error so far, and whether room was left.
    """
    curve_eval(kind, data, at, u, here)
    behind = False
    for i in range(len(grid)):
        p = here[0, i] * scale[i]
        behind = behind or abs(p - grid[i]) >= 1.0 - slack(p)
    done = True
    if behind:
        rows, _, error, done = round_to(
            kind, data, at, u, u, s0, scale, grid, here, error, rows, step, reach
        )
    return rows, error, done
