"""Reference pulse interpolation of a whole path in any number of axes.

In units of one step (BLU) an axis is at P(u) = q(u) * steps_per_mm and its grid point is the integer nearest to P, so that a step falls
due where P crosses a half-grid line:

      k + 1  - - - - - - - - - - - - -       The axis is cut at its turning points into stretches in which P only rises or only
                          ,--.               falls. The value at the end of a stretch tells the grid point g there, hence how many
    k + 1/2 ------------o------o-----        lines are crossed on the way: no step is lost or made twice, whatever rounding does
                     ,-'        `-.          to the crossings' places. The crossings of each axis come in order, and the axes
      k      - - --'- - - - - - - -`-        are merged by their place on the path.

A crossing's place: on a line in closed form; on arcs and spans see :mod:`cnc.kernels.crossings`.

A line counts as crossed only when P is beyond it by more than SLACK. So an axis that rests on a half-grid line while others move gives no
pulses, whatever the rounding, nor does one that turns back on reaching it; and which of two equally near grid points it has there is
the one that it came from. Axes that are within SLACK of their lines at the same path point share a row. Both keep |g - P| <= 1/2 + SLACK.

A graze, an axis that turns back so soon behind a half-grid line that its two pulses would come faster than the board takes them, is passed
over: both pulses are taken out again. Grazes that rest exactly on the line are common in real programs, and SLACK deals with them; those
that reach a hair beyond it are rare in one move but sure to come in a million.

Rows are made in two passes: first which axes step and at which s, piece by piece, then when, by the plan's phases.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.crossings import POLYNOMIAL, STATE, curve_rows, grid_after, slack
from cnc.kernels.curve import LINE, MAX_TURNING_POINTS, curve_eval, curve_inv_arclen, curve_range
from cnc.kernels.jit import njit
from cnc.kernels.timing import nanoseconds, time_in_phase

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SNAP = 1e-9
"""mm: a chunk that ends this near to the end of a piece ends with it."""

PIECE, PHASE, LAST_NS, INSIDE = 0, 1, 2, 3
"""Integer state: piece and phase under way, time of the last row, and whether the piece has been entered."""
INTEGERS = 4
U, DT, ERROR = 0, 1, 2
"""Float state: parameter reached in the piece, time in its phase, largest |g - P| so far (BLU)."""
FLOATS = 3


@njit
def pulses(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, source_line: NDArray[np.int32],
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats,
    whole_ns: int, seconds: float, steps_per_mm: Floats, grid: Ints, integers: Ints, floats: Floats,
    time_ns: Ints, step: NDArray[np.int8], line: NDArray[np.int32], reach: Floats, filled: int, recent: Ints, min_pulse_ns: float,
) -> int:  # fmt: skip
    """Fill the buffers with the next grid moves of a plan chunk; returns how many rows they hold.

    kind .. source_line: the path's pieces, phase_*: the motion over them, as in PlanChunk. The chunk begins at whole_ns + seconds.
    grid (n,): grid point, carried on. integers, floats: state, zeros at the start of a chunk but for LAST_NS and ERROR, which go
    on; the chunk is done when integers[PIECE] is past its last piece. time_ns (rows,), step (rows, n), line (rows,): buffers, of which the
    first ``filled`` rows are taken; reach (rows,): scratch. recent (n,): row of each axis's last pulse, -1 if it is no longer there.
    min_pulse_ns: an axis that steps back sooner after a step makes neither.
    """
    n = len(grid)
    room = len(time_ns)
    s_begin = phase_s[0]
    s_end = phase_s[-1]
    error = floats[ERROR]
    here = np.empty((4, n))
    ra = np.empty((4, n))
    rb = np.empty((4, n))
    turns = np.empty((n, MAX_TURNING_POINTS + 1))
    ends = np.empty((n, MAX_TURNING_POINTS + 1))
    poly = np.empty((n + 1, POLYNOMIAL))
    lengths = np.empty((2, 4))
    state = np.empty((n, STATE))
    stretch = np.empty((n, 2), np.int64)
    place = np.empty(n)
    position = np.empty(n)
    rate = np.empty(n)
    target = np.empty(n, np.int64)
    rows = filled
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
        u = floats[U]
        upto = u1 if s_end >= piece_s[piece + 1] - SNAP else curve_inv_arclen(k, data, a, s_end - s0)
        before = rows
        if k != LINE:
            rows, u, error = curve_rows(
                k, data, a, u, upto, s0, steps_per_mm, grid, turns, ends, poly, ra, rb, here, lengths, state, place, stretch, error, rows,
                step, reach,
            )  # fmt: skip
            full = u < upto
        else:
            curve_eval(k, data, a, upto, here)
            for i in range(n):
                target[i] = grid_after(grid[i], here[0, i] * steps_per_mm[i])
            # crossings are counted from the line's start
            curve_eval(k, data, a, u0, here)
            for i in range(n):
                position[i] = here[0, i] * steps_per_mm[i]
                rate[i] = here[1, i] * steps_per_mm[i]
                place[i] = _on_line(position[i], rate[i], grid[i], target[i], u0, u, upto)
            while True:
                lead = 0
                for i in range(1, n):
                    if place[i] < place[lead]:
                        lead = i
                if place[lead] == math.inf:
                    break
                if rows == room:
                    full = True
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
        for row in range(before, rows):
            line[row] = source_line[piece]
        floats[U] = u
        if not full:
            piece += 1
            integers[INSIDE] = 0
    integers[PIECE] = piece
    floats[ERROR] = error
    _times(phase_t, phase_s, phase_v, phase_a, phase_j, whole_ns, seconds, integers, floats, filled, rows, reach, time_ns)
    return _without_grazes(filled, rows, time_ns, step, line, recent, min_pulse_ns)


@njit
def _on_line(p0: float, rate: float, g: int, target: int, u0: float, begin: float, upto: float) -> float:
    """The u in [begin, upto] at which an axis at p0 + (u - u0) rate (BLU) crosses the line next to g on its way to ``target``; else inf."""
    if g == target:
        return math.inf
    sign = 1 if target > g else -1
    if sign * rate <= 0.0:
        return begin
    return min(max(u0 + (g + 0.5 * sign - p0) / rate, begin), upto)


@njit
def _times(
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats, whole_ns: int, seconds: float, integers: Ints,
    floats: Floats, first: int, rows: int, reach: Floats, time_ns: Ints,
) -> None:  # fmt: skip
    """When the rows from ``first`` on are due: at the arc lengths in ``reach``, and none before the one before it."""
    last = len(phase_j) - 1
    phase = integers[PHASE]
    last_ns = integers[LAST_NS]
    dt = floats[DT]
    row = first
    while row < rows:
        s = reach[row]
        while phase < last and s > phase_s[phase + 1]:
            phase += 1
            dt = 0.0
        t0 = phase_t[phase]
        s0 = phase_s[phase]
        v = phase_v[phase]
        a = phase_a[phase]
        j = phase_j[phase]
        span = phase_t[phase + 1] - t0
        s1 = phase_s[phase + 1] if phase < last else math.inf
        if a == 0.0 and j == 0.0 and v > 0.0:
            while row < rows and reach[row] <= s1:
                dt = min(max((reach[row] - s0) / v, 0.0), span)
                last_ns = max(last_ns, nanoseconds(whole_ns, seconds + (t0 + dt)))
                time_ns[row] = last_ns
                row += 1
        else:
            while row < rows and reach[row] <= s1:
                dt = time_in_phase(v, a, j, reach[row] - s0, span, dt)
                last_ns = max(last_ns, nanoseconds(whole_ns, seconds + (t0 + dt)))
                time_ns[row] = last_ns
                row += 1
    integers[PHASE] = phase
    integers[LAST_NS] = last_ns
    floats[DT] = dt


@njit
def _without_grazes(
    first: int, rows: int, time_ns: Ints, step: NDArray[np.int8], line: NDArray[np.int32], recent: Ints, min_pulse_ns: float
) -> int:
    """Take out, from row ``first`` on, pulses that an axis takes back too soon and those that take them back; returns the rows left."""
    n = len(recent)
    grazed = False
    for row in range(first, rows):
        for i in range(n):
            if step[row, i] != 0:
                back = recent[i]
                if back >= 0 and step[back, i] != step[row, i] and time_ns[row] - time_ns[back] < min_pulse_ns:
                    step[back, i] = 0
                    step[row, i] = 0
                    recent[i] = -1
                    grazed = True
                else:
                    recent[i] = row
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
