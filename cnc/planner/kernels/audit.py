"""Largest values that a plan reaches, for comparison with the limits.

They come from two sources; neither shares a formula with the planner:

- velocity, acceleration and jerk of each axis by the chain rule, from the curve and the phase, at
  points throughout every phase;
- differences of successive positions at the sampling period, which show jumps at junctions too
  (:mod:`cnc.planner.kernels.audit_samples`).

The hull of a piece's control points bounds its derivatives. Where these bounds cannot raise any
maximum, the inside of the piece is skipped; the maxima are the same. Positions are sampled
everywhere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import (
    AXES,
    LINE,
    METRIC,
    METRICS,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
    Pieces,
    curve_eval_s,
)
from cnc.planner.kernels.arrays import PlanArrays, phase_at
from cnc.planner.kernels.timed import is_timed, slowest_between, speeding_up, timed_motion

# Bounds of a piece's derivatives by arc length, from the hull of its control points.
#
# The derivatives by t of a polynomial span are polynomials in Bernstein form. Their coefficients
# are differences of its own, and their values lie in the hull of these. With e the direction of the
# chord, sigma = |dr/dt| >= (dr/dt).e >= m, the least of the first differences along e. By the chain
# rule (see :func:`cnc.path.kernels.curve.curve_eval_s`), with D1, D2, D3 the largest of an axis's
# derivatives by t and N2, N3 those of all metric axes,
#
#     |q'|   <= D1 / m
#     |q''|  <= D2 / m^2 + D1 N2 / m^3
#     |q'''| <= D3 / m^3 + 3 D2 N2 / m^4 + D1 (3 N2^2 / m^5 + N3 / m^4)
#
# for u' = 1 / sigma, |u''| <= N2 / sigma^3,
# |u'''| = |4 sigma'^2 - |r''|^2 - r'.r'''| / sigma^5 and |sigma'| <= |r''|. The curvature is at
# most N2 / m^2. All of them are sharp on a span that bends little.

BOUNDS = 3
"""Columns: bounds of the first, second and third derivative."""


@njit
def derivative_bounds(kind: int, data: Floats, at: int, out: Floats) -> None:
    """Compute bounds of the derivatives by arc length on a piece.

    They are sharp for lines, finite for polynomial spans that turn less than 90 degrees, and
    infinite for everything else.

    Args:
        kind: the kind of the piece.
        data: the records.
        at: index of the record of the piece.
        out: (n + 1, BOUNDS): receives bounds of |q'|, |q''| and |q'''| of each of the n axes. The
            last row receives those of |q'| and |q''| of all metric axes together.
    """
    n = out.shape[0] - 1
    for i in range(n + 1):
        for k in range(BOUNDS):
            out[i, k] = math.inf
    if kind == LINE:
        start = at + START
        end = start + n
        per_u = 1.0 / (data[at + U1] - data[at + U0])
        for i in range(n):
            out[i, 0] = abs((data[end + i] - data[start + i]) * per_u)
            out[i, 1] = 0.0
            out[i, 2] = 0.0
        out[n, 0] = 1.0
        out[n, 1] = 0.0
        out[n, 2] = 0.0
    elif kind == SPAN and data[at + TABLE] != 0.0:
        span_bounds(data, at, out)


@njit
def span_bounds(data: Floats, at: int, out: Floats) -> None:
    """Compute the bounds of a span: the arguments of :func:`derivative_bounds`."""
    n = out.shape[0] - 1
    start = at + START
    end = start + n
    p = int(data[end + n])
    weight = end + n + SPAN_BODY
    polynomial = True
    for k in range(1, p + 1):
        polynomial = polynomial and data[weight + k] == data[weight]
    metrics = int(data[at + METRICS])
    chord = 0.0
    for m in range(metrics):
        c = int(data[at + METRIC + m])
        chord += (data[end + c] - data[start + c]) ** 2
    chord = math.sqrt(chord)
    least = math.inf
    n2 = 0.0
    n3 = 0.0
    for k in range(p):
        along = 0.0
        second = 0.0
        third = 0.0
        for m in range(metrics):
            c = int(data[at + METRIC + m])
            i = weight + (c + 1) * (p + 1) + k
            along += (data[i + 1] - data[i]) * (data[end + c] - data[start + c])
            if k < p - 1:
                second += (data[i + 2] - 2.0 * data[i + 1] + data[i]) ** 2
            if k < p - 2:
                third += (data[i + 3] - 3.0 * (data[i + 2] - data[i + 1]) - data[i]) ** 2
        least = min(least, along)
        n2 = max(n2, second)
        n3 = max(n3, third)
    least *= p
    if not (polynomial and least > 0.0):
        return
    unit = 1.0 / data[weight]
    m1 = chord / (least * unit)
    m2 = m1 * m1
    m3 = m2 * m1
    n2 = math.sqrt(n2) * p * (p - 1) * unit
    n3 = math.sqrt(n3) * p * (p - 1) * (p - 2) * unit
    for axis in range(n):
        d1 = 0.0
        d2 = 0.0
        d3 = 0.0
        row = weight + (axis + 1) * (p + 1)
        for k in range(p):
            i = row + k
            d1 = max(d1, abs(data[i + 1] - data[i]))
            if k < p - 1:
                d2 = max(d2, abs(data[i + 2] - 2.0 * data[i + 1] + data[i]))
            if k < p - 2:
                d3 = max(d3, abs(data[i + 3] - 3.0 * (data[i + 2] - data[i + 1]) - data[i]))
        d1 *= p * unit
        d2 *= p * (p - 1) * unit
        d3 *= p * (p - 1) * (p - 2) * unit
        out[axis, 0] = d1 * m1
        out[axis, 1] = d2 * m2 + d1 * n2 * m3
        out[axis, 2] = (
            d3 * m3 + 3.0 * d2 * n2 * m2 * m2 + d1 * (3.0 * n2 * n2 * m3 * m2 + n3 * m2 * m2)
        )
    out[n, 0] = 1.0
    out[n, 1] = n2 * m2


FEED, ACCEL, JERK, NORMAL_ACCEL, CHORD_ERROR, STEP_DEVIATION, OVERSPEED = range(7)
"""Entries of ``Largest.along``. OVERSPEED is the largest ratio of the speed to the feed that the
piece may have.
"""
ENTRIES = 7

POSITION_GAP, SPEED_GAP, ACCEL_GAP, TIME_GAP, STANDSTILL_GAP = range(5)
"""Entries of the gaps that :func:`continuity` finds."""
GAPS = 5

POINTS = 8
"""Least number of points examined in a phase."""

TIMED_POINTS = 64
"""The same in a timed piece, where the jerk along the path may have a sharp peak. The place between
two of them at which the speed is least is examined too: there the peak may be narrower still.
"""

CLOSE = 1e-3
"""mm; motion that covers less than this in many periods is examined at this distance instead."""

JOINT = 1e-9
"""mm; a phase that starts or ends this near to a junction starts or ends at it. This is more than
the rounding error of the arc lengths in a window of many metres, and too short to matter.
"""


class Largest(NamedTuple):
    """The largest values so far.

    Attributes:
        along: (ENTRIES,): values along the path.
        axis_v: (axes,): speed of each axis, mm/s.
        axis_a: (axes,): acceleration, mm/s^2.
        axis_j: (axes,): jerk, mm/s^3.
    """

    along: Floats
    axis_v: Floats
    axis_a: Floats
    axis_j: Floats


@njit
def next_piece(piece: int, s: float, piece_s: Floats) -> int:
    """Return the piece that contains arc length ``s``, searched forward from ``piece``."""
    while piece + 2 < len(piece_s) and s > piece_s[piece + 1]:
        piece += 1
    return piece


@njit
def cannot_raise(
    v: float, a: float, j: float, feed: float, bounds: Floats, largest: Largest
) -> bool:
    """Return whether a phase cannot raise any maximum on a piece.

    Args:
        v: largest speed of the phase.
        a: its largest acceleration, >= 0.
        j: its largest jerk, >= 0.
        feed: largest feed of the piece, mm/s.
        bounds: of the derivatives of the piece.
        largest: the maxima.
    """
    n = len(largest.axis_v)
    along = largest.along
    result = (
        v <= along[FEED]
        and a <= along[ACCEL]
        and j <= along[JERK]
        and v / feed <= along[OVERSPEED]
        and bounds[n, 1] * v * v <= along[NORMAL_ACCEL]
    )
    for i in range(n):
        d1 = bounds[i, 0]
        d2 = bounds[i, 1] * v
        d3 = bounds[i, 2] * v * v
        result = (
            result
            and d1 * v <= largest.axis_v[i]
            and d2 * v + d1 * a <= largest.axis_a[i]
            and d3 * v + 3.0 * d2 * a + d1 * j <= largest.axis_j[i]
        )
    return result


@njit
def raise_maxima(
    pieces: Pieces,
    piece: int,
    q: Floats,
    v: float,
    a: float,
    j: float,
    feed: float,
    largest: Largest,
) -> None:
    """Raise the maxima to the values at one point of a piece.

    Args:
        pieces: the path.
        piece: the index of the piece.
        q: (4, axes): its derivatives there.
        v: speed along it, mm/s.
        a: acceleration along it.
        j: jerk along it.
        feed: its largest feed, mm/s.
        largest: the maxima.
    """
    kind, data, at = pieces.kind[piece], pieces.data, pieces.at[piece]
    along = largest.along
    if is_timed(kind, data, at):
        speed, tangential, change, normal = timed_motion(data, at, q, v, a, j)
    else:
        squared = 0.0
        for i in range(int(data[at + METRICS])):
            squared += q[2, int(data[at + METRIC + i])] ** 2
        speed, tangential, change, normal = v, a, j, v * v * math.sqrt(squared)
    along[FEED] = max(along[FEED], speed)
    along[ACCEL] = max(along[ACCEL], abs(tangential))
    along[JERK] = max(along[JERK], abs(change))
    along[OVERSPEED] = max(along[OVERSPEED], speed / feed)
    along[NORMAL_ACCEL] = max(along[NORMAL_ACCEL], normal)
    for i in range(q.shape[1]):
        largest.axis_v[i] = max(largest.axis_v[i], abs(q[1, i] * v))
        largest.axis_a[i] = max(largest.axis_a[i], abs(q[2, i] * v * v + q[1, i] * a))
        largest.axis_j[i] = max(
            largest.axis_j[i], abs(q[3, i] * v * v * v + 3.0 * q[2, i] * v * a + q[1, i] * j)
        )


@njit
def audit_phases(
    pieces: Pieces, plan: PlanArrays, feed: Floats, period: float, largest: Largest
) -> None:
    """Raise the maxima to the values that the plan reaches at points throughout its phases.

    Args:
        pieces: the path of the motion.
        plan: its phases.
        feed: (pieces,): largest feed of each, mm/s.
        period: s.
        largest: the maxima.
    """
    kind, data, piece_s = pieces.kind, pieces.data, plan.piece_s
    n = len(largest.axis_v)
    q = np.zeros((4, n))
    bounds = np.zeros((n + 1, BOUNDS))
    piece = 0
    bounded = -1
    for k in range(len(plan.j)):
        duration = plan.t[k + 1] - plan.t[k]
        s0, v0, a0, j = plan.s[k], plan.v[k], plan.a[k], plan.j[k]
        length = plan.s[k + 1] - s0
        v_most = max(v0, plan.v[k + 1])
        a_most = max(abs(a0), abs(a0 + duration * j))
        if a0 * j < 0.0:
            v_most = max(v_most, v0 - 0.5 * a0 * a0 / j)
        steady = a0 == 0.0 and j == 0.0
        # The phase may be shorter than JOINT.
        inside = min(JOINT, 0.5 * length)
        piece = next_piece(piece, s0 + inside, piece_s)
        least = TIMED_POINTS if is_timed(kind[piece], data, pieces.at[piece]) else POINTS
        points = max(least, int(min(duration / period, length / CLOSE)))
        examined = -1
        skip = False
        u_before = 0.0
        change_before = 0.0
        for m in range(points + 1):
            s, v, a = phase_at(duration * m / points, s0, v0, a0, j)
            if m == points:
                # As exact as the junction that may be there.
                s = plan.s[k + 1]
            # At a junction the phase that starts there belongs to the piece behind it, the one that
            # ends there to the piece before it.
            piece = next_piece(piece, s + (inside if m == 0 else -inside), piece_s)
            if examined != piece:
                examined = piece
                change_before = 0.0
                if bounded != piece:
                    bounded = piece
                    derivative_bounds(kind[piece], data, pieces.at[piece], bounds)
                skip = not is_timed(kind[piece], data, pieces.at[piece]) and cannot_raise(
                    v_most, a_most, abs(j), feed[piece], bounds, largest
                )
            elif skip and m < points:
                continue
            local = min(max(s - piece_s[piece], 0.0), piece_s[piece + 1] - piece_s[piece])
            here, where = kind[piece], pieces.at[piece]
            u = curve_inv_arclen(here, data, where, local)
            curve_eval_s(here, data, where, u, q)
            raise_maxima(pieces, piece, q, v, a, j, feed[piece], largest)
            if is_timed(here, data, where):
                change = speeding_up(data, where, q)
                if change_before < 0.0 < change:
                    slowest_between(here, data, where, u_before, u, q)
                    raise_maxima(pieces, piece, q, v, a, j, feed[piece], largest)
                u_before, change_before = u, change
            # A line at constant speed has the same values everywhere.
            skip = skip or (kind[piece] == LINE and steady)


@njit
def along_axes(v: float, a: float, q: Floats) -> None:
    """Replace derivatives by arc length ``q`` (4, axes) by velocity and acceleration of the axes.

    They are written to rows 1 and 2. v, a: the motion along the path.
    """
    for i in range(q.shape[1]):
        q[2, i] = q[2, i] * v * v + q[1, i] * a
        q[1, i] *= v


@njit
def continuity(pieces: Pieces, plan: PlanArrays, gaps: Floats) -> None:
    """Integrate each phase and compare its end with the start of the next.

    The plan's coordinate changes its meaning at the ends of timed pieces: its rate may jump where
    the motion does not. There position, velocity and acceleration are compared in every axis.

    Args:
        pieces: the path of the motion.
        plan: its phases.
        gaps: (GAPS,): raised to the largest jumps of position, speed and acceleration, and to the
            largest negative duration and speed. NaN stays NaN.
    """
    kind, data, at, piece_s = pieces.kind, pieces.data, pieces.at, plan.piece_s
    gap = np.zeros(GAPS)
    n = int(data[at[0] + AXES])
    q = np.zeros((2, 4, n))
    last = len(plan.j)
    piece = 0
    for k in range(last + 1):
        s, v, a = plan.s[k], plan.v[k], plan.a[k]
        gap[STANDSTILL_GAP] = -v
        if k > 0:
            dt = plan.t[k] - plan.t[k - 1]
            s_end, v_end, a_end = phase_at(
                dt, plan.s[k - 1], plan.v[k - 1], plan.a[k - 1], plan.j[k - 1]
            )
            gap[POSITION_GAP] = abs(s_end - s)
            gap[SPEED_GAP] = abs(v_end - v)
            gap[ACCEL_GAP] = abs(a_end - a)
            gap[TIME_GAP] = -dt
            piece = next_piece(piece, s - JOINT, piece_s)
            after = next_piece(piece, s + JOINT, piece_s)
            if k < last and (
                is_timed(kind[piece], data, at[piece]) or is_timed(kind[after], data, at[after])
            ):
                gap[SPEED_GAP] = 0.0
                gap[ACCEL_GAP] = 0.0
                for side in range(2):
                    m = piece if side == 0 else after
                    local = min(max(s - piece_s[m], 0.0), piece_s[m + 1] - piece_s[m])
                    u = curve_inv_arclen(kind[m], data, at[m], local)
                    curve_eval_s(kind[m], data, at[m], u, q[side])
                    along_axes(v_end if side == 0 else v, a_end if side == 0 else a, q[side])
                for order in range(3):
                    for i in range(n):
                        gap[order] = max(gap[order], abs(q[1, order, i] - q[0, order, i]))
        for m in range(GAPS):
            if gaps[m] == gaps[m] and not gap[m] <= gaps[m]:
                gaps[m] = gap[m]
