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

ARC, with helices, spirals and different scales: see the drawing below. The paper leaves the
recursion of arcs to the reader; :mod:`cnc.papers.kernels.half_step` has it for a circle whose
centre and radius are on the grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_arclen
from cnc.path.kernels.curve import LINE, START, TABLE, Floats, Ints, curve_eval, curve_range
from cnc.pulses.kernels.grid_moves import (
    SLACK,
    SLACK_PER_BLU,
    Grid,
    Moves,
    Piece,
    Steps,
    enter,
    prepare,
    round_to,
    slack,
)
from cnc.pulses.kernels.polynomial import estrin, interpolate, value
from cnc.pulses.kernels.windows import (
    CHECKS,
    EXACT,
    ROUNDING,
    SHORTEST,
    Window,
    begin_window,
    following,
    length_rates,
    new_window,
)

# Arcs: leader, windows, and the nearer candidate.
#
# Where leader p is the fastest axis, the others are smooth functions of p with a slope of at most
# one, and so is the arc length: polynomials of degree 7 through values and three derivatives at the
# ends of a window, which is shortened until they agree with the arc. So a row takes a few products
# for each axis, no root and no sine.
#
# y, s ^            ,-o b
#      |        ,-'
#      |     o'
#      |   ,'|  |  |  |
#      | o a |  |  |  |
#      +-----+--+--+--+--> p
#
# Window from a to b in which one axis, the leader p, is the fastest: the positions y of the others,
# the arc length s and the parameter u as polynomials of p. A row is on each grid line of p, where y
# is compared with the half-grid line next to the grid point.


class GridLines(NamedTuple):
    """Grid lines that the leader crosses in a window.

    Attributes:
        leader: the axis.
        sign: its direction, -1 or 1.
        crossed: number of lines.
        x: place of the first in the window, from 0 to 1.
        dx: distance of one from the next.
    """

    leader: int
    sign: int
    crossed: int
    x: float
    dx: float


@njit
def arc_rows(
    piece: Piece,
    u: float,
    upto: float,
    grid: Grid,
    here: Floats,
    error: float,
    rows: int,
    moves: Moves,
) -> tuple[int, float, float, bool]:
    """Write the rows at which the leader of an arc is on a grid line.

    See :func:`half_step_rows`.

    Returns:
        The number of rows, the parameter reached, the largest error so far, and whether the buffer
        was large enough.
    """
    kind, data, at, s0 = piece
    scale, point = grid
    s = moves.s
    n = len(point)
    u0, u1 = curve_range(kind, data, at)
    measured = n if data[at + TABLE] != 0.0 else -1
    moved = np.empty(n, np.int64)
    window = new_window(n)
    widest = (u1 - u0) / 8.0
    shortest = SHORTEST * (u1 - u0)
    width = widest
    wider_off = math.inf
    full = False
    ua = u
    begin_window(piece, ua, window)
    while ua < upto and not full:
        leader = _fastest(window.start, scale)
        sign = 1 if window.start[1, leader] > 0.0 else -1
        if sign * (window.start[0, leader] * scale[leader] - point[leader]) >= 1.0:
            rows, u, error, done = round_to(piece, u, ua, grid, here, error, rows, moves)
            if not done:
                full = True
                break
        ub = ua + width if upto - (ua + width) > 0.1 * width else upto
        curve_eval(kind, data, at, ub, window.end)
        if _lead(window.end, leader, scale) < 0.0:
            ub = _lead_ends(piece, ua, ub, leader, scale, window)
        off = _fit(piece, ua, ub, leader, scale, window)
        # The error grows with the eighth power of the width.
        width = min(
            (ub - ua)
            * min(max(0.9 * math.sqrt(math.sqrt(math.sqrt(1.0 / max(off, 1e-9)))), 0.1), 4.0),
            widest,
        )
        if off > 1.0 and not 0.5 * wider_off < off < ROUNDING and ub - ua > shortest:
            width = min(width, 0.7 * (ub - ua))
            wider_off = off
            continue
        wider_off = off if off > 1.0 else math.inf
        # A window accepted with a larger error would not be better if it were narrower.
        width = max(width, ub - ua if off > 1.0 else shortest)
        pa = window.start[0, leader] * scale[leader]
        pb = window.end[0, leader] * scale[leader]
        all_lines = max(math.floor(sign * (pb - point[leader]) + slack(pb)), 0)
        count = min(all_lines, len(s) - rows)
        x = (point[leader] + sign - pa) / (pb - pa) if count > 0 else 0.0
        dx = 1.0 / abs(pb - pa) if count > 0 else 0.0
        lines = GridLines(leader, sign, count, x, dx)
        made, error = _window_rows(window, lines, grid, moved, error, rows, moves.step)
        if made > 0:
            u = u0 + value(window.poly[leader], x + (made - 1) * dx)
            _place_rows(s0, window.poly[max(measured, leader)], x, dx, s[rows : rows + made])
            rows += made
        if made < count:
            # An axis would make two steps there.
            ub = u0 + value(window.poly[leader], x + made * dx)
        if made == count and count < all_lines:
            full = True
        else:
            before = rows
            rows, u, error, done = prepare(piece, u, ub, ub, grid, here, error, rows, moves)
            if done and made < count and rows == before:
                # There the polynomial and the curve are on two sides of the limit.
                rows, u, error, done = round_to(piece, u, ub, grid, here, error, rows, moves)
            full = not done
            if made == count and rows == before:
                ua = ub
                window = following(window)
            else:
                ua = u if rows > before else ub
                begin_window(piece, ua, window)
    return rows, u, error, not full


@njit
def _window_rows(
    window: Window,
    lines: GridLines,
    grid: Grid,
    moved: Ints,
    error: float,
    rows: int,
    step: Steps,
) -> tuple[int, float]:
    """Write the rows on the grid lines of the leader into ``step``, from row ``rows`` on.

    moved: (n,): work space.

    Returns:
        The number of rows, up to one in which an axis would take two steps, and the largest error
        so far.
    """
    poly = window.poly
    start = window.start
    end = window.end
    scale, point = grid
    leader, sign, count, x, dx = lines
    n = len(point)
    made = count
    for i in range(n):
        moved[i] = 0
        if i != leader:
            c = poly[i]
            far = 0.5 + slack(max(abs(start[0, i]), abs(end[0, i])) * scale[i])
            if (
                start[1, i] == 0.0
                and end[1, i] == 0.0
                and start[0, i] == end[0, i]
                and abs(c[0] - point[i]) <= far
            ):
                for row in range(rows, rows + count):
                    step[row, i] = 0
                error = max(error, abs(c[0] - point[i]) if count > 0 else 0.0)
                continue
            kept, moved[i], worst = _nearest(
                c, float(point[i]), x, dx, far, step[rows : rows + count, i]
            )
            made = min(made, kept)
            error = max(error, worst)
    for i in range(n):
        if i == leader:
            for row in range(rows, rows + made):
                step[row, i] = sign
            point[i] += sign * made
        elif made == count:
            point[i] += moved[i]
        else:
            for row in range(rows, rows + made):
                point[i] += step[row, i]
    return made, error


@njit
def _fastest(r: Floats, scale: Floats) -> int:
    """Return the axis that moves the most BLU per unit of u."""
    leader = 0
    for i in range(1, len(scale)):
        if abs(r[1, i]) * scale[i] > abs(r[1, leader]) * scale[leader]:
            leader = i
    return leader


@njit
def _lead(r: Floats, leader: int, scale: Floats) -> float:
    """Return by how much (BLU per unit of u) the leader is faster than the next axis."""
    next_best = 0.0
    for i in range(len(scale)):
        if i != leader:
            next_best = max(next_best, abs(r[1, i]) * scale[i])
    return abs(r[1, leader]) * scale[leader] - next_best


@njit
def _lead_ends(
    piece: Piece, low: float, high: float, leader: int, scale: Floats, window: Window
) -> float:
    """Return the u in the window [low, high] where the leader is overtaken, by the Illinois method.

    The end of the window moves there.
    """
    kind, data, at, _ = piece
    start = window.start
    end = window.end
    close = 1e-7 / (abs(start[1, leader]) * scale[leader])
    lead = _lead(start, leader, scale)
    lag = _lead(end, leader, scale)
    side = 0
    while high - low > close:
        middle = low + (high - low) * (lead / (lead - lag))
        if not low < middle < high:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
        curve_eval(kind, data, at, middle, end)
        f = _lead(end, leader, scale)
        if f < 0.0:
            high = middle
            lag = f
            lead *= 0.5 if side < 0 else 1.0
            side = -1
        else:
            low = middle
            lead = f
            lag *= 0.5 if side > 0 else 1.0
            side = 1
    curve_eval(kind, data, at, high, end)
    return high


@njit
def _fit(piece: Piece, ua: float, ub: float, leader: int, scale: Floats, window: Window) -> float:
    """Fit polynomials in the position of the leader, 0 at ua and 1 at ub, to a window.

    They give the other axes (BLU), u - u0 in the row of the leader, and the arc length from the
    start of the piece (mm) in the last row, where u is not the arc length itself.

    Returns:
        The largest error in parts of the allowed one.
    """
    kind, data, at, _ = piece
    poly, start, end, lengths, inside = window
    n = len(scale)
    u0, _ = curve_range(kind, data, at)
    measured = data[at + TABLE] != 0.0
    k = scale[leader]
    pa = start[0, leader] * k
    h = end[0, leader] * k - pa
    off = 0.0
    if measured:
        lengths[1, 0] = curve_arclen(kind, data, at, u0, ub)
        length_rates(data, at, start, lengths[0])
        length_rates(data, at, end, lengths[1])
        a1, a2, a3 = _by_leader(lengths[0, 1], lengths[0, 2], lengths[0, 3], start, leader, k, h)
        b1, b2, b3 = _by_leader(lengths[1, 1], lengths[1, 2], lengths[1, 3], end, leader, k, h)
        interpolate(poly, n, lengths[0, 0], a1, a2, a3, lengths[1, 0], b1, b2, b3)
    for i in range(n):
        if i == leader:
            a1, a2, a3 = _by_leader(1.0, 0.0, 0.0, start, leader, k, h)
            b1, b2, b3 = _by_leader(1.0, 0.0, 0.0, end, leader, k, h)
            interpolate(poly, i, ua - u0, a1, a2, a3, ub - u0, b1, b2, b3)
        else:
            q = scale[i]
            a1, a2, a3 = _by_leader(
                start[1, i] * q, start[2, i] * q, start[3, i] * q, start, leader, k, h
            )
            b1, b2, b3 = _by_leader(end[1, i] * q, end[2, i] * q, end[3, i] * q, end, leader, k, h)
            interpolate(poly, i, start[0, i] * q, a1, a2, a3, end[0, i] * q, b1, b2, b3)
    # A leader that moves by rounding alone does not lead.
    moves = h * start[1, leader] > 0.0
    for check in range(2 if moves else 0):
        u = ua + CHECKS[check] * (ub - ua)
        curve_eval(kind, data, at, u, inside)
        x = (inside[0, leader] * k - pa) / h
        for i in range(n):
            y = value(poly[i], x)
            if i == leader:
                off = max(off, abs(y - (u - u0)) / (EXACT + 1e-15 * u0))
            else:
                p = inside[0, i] * scale[i]
                off = max(off, abs(y - p) / (0.25 * SLACK + SLACK_PER_BLU * abs(p)))
        if measured:
            y = value(poly[n], x)
            off = max(off, abs(y - curve_arclen(kind, data, at, u0, u)) / EXACT)
    return off if moves else math.inf


@njit
def _by_leader(
    q1: float, q2: float, q3: float, r: Floats, leader: int, scale: float, h: float
) -> tuple[float, float, float]:
    """Return dq/dp h, half of d2q/dp2 h^2 and a sixth of d3q/dp3 h^3.

    q1 to q3 are the derivatives of q by u; those of the leader's position p are in r (4, n).
    """
    p1 = r[1, leader] * scale
    p2 = r[2, leader] * scale
    p3 = r[3, leader] * scale
    inverse = 1.0 / p1
    y1 = q1 * inverse
    y2 = (q2 - y1 * p2) * inverse * inverse
    y3 = (q3 - 3.0 * y2 * p1 * p2 - y1 * p3) * inverse * inverse * inverse
    return y1 * h, 0.5 * y2 * h * h, y3 * h * h * h / 6.0


@njit
def _nearest(
    c: Floats, base: float, x: float, dx: float, far: float, step: Steps
) -> tuple[int, int, float]:
    """Write the steps of one axis in rows at x, x + dx .., each to the nearer candidate.

    c: (POLYNOMIAL,): position of the axis, BLU. base: its grid point before. far: largest distance
    at which a grid point is near enough.

    Returns:
        The number of rows, up to one that would take two steps; the grid point reached, from
        ``base`` on; and the largest distance after a row.
    """
    # Scalars: a step that is written could change c, as far as the compiler knows.
    c0, c1, c2, c3 = c[0] - base, c[1], c[2], c[3]
    c4, c5, c6, c7 = c[4], c[5], c[6], c[7]
    kept = len(step)
    g = 0.0
    worst = 0.0
    for k in range(len(step)):
        y = estrin(c0, c1, c2, c3, c4, c5, c6, c7, x + k * dx)
        # the grid points that are near enough: one, or both sides of a tie
        low = np.ceil(y - far)
        high = np.floor(y + far)
        near = low if low > g else g
        near = high if high < near else near
        move = near - g
        if abs(move) > 1.0:
            kept = k
            break
        step[k] = int(move)
        g = near
        worst = max(worst, abs(y - g))
    return kept, int(g), worst


@njit
def _place_rows(s0: float, c: Floats, x: float, dx: float, s: Floats) -> None:
    """Write the path coordinates (mm) of rows at x, x + dx .. into s."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    c4, c5, c6, c7 = c[4], c[5], c[6], c[7]
    for k in range(len(s)):
        s[k] = s0 + estrin(c0, c1, c2, c3, c4, c5, c6, c7, x + k * dx)


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

    Arguments and results are those of :func:`cnc.pulses.kernels.crossings.crossing_rows`. The rows
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
