r"""A ramp to rest or from rest that overshoots its corner a little and comes back.

Where the two legs move different axes, each may run past the corner a little and come back. The
ramp to rest then ends with the jerks +J, -J instead of +J alone, the last for a time e. That costs
2 e a ramp. It lets the overlap last about 6 e longer: near its end a ramp that overshoots is closer
to the corner than one that does not.

The ramp goes to the speed -J e^2 at J e^3 behind the corner, and comes back within 2 e. It passes
the corner by 1.943 J e^3, which must be within the tolerance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, Floats, Ints
from cnc.kernels.planner.legs import REST, SHARPEST, LineBounds, directions, line_bounds
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.scurve import peak_speed, ramp_distance, ramp_shape

PHASE_SHARE = 0.999
"""The part of a ramp's last phase that may be overlapped; the rest keeps the phases separate."""

SPLIT = 1e-12
"""s; rounding error of a time of 0."""

PAST = 1.943
"""A ramp of jerk J passes the corner by this times J e^3: minus the minimum of :func:`remaining`,
at t = e (2 + sqrt 2).
"""

BACK = 4.85
"""A ramp to rest is beyond the corner for the last this times e: :func:`remaining` is negative
there.
"""

TRIES = 4
"""Overshoots that are compared: the largest that the tolerance allows, and parts of it."""

PHASES_OF_MOVE = 9
"""Largest number of phases of a move that overshoots."""

GAIN = 1e-5
"""s; an overshoot has to save this."""


class RestToRest(NamedTuple):
    """For each piece, the motion over it if that is a line from rest to rest.

    Attributes:
        first: its first phase; -1 for another piece.
        end: the phase behind it.
        top: largest speed, mm/s.
        accel: mm/s^2.
        jerk: mm/s^3.
    """

    first: Ints
    end: Ints
    top: Floats
    accel: Floats
    jerk: Floats


@njit
def remaining(t: float, e: float) -> float:
    """Return the distance that a ramp to rest of jerk 1 has left a time ``t`` >= e before its end.

    The ramp ends with an overshoot of ``e`` s.
    """
    x = t - e
    return ((x / 3.0 - e) * x - e * e) * x / 2.0 - e * e * e / 6.0


@njit
def time_remaining(distance: float, e: float) -> float:
    """Return the last time before its end at which the ramp has ``distance`` > 0 left.

    The ramp is that of :func:`remaining`.
    """
    low = 3.0 * e
    high = 4.0 * e + 2.0 * (6.0 * distance) ** (1.0 / 3.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if remaining(middle, e) < distance:
            low = middle
        else:
            high = middle
    return low


@njit
def write_leg(
    s: float,
    t: float,
    length: float,
    e1: float,
    e2: float,
    bounds: LineBounds,
    out: PlanArrays,
    written: int,
) -> int:
    """Write the phases of a move from rest to rest that overshoots at its ends.

    Args:
        s: arc length at its start, mm.
        t: time at its start, s.
        length: mm.
        e1: time of the overshoot at its start, s; 0 for none.
        e2: the same at its end.
        bounds: of the move.
        out: receives the phases.
        written: number of phases written so far.

    Returns:
        The new number.
    """
    top, a, j = bounds.v, bounds.a, bounds.j
    v1 = -j * e1 * e1
    v2 = -j * e2 * e2
    distance = length + j * (e1**3 + e2**3)
    peak = peak_speed(v1, v2, distance, top, a, j)
    t1, c1, _ = ramp_shape(peak - v1, a, j)
    t2, c2, _ = ramp_shape(peak - v2, a, j)
    cruise = (
        max(distance - ramp_distance(v1, peak, a, j) - ramp_distance(peak, v2, a, j), 0.0) / peak
    )
    v = 0.0
    acc = 0.0
    here = s
    for m in range(PHASES_OF_MOVE):
        dt = e1 if m == 0 else e1 + t1 if m == 1 else c1 if m == 2 else t1 if m == 3 else cruise
        if m > 4:
            dt = t2 if m == 5 else c2 if m == 6 else t2 + e2 if m == 7 else e2
        jerk = -j if m == 0 or m == 3 or m == 5 or m == 8 else j if m == 1 or m == 7 else 0.0
        if dt <= 0.0:
            continue
        out.t[written] = t
        out.s[written] = here
        out.v[written] = v
        out.a[written] = acc
        out.j[written] = jerk
        written += 1
        t += dt
        here += dt * (v + dt * (0.5 * acc + dt * jerk / 6.0))
        v += dt * (acc + 0.5 * dt * jerk)
        acc += dt * jerk
        if m == 3 or m == 4:
            v = peak
            acc = 0.0
    out.t[written] = t
    out.s[written] = s + length
    out.v[written] = 0.0
    out.a[written] = 0.0
    return written


@njit
def find_moves(
    path: PathArrays, plan: PlanArrays, bound: Floats, limits: LimitArrays
) -> RestToRest:
    """Find the lines that the plan crosses from rest to rest, with the bounds that it keeps to."""
    pieces, piece_s = path.pieces, plan.piece_s
    count = len(pieces.kind)
    u = np.empty((2, len(limits.axis_jerk)))
    moves = RestToRest(
        np.zeros(count, np.int64) - 1,
        np.zeros(count, np.int64),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
    )
    rest = -1
    b = 0
    for k in range(len(plan.j) + 1):
        if plan.v[k] != 0.0 or abs(plan.a[k]) > SPLIT * abs(plan.j[max(k - 1, 0)]):
            continue
        if rest >= 0:
            while b + 1 < count and piece_s[b + 1] <= plan.s[rest] + REST:
                b += 1
            if (
                pieces.kind[b] == LINE
                and abs(piece_s[b] - plan.s[rest]) <= REST
                and abs(piece_s[b + 1] - plan.s[k]) <= REST
            ):
                directions(pieces.data, pieces.at[b], pieces.data, pieces.at[b], u)
                bounds = line_bounds(u[0], bound[b], limits)
                moves.first[b] = rest
                moves.end[b] = k
                moves.top[b] = bounds.v
                moves.accel[b] = bounds.a
                for m in range(rest, k):
                    jerk = abs(plan.j[m])
                    moves.jerk[b] = max(moves.jerk[b], jerk)
                    # The reason for a lower speed or acceleration applies to a new motion too.
                    cruise = (plan.t[m + 1] - plan.t[m]) * plan.v[m]
                    if jerk == 0.0 and plan.a[m] != 0.0:
                        moves.accel[b] = min(moves.accel[b], abs(plan.a[m]))
                    elif jerk == 0.0 and cruise > 1e-6 * path.length[b]:
                        moves.top[b] = min(moves.top[b], plan.v[m])
                for m in range(rest, k):
                    jerk = abs(plan.j[m])
                    # A move with more than one jerk is not changed.
                    if jerk != 0.0 and abs(jerk - moves.jerk[b]) > 1e-9 * moves.jerk[b]:
                        moves.first[b] = -1
        rest = k
    return moves


@njit
def choose_overshoots(
    path: PathArrays, plan: PlanArrays, moves: RestToRest, limits: LimitArrays, past: Floats
) -> None:
    """Write the times of the best overshoots at the ends of the pieces to ``past``, s.

    They are 0 where none saves enough.
    """
    data, at = path.pieces.data, path.pieces.at
    n = len(limits.axis_jerk)
    u = np.empty((2, n))
    for b in range(len(at) - 1):
        past[b] = 0.0
        tolerance = path.tolerance[b]
        first1, first2 = moves.first[b], moves.first[b + 1]
        legal = first1 >= 0 and first2 >= 0 and moves.end[b] == first2
        if not legal or path.stop_after[b] or not tolerance > 0.0:
            continue
        j1, j2 = moves.jerk[b], moves.jerk[b + 1]
        legal = directions(data, at[b], data, at[b + 1], u).sine < SHARPEST
        for i in range(n):
            legal = legal and j1 * abs(u[0, i]) + j2 * abs(u[1, i]) <= limits.axis_jerk[i]
        if not legal:
            continue
        accel1, accel2 = moves.accel[b], moves.accel[b + 1]
        near = tolerance / math.sqrt(2.0)
        largest = (0.999 * tolerance / (PAST * max(j1, j2))) ** (1.0 / 3.0)
        peak1, peak2 = 0.0, 0.0
        for m in range(first1, moves.end[b]):
            peak1 = max(peak1, plan.v[m])
        for m in range(first2, moves.end[b + 1]):
            peak2 = max(peak2, plan.v[m])
        t1 = ramp_shape(peak1, accel1, j1)[0]
        t2 = ramp_shape(peak2, accel2, j2)[0]
        best = GAIN
        for m in range(TRIES + 1):
            e = largest * m / TRIES
            common = time_remaining(near / j1, e) + time_remaining(near / j2, e)
            common = min(common, PHASE_SHARE * (t1 + 2.0 * e), PHASE_SHARE * (t2 + 2.0 * e))
            gain = common - 4.0 * e - (j1 / accel1 + j2 / accel2) * e * e
            gain -= 0.5 * (accel1 / peak1 + accel2 / peak2) * e * e
            reached = max(j1 / accel1, j2 / accel2) * e
            if m == 0:
                best += gain
            elif gain > best and common > 2.1 * BACK * e and reached < 0.5:
                best = gain
                past[b] = e


@njit
def write_overshoots(plan: PlanArrays, moves: RestToRest, past: Floats, out: PlanArrays) -> int:
    """Write a plan whose moves overshoot their corners.

    Args:
        plan: the phases.
        moves: its moves from rest to rest.
        past: (pieces,): the time of the overshoot at the end of each piece, s, or 0.
        out: space for the new phases, PHASES_OF_MOVE more for each piece.

    Returns:
        The number of phases.
    """
    pieces = len(past)
    piece_s = plan.piece_s
    written = 0
    later = 0.0
    b = 0
    k = 0
    while k < len(plan.j):
        while b < pieces and moves.first[b] < k:
            b += 1
        begins = b < pieces and moves.first[b] == k
        before = past[b - 1] if begins and b > 0 else 0.0
        after = past[b] if begins else 0.0
        if before > 0.0 or after > 0.0:
            bounds = LineBounds(moves.top[b], moves.accel[b], moves.jerk[b])
            length = piece_s[b + 1] - piece_s[b]
            t = plan.t[k] + later
            written = write_leg(piece_s[b], t, length, before, after, bounds, out, written)
            k = moves.end[b]
            later = out.t[written] - plan.t[k]
        else:
            out.t[written] = plan.t[k] + later
            out.s[written] = plan.s[k]
            out.v[written] = plan.v[k]
            out.a[written] = plan.a[k]
            out.j[written] = plan.j[k]
            written += 1
            k += 1
    out.t[written] = plan.t[k] + later
    out.s[written] = plan.s[k]
    out.v[written] = plan.v[k]
    out.a[written] = plan.a[k]
    return written
