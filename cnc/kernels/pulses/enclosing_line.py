"""Reference pulses by enclosing lines (Samad & Wan Yusof, Jurnal Teknologi 37(D), 2002), for any
number of axes.

About the grid point P lies a square, a box in space, of 2 BLU a side. The point r at which the
curve leaves it is found, and where that is near a neighbour of P tells the next grid point:

      A4      A3  L2  A2            Of the sides only those lie ahead that the tangent points to (Table 1), and it meets first the one of
        +------+--o---+             the axis with the smallest d / |r'|, d = distance to its side: in the plane that is the sign of the
        |      |,'    |             geometric factor |x'| dy - |y'| dx (Tables 2 and 3, "abs" mended there).
     L3 |      P      | L1
        |    ,'       |             On that side u is found (Table 4, mended: u only grows). One step along the tangent, as printed,
        +--,---+------+             misses by the curve's bend; here it is the start of Newton's iteration in a bracket, so that
      A6      A7  L4  A8            r is on the side and the axis that leaves has no error at all.

The other axes round: one with |D| > 1/2 steps with it, D = r - P (Table 5, mended). As r is on the
square's border there is no null step, and as no axis is beyond its side every |D| after the step is
at most 1/2.

Mended beyond the paper's text: the tangent only guesses which side comes first. If at the place
found another axis is beyond its side, that one left before and takes the lead. An axis that turns
back inside the square, a cusp, a start or end off the grid: windows end there
(:mod:`cnc.kernels.pulses.monotone`), inside them no axis turns, and the square stays the same from
one to the next.

A row is due where r is on the side, so the machine is at the next grid point when the curve passes
by it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints, curve_eval, curve_range
from cnc.kernels.pulses.crossings import approach, risen, slack

CLOSE = 1e-8
"""BLU: how near to its line an axis is found."""


@njit
def reached(poly: Floats, axis: int, line: float, sign: float, low: float, high: float) -> float:
    """The x in [low, high] where an axis, on its heading ``sign`` all the way, is at ``line``
    (BLU): low if it is there, high if never.
    """
    c = poly[axis]
    off = c[0] - line
    first = low
    x = low
    while True:
        x2 = x * x
        x4 = x2 * x2
        f = sign * risen(off, c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)
        if abs(f) <= CLOSE or x >= high or (f > 0.0 and x == first):
            break
        f1 = sign * (
            (c[8] + c[9] * x) + (c[10] + c[11] * x) * x2 + ((c[12] + c[13] * x) + c[14] * x2) * x4
        )
        f2 = sign * ((c[15] + c[16] * x) + (c[17] + c[18] * x) * x2 + (c[19] + c[20] * x) * x4)
        f3 = sign * ((c[21] + c[22] * x) + (c[23] + c[24] * x) * x2 + c[25] * x4)
        if f > 0.0:
            high = x
        else:
            low = x
        near = x + approach(f, f1, f2, f3)
        if not low < near < high:
            near = 0.5 * (low + high)
            if not low < near < high:
                # neighbouring numbers: the line lies between them
                near = high
        x = near
    return x


@njit
def window_rows(
    poly: Floats,
    ends: Floats,
    x: float,
    grid: Ints,
    error: float,
    rows: int,
    room: int,
    step: NDArray[np.int8],
    reach: Floats,
) -> tuple[int, float, float]:
    """Write the grid moves of a window in which no axis turns, from its place x on: rows ``rows``
    to ``room``, if there are as many.

    poly: the axes' polynomials in BLU, see :func:`cnc.kernels.pulses.crossings.fit_window`. ends
    (n,): the axes at x = 1. grid (n,) is carried on. step gets the rows, reach the x of each.
    Returns the number of rows, the x up to which all is done (1 when the window is through), and
    the largest |grid - position| in BLU of any row so far.
    """
    n = len(grid)
    now = np.empty((n, 4))
    way = np.empty((n, 2))
    for i in range(n):
        # the heading, and how far it goes in BLU
        way[i, 0] = np.sign(ends[i] - poly[i, 0])
        way[i, 1] = way[i, 0] * ends[i] - slack(ends[i])
    near = x
    lead = -1
    line = 0.0
    high = 2.0
    exact = False
    moving = False
    while True:
        z = near
        z2 = z * z
        z4 = z2 * z2
        for i in range(n):
            c = poly[i]
            now[i, 0] = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], z)
            now[i, 1] = (
                (c[8] + c[9] * z)
                + (c[10] + c[11] * z) * z2
                + ((c[12] + c[13] * z) + c[14] * z2) * z4
            )
            now[i, 2] = (c[15] + c[16] * z) + (c[17] + c[18] * z) * z2 + (c[19] + c[20] * z) * z4
            now[i, 3] = (c[21] + c[22] * z) + (c[23] + c[24] * z) * z2 + c[25] * z4
        if moving:
            sought = -1
            if not exact and not (x <= near <= 1.0 and abs(now[lead, 0] - line) <= CLOSE):
                sought = lead
            elif x < near < high:
                high = near
                for i in range(n):
                    if way[i, 0] * (now[i, 0] - grid[i]) > 1.0 + CLOSE:
                        # this one has left before
                        sought = i
            if sought >= 0:
                lead = sought
                exact = True
                line = grid[lead] + way[lead, 0]
                near = reached(poly, lead, line, way[lead, 0], x, min(high, 1.0))
                continue
            x = near
            reach[rows] = x
            for i in range(n):
                off = now[i, 0] - grid[i]
                margin = 0.5 + slack(now[i, 0])
                # Table 5, see grid_after
                move = int(off > margin) - int(off < -margin)
                step[rows, i] = move
                grid[i] += move
                error = max(error, abs(off - move))
            rows += 1
        lead = -1
        lead_off = 0.0
        lead_rate = 0.0
        for i in range(n):
            sign = way[i, 0]
            if way[i, 1] - sign * grid[i] > 1.0:
                off = 1.0 - sign * (now[i, 0] - grid[i])
                rate = abs(now[i, 1])
                # the geometric factor
                if lead < 0 or off * lead_rate < lead_off * rate:
                    lead = i
                    lead_off = off
                    lead_rate = rate
        moving = lead >= 0 and rows < room
        if not moving:
            break
        sign = way[lead, 0]
        line = grid[lead] + sign
        # 2 is beyond any window
        near = min(
            x
            + approach(
                min(-lead_off, 0.0), sign * now[lead, 1], sign * now[lead, 2], sign * now[lead, 3]
            ),
            2.0,
        )
        exact = False
        high = 2.0
    return rows, x if lead >= 0 else 1.0, error


@njit
def as_printed(
    kind: int, data: Floats, at: int, scale: Floats, grid: Ints, step: NDArray[np.int8], place: Floats
) -> tuple[int, float]:  # fmt: skip
    """The paper's procedure (Figure 3) on a piece in two axes: one step along the tangent, no end
    treated; Tables 3 to 5 as mended.

    scale (2,): steps per mm. grid (2,): starts at the rounded start point, is carried on. step
    (room, 2) gets the iterations, null steps too, place (room,) the u of each. Returns their number
    and the largest |P - r(u)| in BLU, straight across both axes.
    """
    u, u1 = curve_range(kind, data, at)
    room = len(place)
    r = np.empty((4, 2))
    curve_eval(kind, data, at, u, r)
    rows = 0
    error = 0.0
    while rows < room:
        x = r[0, 0] * scale[0] - grid[0]
        y = r[0, 1] * scale[1] - grid[1]
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
            off = r[0, i] * scale[i] - grid[i]
            move = int(off > 0.5) - int(off < -0.5)
            step[rows, i] = move
            grid[i] += move
            square += (off - move) * (off - move)
        place[rows] = u
        error = max(error, square)
        rows += 1
    return rows, np.sqrt(error)
