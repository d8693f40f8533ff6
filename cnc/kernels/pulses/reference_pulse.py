"""Reference pulses of a whole path: the algorithm for each piece, and the time of each grid move.

A row of the buffers is a grid move: the axes that step together, each by one BLU. Rows are made in
three passes over the buffers:

    piece by piece   axes that step, and path coordinate   a generator, by the kind of piece
    phase by phase   time of that path coordinate          :mod:`cnc.kernels.pulses.timing`
    row by row       limits of the board's step rate       :mod:`cnc.kernels.pulses.spacing`

Every generator takes and returns the same as :func:`cnc.kernels.pulses.crossings.crossing_rows`.
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

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.curve import SPAN, Floats, Ints, curve_range
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.pulses.catch_up import round_to
from cnc.kernels.pulses.crossings import crossing_rows
from cnc.kernels.pulses.grid_moves import Grid, Lines, Piece
from cnc.kernels.pulses.half_step import half_step_rows
from cnc.kernels.pulses.monotone import monotone_rows
from cnc.kernels.pulses.point_by_point import point_by_point_rows
from cnc.kernels.pulses.spacing import Buffers, spaced, without_grazes
from cnc.kernels.pulses.timing import phase_times

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
