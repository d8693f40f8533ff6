"""Reference pulse interpolation of a whole path in any number of axes.

In units of one step (BLU) an axis is at P(u) = q(u) * steps_per_mm and its grid point is the integer nearest to P, so that a step falls
due where P crosses a half-grid line:

      k + 1  - - - - - - - - - - - - -       The axis is cut at its turning points into stretches in which P only rises or only
                          ,--.               falls. The value at the end of a stretch tells the grid point g there, hence how many
    k + 1/2 ------------o------o-----        lines are crossed on the way: no step is lost or made twice, whatever rounding does
                     ,-'        `-.          to the crossings' places. The crossings of each axis come in order, and the axes
      k      - - --'- - - - - - - -`-        are merged by their place on the path.

A crossing's place: on a line in closed form; on arcs and spans by Euler's irrational method (the parabola that touches P solves a
crossing next to a turning point too) with a cubic term from the last crossing, bracketed by the stretch. One evaluation mostly does.

A line counts as crossed only when P is beyond it by more than SLACK. So an axis that rests on a half-grid line while others move gives no
pulses, whatever the rounding, nor does one that turns back on reaching it; and which of two equally near grid points it has there is
the one that it came from. Axes that are within SLACK of their lines at the same path point share a row. Both keep |g - P| <= 1/2 + SLACK.

A graze, an axis that turns back so soon behind a half-grid line that its two pulses would come faster than the board takes them, is passed
over: both pulses are taken out again. Grazes that rest exactly on the line are common in real programs, and SLACK deals with them; those
that reach a hair beyond it are rare in one move but sure to come in a million.

Times follow from s by the plan's phases. On a span s advances from row to row by the Hermite quadrature with two derivatives of the speed,
which the evaluation gives free of cost, and is tied to the table of the arc length every ANCHOR rows and wherever the rule is not sharp.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.curve import (
    LINE,
    MAX_TURNING_POINTS,
    METRIC,
    METRICS,
    TABLE,
    curve_arclen,
    curve_eval,
    curve_inv_arclen,
    curve_range,
    curve_turning_points,
)
from cnc.kernels.jit import njit
from cnc.kernels.timing import nanoseconds, phase_holding, time_in_phase

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SLACK = 5e-10
"""BLU. Far below anything that matters, and above the rounding of positions of up to a million BLU (2e-16 of their size each)."""
SLACK_PER_BLU = 4e-16
"""Added to SLACK for each BLU of distance from the origin, where rounding grows with the position."""
SNAP = 1e-9
"""mm: a chunk that ends this near to the end of a piece ends with it."""
ANCHOR = 64
"""Rows after which the arc length is taken from the table again."""
SHARP = 1e-9
"""Largest part of a step in s by which the quadratures of orders 4 and 6 may differ; the error of the better one is smaller by far."""

PIECE, PHASE, LAST_NS, INSIDE = 0, 1, 2, 3
"""Integer state: piece and phase under way, time of the last row, and whether the piece has been entered."""
INTEGERS = 4
DUE = -math.inf
"""In the place of a crossing: still to be found."""
U, DT, ERROR = 0, 1, 2
"""Float state: parameter reached in the piece, time in its phase, largest |g - P| so far (BLU)."""
FLOATS = 3


@njit
def slack(p: float) -> float:
    """What rounding may do to a position of p BLU."""
    return SLACK + SLACK_PER_BLU * abs(p)


@njit
def grid_after(g: int, p: float) -> int:
    """The grid point of an axis that had g and has moved to p BLU: g unless p is beyond the half-grid line next to g."""
    margin = 0.5 + slack(p)
    if p > g + margin:
        return math.ceil(p - margin)
    if p < g - margin:
        return math.floor(p + margin)
    return g


@njit
def _speed(data: Floats, at: int, r: Floats, out: Floats) -> None:
    """Write |dr/du| over the metric axes and its first two derivatives by u, from r (4, n); just 0 where it vanishes."""
    d11 = 0.0
    d12 = 0.0
    d22_13 = 0.0
    for k in range(int(data[at + METRICS])):
        i = int(data[at + METRIC + k])
        d11 += r[1, i] * r[1, i]
        d12 += r[1, i] * r[2, i]
        d22_13 += r[2, i] * r[2, i] + r[1, i] * r[3, i]
    sigma = math.sqrt(d11)
    out[0] = sigma
    if sigma > 0.0:
        out[1] = d12 / sigma
        out[2] = (d22_13 - out[1] * out[1]) / sigma


@njit
def _next(
    kind: int, data: Floats, at: int, axis: int, scale: float, g: int, upto: float, turns: Floats, stretch: Ints, place: Floats, r: Floats
) -> None:
    """Find the next crossing of one axis.

    turns: where its stretches begin, then inf. stretch: [index of the next one, grid point at the end of the present one]. place: [how
    far the axis has been followed, next crossing or inf]. r (4, n): evaluation at place[0]; on return at the crossing.
    """
    low = place[0]
    evaluated = True
    while stretch[1] == g:
        if turns[stretch[0]] >= upto:
            place[1] = math.inf
            return
        low = turns[stretch[0]]
        stretch[0] += 1
        curve_eval(kind, data, at, min(turns[stretch[0]], upto), r)
        stretch[1] = grid_after(g, r[0, axis] * scale)
        evaluated = False
    sign = 1 if stretch[1] > g else -1
    line = g + 0.5 * sign
    close = 0.25 * slack(line)
    high = min(turns[stretch[0]], upto)
    x = low
    while True:
        if not evaluated:
            curve_eval(kind, data, at, x, r)
        evaluated = False
        f = sign * (r[0, axis] * scale - line)
        # at the very start of a stretch the line may lie behind, by rounding
        if abs(f) <= close or x >= high or (f > 0.0 and x == low):
            break
        if f > 0.0:
            high = x
        else:
            low = x
        f1 = sign * r[1, axis] * scale
        f2 = sign * r[2, axis] * scale
        under = f1 * f1 - 2.0 * f * f2
        slope = f1 + math.sqrt(max(under, 0.0))
        step = math.inf
        if under >= 0.0 and f1 >= 0.0 and slope > 0.0:
            step = -2.0 * f / slope
            # the cubic term bends the parabola's root by one Newton step
            f3 = sign * r[3, axis] * scale
            slope = f1 + step * (f2 + 0.5 * step * f3)
            if slope > 0.0:
                step -= step * step * step * f3 / (6.0 * slope)
        near = x + step
        if not low < near < high:
            near = 0.5 * (low + high)
            if not low < near < high:
                # neighbouring numbers: the line lies between them
                near = high
        x = near
    place[0] = x
    place[1] = x


@njit
def pulses(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, source_line: NDArray[np.int32],
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats,
    whole_ns: int, seconds: float, steps_per_mm: Floats, grid: Ints, integers: Ints, floats: Floats,
    time_ns: Ints, step: NDArray[np.int8], line: NDArray[np.int32], filled: int, recent: Ints, min_pulse_ns: float,
) -> int:  # fmt: skip
    """Fill the buffers with the next grid moves of a plan chunk; returns how many rows they hold.

    kind .. source_line: the path's pieces, phase_*: the motion over them, as in PlanChunk. The chunk begins at whole_ns + seconds.
    grid (n,): grid point, carried on. integers, floats: state, zeros at the start of a chunk but for LAST_NS and ERROR, which go
    on; the chunk is done when integers[PIECE] is past its last piece. time_ns (rows,), step (rows, n), line (rows,): buffers, of which the
    first ``filled`` rows are taken. recent (n,): row of each axis's last pulse, -1 if it is no longer there. min_pulse_ns: an axis that
    steps back sooner after a step makes neither.
    """
    n = len(grid)
    room = len(time_ns)
    s_begin = phase_s[0]
    s_end = phase_s[-1]
    phase = integers[PHASE]
    dt = floats[DT]
    last_ns = integers[LAST_NS]
    error = floats[ERROR]
    r = np.empty((n, 4, n))
    here = np.empty((4, n))
    turns = np.empty((n, MAX_TURNING_POINTS + 2))
    stretch = np.empty((n, 2), np.int64)
    place = np.empty((n, 2))
    position = np.empty(n)
    rate = np.empty(n)
    speed = np.empty(3)
    before = np.empty(3)
    rows = filled
    grazed = False
    piece = integers[PIECE]
    full = False
    while piece < len(kind) and not full:
        if piece_s[piece + 1] <= s_begin:
            piece += 1
            continue
        k = int(kind[piece])
        a = int(at[piece])
        s0 = piece_s[piece]
        u0, u1 = curve_range(k, data, a)
        if integers[INSIDE] == 0:
            floats[U] = curve_inv_arclen(k, data, a, s_begin - s0)
            integers[INSIDE] = 1
        begin = floats[U]
        upto = u1 if s_end >= piece_s[piece + 1] - SNAP else curve_inv_arclen(k, data, a, s_end - s0)
        straight = k == LINE
        measured = data[a + TABLE] != 0.0
        for first in range(2):
            # the end, then where the motion begins; a line's crossings are counted from its start
            curve_eval(k, data, a, upto if first == 0 else u0 if straight else begin, here)
            for i in range(n):
                position[i] = here[0, i] * steps_per_mm[i]
                rate[i] = here[1, i] * steps_per_mm[i]
                if first == 0:
                    stretch[i, 1] = grid_after(grid[i], position[i]) if straight else grid[i]
                    place[i, 0] = begin
                    place[i, 1] = DUE
        if not straight:
            for i in range(n):
                count = curve_turning_points(k, data, a, i, turns[i, 1:])
                turns[i, 1 + count] = math.inf
                passed = 0
                while turns[i, 1 + passed] <= begin:
                    passed += 1
                turns[i, passed] = begin
                stretch[i, 0] = passed
        s = begin - u0
        if measured:
            s = curve_arclen(k, data, a, u0, begin)
            _speed(data, a, here, before)
        unanchored = 0
        u = begin
        while True:
            lead = 0
            for i in range(n):
                if place[i, 1] == DUE:
                    if not straight:
                        _next(k, data, a, i, steps_per_mm[i], grid[i], upto, turns[i], stretch[i], place[i], r[i])
                    elif stretch[i, 1] == grid[i]:
                        place[i, 1] = math.inf
                    else:
                        place[i, 1] = _on_line(position[i], rate[i], grid[i], stretch[i, 1], u0, u, upto)
                if place[i, 1] < place[lead, 1]:
                    lead = i
            if place[lead, 1] == math.inf:
                break
            if rows == room:
                full = True
                break
            was = u
            u = place[lead, 1]
            # arc length, then time
            if not measured:
                s = u - u0
            else:
                _speed(data, a, r[lead], speed)
                h = u - was
                ends = 0.5 * h * (before[0] + speed[0])
                bend = h * h * (before[1] - speed[1])
                ds = ends + bend / 10.0 + h * h * h * (before[2] + speed[2]) / 120.0
                unanchored += 1
                sharp = before[0] > 0.0 and speed[0] > 0.0 and abs(ds - (ends + bend / 12.0)) <= SHARP * ds
                if sharp and unanchored < ANCHOR:
                    s += ds
                else:
                    s = max(s, curve_arclen(k, data, a, u0, u))
                    unanchored = 0
                before[0] = speed[0]
                before[1] = speed[1]
                before[2] = speed[2]
            local = min(max(s0 + s, s_begin), s_end)
            ahead = phase_holding(phase_s, local, phase)
            if ahead != phase:
                phase = ahead
                dt = 0.0
            dt = time_in_phase(
                phase_v[phase], phase_a[phase], phase_j[phase], local - phase_s[phase], phase_t[phase + 1] - phase_t[phase], dt
            )
            last_ns = max(last_ns, nanoseconds(whole_ns, seconds + (phase_t[phase] + dt)))
            time_ns[rows] = last_ns
            line[rows] = source_line[piece]
            # who steps
            for i in range(n):
                at_row = position[i] + (u - u0) * rate[i] if straight else r[lead, 0, i] * steps_per_mm[i]
                step[rows, i] = 0
                if place[i, 1] != math.inf:
                    sign = 1 if stretch[i, 1] > grid[i] else -1
                    if i == lead or sign * (grid[i] + 0.5 * sign - at_row) <= slack(at_row):
                        step[rows, i] = sign
                        grid[i] += sign
                error = max(error, abs(grid[i] - at_row))
            moves = False
            for i in range(n):
                if step[rows, i] != 0:
                    place[i, 1] = DUE
                    back = recent[i]
                    if back >= 0 and step[back, i] != step[rows, i] and last_ns - time_ns[back] < min_pulse_ns:
                        step[back, i] = 0
                        step[rows, i] = 0
                        recent[i] = -1
                        grazed = True
                    else:
                        recent[i] = rows
                        moves = True
            if moves:
                rows += 1
        floats[U] = u
        if not full:
            piece += 1
            integers[INSIDE] = 0
    integers[PIECE] = piece
    integers[PHASE] = phase
    integers[LAST_NS] = last_ns
    floats[DT] = dt
    floats[ERROR] = error
    return _close_ranks(rows, time_ns, step, line, recent) if grazed else rows


@njit
def _close_ranks(rows: int, time_ns: Ints, step: NDArray[np.int8], line: NDArray[np.int32], recent: Ints) -> int:
    """Take rows without a step out of the buffers; returns how many remain."""
    n = len(recent)
    kept = 0
    for row in range(rows):
        moves = False
        for i in range(n):
            moves = moves or step[row, i] != 0
        if moves:
            time_ns[kept] = time_ns[row]
            line[kept] = line[row]
            for i in range(n):
                step[kept, i] = step[row, i]
                if recent[i] == row:
                    recent[i] = kept
            kept += 1
    return kept


@njit
def _on_line(p0: float, rate: float, g: int, target: int, u0: float, begin: float, upto: float) -> float:
    """The u in [begin, upto] at which an axis at p0 + (u - u0) rate (BLU) crosses the line next to g on its way to ``target``."""
    sign = 1 if target > g else -1
    if sign * rate <= 0.0:
        return begin
    return min(max(u0 + (g + 0.5 * sign - p0) / rate, begin), upto)
