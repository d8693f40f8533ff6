r"""Ramps to rest and from rest that end with another jerk beside a corner, where they overlap.

The last phase of such a ramp takes a time e at a part c of its jerk J; the rest of the ramp is as
long as it has to be. Behind this phase, seen from the corner, the ramp is one of jerk J that begins
at the speed c (1 - c) J e^2 / 2.

- Overshoot, c = -1: where the two legs move different axes, each may run past the corner a little
  and come back. That costs 2 e a ramp. It lets the overlap last about 6 e longer: near its end a
  ramp that overshoots is closer to the corner than one that does not. The ramp passes the corner by
  1.943 J e^3, which must be within the tolerance.
- Soft end, 0 < c < 1: where the sum of the jerks would pass a limit during the overlap. That costs
  about (1 - c) e / 2 a ramp, and the overlap saves e.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, Floats, Ints
from cnc.kernels.planner.legs import (
    LEGS_SHARE,
    PHASE_SHARE,
    REST,
    REVERSED,
    SHARPEST,
    LineBounds,
    directions,
    line_bounds,
)
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.overlap import (
    Leg,
    common_jerk,
    overlap_time,
    softening_time,
    time_saved,
)
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.scurve import peak_speed, ramp_distance, ramp_shape

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
"""Largest number of phases of a move with other jerks at its ends."""

GAIN = 1e-5
"""s; another jerk has to save this."""


class Ends(NamedTuple):
    """The last phases of the ramps at the ends of the pieces.

    Attributes:
        t: (pieces,): their duration, s; 0 for ramps as they were planned.
        part: (pieces,): their jerk, as a part of that of the ramps; -1 for an overshoot.
    """

    t: Floats
    part: Floats


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
def end_speed(t: float, part: float, j: float) -> float:
    """Return the speed from which a ramp of jerk ``j`` begins behind its last phase, mm/s."""
    return 0.5 * part * (1.0 - part) * j * t * t


@njit
def write_leg(
    s: float,
    t: float,
    length: float,
    ends: tuple[float, float, float, float],
    bounds: LineBounds,
    out: PlanArrays,
    written: int,
) -> int:
    """Write the phases of a move from rest to rest with other jerks at its ends.

    Args:
        s: arc length at its start, mm.
        t: time at its start, s.
        length: mm.
        ends: duration and part of the jerk of the first phase, then of the last.
        bounds: of the move.
        out: receives the phases.
        written: number of phases written so far.

    Returns:
        The new number; -1 if the move is too short for these ends.
    """
    top, a, j = bounds.v, bounds.a, bounds.j
    e1, part1, e2, part2 = ends
    v1, v2 = end_speed(e1, part1, j), end_speed(e2, part2, j)
    # A ramp of jerk j from the speed v1 covers this much less until it has the same speed.
    distance = length - j * part1 * (1.0 - part1) * (1.0 - 2.0 * part1) * e1**3 / 6.0
    distance -= j * part2 * (1.0 - part2) * (1.0 - 2.0 * part2) * e2**3 / 6.0
    peak = peak_speed(v1, v2, distance, top, a, j)
    t1, c1, _ = ramp_shape(peak - v1, a, j)
    t2, c2, _ = ramp_shape(peak - v2, a, j)
    if peak <= max(v1, v2) or min(t1 - part1 * e1, t2 - part2 * e2) <= SPLIT:
        return -1
    cruise = (
        max(distance - ramp_distance(v1, peak, a, j) - ramp_distance(peak, v2, a, j), 0.0) / peak
    )
    v = 0.0
    acc = 0.0
    here = s
    for m in range(PHASES_OF_MOVE):
        dt = e1 if m == 0 else t1 - part1 * e1 if m == 1 else c1 if m == 2 else t1
        jerk = part1 * j if m == 0 else j if m == 1 else 0.0 if m == 2 else -j
        if m > 3:
            dt = cruise if m == 4 else t2 if m == 5 else c2 if m == 6 else t2 - part2 * e2
            jerk = 0.0 if m == 4 or m == 6 else -j if m == 5 else j
        if m == 8:
            dt, jerk = e2, part2 * j
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
def choose_ends(
    path: PathArrays, plan: PlanArrays, moves: RestToRest, limits: LimitArrays, ends: Ends
) -> None:
    """Write the last phases of the ramps to ``ends``: overshoots, soft ends, or none."""
    data, at = path.pieces.data, path.pieces.at
    n = len(limits.axis_jerk)
    u = np.empty((2, n))
    free = min(limits.tangential_acceleration, limits.tangential_jerk, limits.normal_acceleration)
    for b in range(len(at) - 1):
        ends.t[b] = 0.0
        ends.part[b] = 1.0
        tolerance = path.tolerance[b]
        first1, first2 = moves.first[b], moves.first[b + 1]
        changeable = first1 >= 0 and first2 >= 0 and moves.end[b] == first2
        if not changeable or path.stop_after[b] or not tolerance > 0.0:
            continue
        j1, j2 = moves.jerk[b], moves.jerk[b + 1]
        accel1, accel2 = moves.accel[b], moves.accel[b + 1]
        peak1, peak2 = 0.0, 0.0
        for m in range(first1, moves.end[b]):
            peak1 = max(peak1, plan.v[m])
        for m in range(first2, moves.end[b + 1]):
            peak2 = max(peak2, plan.v[m])
        t1 = ramp_shape(peak1, accel1, j1)[0]
        t2 = ramp_shape(peak2, accel2, j2)[0]
        turn = directions(data, at[b], data, at[b + 1], u)
        if turn.sine > REVERSED or turn.sine == 0.0:
            continue
        part = common_jerk(u, turn, j1, j2, limits)
        if part < 1.0:
            end1 = softening_time(peak1, accel1, j1, part)
            end2 = softening_time(peak2, accel2, j2, part)
            before = Leg(part * j1, end1, LEGS_SHARE * path.length[b])
            after = Leg(part * j2, end2, LEGS_SHARE * path.length[b + 1])
            common = overlap_time(turn, before, after, tolerance, limits)
            if common > 0.0 and time_saved(common, part, t1, t2) > GAIN:
                ends.t[b] = common / PHASE_SHARE
                ends.part[b] = part
            continue
        legal = turn.sine < SHARPEST and free == math.inf
        for i in range(n):
            legal = legal and j1 * abs(u[0, i]) + j2 * abs(u[1, i]) <= limits.axis_jerk[i]
        if not legal:
            continue
        near = tolerance / math.sqrt(2.0)
        largest = (0.999 * tolerance / (PAST * max(j1, j2))) ** (1.0 / 3.0)
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
                ends.t[b] = e
                ends.part[b] = -1.0


@njit
def write_ends(plan: PlanArrays, moves: RestToRest, ends: Ends, out: PlanArrays) -> int:
    """Write a plan whose moves end with other jerks.

    Args:
        plan: the phases.
        moves: its moves from rest to rest.
        ends: the last phases at the end of each piece.
        out: space for the new phases, PHASES_OF_MOVE more for each piece.

    Returns:
        The number of phases; -1 if a move is too short for its ends.
    """
    pieces = len(ends.t)
    piece_s = plan.piece_s
    written = 0
    later = 0.0
    b = 0
    k = 0
    while k < len(plan.j):
        while b < pieces and moves.first[b] < k:
            b += 1
        begins = b < pieces and moves.first[b] == k
        e1, part1, e2, part2 = 0.0, 1.0, 0.0, 1.0
        if begins:
            e2, part2 = ends.t[b], ends.part[b]
            if b > 0:
                e1, part1 = ends.t[b - 1], ends.part[b - 1]
        if e1 > 0.0 or e2 > 0.0:
            bounds = LineBounds(moves.top[b], moves.accel[b], moves.jerk[b])
            length = piece_s[b + 1] - piece_s[b]
            t = plan.t[k] + later
            written = write_leg(piece_s[b], t, length, (e1, part1, e2, part2), bounds, out, written)
            if written < 0:
                return -1
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
