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
    u = np.zeros((2, len(limits.axis_jerk)))
    moves = RestToRest(
        np.full(count, -1),
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
                keep_to_plan(path.length[b], plan, moves, b)
        rest = k
    return moves


@njit
def keep_to_plan(length: float, plan: PlanArrays, moves: RestToRest, b: int) -> None:
    """Lower the bounds of the move over piece ``b`` to those that its phases keep to.

    A move with more than one jerk is not changed.
    """
    first, end = moves.first[b], moves.end[b]
    jerk, accel, top = 0.0, moves.accel[b], moves.top[b]
    for m in range(first, end):
        jerk = max(jerk, abs(plan.j[m]))
        if plan.j[m] == 0.0:
            # The reason for the lower speed or acceleration here applies to the new motion too.
            if plan.a[m] != 0.0:
                accel = min(accel, abs(plan.a[m]))
            elif (plan.t[m + 1] - plan.t[m]) * plan.v[m] > 1e-6 * length:
                top = min(top, plan.v[m])
    for m in range(first, end):
        if plan.j[m] != 0.0 and abs(abs(plan.j[m]) - jerk) > 1e-9 * jerk:
            moves.first[b] = -1
    moves.jerk[b] = jerk
    moves.accel[b] = accel
    moves.top[b] = top


@njit
def best_overshoot(tolerance: float, plan: PlanArrays, moves: RestToRest, b: int) -> float:
    """Return the time of the best overshoot between the moves over pieces b and b + 1, s.

    It is 0 if none saves enough.
    """
    j1, j2 = moves.jerk[b], moves.jerk[b + 1]
    accel1, accel2 = moves.accel[b], moves.accel[b + 1]
    near = tolerance / math.sqrt(2.0)
    largest = (0.999 * tolerance / (PAST * max(j1, j2))) ** (1.0 / 3.0)
    peak1 = plan.v[moves.first[b] : moves.end[b]].max()
    peak2 = plan.v[moves.first[b + 1] : moves.end[b + 1]].max()
    t1 = ramp_shape(peak1, accel1, j1)[0]
    t2 = ramp_shape(peak2, accel2, j2)[0]
    best = GAIN
    found = 0.0
    for m in range(TRIES + 1):
        e = largest * m / TRIES
        common = time_remaining(near / j1, e) + time_remaining(near / j2, e)
        common = min(common, PHASE_SHARE * (t1 + 2.0 * e), PHASE_SHARE * (t2 + 2.0 * e))
        gain = common - 4.0 * e - (j1 / accel1 + j2 / accel2) * e * e
        gain -= 0.5 * (accel1 / peak1 + accel2 / peak2) * e * e
        if m == 0:
            best += gain
        elif gain > best and common > 2.1 * BACK * e and max(j1 / accel1, j2 / accel2) * e < 0.5:
            best = gain
            found = e
    return found


@njit
def choose_overshoots(
    path: PathArrays, plan: PlanArrays, moves: RestToRest, limits: LimitArrays, past: Floats
) -> bool:
    """Write the times of the overshoots at the ends of the pieces to ``past``.

    Returns:
        Whether there is one.
    """
    data, at = path.pieces.data, path.pieces.at
    n = len(limits.axis_jerk)
    u = np.zeros((2, n))
    found = False
    for b in range(len(at) - 1):
        past[b] = 0.0
        if (
            moves.first[b] < 0
            or moves.first[b + 1] < 0
            or path.stop_after[b]
            or not path.tolerance[b] > 0.0
            or moves.end[b] != moves.first[b + 1]
        ):
            continue
        legal = directions(data, at[b], data, at[b + 1], u).sine < SHARPEST
        for i in range(n):
            jerk = moves.jerk[b] * abs(u[0, i]) + moves.jerk[b + 1] * abs(u[1, i])
            legal = legal and jerk <= limits.axis_jerk[i]
        if legal:
            past[b] = best_overshoot(path.tolerance[b], plan, moves, b)
            found = found or past[b] > 0.0
    return found


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
