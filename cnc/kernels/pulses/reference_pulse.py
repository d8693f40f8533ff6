"""Reference pulses of a whole path: which algorithm makes the rows of each piece, and when they are
due.

A row is a grid move: the axes that step together, each by one BLU. Rows are made in three passes
over a buffer:

    piece by piece     which axes step, and at which path coordinate     one of the generators below, by the kind of piece
    phase by phase     when the motion is there                          :mod:`cnc.kernels.pulses.timing`
    row by row         what is too fast for the board                    :mod:`cnc.kernels.pulses.spacing`

Every generator has the shape of :func:`cnc.kernels.pulses.crossing_rows.crossing_rows`; the grid
point is what they hand on to each other.

Half steps (lines, arcs) and enclosing lines (curves) make a row where the path's fastest axis, the
leader, comes to its next grid line; the others round there and step with it or not:

      |     |     |   ,-o         At a row each axis is within half a BLU of the path. Between two rows the leader is up to a BLU behind,
      |     | ,o--|---|           any other up to a BLU and a half. The leader's steps are as even as the motion; those of another axis
      o-----|-'---|---|---- x     wait for it, so that two of them may be nearer to each other by one row than the axis's speed makes them.

Where the path goes on, a piece that ends off the grid leaves the grid point as it is, and the next
leader takes over; where the motion rests a last row rounds it to the end. Rows don't depend on how
a plan is cut.

By crossings, and point by point, each axis steps by itself where it is half-way to its next grid
point: more rows, no axis ever more than half a BLU off, and steps of every axis as even as the
motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import SPAN, Floats, Ints, curve_inv_arclen, curve_range
from cnc.kernels.pulses.catch_up import round_to
from cnc.kernels.pulses.crossing_rows import crossing_rows
from cnc.kernels.pulses.crossings import KEPT
from cnc.kernels.pulses.half_step import half_step_rows
from cnc.kernels.pulses.monotone import enclosing_line_rows, kiritsis_rows
from cnc.kernels.pulses.point_by_point import point_by_point_rows
from cnc.kernels.pulses.spacing import spaced, without_grazes
from cnc.kernels.pulses.timing import phase_times

BY_PIECE, ENCLOSING_LINE, HALF_STEP, POINT_BY_POINT, KIRITSIS, CROSSINGS = range(6)
"""Algorithms; the first is the choice of one for each piece."""

SNAP = 1e-9
"""mm: a chunk that ends this near to the end of a piece ends with it."""
REST = 1e-6
"""mm/s: a chunk that ends no faster than this ends at rest."""

PIECE, PHASE, LAST_NS, INSIDE, RELEASED_NS = range(5)
"""Integer state: piece and phase under way, time of the last row, whether the piece has been
entered, and the time of the last row that has left the buffers.
"""
INTEGERS = 5
U, DT, ERROR, SCRATCH = range(4)
"""Float state: parameter reached in the piece, time in its phase, largest |g - P| so far (BLU),
what the generator keeps of the piece.
"""
FLOATS = SCRATCH + KEPT


@njit
def algorithm_for(kind: int, wanted: int) -> int:
    """The algorithm for a piece: the one that is wanted, but half steps need a line or an arc."""
    if wanted in (BY_PIECE, HALF_STEP):
        return ENCLOSING_LINE if kind == SPAN else HALF_STEP
    return wanted


@njit
def rests(phase_s: Floats, phase_v: Floats, s: float) -> bool:
    """Whether the motion comes to rest at the path coordinate s, to within SNAP."""
    k = np.searchsorted(phase_s, s - SNAP)
    at_rest = False
    while k < len(phase_s) and phase_s[k] <= s + SNAP:
        at_rest = at_rest or phase_v[k] <= REST
        k += 1
    return at_rest


@njit
def pulses(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, source_line: NDArray[np.int32],
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats,
    whole_ns: int, seconds: float, algorithm: int, scale: Floats, grid: Ints, integers: Ints, floats: Floats,
    time_ns: Ints, step: NDArray[np.int8], line: NDArray[np.int32], reach: Floats, filled: int, recent: Ints, min_pulse_ns: float,
) -> int:  # fmt: skip
    """Fill the buffers with the next grid moves of a plan chunk; returns how many rows they hold.

    kind .. source_line: the path's pieces, phase_*: the motion over them, as in PlanChunk. The
    chunk begins at whole_ns + seconds. scale (n,): steps per mm. grid (n,): grid point, carried on.
    integers, floats: state, zeros at the start of a chunk but for LAST_NS, RELEASED_NS and ERROR,
    which go on; the chunk is done when integers[PIECE] is past its last piece. time_ns (rows,),
    step (rows, n), line (rows,): buffers, of which the first ``filled`` rows are taken; reach
    (rows,): scratch. recent (n,): row of each axis's last pulse, -1 if it is no longer there.
    min_pulse_ns: rows come no faster, and an axis that steps back sooner after a step makes
    neither.
    """
    here = np.empty((4, len(grid)))
    s_begin = phase_s[0]
    s_end = phase_s[-1]
    state = floats[SCRATCH:]
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
            floats[U] = curve_inv_arclen(k, data, a, s_begin - s0) if s_begin > s0 + SNAP else u0
            integers[INSIDE] = 1
            state[:] = 0.0
        u = floats[U]
        upto = u1
        if s_end < piece_s[piece + 1] - SNAP:
            upto = curve_inv_arclen(k, data, a, s_end - s0)
        how = algorithm_for(k, algorithm)
        before = rows
        error = 0.0
        if u >= upto:
            # all but the row that rounds
            u = upto
        elif how == HALF_STEP:
            rows, u, error = half_step_rows(
                k, data, a, u, upto, s0, scale, grid, state, rows, step, reach
            )
        elif how == ENCLOSING_LINE:
            rows, u, error = enclosing_line_rows(
                k, data, a, u, upto, s0, scale, grid, state, rows, step, reach
            )
        elif how == POINT_BY_POINT:
            rows, u, error = point_by_point_rows(
                k, data, a, u, upto, s0, scale, grid, state, rows, step, reach
            )
        elif how == KIRITSIS:
            rows, u, error = kiritsis_rows(
                k, data, a, u, upto, s0, scale, grid, state, rows, step, reach
            )
        else:
            rows, u, error = crossing_rows(
                k, data, a, u, upto, s0, scale, grid, state, rows, step, reach
            )
        full = u < upto
        if u == u1 and rests(phase_s, phase_v, piece_s[piece + 1]):
            rows, _, error, done = round_to(
                k, data, a, u, u, s0, scale, grid, here, error, rows, step, reach
            )
            full = not done
        floats[ERROR] = max(floats[ERROR], error)
        for row in range(before, rows):
            line[row] = source_line[piece]
        floats[U] = u
        if not full:
            piece += 1
            integers[INSIDE] = 0
    integers[PIECE] = piece
    _times(
        phase_t,
        phase_s,
        phase_v,
        phase_a,
        phase_j,
        whole_ns,
        seconds,
        integers,
        floats,
        filled,
        rows,
        reach,
        time_ns,
    )
    rows = without_grazes(filled, rows, time_ns, step, line, recent, min_pulse_ns)
    return spaced(rows, integers[RELEASED_NS], time_ns, step, line, recent, min_pulse_ns)


@njit
def _times(
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats, whole_ns: int, seconds: float, integers: Ints,
    floats: Floats, first: int, rows: int, reach: Floats, time_ns: Ints,
) -> None:  # fmt: skip
    """When the rows from ``first`` on are due: at the arc lengths in ``reach``, and none before the
    one before it.
    """
    last = len(phase_j) - 1
    phase = integers[PHASE]
    last_ns = integers[LAST_NS]
    dt = floats[DT]
    row = first
    while row < rows:
        while phase < last and reach[row] > phase_s[phase + 1]:
            phase += 1
            dt = 0.0
        behind = rows if phase == last else row
        while behind < rows and reach[behind] <= phase_s[phase + 1]:
            behind += 1
        dt, last_ns = phase_times(
            seconds + phase_t[phase], phase_s[phase], phase_v[phase], phase_a[phase], phase_j[phase], phase_t[phase + 1] - phase_t[phase],
            dt, whole_ns, last_ns, row, behind, reach, time_ns,
        )  # fmt: skip
        row = behind
    integers[PHASE] = phase
    integers[LAST_NS] = last_ns
    floats[DT] = dt
