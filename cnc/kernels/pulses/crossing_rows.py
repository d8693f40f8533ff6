"""Reference pulses in any number of axes, each of which steps where it crosses its own half-grid
lines.

In units of one step (BLU) an axis is at P(u) = q(u) * steps_per_mm and its grid point is the
integer nearest to P, so that a step falls due where P crosses a half-grid line:

      k + 1  - - - - - - - - - - - - -       The axis is cut at its turning points into stretches in which P only rises or only
                          ,--.               falls. The value at the end of a stretch tells the grid point g there, hence how many
    k + 1/2 ------------o------o-----        lines are crossed on the way: no step is lost or made twice, whatever rounding does
                     ,-'        `-.          to the crossings' places. The crossings of each axis come in order, and the axes
      k      - - --'- - - - - - - -`-        are merged by their place on the path.

A crossing's place: on a line in closed form; on arcs and spans see
:mod:`cnc.kernels.pulses.crossings`.

A line counts as crossed only when P is beyond it by more than SLACK. So an axis that rests on a
half-grid line while others move gives no pulses, whatever the rounding, nor does one that turns
back on reaching it; and which of two equally near grid points it has there is the one that it came
from. Axes that are within SLACK of their lines at the same path point share a row. Both keep |g -
P| <= 1/2 + SLACK, not at each row only but between them, too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, MAX_TURNING_POINTS, Floats, Ints, curve_eval, curve_range
from cnc.kernels.pulses.crossings import POLYNOMIAL, STATE, curve_rows, grid_after, slack


@njit
def crossing_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of a piece from u to ``upto``, from row ``rows`` on, as many as there is
    room for.

    s0: path coordinate of the piece's start. scale (n,): steps per mm. grid (n,) is carried on.
    state: not needed here. step gets the rows, reach the path coordinate of each. Returns the
    number of rows, the u up to which all is done, and the largest |grid - position| in BLU.
    """
    n = len(grid)
    here = np.empty((4, n))
    place = np.empty(n)
    error = 0.0
    if kind == LINE:
        room = len(reach)
        target = np.empty(n, np.int64)
        position = np.empty(n)
        rate = np.empty(n)
        u0, _ = curve_range(kind, data, at)
        curve_eval(kind, data, at, upto, here)
        for i in range(n):
            target[i] = grid_after(grid[i], here[0, i] * scale[i])
        # crossings are counted from the line's start
        curve_eval(kind, data, at, u0, here)
        for i in range(n):
            position[i] = here[0, i] * scale[i]
            rate[i] = here[1, i] * scale[i]
            place[i] = _on_line(position[i], rate[i], grid[i], target[i], u0, u, upto)
        while True:
            lead = 0
            for i in range(1, n):
                if place[i] < place[lead]:
                    lead = i
            if place[lead] == math.inf:
                u = upto
                break
            if rows == room:
                break
            u = place[lead]
            reach[rows] = s0 + (u - u0)
            for i in range(n):
                at_row = position[i] + (u - u0) * rate[i]
                step[rows, i] = 0
                if place[i] != math.inf:
                    sign = 1 if target[i] > grid[i] else -1
                    if i == lead or sign * (grid[i] + 0.5 * sign - at_row) <= slack(at_row):
                        step[rows, i] = sign
                        grid[i] += sign
                        place[i] = _on_line(position[i], rate[i], grid[i], target[i], u0, u, upto)
                error = max(error, abs(grid[i] - at_row))
            rows += 1
    else:
        turns = np.empty((n, MAX_TURNING_POINTS + 1))
        ends = np.empty((n, MAX_TURNING_POINTS + 1))
        poly = np.empty((n + 1, POLYNOMIAL))
        rows, u, error = curve_rows(
            kind, data, at, u, upto, s0, scale, grid, turns, ends, poly, np.empty((4, n)), np.empty((4, n)), here, np.empty((2, 4)),
            np.empty((n, STATE)), place, np.empty((n, 2), np.int64), error, rows, step, reach,
        )  # fmt: skip
    return rows, u, error


@njit
def _on_line(
    p0: float, rate: float, g: int, target: int, u0: float, begin: float, upto: float
) -> float:
    """The u in [begin, upto] at which an axis at p0 + (u - u0) rate (BLU) crosses the line next to
    g on its way to ``target``; else inf.
    """
    if g == target:
        return math.inf
    sign = 1 if target > g else -1
    if sign * rate <= 0.0:
        return begin
    return min(max(u0 + (g + 0.5 * sign - p0) / rate, begin), upto)
