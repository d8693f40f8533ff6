"""Half-step deviation interpolation (Shu et al. 2019) of lines and arcs in any number of axes.

In units of one step (BLU) the axis that is fastest, the leader, steps in every row, and each other axis steps with it or does not: as the
paper has it, towards the nearer of the two candidates, which are one BLU apart, so that the nearer one is at most half a BLU from the curve.

      g + 1  - - - - - - - C         Leader x, row after row on the grid lines of x. The candidates P + (1, 0) = B and P + (1, 1) = C are
                         ,-'         equally far where the curve passes half-way between them, at D with BD = CD = 1/2. Comparing BD with
                    ,--'   D         CD is comparing the distances themselves: BE / CF = BD / CD (figure 3). A tie moves the leader alone
      g      - - P - - - - B         (equation 9, f >= 0, which is the mended end of section 3): here |g - y| > 1/2 + slack is needed.

A row lies at the place of the path at which the leader is on its grid line: there it is exact and the others are within half a BLU.
Where the path turns so that another axis becomes the fastest (Figures 2 and 6: eight octants in a plane, by size of the end point on a line,
by the tangent on an arc), that one leads; if it is a whole BLU behind, there is a row at once. An axis that would have to make two steps in a
row, as at a start off the grid on both sides of its cell, gets a row of its own before. At the end of the piece a last row rounds the grid
point to the end, on the grid or not.

LINE. The deviation f of an axis is counted in integers: with the line's ends on the grid, in units of half the leader's travel, it is the
paper's recursion (equations 8 to 10: -2 Ye for each step of X, +2 Xe for one of Y) without any rounding; else in units of 2^-52 BLU.

ARC, with helices, spirals and different scales. Where leader p is the fastest, the others are smooth functions of p with a slope of at most
one, and so is the arc length: polynomials of degree 7 through values and three derivatives at the ends of a window, which is made shorter
until they agree with the arc. So a row takes a few products an axis, no root and no sine. The paper leaves the recursion of arcs to the
reader; see :mod:`cnc.kernels.circles` for it, on a circle whose centre and radius are on the grid.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.crossings import CHECKS, EXACT, POLYNOMIAL, ROUNDING, SHORTEST, grid_after, interpolate, length_rates, risen, slack
from cnc.kernels.curve import LINE, START, TABLE, Floats, Ints, curve_arclen, curve_eval, curve_range
from cnc.kernels.jit import njit

FINE = 2**52
"""Parts of a BLU in which the deviation from a line off the grid is counted."""
LARGEST = 2**28
"""BLU: ends on the grid farther off than this are treated like others, so that the paper's products stay within 64 bits."""


@njit
def half_step_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, state: Floats, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """Write the grid moves of a line or an arc from u to ``upto``, from row ``rows`` on, as many as there is room for.

    s0: path coordinate (mm) of the piece's start. scale (n,): steps per mm. grid (n,) is carried on. state: not needed here. step (room, n)
    gets the rows, reach (room,) the path coordinate of each. Returns the number of rows, the u up to which all is done (``upto`` when
    through), and the largest |grid - position| (BLU) over axes and rows, at the place of the row. The rows do not depend on where a piece
    is cut: only its very end is rounded to.
    """
    u0, u1 = curve_range(kind, data, at)
    here = np.empty((4, len(grid)))
    error = 0.0
    done = True
    if u == u0:
        # another algorithm may have left the grid point where this one would not
        rows, u, error, done = _round_to(kind, data, at, u, u, s0, scale, grid, here, error, rows, step, reach)
    if done and kind == LINE:
        rows, u, error, done = _line_rows(data, at, u, upto, s0, scale, grid, here, error, rows, step, reach)
    elif done:
        rows, u, error, done = _arc_rows(kind, data, at, u, upto, s0, scale, grid, here, error, rows, step, reach)
    if done and upto == u1:
        rows, u, error, done = _round_to(kind, data, at, u, upto, s0, scale, grid, here, error, rows, step, reach)
    return rows, upto if done else min(u, np.nextafter(upto, u0)), error


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
def _prepare(
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
def _round_to(
    kind: int, data: Floats, at: int, low: float, u: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows after which the grid point is the curve's, rounded, at u: see :func:`_prepare`, which returns the same."""
    rows, low, error, done = _prepare(kind, data, at, low, u, s0, scale, grid, here, error, rows, step, reach)
    if done:
        curve_eval(kind, data, at, u, here)
        for i in range(len(grid)):
            done = done and grid_after(grid[i], here[0, i] * scale[i]) == grid[i]
        if not done and rows < len(reach):
            rows, error = _write_row(kind, data, at, u, s0, scale, grid, here, error, rows, step, reach)
            done = True
        low = u if done else low
    return rows, low, error, done


@njit
def _line_rows(
    data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows at which a line's leader is on a grid line; see :func:`half_step_rows`. Returns also whether room was left."""
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
        on_grid = on_grid and abs(a - np.rint(a)) <= 0.25 * slack(a) and abs(b - np.rint(b)) <= 0.25 * slack(b)
        far = max(far, max(abs(a), abs(b)))
        if abs(b - a) > abs(travel):
            leader = i
            travel = b - a
    on_grid = on_grid and far < LARGEST
    full = False
    first = data[start + leader] * scale[leader]
    sign = 1 if travel > 0.0 else -1
    per_blu = (u1 - u0) / abs(travel)
    here_at = data[end + leader] * scale[leader] if upto == u1 else first + sign * ((upto - u0) / per_blu)
    count = math.floor(sign * (here_at - grid[leader]))
    if count > 0:
        # no axis makes two steps in the first row, hence none later
        line = sign * (grid[leader] + sign - first) * per_blu
        rows, u, error, done = _prepare(LINE, data, at, u, u0 + line, s0, scale, grid, here, error, rows, step, reach)
        full = not done
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
                made, low, high = _deviations(f, rise, whole, half, ahead, step[rows : rows + count, i])
                grid[i] += ahead * made
                error = max(error, max(-low, high) / whole)
        begin = s0 + (u - u0)
        u = min(max(u0 + (line + count) * per_blu, u), upto)
        for k in range(count):
            reach[rows + k] = min(max(s0 + (line + (k + 1)) * per_blu, begin), s0 + (u - u0))
        rows += count
        full = math.floor(sign * (here_at - grid[leader])) > 0
    return rows, u, error, not full


@njit
def _deviations(f: int, rise: int, whole: int, half: int, ahead: int, step: NDArray[np.int8]) -> tuple[int, int, int]:
    """One axis of a line: equations 8 to 10 with f counted from the grid point. Returns steps made, smallest and largest f after a row."""
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


@njit
def _arc_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows at which an arc's leader is on a grid line; see :func:`half_step_rows`. Returns also whether room was left."""
    n = len(grid)
    room = len(reach)
    u0, u1 = curve_range(kind, data, at)
    measured = n if data[at + TABLE] != 0.0 else -1
    poly = np.empty((n + 1, POLYNOMIAL))
    lengths = np.empty((2, 4))
    moved = np.empty(n, np.int64)
    ra = np.empty((4, n))
    rb = np.empty((4, n))
    widest = (u1 - u0) / 8.0
    width = widest
    wider_off = math.inf
    full = False
    ua = u
    curve_eval(kind, data, at, ua, ra)
    lengths[0, 0] = curve_arclen(kind, data, at, u0, ua)
    while ua < upto and not full:
        leader = _fastest(ra, scale)
        sign = 1 if ra[1, leader] > 0.0 else -1
        if sign * (ra[0, leader] * scale[leader] - grid[leader]) >= 1.0:
            rows, u, error, done = _round_to(kind, data, at, u, ua, s0, scale, grid, here, error, rows, step, reach)
            if not done:
                full = True
                break
        ub = ua + width if upto - (ua + width) > 0.1 * width else upto
        curve_eval(kind, data, at, ub, rb)
        if _lead(rb, leader, scale) < 0.0:
            ub = _lead_ends(kind, data, at, ua, ub, leader, scale, ra, rb)
        off = _fit(kind, data, at, ua, ub, leader, scale, ra, rb, here, lengths, poly)
        # the error goes with the eighth power of the width
        width = min((ub - ua) * min(max(0.9 * math.sqrt(math.sqrt(math.sqrt(1.0 / max(off, 1e-9)))), 0.1), 4.0), widest)
        if off > 1.0 and not 0.5 * wider_off < off < ROUNDING and ub - ua > SHORTEST * (u1 - u0):
            width = min(width, 0.7 * (ub - ua))
            wider_off = off
            continue
        wider_off = math.inf
        pa = ra[0, leader] * scale[leader]
        pb = rb[0, leader] * scale[leader]
        lines = max(math.floor(sign * (pb - grid[leader])), 0)
        count = min(lines, room - rows)
        x = (grid[leader] + sign - pa) / (pb - pa)
        dx = 1.0 / abs(pb - pa)
        made = count
        for i in range(n):
            moved[i] = 0
            if i != leader:
                c = poly[i]
                far = 0.5 + slack(max(abs(ra[0, i]), abs(rb[0, i])) * scale[i])
                kept, moved[i], worst = _nearest(
                    c[0] - grid[i], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x, dx, far, step[rows : rows + count, i]
                )  # fmt: skip
                made = min(made, kept)
                error = max(error, worst)
        for i in range(n):
            if i == leader:
                for row in range(rows, rows + made):
                    step[row, i] = sign
                grid[i] += sign * made
            elif made == count:
                grid[i] += moved[i]
            else:
                for row in range(rows, rows + made):
                    grid[i] += step[row, i]
        if made > 0:
            c = poly[leader]
            u = u0 + risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x + (made - 1) * dx)
            c = poly[max(measured, leader)]
            _reaches(s0, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x, dx, reach[rows : rows + made])
            rows += made
        if made < count:
            c = poly[leader]
            place = u0 + risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x + made * dx)
            rows, u, error, done = _prepare(kind, data, at, u, place, s0, scale, grid, here, error, rows, step, reach)
            ua = u
            curve_eval(kind, data, at, ua, ra)
            lengths[0, 0] = curve_arclen(kind, data, at, u0, ua)
        elif count < lines:
            full = True
        else:
            ua = ub
            lengths[0, 0] = lengths[1, 0]
            ra, rb = rb, ra
    return rows, u, error, not full


@njit
def _fastest(r: Floats, scale: Floats) -> int:
    """The axis that moves the most BLU per unit of u."""
    leader = 0
    for i in range(1, len(scale)):
        if abs(r[1, i]) * scale[i] > abs(r[1, leader]) * scale[leader]:
            leader = i
    return leader


@njit
def _lead(r: Floats, leader: int, scale: Floats) -> float:
    """By how much (BLU per unit of u) the leader is faster than the next."""
    next_best = 0.0
    for i in range(len(scale)):
        if i != leader:
            next_best = max(next_best, abs(r[1, i]) * scale[i])
    return abs(r[1, leader]) * scale[leader] - next_best


@njit
def _lead_ends(kind: int, data: Floats, at: int, low: float, high: float, leader: int, scale: Floats, ra: Floats, rb: Floats) -> float:
    """Where between low and high (the curve there: ra, rb) the leader is overtaken; rb becomes the curve there. Illinois' method."""
    close = 1e-7 / (abs(ra[1, leader]) * scale[leader])
    lead = _lead(ra, leader, scale)
    lag = _lead(rb, leader, scale)
    side = 0
    while high - low > close:
        middle = low + (high - low) * (lead / (lead - lag))
        if not low < middle < high:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
        curve_eval(kind, data, at, middle, rb)
        f = _lead(rb, leader, scale)
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
    curve_eval(kind, data, at, high, rb)
    return high


@njit
def _fit(
    kind: int, data: Floats, at: int, ua: float, ub: float, leader: int, scale: Floats, ra: Floats, rb: Floats, rc: Floats, lengths: Floats,
    poly: Floats,
) -> float:  # fmt: skip
    """Fit polynomials in the leader's position, 0 at ua and 1 at ub, to the other axes (BLU), in the leader's row to u - u0, and in the last
    row to the arc length where that is another one (mm from the piece's start).

    ra, rb (4, n): the curve at ua and ub. lengths[0, 0]: arc length at ua; lengths[1, 0] becomes that at ub. rc (4, n): scratch. Returns by
    how many times what is allowed a polynomial is off.
    """
    n = len(scale)
    u0, _ = curve_range(kind, data, at)
    measured = data[at + TABLE] != 0.0
    k = scale[leader]
    pa = ra[0, leader] * k
    h = rb[0, leader] * k - pa
    off = 0.0
    if measured:
        lengths[1, 0] = curve_arclen(kind, data, at, u0, ub)
        length_rates(data, at, ra, lengths[0])
        length_rates(data, at, rb, lengths[1])
        a1, a2, a3 = _by_leader(lengths[0, 1], lengths[0, 2], lengths[0, 3], ra[1, leader] * k, ra[2, leader] * k, ra[3, leader] * k, h)
        b1, b2, b3 = _by_leader(lengths[1, 1], lengths[1, 2], lengths[1, 3], rb[1, leader] * k, rb[2, leader] * k, rb[3, leader] * k, h)
        interpolate(poly, n, lengths[0, 0], a1, a2, a3, lengths[1, 0], b1, b2, b3)
    for i in range(n):
        if i == leader:
            a1, a2, a3 = _by_leader(1.0, 0.0, 0.0, ra[1, i] * k, ra[2, i] * k, ra[3, i] * k, h)
            b1, b2, b3 = _by_leader(1.0, 0.0, 0.0, rb[1, i] * k, rb[2, i] * k, rb[3, i] * k, h)
            interpolate(poly, i, ua - u0, a1, a2, a3, ub - u0, b1, b2, b3)
        else:
            q = scale[i]
            a1, a2, a3 = _by_leader(ra[1, i] * q, ra[2, i] * q, ra[3, i] * q, ra[1, leader] * k, ra[2, leader] * k, ra[3, leader] * k, h)
            b1, b2, b3 = _by_leader(rb[1, i] * q, rb[2, i] * q, rb[3, i] * q, rb[1, leader] * k, rb[2, leader] * k, rb[3, leader] * k, h)
            interpolate(poly, i, ra[0, i] * q, a1, a2, a3, rb[0, i] * q, b1, b2, b3)
    for check in range(2):
        u = ua + CHECKS[check] * (ub - ua)
        curve_eval(kind, data, at, u, rc)
        x = (rc[0, leader] * k - pa) / h
        for i in range(n):
            c = poly[i]
            y = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)
            if i == leader:
                off = max(off, abs(y - (u - u0)) / (EXACT + 1e-15 * u0))
            else:
                p = rc[0, i] * scale[i]
                off = max(off, abs(y - p) / (0.25 * slack(p)))
        if measured:
            c = poly[n]
            y = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)
            off = max(off, abs(y - curve_arclen(kind, data, at, u0, u)) / EXACT)
    return off if h * ra[1, leader] > 0.0 else math.inf


@njit
def _by_leader(q1: float, q2: float, q3: float, p1: float, p2: float, p3: float, h: float) -> tuple[float, float, float]:
    """dq/dp h, half of d2q/dp2 h^2 and a sixth of d3q/dp3 h^3 from the derivatives of q and p by u."""
    inverse = 1.0 / p1
    y1 = q1 * inverse
    y2 = (q2 - y1 * p2) * inverse * inverse
    y3 = (q3 - 3.0 * y2 * p1 * p2 - y1 * p3) * inverse * inverse * inverse
    return y1 * h, 0.5 * y2 * h * h, y3 * h * h * h / 6.0


@njit
def _nearest(
    c0: float, c1: float, c2: float, c3: float, c4: float, c5: float, c6: float, c7: float, x: float, dx: float, far: float,
    step: NDArray[np.int8],
) -> tuple[int, int, float]:  # fmt: skip
    """One axis of an arc: of the two candidates of each row the nearer one. c0 .. c7: the polynomial, less the grid point.

    Returns the number of rows, up to one that would take two steps; the steps made; and the largest distance after a row.
    """
    kept = len(step)
    moved = 0
    worst = 0.0
    for k in range(len(step)):
        d = risen(c0 - moved, c1, c2, c3, c4, c5, c6, c7, x + k * dx)
        move = 1 if d > far else 0
        move -= 1 if d < -far else 0
        step[k] = move
        d = abs(d - move)
        if d > far:
            kept = k
            break
        moved += move
        worst = max(worst, d)
    return kept, moved, worst


@njit
def _reaches(
    s0: float, c0: float, c1: float, c2: float, c3: float, c4: float, c5: float, c6: float, c7: float, x: float, dx: float, reach: Floats
) -> None:  # fmt: skip
    """The path coordinate of rows at x, x + dx .."""
    for k in range(len(reach)):
        reach[k] = s0 + risen(c0, c1, c2, c3, c4, c5, c6, c7, x + k * dx)
