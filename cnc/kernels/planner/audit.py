"""Largest values that a plan reaches, for comparison with the limits.

They come from two sources; neither shares a formula with the planner:

- velocity, acceleration and jerk of each axis by the chain rule, from the curve and the phase, at
  points throughout every phase;
- differences of successive positions at the sampling period, which show jumps at junctions too
  (:mod:`cnc.kernels.planner.audit_samples`).

The hull of a piece's control points (:mod:`cnc.kernels.planner.hull`) bounds its derivatives. Where
these bounds cannot raise any maximum, the inside of the piece is skipped; the maxima are the same.
Positions are sampled everywhere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.curve import AXES, LINE, METRIC, METRICS, curve_eval_s
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.hull import BOUNDS, derivative_bounds
from cnc.kernels.planner.phases import phase_at
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.timed import is_timed, slowest_between, speeding_up, timed_motion

Floats = NDArray[np.float64]

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
