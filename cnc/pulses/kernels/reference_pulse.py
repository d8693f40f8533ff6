"""Reference pulses of a whole path: the algorithm for each piece, and the time of each grid move.

A row of the buffers is a grid move: the axes that step together, each by one BLU. Rows are made in
three passes over the buffers:

    piece by piece   axes that step, and path coordinate   a generator, by the kind of piece
    phase by phase   time of that path coordinate
    row by row       limits of the board's step rate

Every generator takes and returns the same as :func:`cnc.pulses.kernels.crossings.crossing_rows`.
The grid point passes from one to the next.

Half steps (lines, arcs) and enclosing lines (curves) write a row where the fastest axis of the
path, the leader, comes to its next grid line. The others round there and step with it or not:

      |     |     |   ,-o
      |     | ,o--|---|
      o-----|-'---|---|---- x

At a row each axis is within half a BLU of the path. Between two rows the leader is up to a BLU
behind, any other up to a BLU and a half. The steps of the leader are as even as the motion. The
steps of another axis wait for it. So two of them may be nearer to each other, by one row, than its
speed alone gives.

Where the path goes on, a piece that ends off the grid leaves the grid point as it is, and the next
leader takes over. Where the motion rests, a last row rounds the grid point to the end. The rows do
not depend on the places where a plan is cut.

By crossings, and point by point, each axis steps by itself where it is halfway to its next grid
point: more rows, no axis ever more than half a BLU off, and steps of every axis as even as the
motion.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import SPAN, Floats, Ints, Pieces, curve_range
from cnc.planner.kernels.arrays import PlanArrays
from cnc.pulses.kernels.crossings import crossing_rows, point_by_point_rows
from cnc.pulses.kernels.enclosing_line import monotone_rows
from cnc.pulses.kernels.grid_moves import Grid, Lines, Moves, Piece, round_to
from cnc.pulses.kernels.half_step import half_step_rows

# Limits of the board's step rate: pulses that are taken back at once, and rows too close together.
#
# A graze is an axis that turns back so soon behind a half-grid line that its two pulses would come
# faster than the board allows. Both pulses are removed. Grazes that rest exactly on the line are
# common in real programs, and the slack of the generators deals with them. Those that reach
# slightly beyond it are rare in one move, but sure to occur among a million.
#
# Rows of different axes may fall due at almost the same time. Where the board needs more time they
# are joined:
#
#       x   |      |      |      |
#       y     |       |      |    |
#       row ^ ^    ^  ^      ^   ^
#                         one  one
#
# at the time of the later row: there the curve is within half a BLU of the grid point to which both
# lead. Two rows of the same axis come so near only where another axis takes the lead: its steps
# were those of the other's rows and are its own from then on. Then the second row waits.

BLOCK = 256
"""Rows of which it is asked at once whether an axis turns in them."""


class Buffers(NamedTuple):
    """Buffers of grid moves with their times.

    Attributes:
        moves: the moves.
        time_ns: (rows,) int64: time of each, ns.
        line: (rows,) int32: source line of each.
        recent: (n,) int64: row of the last pulse of each axis; -1 where it has left the buffers.
        made: (n,) int64: number of pulses of each axis so far.
    """

    moves: Moves
    time_ns: Ints
    line: Lines
    recent: Ints
    made: Ints


@njit
def without_grazes(first: int, rows: int, buffers: Buffers, min_pulse_ns: float) -> int:
    """Remove pulses that an axis takes back within ``min_pulse_ns``, from row ``first`` on.

    Other pulses are counted in ``buffers.made``. An axis seldom turns, so in most blocks of rows no
    times have to be compared.

    Returns:
        The number of rows left.
    """
    step, recent, made = buffers.moves.step, buffers.recent, buffers.made
    grazes = 0
    for i in range(len(recent)):
        for begin in range(first, rows, BLOCK):
            end = min(begin + BLOCK, rows)
            ups, downs = 0, 0
            for row in range(begin, end):
                ups += step[row, i] > 0
                downs += step[row, i] < 0
            made[i] += ups + downs
            before = step[recent[i], i] if recent[i] >= 0 else 0
            if (ups > 0 or before > 0) and (downs > 0 or before < 0):
                found = _remove_grazes(i, begin, end, buffers, min_pulse_ns)
                made[i] -= 2 * found
                grazes += found
            elif ups + downs > 0:
                back = end - 1
                while step[back, i] == 0:
                    back -= 1
                recent[i] = back
    return _without_empty_rows(rows, buffers) if grazes > 0 else rows


@njit
def _remove_grazes(i: int, first: int, end: int, buffers: Buffers, min_pulse_ns: float) -> int:
    """Remove such pulses of axis i from the rows ``first`` to before ``end``.

    Returns:
        The number of pairs of pulses that were removed.
    """
    step, time_ns, recent = buffers.moves.step, buffers.time_ns, buffers.recent
    found = 0
    for row in range(first, end):
        if step[row, i] != 0:
            back = recent[i]
            if (
                back >= 0
                and step[back, i] != step[row, i]
                and time_ns[row] - time_ns[back] < min_pulse_ns
            ):
                step[back, i] = 0
                step[row, i] = 0
                recent[i] = -1
                found += 1
            else:
                recent[i] = row
    return found


@njit
def _without_empty_rows(rows: int, buffers: Buffers) -> int:
    """Remove rows without a step; return the number of rows left."""
    moves, time_ns, line, recent, _ = buffers
    step = moves.step
    n = len(recent)
    kept = 0
    for row in range(rows):
        steps = False
        for i in range(n):
            steps = steps or step[row, i] != 0
        if steps:
            time_ns[kept] = time_ns[row]
            line[kept] = line[row]
            for i in range(n):
                step[kept, i] = step[row, i]
                if recent[i] == row:
                    recent[i] = kept
            kept += 1
    return kept


@njit
def spaced(rows: int, released_ns: int, buffers: Buffers, min_ns: float) -> int:
    """Keep rows ``min_ns`` apart, and the first as far from ``released_ns``.

    Rows that were spaced before stay as they are.

    Returns:
        The number of rows left.
    """
    moves, time_ns, line, recent, _ = buffers
    step = moves.step
    n = len(recent)
    least = int(min_ns)
    kept = 0
    earliest = released_ns + least
    # Up to the first row that is too close to the one before it, nothing moves.
    while kept < rows and time_ns[kept] >= earliest:
        earliest = time_ns[kept] + least
        kept += 1
    for row in range(kept, rows):
        earliest = (time_ns[kept - 1] if kept > 0 else released_ns) + least
        joins = kept > 0 and time_ns[row] < earliest
        if joins:
            for i in range(n):
                joins = joins and (step[row, i] == 0 or step[kept - 1, i] == 0)
        if joins:
            kept -= 1
            for i in range(n):
                step[kept, i] += step[row, i]
                step[row, i] = step[kept, i]
        time = max(time_ns[row], time_ns[kept] if joins else earliest)
        if kept < row or time != time_ns[row]:
            time_ns[kept] = time
            line[kept] = line[row]
            for i in range(n):
                step[kept, i] = step[row, i]
                if recent[i] == row:
                    recent[i] = kept
        kept += 1
    return kept


# Times of path coordinates: the inverse of s(t) in a phase of constant jerk, and time stamps.
#
# Rows are dense: over many of them the speed changes by a few hundredths. About a time t_e with
# speed v, acceleration a and jerk j, s - s_e = v (x + alpha x^2 + beta x^3) with x = t - t_e, alpha
# = a / 2v and beta = j / 6v, so that with y = (s - s_e) / v
#
#     x = y - alpha y^2 + (2 alpha^2 - beta) y^3 + ..
#     c_n = 1/n [x^(n-1)] (1 + alpha x + beta x^2)^-n    (Lagrange's inversion)
#
# which is cut off after y^7: seven products a row, no root and no quotient. The next term is at
# most 2871 kappa^7 y^8 with kappa the larger of |alpha| and sqrt|beta|; that limits the range of a
# series. Where rows are too far apart for a series, next to rest, each is found by iteration.

CLOSE = 1e-12
"""s: a step this short ends the iteration. The convergence is cubic, so the rest is rounding."""

TAIL = 1e-14
"""s: the first term that a series leaves out is at most 2871 times that by the speed at its first
row, three times as much where the motion brakes: less than 0.1 ns.
"""
NEAR = 0.125
"""Largest range of a series in units of 1 / kappa. There each term left out is at most half of the
term before it.
"""
DENSE = 2
"""Smallest number of rows for which a series is made."""


@njit
def time_in_phase(v: float, a: float, j: float, ds: float, span: float, guess: float) -> float:
    """Return the t in [0, span] with t (v + t (a / 2 + t j / 6)) = ds; the nearer end outside.

    The method is Euler's irrational one: each step solves the parabola that touches the cubic. So
    the convergence is cubic, and a start or an end at rest needs no special care (v = 0, where
    Newton's step would be infinite). The root stays bracketed; a step out of the bracket is
    replaced by bisection, so that the iteration always ends.

    Args:
        v: speed at t = 0, mm/s; never negative in the phase.
        a: acceleration at t = 0, mm/s^2.
        j: jerk, mm/s^3.
        ds: distance, mm.
        span: duration of the phase, s.
        guess: start of the iteration, s.
    """
    if ds <= 0.0:
        return 0.0
    if a == 0.0 and j == 0.0:
        return min(ds / v, span) if v > 0.0 else span
    if span * (v + span * (0.5 * a + span * (j / 6.0))) <= ds:
        return span
    low = 0.0
    high = span
    t = guess
    if v == 0.0 and a == 0.0 and guess <= 0.0:
        t = (6.0 * ds / j) ** (1.0 / 3.0)
    if not low <= t <= high:
        t = 0.5 * span
    for _ in range(100):
        f = t * (v + t * (0.5 * a + t * (j / 6.0))) - ds
        if f > 0.0:
            high = t
        else:
            low = t
        f1 = v + t * (a + t * (0.5 * j))
        under = f1 * f1 - 2.0 * f * (a + t * j)
        step = math.inf
        slope = f1 + math.sqrt(max(under, 0.0))
        if under >= 0.0 and f1 >= 0.0 and slope > 0.0:
            step = -2.0 * f / slope
        near = t + step
        if not low <= near <= high:
            near = 0.5 * (low + high)
        step = near - t
        t = near
        if abs(step) <= CLOSE:
            break
    return t


@njit
def nanoseconds(whole_ns: int, seconds: float) -> int:
    """Return ``whole_ns`` plus ``seconds``, to the nearest ns.

    The sum is integer, so that it is as exact after days as at the start.
    """
    return whole_ns + int(np.rint(seconds * 1e9))


@njit
def phase_times(
    plan: PlanArrays,
    phase: int,
    whole_ns: int,
    seconds: float,
    dt: float,
    last_ns: int,
    first: int,
    rows: int,
    s: Floats,
    time_ns: Ints,
) -> tuple[float, int]:
    """Write the times of the rows ``first`` to ``rows``, all in one phase, into time_ns.

    Args:
        plan: the plan.
        phase: index of the phase.
        whole_ns: whole seconds of the time at which the plan begins, ns.
        seconds: the fraction of that time, s.
        dt: time of the row before, from the start of the phase, s.
        last_ns: no row is due before this time.
        first: first row.
        rows: row behind the last.
        s: path coordinates of the rows, mm.
        time_ns: takes the times.

    Returns:
        The time of the last row from the start of the phase (s), and its time (ns).
    """
    t0 = seconds + plan.t[phase]
    s0 = plan.s[phase]
    v0 = plan.v[phase]
    a0 = plan.a[phase]
    j0 = plan.j[phase]
    span = plan.t[phase + 1] - plan.t[phase]
    row = first
    if a0 == 0.0 and j0 == 0.0 and v0 > 0.0:
        slow = 1.0 / v0
        for k in range(first, rows):
            dt = min(max((s[k] - s0) * slow, 0.0), span)
            last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
            time_ns[k] = last_ns
        row = rows
    while row < rows:
        v = v0 + dt * (a0 + dt * (0.5 * j0))
        half = 0.0
        if v > 0.0:
            slow = 1.0 / v
            kappa = max(0.5 * abs(a0 + dt * j0) * slow, math.sqrt(abs(j0) * slow / 6.0))
            # TAIL = kappa^7 half^8
            part = min(NEAR, math.sqrt(math.sqrt(math.sqrt(TAIL * kappa))))
            half = min(0.5 * (span - dt), part / kappa if kappa > 0.0 else math.inf)
        te = dt + half
        end = te + half
        beyond = s0 + end * (v0 + end * (0.5 * a0 + end * (j0 / 6.0)))
        if half > 0.0 and s[min(row + DENSE, rows) - 1] <= beyond:
            ve = v0 + te * (a0 + te * (0.5 * j0))
            se = s0 + te * (v0 + te * (0.5 * a0 + te * (j0 / 6.0)))
            slow = 1.0 / ve
            p = 0.5 * (a0 + te * j0) * slow
            q = j0 / 6.0 * slow
            p2 = p * p
            c3 = 2.0 * p2 - q
            c4 = p * (5.0 * q - 5.0 * p2)
            c5 = p2 * (14.0 * p2 - 21.0 * q) + 3.0 * q * q
            c6 = p * (p2 * (84.0 * q - 42.0 * p2) - 28.0 * q * q)
            c7 = p2 * (p2 * (132.0 * p2 - 330.0 * q) + 180.0 * q * q) - 12.0 * q * q * q
            while row < rows and s[row] <= beyond:
                y = (s[row] - se) * slow
                y2 = y * y
                x = y + y2 * ((c3 * y - p) + y2 * ((c4 + c5 * y) + y2 * (c6 + c7 * y)))
                dt = min(max(te + x, 0.0), span)
                last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
                time_ns[row] = last_ns
                row += 1
        else:
            dt = time_in_phase(v0, a0, j0, s[row] - s0, span, dt)
            last_ns = max(last_ns, nanoseconds(whole_ns, t0 + dt))
            time_ns[row] = last_ns
            row += 1
    return dt, last_ns


BY_PIECE, ENCLOSING_LINE, HALF_STEP, POINT_BY_POINT, KIRITSIS, CROSSINGS = range(6)
"""Algorithms; the first chooses one for each piece."""

SNAP = 1e-9
"""mm: a chunk that ends this near to the end of a piece ends with it."""
REST = 1e-6
"""mm/s: a chunk that ends no faster than this ends at rest."""

STATE = np.dtype(
    [
        ("whole_ns", np.int64),
        ("seconds", np.float64),
        ("last_ns", np.int64),
        ("released_ns", np.int64),
        ("error", np.float64),
        ("piece", np.int64),
        ("entered", np.int64),
        ("u", np.float64),
        ("width", np.float64),
        ("phase", np.int64),
        ("dt", np.float64),
    ]
)
"""State of a chunk. It begins at whole_ns + seconds. The last row is due at last_ns; the last row
that has left the buffers was due at released_ns. error: largest |grid point - path| so far, BLU.

Zero at the start of a chunk: the piece, whether it has been entered, the parameter reached in it,
and the width of its next window; the phase, and the time reached in it (s).
"""


@njit
def algorithm_for(kind: int, wanted: int) -> int:
    """Return the algorithm for a piece: the wanted one, but half steps for lines and arcs only."""
    if wanted in (BY_PIECE, HALF_STEP):
        return ENCLOSING_LINE if kind == SPAN else HALF_STEP
    return wanted


@njit
def rests(plan: PlanArrays, s: float) -> bool:
    """Return whether the motion comes to rest at the path coordinate s, to within SNAP."""
    k = np.searchsorted(plan.s, s - SNAP)
    at_rest = False
    while k < len(plan.s) and plan.s[k] <= s + SNAP:
        at_rest = at_rest or plan.v[k] <= REST
        k += 1
    return at_rest


@njit
def pulses(
    pieces: Pieces,
    plan: PlanArrays,
    source_line: Lines,
    algorithm: int,
    grid: Grid,
    state: NDArray[np.void],
    buffers: Buffers,
    filled: int,
    min_pulse_ns: float,
    min_row_ns: float,
) -> int:
    """Fill the buffers with the next grid moves of a plan chunk.

    The chunk is done when state[0]["piece"] is behind its last piece.

    Args:
        pieces: the pieces of the path.
        plan: the motion along them.
        source_line: (pieces,): source line of each piece.
        algorithm: one of the algorithms above.
        grid: the grid and its point, moved along.
        state: (1,) STATE, kept from call to call.
        buffers: the buffers.
        filled: number of rows that they hold.
        min_pulse_ns: an axis that steps back sooner after a step makes neither step.
        min_row_ns: rows come no faster.

    Returns:
        The number of rows in the buffers.
    """
    kind, at, data = pieces
    piece_s = plan.piece_s
    moves = buffers.moves
    now = state[0]
    here = np.empty((4, len(grid.point)))
    s_begin = plan.s[0]
    s_end = plan.s[-1]
    rows = filled
    index = now["piece"]
    full = False
    while index < len(kind) and not full:
        if piece_s[index + 1] <= s_begin:
            index += 1
            continue
        piece = Piece(kind[index], data, at[index], piece_s[index])
        u0, u1 = curve_range(piece.kind, data, piece.at)
        if now["entered"] == 0:
            now["u"] = u0
            if s_begin > piece.s0 + SNAP:
                now["u"] = curve_inv_arclen(piece.kind, data, piece.at, s_begin - piece.s0)
            now["entered"] = 1
            now["width"] = 0.0
        u = now["u"]
        upto = u1
        if s_end < piece_s[index + 1] - SNAP:
            upto = curve_inv_arclen(piece.kind, data, piece.at, s_end - piece.s0)
        how = algorithm_for(piece.kind, algorithm)
        before = rows
        error = 0.0
        if u >= upto:
            # nothing is left but the row that rounds
            u = upto
        elif how == HALF_STEP:
            rows, u, error = half_step_rows(piece, u, upto, grid, rows, moves)
        elif how == POINT_BY_POINT:
            rows, u, error = point_by_point_rows(piece, u, upto, grid, rows, moves)
        elif how == CROSSINGS:
            rows, u, error = crossing_rows(piece, u, upto, grid, rows, moves)
        else:
            rows, u, error, width = monotone_rows(
                how == KIRITSIS, piece, u, upto, now["width"], grid, rows, moves
            )
            now["width"] = width
        full = u < upto
        if u == u1 and rests(plan, piece_s[index + 1]):
            rows, _, error, done = round_to(piece, u, u, grid, here, error, rows, moves)
            full = not done
        now["error"] = max(now["error"], error)
        for row in range(before, rows):
            buffers.line[row] = source_line[index]
        now["u"] = u
        if not full:
            index += 1
            now["entered"] = 0
    now["piece"] = index
    _times(plan, state, filled, rows, moves.s, buffers.time_ns)
    rows = without_grazes(filled, rows, buffers, min_pulse_ns)
    return spaced(rows, now["released_ns"], buffers, min_row_ns)


@njit
def _times(
    plan: PlanArrays, state: NDArray[np.void], first: int, rows: int, s: Floats, time_ns: Ints
) -> None:
    """Write the times of the rows from ``first`` on, at the path coordinates s, into time_ns.

    No row is due before the one before it.
    """
    now = state[0]
    last = len(plan.j) - 1
    phase = now["phase"]
    last_ns = now["last_ns"]
    dt = now["dt"]
    row = first
    while row < rows:
        while phase < last and s[row] > plan.s[phase + 1]:
            phase += 1
            dt = 0.0
        behind = rows if phase == last else row
        while behind < rows and s[behind] <= plan.s[phase + 1]:
            behind += 1
        dt, last_ns = phase_times(
            plan, phase, now["whole_ns"], now["seconds"], dt, last_ns, row, behind, s, time_ns
        )
        row = behind
    now["phase"] = phase
    now["last_ns"] = last_ns
    now["dt"] = dt
