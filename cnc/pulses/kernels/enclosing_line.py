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
grid. No axis turns inside a window, and the square stays the same from one window to the next.

A row is due where r is on the side, so the machine reaches the next grid point when the curve
passes it.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import (
    MAX_TURNING_POINTS,
    Floats,
    Ints,
    curve_range,
    curve_turning_points,
)
from cnc.pulses.kernels.grid_moves import SLACK, Grid, Moves, Piece, enter, slack
from cnc.pulses.kernels.polynomial import (
    approach,
    derivatives,
    estrin,
    is_constant,
    value,
    value_less,
)
from cnc.pulses.kernels.windows import begin_window, following, new_window, next_window, place_rows

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
        poly: polynomials of the axes in BLU, see :class:`cnc.pulses.kernels.windows.Window`.
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


# Reference pulses by the shortest normal (Kiritsis 1994).
#
# The source is Computer-Aided Design 26(11), 1994, as equations 2 and 3 of Samad & Wan Yusof, 2002.
#
# This is the baseline beside enclosing lines. The tangent at r, the point of the curve at the last
# step, gives the quadrant in which the path goes on. There the grid point P has three neighbours
# ahead, 2^n - 1 in n axes:
#
#        P2 o-----o P3
#           |    ,'         u_i = u - (P_i - r) . r' / ((P_i - r) . r'' - r' . r')   (2, corrected)
#           |  ,' |
#         P o,----o P1      |n_i|^2 = |P_i - r(u_i)|^2                               (3)
#         ,'
#        r
#
# The distance of each neighbour from the curve is measured along the normal through it. One step of
# Newton's iteration for (P_i - r(u)) . r'(u) = 0 from the last u gives u_i. The nearest neighbour
# is the next grid point.
#
# Correction to the paper: where the nearest neighbour is more than half a BLU from the curve in
# some axis, u_i is refined by further steps. Where it stays so far, or u_i lies behind the last u,
# the curve bends away within a BLU. Then no neighbour ahead may be near the curve, and the step is
# that of the enclosing line.

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
def kiritsis_rows(
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

    Arguments and results are those of :func:`window_rows`.
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
            rows, x, error = window_rows(poly, ends, x, grid, error, rows, rows + 1, moves)
            through = rows == before
            if not through:
                x = s[before]
                _look(poly, x, now)
    return rows, 1.0 if through else x, error


# Reference pulses of a piece in windows in which no axis turns back.
#
# Both interpolators go from grid point to grid point. Their windows
# (:mod:`cnc.pulses.kernels.windows`) also end wherever an axis turns. So each axis has one heading
# in a window, and the position of its end decides whether a line is reached inside:
#
#       y ^      ,---o         o   ends of windows: turning points of x and of y, and the ends of
#         |    ,'     `.           the range of one polynomial
#         |   o         o
#         |  /          |          The rows of a window are written at once. The grid point goes
#         +---------------> x      from one window to the next, at most one BLU from the curve.
#
# A piece may end off the grid: the next piece goes on from the grid point reached. The rows do not
# depend on the place where a piece is cut.


@njit
def _all_turning_points(piece: Piece, n: int, turns: Floats) -> None:
    """Write the places where any of n axes turns, in order, then inf.

    ``turns`` takes n MAX_TURNING_POINTS + 1 numbers.
    """
    of_axis = np.empty(MAX_TURNING_POINTS)
    count = 0
    for i in range(n):
        for k in range(curve_turning_points(piece.kind, piece.data, piece.at, i, of_axis)):
            place = count
            while place > 0 and turns[place - 1] > of_axis[k]:
                turns[place] = turns[place - 1]
                place -= 1
            turns[place] = of_axis[k]
            count += 1
    turns[count] = math.inf


@njit
def monotone_rows(
    by_normal: bool,
    piece: Piece,
    u: float,
    upto: float,
    width: float,
    grid: Grid,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float, float]:
    """Write the grid moves of a piece from u to ``upto``, until the buffer is full.

    Args:
        by_normal: by the shortest normal (Kiritsis) if true, by enclosing lines if false.
        piece: the piece.
        u: parameter from which the moves are wanted.
        upto: parameter up to which they are wanted.
        width: width of the next window; 0 when the piece is entered.
        grid: the grid and its point, moved along. When the piece is entered the point is at most a
            BLU and a half from the curve in each axis.
        rows: number of rows in ``moves``.
        moves: the buffer.

    Returns:
        The number of rows, the u up to which all moves are written, the largest
        |grid point - position| (BLU) of any axis at any of these rows, and the width of the next
        window.
    """
    kind, data, at, _ = piece
    scale, point = grid
    n = len(point)
    ends = np.empty(n)
    turns = np.empty(n * MAX_TURNING_POINTS + 1)
    window = new_window(n)
    _all_turning_points(piece, n, turns)
    u0, _ = curve_range(kind, data, at)
    error = 0.0
    full = False
    if u == u0:
        rows, error, done = enter(piece, u, grid, window.inside, error, rows, moves)
        full = not done
    begin_window(piece, u, window)
    if width <= 0.0:
        width = upto - u
    turn = 0
    while u < upto and not full:
        while turns[turn] <= u:
            turn += 1
        ub, width, by_table = next_window(piece, u, min(turns[turn], upto), width, scale, window)
        for i in range(n):
            ends[i] = window.end[0, i] * scale[i]
        first = rows
        if by_normal:
            rows, x, error = kiritsis_rows(
                window.poly, ends, 0.0, point, error, rows, len(moves.s), moves
            )
        else:
            rows, x, error = window_rows(
                window.poly, ends, 0.0, point, error, rows, len(moves.s), moves
            )
        place_rows(piece, u, ub, by_table, window, first, rows, moves.s)
        full = x < 1.0
        u = u + x * (ub - u) if full else ub
        window = following(window)
    return rows, u, error, width
