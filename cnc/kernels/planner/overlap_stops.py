"""A plan in which the ramps at stops on corners overlap (:mod:`cnc.kernels.planner.overlap`).

The path gets timed pieces for the overlaps, and the lines beside them become shorter. All phases
behind an overlap begin earlier.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LENGTH, LINE, SPAN, START, Floats, Ints
from cnc.kernels.planner.legs import LEGS_SHARE, REST, directions, record_end, write_line
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.overlap import Leg, overlap_time
from cnc.kernels.planner.overshoot import BACK, PHASE_SHARE, SPLIT, time_remaining
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.timed import TIMED_SIZE, TIMED_SIZE_PER_AXIS, write_timed

PIECES_OF_CORNER = 3
"""Largest number of timed pieces of a corner."""


class Cuts(NamedTuple):
    """The overlaps of a plan.

    Attributes:
        common: (pieces,): duration of the overlap at the end of a piece, s, or 0.
        before: (pieces,): length that the overlap at its start takes off a piece, mm.
        after: (pieces,): length that the overlap at its end takes off, mm.
        rest: (pieces,): the phase that begins at the end of the piece.
    """

    common: Floats
    before: Floats
    after: Floats
    rest: Ints


class Progress(NamedTuple):
    """State of the construction of a new path and plan, in arrays so that kernels can change it.

    Attributes:
        counts: (3,): PIECES, PHASES and NUMBERS (of the records) written so far.
        places: (3,): arc length REACHED, mm; time by which later phases are EARLIER, s; SHIFT of
            their arc lengths, mm.
    """

    counts: Ints
    places: Floats


PIECES, PHASES, NUMBERS = range(3)
"""Entries of ``Progress.counts``."""

REACHED, EARLIER, SHIFT = range(3)
"""Entries of ``Progress.places``."""


@njit
def state_at(t: float, k: int, plan: PlanArrays) -> tuple[float, float, float]:
    """Return arc length, speed and acceleration at time ``t`` by phase ``k``."""
    dt = t - plan.t[k]
    v, a, j = plan.v[k], plan.a[k], plan.j[k]
    s = plan.s[k] + dt * (v + dt * (0.5 * a + dt * j / 6.0))
    return s, v + dt * (a + 0.5 * dt * j), a + dt * j


@njit
def phases_of_ramp(past: float) -> int:
    """Return the number of phases on either side that reach into an overlap."""
    return 1 if past == 0.0 else 2


@njit
def find_cuts(
    path: PathArrays, plan: PlanArrays, past: Floats, limits: LimitArrays
) -> tuple[int, Cuts]:
    """Find the overlaps of a plan.

    Args:
        path: of the motion.
        plan: its phases.
        past: (pieces,): times of the overshoots at the ends of the pieces, s, from
            :func:`cnc.kernels.planner.overshoot.choose_overshoots`.
        limits: of the machine.

    Returns:
        1 if there are some, 0 if there are none, -1 if an overshoot is not possible; and the
        overlaps.
    """
    kind, piece_s, length = path.pieces.kind, plan.piece_s, path.length
    data, at = path.pieces.data, path.pieces.at
    pieces = len(kind)
    cuts = Cuts(np.zeros(pieces), np.zeros(pieces), np.zeros(pieces), np.zeros(pieces, np.int64))
    u = np.empty((2, len(limits.axis_jerk)))
    found = 0
    b = 0
    for k in range(1, len(plan.j)):
        if plan.v[k] != 0.0 or plan.a[k] != 0.0:
            continue
        while b + 1 < pieces and piece_s[b + 1] < plan.s[k] - REST:
            b += 1
        tolerance = path.tolerance[b]
        if (
            b + 1 >= pieces
            or path.stop_after[b]
            or not tolerance > 0.0
            or kind[b] != LINE
            or kind[b + 1] != LINE
            or abs(plan.s[k] - piece_s[b + 1]) > REST
        ):
            continue
        m = phases_of_ramp(past[b])
        if k < m or k + m > len(plan.j):
            continue
        j1 = plan.j[k - m]
        j2 = plan.j[k + m - 1]
        t1 = plan.t[k] - plan.t[k - m]
        t2 = plan.t[k + m] - plan.t[k]
        common = 0.0
        if past[b] > 0.0:
            near = tolerance / math.sqrt(2.0)
            reach = time_remaining(near / j1, past[b]) + time_remaining(near / j2, past[b])
            bend = limits.period**2 * math.sqrt(j1 * j1 + j2 * j2)
            longest = min(PHASE_SHARE * t1, PHASE_SHARE * t2, 8.0 * limits.chord_error / bend)
            common = min(reach, longest)
        elif j1 > 0.0 and j2 > 0.0 and abs(plan.a[k - 1] + j1 * t1) <= SPLIT * j1:
            turn = directions(data, at[b], data, at[b + 1], u)
            before = Leg(j1, t1, min(LEGS_SHARE * length[b], plan.s[k] - plan.s[k - 1]))
            after = Leg(j2, t2, min(LEGS_SHARE * length[b + 1], plan.s[k + 1] - plan.s[k]))
            common = overlap_time(u, turn, before, after, tolerance, limits)
        if common > 0.0:
            cuts.after[b] = plan.s[k] - state_at(plan.t[k] - common, k - m, plan)[0]
            cuts.before[b + 1] = state_at(plan.t[k] + common, k + m - 1, plan)[0] - plan.s[k]
            cuts.common[b] = common
            cuts.rest[b] = k
            found = 1
        most = max(cuts.after[b] / length[b], cuts.before[b + 1] / length[b + 1])
        if past[b] > 0.0 and (common <= 2.0 * BACK * past[b] or most > LEGS_SHARE):
            return -1, cuts
    for b in range(pieces):
        if past[b] > 0.0 and cuts.common[b] == 0.0:
            return -1, cuts
    return found, cuts


@njit
def write_overlap(
    path: PathArrays,
    plan: PlanArrays,
    m: int,
    cuts: Cuts,
    b: int,
    out: PathArrays,
    out_plan: PlanArrays,
    progress: Progress,
) -> None:
    """Append the overlap behind piece ``b``, and the rest of the phase that it ends in.

    Both motions go on with constant jerks up to the next end of a phase of either: there a timed
    piece ends. The line of these pieces is that of the faster move, so that the speed of a traverse
    is not assigned to a feed move.

    Args:
        path: of the motion.
        plan: its phases.
        m: number of phases on either side that reach into the overlap.
        cuts: the overlaps.
        b: the piece.
        out: the new path.
        out_plan: its phases.
        progress: state of the construction.
    """
    counts, places = progress.counts, progress.places
    data, at = path.pieces.data, path.pieces.at
    common, r = cuts.common[b], cuts.rest[b]
    n = int(data[at[b]])
    u, q = np.empty((2, n)), np.empty((4, n))
    # Start, inner control points (measured from the start) and end of a timed piece.
    ends = np.empty((4, n))
    directions(data, at[b], data, at[b + 1], u)
    left = out.pieces.at[counts[PIECES] - 1]
    corner = at[b + 1] + START
    for i in range(n):
        ends[3, i] = out.pieces.data[left + START + n + i]
    feed1, feed2 = path.feed[b], path.feed[b + 1]
    both = feed1 == feed1 and feed2 == feed2
    faster = feed1 < feed2 or (feed1 == feed1 and feed2 != feed2)
    # Times are measured from the start of the overlap.
    rest_t, rest_s = plan.t[r], plan.s[r]
    begin = rest_t - common
    first, second = r - m, r
    t = 0.0
    v2, a2 = 0.0, 0.0
    while t < common:
        until = min(common, plan.t[first + 1] - begin, plan.t[second + 1] - rest_t)
        if first + 1 == r and second + 1 == r + m:
            until = common
        dt = until - t
        _, v1, a1 = state_at(begin + t, first, plan)
        _, v2, a2 = state_at(rest_t + t, second, plan)
        for i in range(n):
            v = v1 * u[0, i] + v2 * u[1, i]
            ends[0, i] = ends[3, i]
            ends[1, i] = v * dt / 3.0
            ends[2, i] = 2.0 * v * dt / 3.0 + (a1 * u[0, i] + a2 * u[1, i]) * dt * dt / 6.0
        s1, v1, a1 = state_at(begin + until, first, plan)
        s2, v2, a2 = state_at(rest_t + until, second, plan)
        if until == common:
            s1, s2 = rest_s, rest_s + cuts.before[b + 1]
        for i in range(n):
            ends[3, i] = data[corner + i] + (s1 - rest_s) * u[0, i] + (s2 - rest_s) * u[1, i]
        used, count, written = counts[NUMBERS], counts[PIECES], counts[PHASES]
        counts[NUMBERS] = write_timed(
            out.pieces.data, used, left, ends[0], ends[1], ends[2], ends[3], q
        )
        length = out.pieces.data[used + LENGTH]
        out.pieces.kind[count] = SPAN
        out.pieces.at[count] = used
        out.length[count] = length
        out.feed[count] = max(feed1, feed2) if both else math.nan
        out.line[count] = path.line[b + 1] if faster else path.line[b]
        out.stop_after[count] = False
        out.tolerance[count] = 0.0
        out_plan.piece_s[count] = places[REACHED]
        out_plan.t[written] = begin + t - places[EARLIER]
        out_plan.s[written] = places[REACHED]
        out_plan.v[written] = length / dt
        out_plan.a[written] = 0.0
        out_plan.j[written] = 0.0
        counts[PIECES] += 1
        counts[PHASES] += 1
        places[REACHED] += length
        t = until
        if plan.t[first + 1] - begin <= t and first + 1 < r:
            first += 1
        if plan.t[second + 1] - rest_t <= t and second + 1 < r + m:
            second += 1
    written = counts[PHASES]
    out_plan.t[written] = begin + common - places[EARLIER]
    out_plan.s[written] = places[REACHED]
    out_plan.v[written] = v2
    out_plan.a[written] = a2
    out_plan.j[written] = plan.j[r + m - 1]
    counts[PHASES] += 1
    places[EARLIER] += common
    places[SHIFT] = places[REACHED] - (rest_s + cuts.before[b + 1])


@njit
def overlap_stops(
    path: PathArrays,
    plan: PlanArrays,
    past: Floats,
    cuts: Cuts,
    out: PathArrays,
    out_plan: PlanArrays,
) -> tuple[int, int, int]:
    """Let the ramps at the stops on corners of a plan overlap.

    Args:
        path: of the motion.
        plan: its phases.
        past: (pieces,): times of the overshoots at the ends of the pieces, s, from
            :func:`cnc.kernels.planner.overshoot.choose_overshoots`.
        cuts: the overlaps, from :func:`find_cuts`.
        out: space for the new path: four times the pieces and one more. The data needs the size of
            all records, and :func:`overlap_size` for each piece.
        out_plan: space for its phases: four more for each piece.

    Returns:
        The numbers of pieces, of phases and of numbers in records of the new motion.
    """
    pieces = len(path.length)
    # The old records come first, those of changed pieces behind them.
    lowest = path.pieces.at[0]
    used = 0
    for b in range(pieces):
        lowest = min(lowest, path.pieces.at[b])
        used = max(used, record_end(path.pieces, b))
    used -= lowest
    data = out.pieces.data
    for i in range(used):
        data[i] = path.pieces.data[lowest + i]
    progress = Progress(np.zeros(3, np.int64), np.zeros(3))
    counts, places = progress.counts, progress.places
    counts[NUMBERS] = used
    end = len(plan.j)
    k = 0
    for b in range(pieces):
        count = counts[PIECES]
        at = path.pieces.at[b] - lowest
        before, after, common = cuts.before[b], cuts.after[b], cuts.common[b]
        out.pieces.kind[count] = path.pieces.kind[b]
        out.pieces.at[count] = at
        out.length[count] = path.length[b]
        if before > 0.0 or after > 0.0:
            used = counts[NUMBERS]
            out.pieces.at[count] = used
            counts[NUMBERS] = write_line(data, used, at, before, after)
            out.length[count] = data[used + LENGTH]
        out.feed[count] = path.feed[b]
        out.line[count] = path.line[b]
        out.stop_after[count] = path.stop_after[b]
        out.tolerance[count] = 0.0 if common > 0.0 else path.tolerance[b]
        out_plan.piece_s[count] = places[REACHED]
        places[REACHED] += out.length[count]
        counts[PIECES] += 1
        if common == 0.0 and b + 1 < pieces:
            continue
        # The phases up to the start of the second ramp, or to the end.
        m = phases_of_ramp(past[b])
        for p in range(k, cuts.rest[b] - m + 1 if common > 0.0 else end):
            written = counts[PHASES]
            out_plan.t[written] = plan.t[p] - places[EARLIER]
            out_plan.s[written] = plan.s[p] + places[SHIFT]
            out_plan.v[written] = plan.v[p]
            out_plan.a[written] = plan.a[p]
            out_plan.j[written] = plan.j[p]
            counts[PHASES] += 1
        if common > 0.0:
            write_overlap(path, plan, m, cuts, b, out, out_plan, progress)
            k = cuts.rest[b] + m
    out_plan.piece_s[counts[PIECES]] = places[REACHED]
    last = counts[PHASES]
    out_plan.t[last] = plan.t[end] - places[EARLIER]
    out_plan.s[last] = plan.s[end] + places[SHIFT]
    out_plan.v[last] = plan.v[end]
    out_plan.a[last] = plan.a[end]
    return counts[PIECES], counts[PHASES], counts[NUMBERS]


@njit
def overlap_size(axes: int) -> int:
    """Return the largest size of the records of an overlap and the line before it, in numbers."""
    return PIECES_OF_CORNER * (TIMED_SIZE + axes * TIMED_SIZE_PER_AXIS) + START + 2 * axes
