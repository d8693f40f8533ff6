"""Maxima of a plan from differences of its positions at the sampling period."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.bspline import MAX_DEGREE
from cnc.kernels.path.curve import (
    METRIC,
    METRICS,
    SPAN,
    SPAN_BODY,
    START,
    U0,
    U1,
    curve_eval,
    is_plain_quintic,
)
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.audit import (
    CHORD_ERROR,
    CLOSE,
    POINTS,
    STEP_DEVIATION,
    Largest,
    next_piece,
)
from cnc.kernels.planner.hull import BOUNDS, derivative_bounds
from cnc.kernels.planner.phases import phase_at
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.timed import is_timed

Floats = NDArray[np.float64]


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
def raise_by_differences(last: Floats, known: int, period: float, largest: Largest) -> None:
    """Raise the maxima of the axes to the differences of the last positions.

    Args:
        last: (5, axes): the new position in row 4, those before in rows 0 to 2.
        known: number of valid positions before.
        period: s.
        largest: the maxima.
    """
    per_v = 1.0 / period
    per_a = per_v * per_v
    per_j = per_a * per_v
    for i in range(len(largest.axis_v)):
        v = last[4, i] - last[0, i]
        a = v - (last[0, i] - last[1, i])
        j = a - (last[0, i] - 2.0 * last[1, i] + last[2, i])
        if known > 0:
            largest.axis_v[i] = max(largest.axis_v[i], abs(v) * per_v)
        if known > 1:
            largest.axis_a[i] = max(largest.axis_a[i], abs(a) * per_a)
        if known > 2:
            largest.axis_j[i] = max(largest.axis_j[i], abs(j) * per_j)


@njit
def chord_of(pieces: Pieces, piece: int, last: Floats) -> float:
    """Return the distance of rows 0 and 4 of ``last`` along the axes that measure a piece, mm."""
    data, at = pieces.data, pieces.at[piece]
    squared = 0.0
    for m in range(int(data[at + METRICS])):
        c = int(data[at + METRIC + m])
        squared += (last[4, c] - last[0, c]) * (last[4, c] - last[0, c])
    return math.sqrt(squared)


@njit
def some_timed(pieces: Pieces, first: int, last: int) -> bool:
    """Return whether one of the pieces first .. last is timed."""
    found = False
    for k in range(first, last + 1):
        found = found or is_timed(pieces.kind[k], pieces.data, pieces.at[k])
    return found


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
def audit_samples(
    pieces: Pieces,
    plan: PlanArrays,
    t0: float,
    period: float,
    shortest: float,
    index: int,
    known: int,
    last: Floats,
    largest: Largest,
) -> tuple[int, int]:
    """Raise the maxima to those that differences of positions show.

    The positions are those at the instants ``index * period`` and later, up to the plan's end. The
    step deviation and the chord error count in steps longer than ``shortest`` in which the motion
    does not stop. A shorter step is too short to measure. A stop is a corner, and a sample there
    belongs to neither side; so the step deviation does not count in an overlap either.

    Args:
        pieces: the path of the motion.
        plan: its phases.
        t0: time at its start, s.
        period: s.
        shortest: mm.
        index: number of the first instant.
        known: number of valid positions in ``last``.
        last: (5, axes): positions at the instants before, the newest in row 0; rows 3 and 4 are
            scratch.
        largest: the maxima.

    Returns:
        The next index and the new ``known``.
    """
    kind, data, piece_s = pieces.kind, pieces.data, plan.piece_s
    along, n = largest.along, len(largest.axis_v)
    q = np.zeros((4, n))
    weight = np.zeros(MAX_DEGREE + 1)
    bounds = np.zeros((n + 1, BOUNDS))
    bent = math.inf
    bounded = -1
    piece = 0
    phase = 0
    s_before = -1.0
    piece_before = 0
    end = t0 + plan.t[-1]
    while index * period <= end:
        t = max(index * period - t0, 0.0)
        stopped = False
        while phase + 1 < len(plan.j) and t > plan.t[phase + 1]:
            phase += 1
            stopped = stopped or plan.v[phase] == 0.0
        v, a, j = plan.v[phase], plan.a[phase], plan.j[phase]
        s = phase_at(t - plan.t[phase], plan.s[phase], v, a, j)[0]
        piece = next_piece(piece, s, piece_s)
        local = min(max(s - piece_s[piece], 0.0), piece_s[piece + 1] - piece_s[piece])
        here = kind[piece]
        where = pieces.at[piece]
        u = curve_inv_arclen(here, data, where, local)
        if here == SPAN:
            span_point(data, where, u, weight, last)
        else:
            curve_eval(here, data, where, u, q)
            for i in range(n):
                last[4, i] = q[0, i]
        raise_by_differences(last, known, period, largest)
        if s_before >= 0.0 and not stopped and s - s_before > shortest:
            if piece != bounded:
                bounded = piece
                derivative_bounds(here, data, where, bounds)
                bent = bounds[n, 1] / 8.0
            step = s - s_before
            if piece == piece_before and step * step * bent <= along[CHORD_ERROR]:
                # The chord alone: the curve is nearer to it than the chord error so far.
                chord = chord_of(pieces, piece, last)
                along[STEP_DEVIATION] = max(along[STEP_DEVIATION], abs(chord - step) / step)
            else:
                chord, apart = _step_and_sagitta(
                    pieces, piece_s, piece_before, piece, s_before, s, last, q
                )
                if not some_timed(pieces, piece_before, piece):
                    along[STEP_DEVIATION] = max(along[STEP_DEVIATION], abs(chord - step) / step)
                along[CHORD_ERROR] = max(along[CHORD_ERROR], apart)
        for i in range(n):
            last[2, i] = last[1, i]
            last[1, i] = last[0, i]
            last[0, i] = last[4, i]
        s_before = s
        piece_before = piece
        known = min(known + 1, 3)
        index += 1
        steady = a == 0.0 and j == 0.0 and v > 0.0 and not is_timed(here, data, where)
        if known == 3 and steady:
            skipped = instants_to_skip(v, plan.t[phase + 1] + t0 - index * period, period)
            if skipped > 0:
                index += skipped
                known = 0
                s_before = -1.0
    return index, known
