"""Half-step deviation interpolation (Shu et al. 2019) of lines and arcs in any number of axes.

In units of one step (BLU) the axis that is fastest, the leader, steps in every row, and each other
axis steps with it or not: as the paper has it, towards the nearer of two candidates, which are one
BLU apart, so that the nearer one is at most half a BLU from the curve.

      g + 1  - - - - - - - C         Leader x, row after row on the grid lines of x. The candidates P + (1, 0) = B and P + (1, 1) = C are
                         ,-'         equally far where the curve passes half-way between them, at D with BD = CD = 1/2. Comparing BD with
                    ,--'   D         CD is comparing the distances themselves: BE / CF = BD / CD (figure 3). A tie moves the leader alone
      g      - - P - - - - B         (equation 9, f >= 0, which is the mended end of section 3): here |g - y| > 1/2 + slack is needed.

A row lies at the place of the path at which the leader is on its grid line: there it is exact and
the others are within half a BLU. Where the path turns so that another axis becomes the fastest
(figures 2 and 6: eight octants in a plane, by the end point's larger coordinate on a line, by the
tangent on an arc), that one leads; if it is a whole BLU behind, there is a row at once. An axis
that would have to make two steps in a row, as after a start far from the middle of its cell, gets a
row of its own before. A piece that ends off the grid leaves the grid point where it is, less than a
BLU and a half behind: the next piece goes on from there, and its leader's steps stay even.

LINE. The deviation f of an axis is counted in integers: with the line's ends on the grid, in units
of half the leader's travel, it is the paper's recursion (equations 8 to 10: -2 Ye for each step of
X, +2 Xe for one of Y) without any rounding; else in units of 2^-52 BLU.

ARC, with helices, spirals and different scales. Where leader p is the fastest, the others are
smooth functions of p with a slope of at most one, and so is the arc length: polynomials of degree 7
through values and three derivatives at the ends of a window, which is made shorter until they agree
with the arc. So a row takes a few products an axis, no root and no sine. The paper leaves the
recursion of arcs to the reader; see :mod:`cnc.kernels.circles` for it, on a circle whose centre and
radius are on the grid.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, START, Floats, Ints, curve_range
from cnc.kernels.pulses.catch_up import enter, prepare, round_to
from cnc.kernels.pulses.crossings import slack
from cnc.kernels.pulses.half_step_arc import arc_rows

FINE = 2**52
"""Parts of a BLU in which the deviation from a line off the grid is counted."""
LARGEST = 2**28
"""BLU: ends on the grid farther off than this are treated like others, so that the paper's products
stay within 64 bits.
"""


@njit
def half_step_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of a line or an arc from u to ``upto``, from row ``rows`` on, as many as
    there is room for.

    s0: path coordinate (mm) of the piece's start. scale (n,): steps per mm. grid (n,) is carried
    on. state: not needed here. step (room, n) gets the rows, reach (room,) the path coordinate of
    each. Returns the number of rows, the u up to which all is done (``upto`` when through), and the
    largest |grid - position| (BLU) over axes and rows, at the place of the row. The rows do not
    depend on where a piece is cut.
    """
    u0, _ = curve_range(kind, data, at)
    here = np.empty((4, len(grid)))
    error = 0.0
    done = True
    if u == u0:
        rows, error, done = enter(
            kind, data, at, u, s0, scale, grid, here, error, rows, step, reach
        )
    if done and kind == LINE:
        rows, u, error, done = _line_rows(
            data, at, u, upto, s0, scale, grid, here, error, rows, step, reach
        )
    elif done:
        rows, u, error, done = arc_rows(
            kind, data, at, u, upto, s0, scale, grid, here, error, rows, step, reach
        )
    return rows, upto if done else min(u, np.nextafter(upto, u0)), error


@njit
def _line_rows(
    data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows at which a line's leader is on a grid line; see :func:`half_step_rows`. Returns also
    whether room was left.
    """
    n = len(grid)
    room = len(reach)
    u0, u1 = curve_range(LINE, data, at)
    start = at + START
    end = start + n
    leader = 0
    travel = 0.0
    on_grid = True
    far = 0.0
    for i in range(n):
        a = data[start + i] * scale[i]
        b = data[end + i] * scale[i]
        on_grid = (
            on_grid
            and abs(a - np.rint(a)) <= 0.25 * slack(a)
            and abs(b - np.rint(b)) <= 0.25 * slack(b)
        )
        far = max(far, max(abs(a), abs(b)))
        if abs(b - a) > abs(travel):
            leader = i
            travel = b - a
    on_grid = on_grid and far < LARGEST
    full = False
    first = data[start + leader] * scale[leader]
    sign = 1 if travel > 0.0 else -1
    per_blu = (u1 - u0) / abs(travel)
    here_at = (
        data[end + leader] * scale[leader] if upto == u1 else first + sign * ((upto - u0) / per_blu)
    )
    # a line that is reached but for rounding is reached
    here_at += sign * slack(here_at)
    count = math.floor(sign * (here_at - grid[leader]))
    # no axis makes two steps in the first row, hence none later, nor is left two steps behind; the
    # leader may step in such a row, too
    line = 0.0
    before = -1
    while not full and rows > before:
        before = rows
        line = sign * (grid[leader] + sign - first) * per_blu
        rows, u, error, done = prepare(
            LINE,
            data,
            at,
            u,
            min(u0 + line, u1),
            upto,
            s0,
            scale,
            grid,
            here,
            error,
            rows,
            step,
            reach,
        )
        full = not done
    if count > 0:
        count = math.floor(sign * (here_at - grid[leader]))
        if not full and count > 0 and rows < room and _aside(data, at, line, leader, scale, grid):
            rows, u, error, _ = round_to(
                LINE,
                data,
                at,
                u,
                min(u0 + line, upto),
                s0,
                scale,
                grid,
                here,
                error,
                rows,
                step,
                reach,
            )
        count = min(math.floor(sign * (here_at - grid[leader])), room - rows)
    if count > 0 and not full:
        line = sign * (grid[leader] - first)
        whole = 2 * int(np.rint(abs(travel))) if on_grid else FINE
        half = whole // 2
        if not on_grid:
            half += int(slack(far) * FINE)
        for i in range(n):
            a = data[start + i] * scale[i]
            slope = (data[end + i] * scale[i] - a) / abs(travel)
            ahead = 1 if slope >= 0.0 else -1
            if i == leader:
                for row in range(rows, rows + count):
                    step[row, i] = sign
                grid[i] += sign * count
            elif slope == 0.0:
                for row in range(rows, rows + count):
                    step[row, i] = 0
                error = max(error, abs(grid[i] - a))
            else:
                # by how much the line is ahead of the grid point where the leader is on a grid line
                if on_grid:
                    rise = 2 * abs(int(np.rint(data[end + i] * scale[i])) - int(np.rint(a)))
                    f = rise * int(np.rint(line)) - whole * (ahead * (grid[i] - int(np.rint(a))))
                else:
                    rise = int(np.rint(abs(slope) * FINE))
                    f = int(np.rint(ahead * (a - grid[i] + line * slope) * FINE))
                made, low, high = _deviations(
                    f, rise, whole, half, ahead, step[rows : rows + count, i]
                )
                grid[i] += ahead * made
                error = max(error, max(-low, high) / whole)
        begin = s0 + (u - u0)
        u = min(max(u0 + (line + count) * per_blu, u), upto)
        for k in range(count):
            reach[rows + k] = min(max(s0 + (line + (k + 1)) * per_blu, begin), s0 + (u - u0))
        rows += count
    full = full or math.floor(sign * (here_at - grid[leader])) > 0
    return rows, u, error, not full


@njit
def _aside(data: Floats, at: int, line: float, leader: int, scale: Floats, grid: Ints) -> bool:
    """Whether an axis stands where its own steps don't lead it back to the line: the piece before
    left it beside its way.

    line: the leader's first grid line, as a distance along the move.
    """
    start = at + START
    end = start + len(grid)
    u0, u1 = curve_range(LINE, data, at)
    aside = False
    for i in range(len(grid)):
        if i != leader:
            travel = (data[end + i] - data[start + i]) * scale[i]
            off = data[start + i] * scale[i] + travel * (line / (u1 - u0)) - grid[i]
            margin = 0.5 + slack(grid[i])
            aside = aside or (
                off < -margin
                if travel > 0.0
                else off > margin
                if travel < 0.0
                else abs(off) > margin
            )
    return aside


@njit
def _deviations(
    f: int, rise: int, whole: int, half: int, ahead: int, step: NDArray[np.int8]
) -> tuple[int, int, int]:
    """One axis of a line: equations 8 to 10 with f counted from the grid point. Returns steps made,
    smallest and largest f after a row.
    """
    made = 0
    low = 0
    high = 0
    for k in range(len(step)):
        f += rise
        both = f > half
        f -= whole if both else 0
        step[k] = ahead if both else 0
        made += 1 if both else 0
        low = min(low, f)
        high = max(high, f)
    return made, low, high
