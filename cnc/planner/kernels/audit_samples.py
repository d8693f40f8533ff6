"""Maxima of a plan from differences of its positions at the sampling period."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.bspline import MAX_DEGREE
from cnc.path.kernels.curve import (
    LENGTH,
    METRIC,
    METRICS,
    ROW,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Pieces,
    curve_eval,
    is_plain_quintic,
)
from cnc.planner.kernels.arrays import PlanArrays, phase_at
from cnc.planner.kernels.audit import (
    BOUNDS,
    CHORD_ERROR,
    CLOSE,
    POINTS,
    STEP_DEVIATION,
    Largest,
    derivative_bounds,
    next_piece,
)
from cnc.planner.kernels.timed import is_timed

Floats = NDArray[np.float64]

# Positions of a plan at many instants, for the audit.

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

KEPT = 3
"""Positions before an instant that its differences take."""
INSTANTS = 256
"""Most instants that are examined together."""


class Run(NamedTuple):
    """Instants that follow each other. Entry 0 is the instant before them.

    Attributes:
        s: (INSTANTS + 1,): arc length, mm; entry 0 is negative where there is none before.
        piece: (INSTANTS + 1,): the piece.
        stopped: (INSTANTS + 1,): whether the motion has stopped since the instant before.
        position: (axes, KEPT + INSTANTS): positions, those of KEPT instants before included, mm.
        timed: (pieces,): whether a piece is timed.
        bounds: (axes + 1, BOUNDS): scratch, like the others.
        weight: see bounds.
        q: (4, axes): see bounds.
        last: (5, axes): see bounds.
    """

    s: Floats
    piece: Ints
    stopped: Flags
    position: Floats
    timed: Flags
    bounds: Floats
    weight: Floats
    q: Floats
    last: Floats


@njit
def span_point(data: Floats, at: int, u: float, weight: Floats, out: Floats) -> None:
    """Write the position at ``u`` of a span to the last row of ``out``.

    It computes no derivatives, which would take most of the time.

    Args:
        data: the records.
        at: index of the record of the span.
        u: its parameter.
        weight: (degree + 1,): scratch for the Bernstein polynomials.
        out: (rows, axes).
    """
    n = out.shape[1]
    start = at + START
    k = start + 2 * n
    p = int(data[k])
    k += SPAN_BODY
    x = (u - data[at + U0]) / (data[at + U1] - data[at + U0])
    y = 1.0 - x
    row = out.shape[0] - 1
    if is_plain_quintic(data, at):
        xx, yy = x * x, y * y
        w0, w1, w2 = y * yy * yy, 5.0 * x * yy * yy, 10.0 * xx * y * yy
        w3, w4, w5 = 10.0 * x * xx * yy, 5.0 * xx * xx * y, x * xx * xx
        for i in range(n):
            k += p + 1
            low = w0 * data[k] + w1 * data[k + 1] + w2 * data[k + 2]
            high = w3 * data[k + 3] + w4 * data[k + 4] + w5 * data[k + 5]
            out[row, i] = data[start + i] + (low + high)
        return
    # C(p, m) x^m from one end, times y^(p - m) from the other: no step loses digits.
    rising = 1.0
    for m in range(p + 1):
        weight[m] = rising
        rising *= x * (p - m) / (m + 1)
    falling = 1.0
    divisor = 0.0
    for m in range(p, -1, -1):
        weight[m] *= falling
        falling *= y
        divisor += weight[m] * data[k + m]
    inverse = 1.0 / divisor
    for i in range(n):
        k += p + 1
        total = 0.0
        for m in range(p + 1):
            total += weight[m] * data[k + m]
        out[row, i] = data[start + i] + total * inverse


@njit
def _quintic_positions(data: Floats, at: int, s0: float, first: int, last: int, run: Run) -> None:
    """Write the positions at the instants first .. last - 1 of a span that is_plain_quintic.

    The row of the table of the arc length is that of the instant before, or near it. ``s0``: arc
    length at the start of the span, mm.
    """
    s, position = run.s, run.position
    n = position.shape[0]
    start = at + START
    body = start + 2 * n + SPAN_BODY
    u0, u1, length = data[at + U0], data[at + U1], data[at + LENGTH]
    table = at + int(data[at + TABLE])
    bottom = table + 1
    top = bottom + (int(data[table]) - 1) * ROW
    r = bottom
    per_row = 1.0 / (data[r + ROW] - data[r])
    for k in range(first, last):
        local = min(max(s[k] - s0, 0.0), length)
        if (r < top and local >= data[r + ROW]) or (r > bottom and local < data[r]):
            while r < top and local >= data[r + ROW]:
                r += ROW
            while r > bottom and local < data[r]:
                r -= ROW
            per_row = 1.0 / (data[r + ROW] - data[r])
        x = (local - data[r]) * per_row
        xx = x * x
        low = data[r + 2] + data[r + 3] * x + (data[r + 4] + data[r + 5] * x) * xx
        high = data[r + 6] + data[r + 7] * x + data[r + 8] * xx
        u = min(max(data[r + 1] + (low + high * (xx * xx)) * x, data[r + 1]), data[r + ROW + 1])
        x = (u - u0) / (u1 - u0) if local < length else 1.0
        y = 1.0 - x
        xx, yy = x * x, y * y
        w0, w1, w2 = y * yy * yy, 5.0 * x * yy * yy, 10.0 * xx * y * yy
        w3, w4, w5 = 10.0 * x * xx * yy, 5.0 * xx * xx * y, x * xx * xx
        c = body
        for i in range(n):
            c += 6
            low = w0 * data[c] + w1 * data[c + 1] + w2 * data[c + 2]
            high = w3 * data[c + 3] + w4 * data[c + 4] + w5 * data[c + 5]
            position[i, KEPT - 1 + k] = data[start + i] + (low + high)


@njit
def write_positions(pieces: Pieces, piece_s: Floats, count: int, run: Run) -> None:
    """Write the positions of ``count`` instants, whose arc lengths and pieces are known."""
    data, position, weight, q = pieces.data, run.position, run.weight, run.q
    first = 1
    while first <= count:
        piece = run.piece[first]
        last = first + 1
        while last <= count and run.piece[last] == piece:
            last += 1
        kind, at = pieces.kind[piece], pieces.at[piece]
        s0, length = piece_s[piece], piece_s[piece + 1] - piece_s[piece]
        if kind == SPAN and data[at + TABLE] != 0.0 and is_plain_quintic(data, at):
            _quintic_positions(data, at, s0, first, last, run)
        else:
            for k in range(first, last):
                local = min(max(run.s[k] - s0, 0.0), length)
                u = curve_inv_arclen(kind, data, at, local)
                if kind == SPAN:
                    span_point(data, at, u, weight, q)
                else:
                    curve_eval(kind, data, at, u, q)
                row = q.shape[0] - 1 if kind == SPAN else 0
                for i in range(position.shape[0]):
                    position[i, KEPT - 1 + k] = q[row, i]
        first = last


@njit
def _step_and_sagitta(
    pieces: Pieces,
    piece_s: Floats,
    first: int,
    piece: int,
    s_before: float,
    s: float,
    last: Floats,
    q: Floats,
) -> tuple[float, float]:
    """Return the length of a step through junctions, and the distance of the curve from its chord.

    Args:
        pieces: the path.
        piece_s: arc lengths at the ends of the pieces, mm.
        first: the piece in which the step starts.
        piece: the piece in which it ends.
        s_before: arc length at its start, mm.
        s: arc length at its end, mm.
        last: (5, axes): the positions there in rows 0 and 4; row 3 is scratch.
        q: (4, axes): scratch.
    """
    kind, data, at = pieces.kind, pieces.data, pieces.at
    length = 0.0
    apart = 0.0
    chord = 0.0
    for m in range(int(data[at[piece] + METRICS])):
        c = int(data[at[piece] + METRIC + m])
        chord += (last[4, c] - last[0, c]) ** 2
        last[3, c] = last[0, c]
    for k in range(first, piece + 1):
        # In the middle of the step's part on this piece, then at the piece's end.
        begin = max(s_before, piece_s[k])
        end = min(s, piece_s[k + 1])
        for half in range(2):
            inside = 0.5 * (begin + end) if half == 0 else end
            curve_eval(
                kind[k], data, at[k], curve_inv_arclen(kind[k], data, at[k], inside - piece_s[k]), q
            )
            along = 0.0
            squared = 0.0
            step = 0.0
            for m in range(int(data[at[k] + METRICS])):
                c = int(data[at[k] + METRIC + m])
                along += (q[0, c] - last[0, c]) * (last[4, c] - last[0, c])
                squared += (q[0, c] - last[0, c]) ** 2
                step += (q[0, c] - last[3, c]) ** 2
            if chord > 0.0:
                squared -= along * along / chord
            apart = max(apart, squared)
            if half == 1:
                length += math.sqrt(step)
                for m in range(int(data[at[k] + METRICS])):
                    c = int(data[at[k] + METRIC + m])
                    last[3, c] = q[0, c]
    return length, math.sqrt(apart)


@njit
def _raise_by_differences(
    position: Floats, kept: int, count: int, period: float, largest: Largest
) -> None:
    """Raise the maxima of the axes to the differences of positions.

    Args:
        position: (axes, KEPT + count): those at three instants before, then the new ones.
        kept: number of valid positions before.
        count: number of new positions.
        period: s.
        largest: the maxima.
    """
    per_v = 1.0 / period
    per_a = per_v * per_v
    per_j = per_a * per_v
    for i in range(len(largest.axis_v)):
        here = position[i, KEPT - 1]
        v_before = here - position[i, KEPT - 2]
        a_before = v_before - (position[i, KEPT - 2] - position[i, KEPT - 3])
        v_most, a_most, j_most = 0.0, 0.0, 0.0
        for k in range(count):
            v = position[i, KEPT + k] - here
            a = v - v_before
            j = a - a_before
            if kept + k >= KEPT:
                v_most, a_most, j_most = (
                    max(v_most, abs(v)),
                    max(a_most, abs(a)),
                    max(j_most, abs(j)),
                )
            else:
                v_most = max(v_most, abs(v)) if kept + k > 0 else v_most
                a_most = max(a_most, abs(a)) if kept + k > 1 else a_most
            here, v_before, a_before = position[i, KEPT + k], v, a
        largest.axis_v[i] = max(largest.axis_v[i], v_most * per_v)
        largest.axis_a[i] = max(largest.axis_a[i], a_most * per_a)
        largest.axis_j[i] = max(largest.axis_j[i], j_most * per_j)


@njit
def some_timed(pieces: Pieces, first: int, last: int) -> bool:
    """Return whether one of the pieces first .. last is timed."""
    timed = False
    for k in range(first, last + 1):
        timed = timed or is_timed(pieces.kind[k], pieces.data, pieces.at[k])
    return timed


@njit
def instants_to_skip(v: float, left: float, period: float) -> int:
    """Return how many instants of a steady motion need no sample; 0 or less for none.

    Slow steady motion has the same differences for long: a few instants are enough, up to where the
    path may have changed.

    Args:
        v: speed, mm/s.
        left: time that the motion stays steady, s.
        period: s.
    """
    return min(int(CLOSE / (v * period)), int(left / period)) - 2 * POINTS


@njit
def _instants(
    plan: PlanArrays, t0: float, period: float, index: int, kept: int, phase: int, run: Run
) -> tuple[int, int, int]:
    """Write arc length and piece at the next instants; the entries are those of :class:`Run`.

    Returns:
        The number of instants, the phase of the last one, and the number of instants behind it that
        need no sample.
    """
    piece_s, last_phase = plan.piece_s, len(plan.j) - 1
    end = t0 + plan.t[last_phase + 1]
    piece = run.piece[0]
    count, skipped = 0, 0
    while count < INSTANTS and skipped <= 0 and (index + count) * period <= end:
        t = max((index + count) * period - t0, 0.0)
        stopped = False
        while phase < last_phase and t > plan.t[phase + 1]:
            phase += 1
            stopped = stopped or plan.v[phase] == 0.0
        v, a, j = plan.v[phase], plan.a[phase], plan.j[phase]
        s = phase_at(t - plan.t[phase], plan.s[phase], v, a, j)[0]
        piece = next_piece(piece, s, piece_s)
        count += 1
        run.s[count], run.piece[count], run.stopped[count] = s, piece, stopped
        if a == 0.0 and j == 0.0 and v > 0.0 and kept + count >= KEPT and not run.timed[piece]:
            left = plan.t[phase + 1] + t0 - (index + count) * period
            skipped = instants_to_skip(v, left, period)
    return count, phase, max(skipped, 0)


@njit
def _raise_by_steps(
    pieces: Pieces, piece_s: Floats, shortest: float, count: int, run: Run, largest: Largest
) -> None:
    """Raise step deviation and chord error to those of the steps that end at ``count`` instants.

    A step counts as in :func:`audit_samples`.
    """
    data, along, position, bounds = pieces.data, largest.along, run.position, run.bounds
    n = position.shape[0]
    bounded = -1
    bent, at = math.inf, 0
    for k in range(1, count + 1):
        step = run.s[k] - run.s[k - 1]
        if run.s[k - 1] < 0.0 or run.stopped[k] or step <= shortest:
            continue
        piece, before = run.piece[k], run.piece[k - 1]
        if piece != bounded:
            bounded, at = piece, pieces.at[piece]
            derivative_bounds(pieces.kind[piece], data, at, bounds)
            bent = bounds[n, 1] / 8.0
        if piece == before and step * step * bent <= along[CHORD_ERROR]:
            # The chord alone: the curve is nearer to it than the chord error so far.
            squared = 0.0
            for m in range(int(data[at + METRICS])):
                c = int(data[at + METRIC + m])
                off = position[c, KEPT - 1 + k] - position[c, KEPT - 2 + k]
                squared += off * off
            apart = 0.0
            timed = False
        else:
            for i in range(n):
                run.last[0, i] = position[i, KEPT - 2 + k]
                run.last[4, i] = position[i, KEPT - 1 + k]
            chord, apart = _step_and_sagitta(
                pieces, piece_s, before, piece, run.s[k - 1], run.s[k], run.last, run.q
            )
            squared = chord * chord
            timed = some_timed(pieces, before, piece)
        # Most steps deviate less than one before: that takes no root.
        least = max(1.0 - along[STEP_DEVIATION], 0.0) * step
        most = (1.0 + along[STEP_DEVIATION]) * step
        if not (timed or least * least <= squared <= most * most):
            off = abs(math.sqrt(squared) - step)
            along[STEP_DEVIATION] = max(along[STEP_DEVIATION], off / step)
        along[CHORD_ERROR] = max(along[CHORD_ERROR], apart)


@njit
def audit_samples(
    pieces: Pieces,
    plan: PlanArrays,
    t0: float,
    period: float,
    shortest: float,
    index: int,
    kept: int,
    last: Floats,
    largest: Largest,
) -> tuple[int, int]:
    """Raise the maxima to those that differences of positions show.

    The positions are those at the instants ``index * period`` and later, up to the plan's end. The
    step deviation and the chord error count in steps longer than ``shortest`` in which the motion
    does not stop. A shorter step is too short to measure. A stop is a corner, and a sample there
    belongs to neither side; so the step deviation does not count in timed pieces either.

    Args:
        pieces: the path of the motion.
        plan: its phases.
        t0: time at its start, s.
        period: s.
        shortest: mm.
        index: number of the first instant.
        kept: number of valid positions in ``last``.
        last: (5, axes): positions at the instants before, the newest in row 0; rows 3 and 4 are
            scratch.
        largest: the maxima.

    Returns:
        The next index and the new ``kept``.
    """
    n = len(largest.axis_v)
    run = Run(
        np.zeros(INSTANTS + 1),
        np.zeros(INSTANTS + 1, np.int64),
        np.zeros(INSTANTS + 1, np.bool_),
        np.zeros((n, KEPT + INSTANTS)),
        np.zeros(len(pieces.kind), np.bool_),
        np.zeros((n + 1, BOUNDS)),
        np.zeros(MAX_DEGREE + 1),
        np.zeros((4, n)),
        last,
    )
    for k in range(len(pieces.kind)):
        run.timed[k] = is_timed(pieces.kind[k], pieces.data, pieces.at[k])
    position = run.position
    for i in range(n):
        for k in range(KEPT):
            position[i, k] = last[KEPT - 1 - k, i]
    run.s[0] = -1.0
    phase = 0
    end = t0 + plan.t[-1]
    while index * period <= end:
        count, phase, skipped = _instants(plan, t0, period, index, kept, phase, run)
        write_positions(pieces, plan.piece_s, count, run)
        _raise_by_differences(position, kept, count, period, largest)
        _raise_by_steps(pieces, plan.piece_s, shortest, count, run, largest)
        for i in range(n):
            for k in range(KEPT):
                position[i, k] = position[i, count + k]
        index += count + skipped
        kept = 0 if skipped > 0 else min(kept + count, KEPT)
        run.s[0] = -1.0 if skipped > 0 else run.s[count]
        run.piece[0] = run.piece[count]
    for i in range(n):
        for k in range(KEPT):
            last[KEPT - 1 - k, i] = position[i, k]
    return index, kept
