"""Reference pulses by half-step deviation (Shu et al. 2019) on lines and arcs.

The number of axes is free.

In units of one step (BLU) the fastest axis, the leader, steps in every row, and each other axis
steps with it or not. As in the paper it steps to the nearer of two candidates. They are one BLU
apart, so the nearer one is at most half a BLU from the curve.

      g + 1  - - - - - - - C
                         ,-'
                    ,--'   D
      g      - - P - - - - B

The leader is x; the rows lie on the grid lines of x. The candidates P + (1, 0) = B and P + (1, 1) =
C are equally far from the curve where it passes halfway between them, at D with BD = CD = 1/2.
Comparing BD with CD compares the distances themselves: BE / CF = BD / CD (figure 3). A tie moves
the leader alone (equation 9, f >= 0, the corrected end of section 3): here |g - y| > 1/2 + slack.

A row lies at the place of the path where the leader is on its grid line. There the leader is exact
and the others are within half a BLU. Where another axis becomes the fastest, that axis leads
(figures 2 and 6: eight octants in a plane, by the larger coordinate of the end point on a line, by
the tangent on an arc). If the new leader is a whole BLU behind, a row follows at once. An axis that
would have to make two steps in a row, as after a start far from the middle of its cell, gets a row
of its own before. A piece that ends off the grid leaves the grid point there, less than a BLU and a
half behind. The next piece goes on from it, and the steps of its leader stay even.

LINE. The deviation f of an axis is counted in integers. With the ends of the line on the grid the
unit is half the leader's travel: then it is the paper's recursion (equations 8 to 10: -2 Ye for
each step of X, +2 Xe for each step of Y) without any rounding. Otherwise the unit is 2^-52 BLU.

ARC, with helices, spirals and different scales: see :mod:`cnc.kernels.pulses.half_step_arc`. The
paper leaves the recursion of arcs to the reader; :mod:`cnc.kernels.papers.half_step` has it for a
circle whose centre and radius are on the grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, START, Floats, curve_range
from cnc.kernels.pulses.catch_up import enter, prepare, round_to
from cnc.kernels.pulses.grid_moves import Grid, Moves, Piece, Steps, slack
from cnc.kernels.pulses.half_step_arc import arc_rows

FINE = 2**52
"""Parts of a BLU in which the deviation from a line off the grid is counted."""
LARGEST = 2**28
"""BLU. Ends on the grid beyond this are treated like ends off the grid, so that the products of the
paper stay within 64 bits.
"""


class Leader(NamedTuple):
    """The leader of a line.

    Attributes:
        axis: its index.
        travel: distance that it moves, BLU, signed.
        on_grid: whether both ends of the line are on the grid, and near enough for the paper's
            products.
        far: largest coordinate of the ends, BLU.
    """

    axis: int
    travel: float
    on_grid: bool
    far: float


@njit
def half_step_rows(
    piece: Piece, u: float, upto: float, grid: Grid, rows: int, moves: Moves
) -> tuple[int, float, float]:
    """Write the grid moves of a line or an arc from u to ``upto``, until the buffer is full.

    Arguments and results are those of :func:`cnc.kernels.pulses.crossings.crossing_rows`. The rows
    do not depend on the place where a piece is cut.
    """
    kind, data, at, _ = piece
    u0, _ = curve_range(kind, data, at)
    here = np.empty((4, len(grid.point)))
    error = 0.0
    done = True
    if u == u0:
        rows, error, done = enter(piece, u, grid, here, error, rows, moves)
    if done and kind == LINE:
        rows, u, error, done = _line_rows(piece, u, upto, grid, here, error, rows, moves)
    elif done:
        rows, u, error, done = arc_rows(piece, u, upto, grid, here, error, rows, moves)
    return rows, upto if done else min(u, np.nextafter(upto, u0)), error


@njit
def _find_leader(piece: Piece, scale: Floats) -> Leader:
    """Return the leader of a line."""
    _, data, at, _ = piece
    n = len(scale)
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
    return Leader(leader, travel, on_grid and far < LARGEST, far)


@njit
def _line_rows(
    piece: Piece,
    u: float,
    upto: float,
    grid: Grid,
    here: Floats,
    error: float,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float, bool]:
    """Write the rows at which the leader of a line is on a grid line; see :func:`half_step_rows`.

    Returns:
        The number of rows, the parameter reached, the largest error so far, and whether the buffer
        was large enough.
    """
    kind, data, at, s0 = piece
    scale, point = grid
    s = moves.s
    most = len(s)
    u0, u1 = curve_range(kind, data, at)
    lead = _find_leader(piece, scale)
    leader = lead.axis
    full = False
    first = data[at + START + leader] * scale[leader]
    sign = 1 if lead.travel > 0.0 else -1
    per_blu = (u1 - u0) / abs(lead.travel)
    here_at = (
        data[at + START + len(point) + leader] * scale[leader]
        if upto == u1
        else first + sign * ((upto - u0) / per_blu)
    )
    # A line that is reached but for rounding counts as reached.
    here_at += sign * slack(here_at)
    count = math.floor(sign * (here_at - point[leader]))
    # No axis makes two steps in the first row, hence none does so later or is left two steps
    # behind. The leader may step in such a row as well.
    line = 0.0
    before = -1
    while not full and rows > before:
        before = rows
        line = sign * (point[leader] + sign - first) * per_blu
        rows, u, error, done = prepare(
            piece, u, min(u0 + line, u1), upto, grid, here, error, rows, moves
        )
        full = not done
    if count > 0:
        count = math.floor(sign * (here_at - point[leader]))
        if not full and count > 0 and rows < most and _aside(piece, line, leader, grid):
            rows, u, error, _ = round_to(
                piece, u, min(u0 + line, upto), grid, here, error, rows, moves
            )
        count = min(math.floor(sign * (here_at - point[leader])), most - rows)
    if count > 0 and not full:
        line = sign * (point[leader] - first)
        error = _count(piece, lead, line, grid, error, rows, count, moves.step)
        begin = s0 + (u - u0)
        u = min(max(u0 + (line + count) * per_blu, u), upto)
        for k in range(count):
            s[rows + k] = min(max(s0 + (line + (k + 1)) * per_blu, begin), s0 + (u - u0))
        rows += count
    full = full or math.floor(sign * (here_at - point[leader])) > 0
    return rows, u, error, not full


@njit
def _count(
    piece: Piece,
    lead: Leader,
    line: float,
    grid: Grid,
    error: float,
    rows: int,
    count: int,
    step: Steps,
) -> float:
    """Write ``count`` rows of a line into ``step`` from row ``rows`` on, axis by axis.

    line: distance of the leader's grid point from the start, BLU.

    Returns:
        The largest |grid point - position| so far, BLU.
    """
    _, data, at, _ = piece
    scale, point = grid
    leader, travel, on_grid, far = lead
    n = len(point)
    start = at + START
    end = start + n
    sign = 1 if travel > 0.0 else -1
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
            point[i] += sign * count
        elif slope == 0.0:
            for row in range(rows, rows + count):
                step[row, i] = 0
            error = max(error, abs(point[i] - a))
        else:
            # f: distance by which the line is ahead of the grid point where the leader is on its
            # grid line
            if on_grid:
                rise = 2 * abs(int(np.rint(data[end + i] * scale[i])) - int(np.rint(a)))
                f = rise * int(np.rint(line)) - whole * (ahead * (point[i] - int(np.rint(a))))
            else:
                rise = int(np.rint(abs(slope) * FINE))
                f = int(np.rint(ahead * (a - point[i] + line * slope) * FINE))
            made, low, high = _deviations(f, rise, whole, half, ahead, step[rows : rows + count, i])
            point[i] += ahead * made
            error = max(error, max(-low, high) / whole)
    return error


@njit
def _aside(piece: Piece, line: float, leader: int, grid: Grid) -> bool:
    """Return whether the own steps of an axis do not lead it back to the line.

    The piece before left it beside its path. line: first grid line of the leader, as a distance
    along the move, mm.
    """
    kind, data, at, _ = piece
    scale, point = grid
    start = at + START
    end = start + len(point)
    u0, u1 = curve_range(kind, data, at)
    aside = False
    for i in range(len(point)):
        if i != leader:
            travel = (data[end + i] - data[start + i]) * scale[i]
            off = data[start + i] * scale[i] + travel * (line / (u1 - u0)) - point[i]
            margin = 0.5 + slack(float(point[i]))
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
    f: int, rise: int, whole: int, half: int, ahead: int, step: Steps
) -> tuple[int, int, int]:
    """Write the steps of one axis of a line: equations 8 to 10 with f counted from the grid point.

    Returns:
        The number of steps, and the smallest and the largest f after a row.
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
