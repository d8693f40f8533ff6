"""Reference pulses by crossings: each axis steps where it crosses its own half-grid lines.

In units of one step (BLU) an axis is at P(u) = q(u) * steps_per_mm. Its grid point is the integer
nearest to P, so a step is due where P crosses a half-grid line:

      k + 1  - - - - - - - - - - - - -
                          ,--.
    k + 1/2 ------------o------o-----
                     ,-'        `-.
      k      - - --'- - - - - - - -`-

The axis is cut at its turning points into stretches in which P only rises or only falls. The
position at the end of a stretch gives the grid point there, hence the number of crossings on the
way there. So no step is lost or made twice, whatever rounding does to the places of the crossings.
The crossings of each axis come in order, and the axes are merged by their place on the path.

On a line a crossing has a closed form. On arcs and spans it is a zero of the polynomial of a window
(:mod:`cnc.pulses.kernels.windows`).

A line counts as crossed only when P is beyond it by more than the slack. So an axis that rests on a
half-grid line while others move gives no pulses, whatever the rounding, and neither does an axis
that turns back on reaching it. Of two equally near grid points the axis keeps the one from which it
came. Axes that are within the slack of their lines at the same path point share a row. Both rules
keep
|g - P| <= 1/2 + slack at each row and between rows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import (
    LINE,
    MAX_TURNING_POINTS,
    Floats,
    curve_eval,
    curve_range,
    curve_turning_points,
)
from cnc.pulses.kernels.grid_moves import Grid, Moves, Piece, grid_after, slack
from cnc.pulses.kernels.polynomial import approach, derivatives, value, value_less
from cnc.pulses.kernels.windows import (
    Window,
    begin_window,
    following,
    new_window,
    next_window,
    place_rows,
)

TOGETHER = 1e-4
"""Part of a window. A crossing of another axis within it may belong to the same row."""
DUE = -math.inf
"""Place of a crossing that has yet to be found."""
AXIS = np.dtype(
    [
        ("place", np.float64),
        ("target", np.int64),
        ("stretch", np.int64),
        ("x", np.float64),
        ("line", np.float64),
        ("off", np.float64),
        ("rate", np.float64),
        ("bend", np.float64),
        ("twist", np.float64),
    ]
)
"""State of an axis in a window: place of its next crossing (inf: none), grid point at the end of
its stretch, and index of the stretch. Then the last place x examined, with a half-grid line, the
position less that line, and its first three derivatives by x.
"""


@njit
def crossing_rows(
    piece: Piece, u: float, upto: float, grid: Grid, rows: int, moves: Moves
) -> tuple[int, float, float]:
    """Write the grid moves of a piece from u to ``upto``, until the buffer is full.

    Args:
        piece: the piece.
        u: parameter from which the moves are wanted.
        upto: parameter up to which they are wanted.
        grid: the grid and its point, moved along.
        rows: number of rows in ``moves``.
        moves: the buffer.

    Returns:
        The number of rows, the u up to which all moves are written (``upto`` when done), and the
        largest |grid point - position| (BLU) of any axis at any of these rows.
    """
    return (
        _line_rows(piece, u, upto, grid, rows, moves)
        if piece.kind == LINE
        else _curve_rows(piece, u, upto, grid, rows, moves)
    )


@njit
def _line_rows(
    piece: Piece, u: float, upto: float, grid: Grid, rows: int, moves: Moves
) -> tuple[int, float, float]:
    """Write the grid moves of a line; see :func:`crossing_rows`."""
    kind, data, at, s0 = piece
    scale, point = grid
    step, s = moves
    n = len(point)
    here = np.empty((4, n))
    place = np.empty(n)
    error = 0.0
    target = np.empty(n, np.int64)
    position = np.empty(n)
    rate = np.empty(n)
    u0, _ = curve_range(kind, data, at)
    curve_eval(kind, data, at, upto, here)
    for i in range(n):
        target[i] = grid_after(point[i], here[0, i] * scale[i])
    # Crossings are counted from the start of the line.
    curve_eval(kind, data, at, u0, here)
    for i in range(n):
        position[i] = here[0, i] * scale[i]
        rate[i] = here[1, i] * scale[i]
        place[i] = _on_line(position[i], rate[i], point[i], target[i], u0, u, upto)
    while True:
        lead = 0
        for i in range(1, n):
            if place[i] < place[lead]:
                lead = i
        if place[lead] == math.inf:
            u = upto
            break
        if rows == len(s):
            break
        u = place[lead]
        s[rows] = s0 + (u - u0)
        for i in range(n):
            at_row = position[i] + (u - u0) * rate[i]
            step[rows, i] = 0
            if place[i] != math.inf:
                sign = 1 if target[i] > point[i] else -1
                if i == lead or sign * (point[i] + 0.5 * sign - at_row) <= slack(at_row):
                    step[rows, i] = sign
                    point[i] += sign
                    place[i] = _on_line(position[i], rate[i], point[i], target[i], u0, u, upto)
            error = max(error, abs(point[i] - at_row))
        rows += 1
    return rows, u, error


@njit
def _on_line(
    p0: float, rate: float, g: int, target: int, u0: float, begin: float, upto: float
) -> float:
    """Return the u in [begin, upto] at which an axis crosses its next half-grid line; inf if none.

    The axis is at p0 + (u - u0) rate (BLU) and moves from grid point g to ``target``.
    """
    if g == target:
        return math.inf
    sign = 1 if target > g else -1
    if sign * rate <= 0.0:
        return begin
    return min(max(u0 + (g + 0.5 * sign - p0) / rate, begin), upto)


@njit
def _curve_rows(
    piece: Piece, begin: float, upto: float, grid: Grid, rows: int, moves: Moves
) -> tuple[int, float, float]:
    """Write the grid moves of an arc or a span; see :func:`crossing_rows`."""
    kind, data, at, _ = piece
    scale, point = grid
    n = len(point)
    turns = np.empty((n, MAX_TURNING_POINTS + 1))
    ends = np.empty((n, MAX_TURNING_POINTS + 1))
    axes = np.empty(n, AXIS)
    window = new_window(n)
    error = 0.0
    for i in range(n):
        turns[i, curve_turning_points(kind, data, at, i, turns[i])] = math.inf
    ua = begin
    width = upto - begin
    begin_window(piece, ua, window)
    full = False
    while ua < upto and not full:
        ub, width, by_table = next_window(piece, ua, upto, width, scale, window)
        for i in range(n):
            k = 0
            for j in range(MAX_TURNING_POINTS):
                if turns[i, j] >= ub:
                    break
                if turns[i, j] > ua:
                    ends[i, k] = (turns[i, j] - ua) / (ub - ua)
                    k += 1
            ends[i, k] = 1.0
        first = rows
        rows, x, error = _window_rows(window, ends, grid, axes, error, rows, moves)
        full = x < 1.0
        place_rows(piece, ua, ub, by_table, window, first, rows, moves.s)
        ua = ua + x * (ub - ua) if full else ub
        window = following(window)
    return rows, ua, error


@njit
def _window_rows(
    window: Window,
    ends: Floats,
    grid: Grid,
    axes: NDArray[np.void],
    error: float,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float]:
    """Write the grid moves of a window from row ``rows`` on, until the buffer is full.

    Args:
        window: the window.
        ends: (n, ..): places x at which each axis turns, in order, then 1.
        grid: the grid and its point, moved along.
        axes: (n,) AXIS: work space.
        error: largest |grid point - position| so far, BLU.
        rows: number of rows in ``moves``.
        moves: the buffer; ``s`` takes the x of each row.

    Returns:
        The number of rows, the x up to which all moves are written (1 when the window is done), and
        the largest error so far.
    """
    poly = window.poly
    scale, point = grid
    step, s = moves
    n = len(point)
    first = rows
    reached = 1.0
    last = 0.0
    for i in range(n):
        axes[i]["place"] = DUE
        axes[i]["stretch"] = 0
        at_end = value(poly[i], ends[i, 0]) if ends[i, 0] < 1.0 else window.end[0, i] * scale[i]
        axes[i]["target"] = grid_after(point[i], at_end)
        axes[i]["x"] = -1.0
    while True:
        lead = 0
        for i in range(n):
            if axes[i]["place"] == DUE:
                _find_crossing(poly[i], ends[i], window.end[0, i] * scale[i], point[i], axes[i])
            if axes[i]["place"] < axes[lead]["place"]:
                lead = i
        x = axes[lead]["place"]
        if x == math.inf:
            break
        if rows == len(s):
            reached = last
            break
        last = x
        s[rows] = x
        for i in range(n):
            step[rows, i] = 0
            if axes[i]["place"] - x <= TOGETHER:
                sign = 1 if axes[i]["target"] > point[i] else -1
                steps = i == lead
                if not steps:
                    p = value(poly[i], x)
                    steps = sign * (point[i] + 0.5 * sign - p) <= slack(p)
                if steps:
                    step[rows, i] = sign
                    point[i] += sign
                    axes[i]["place"] = DUE
        rows += 1
    # The error of each axis, from the last row back to the first.
    for i in range(n):
        c = poly[i]
        g = point[i]
        for row in range(rows - 1, first - 1, -1):
            error = max(error, abs(g - value(c, s[row])))
            g -= step[row, i]
    return rows, reached, error


@njit
def _find_crossing(c: Floats, ends: Floats, at_end: float, g: int, axis: np.void) -> None:
    """Find the next crossing of an axis at grid point g, and write its place into ``axis``.

    Args:
        c: (POLYNOMIAL,): the position of the axis in the window, BLU.
        ends: places x at which the axis turns, in order, then 1.
        at_end: position at x = 1, BLU.
        g: the grid point of the axis.
        axis: AXIS: its state.
    """
    low = max(axis["x"], 0.0)
    k = axis["stretch"]
    while axis["target"] == g and ends[k] < 1.0:
        low = ends[k]
        k += 1
        axis["target"] = grid_after(g, value(c, ends[k]) if ends[k] < 1.0 else at_end)
    axis["stretch"] = k
    axis["place"] = math.inf
    if axis["target"] != g:
        sign = 1.0 if axis["target"] > g else -1.0
        line = g + 0.5 * sign
        close = 0.25 * slack(line)
        high = ends[k]
        x = low
        known = axis["x"] == low
        off = axis["off"] + (axis["line"] - line)
        f1 = axis["rate"]
        f2 = axis["bend"]
        f3 = axis["twist"]
        while True:
            if not known:
                off = value_less(c, line, x)
                f1, f2, f3 = derivatives(c, x)
            known = False
            f = sign * off
            # At the very start of a stretch the line may lie behind, by rounding.
            if abs(f) <= close or x >= high or (f > 0.0 and x == low):
                break
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
        axis["place"] = x
        axis["x"] = x
        axis["off"] = off
        axis["line"] = line
        axis["rate"] = f1
        axis["bend"] = f2
        axis["twist"] = f3


# Reference pulses by point-by-point comparison, with one axis in each move.
#
# This is the baseline of Shu et al. 2019. The grid points are 4-connected.
#
# The method compares on which side of the curve the grid point P is, by the sign of a deviation F,
# and steps towards the curve or along it. That keeps P within a whole BLU only. Moved by half a
# step the method keeps half a BLU, and so it is used for pieces of path:
#
#         +-----------+
#       C o     ,'    |
#         |    '      |
#         |   :   P   |
#         |   '.      |
#         +-----'-----+
#
# F is taken at the corner C of the cell about P, (x - 1/2, y + 1/2) for an arc that goes left and
# up. With the corner inside the circle the arc leaves the cell at the top, so y steps; else at the
# left, so x steps. In other words, an axis steps where the curve crosses its next half-grid line,
# whichever comes first. So the rows are those of :func:`crossing_rows`, with one axis
# in each row where the curve passes through a corner. Any number of axes may move, on any curve.
#
# The method in integers on the line and the circle of the paper is in
# :mod:`cnc.papers.kernels.half_step`.


@njit
def point_by_point_rows(
    piece: Piece, u: float, upto: float, grid: Grid, rows: int, moves: Moves
) -> tuple[int, float, float]:
    """Write the grid moves of a piece from u to ``upto``, until the buffer is full.

    Arguments and results are those of :func:`crossing_rows`.
    """
    kind, data, at, s0 = piece
    point = grid.point
    step, s = moves
    n = len(point)
    most = len(s)
    first = rows
    u0, _ = curve_range(kind, data, at)
    rows, u, error = crossing_rows(piece, u, upto, grid, rows, moves)
    count = first
    for row in range(first, rows):
        for i in range(n):
            count += 1 if step[row, i] != 0 else 0
    # From the last row to the first, so that each is read before it is overwritten. Steps beyond
    # the buffer are taken back.
    signs = np.empty(n, np.int8)
    taken = min(count, most)
    target = count
    for row in range(rows - 1, first - 1, -1):
        place = s[row]
        for i in range(n):
            signs[i] = step[row, i]
        for i in range(n - 1, -1, -1):
            if signs[i] != 0:
                target -= 1
                if target < most:
                    for k in range(n):
                        step[target, k] = 0
                    step[target, i] = signs[i]
                    s[target] = place
                else:
                    point[i] -= signs[i]
    if count > most:
        u = min(curve_inv_arclen(kind, data, at, s[most - 1] - s0), np.nextafter(upto, u0))
    return taken, u, error
