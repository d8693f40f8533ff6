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

S, V, A, J = range(4)
"""Entries of a state of motion: arc length, speed, acceleration and jerk."""


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


class Corner(NamedTuple):
    """Scratch for one overlap.

    Attributes:
        u: (2, axes): directions of the legs.
        place: (axes,): the corner.
        ends: (4, axes): start, inner control points (measured from the start) and end of a part.
        state: (2, 4): S, V, A and J of both ramps.
    """

    u: Floats
    place: Floats
    ends: Floats
    state: Floats


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
def at_time(t: float, k: int, plan: PlanArrays, out: Floats) -> None:
    """Write the entries S, V, A, J at time ``t`` of phase ``k`` to ``out`` (4,)."""
    dt = t - plan.t[k]
    s, v, a, j = plan.s[k], plan.v[k], plan.a[k], plan.j[k]
    out[S] = s + dt * (v + dt * (0.5 * a + dt * j / 6.0))
    out[V] = v + dt * (a + 0.5 * dt * j)
    out[A] = a + dt * j
    out[J] = j


@njit
def overlap_at(
    path: PathArrays, plan: PlanArrays, k: int, b: int, past: float, limits: LimitArrays, u: Floats
) -> float:
    """Return the duration of the overlap at the rest before phase ``k``, behind piece ``b``, s.

    Args:
        path: of the motion.
        plan: its phases.
        k: the phase.
        b: the piece.
        past: time of the overshoot there, s, or 0.
        limits: of the machine.
        u: (2, axes): receives the directions of the legs.

    Returns:
        The duration; 0 for none.
    """
    data, at = path.pieces.data, path.pieces.at
    tolerance = path.tolerance[b]
    m = phases_of_ramp(past)
    j1 = plan.j[k - m]
    j2 = plan.j[k + m - 1]
    t1 = plan.t[k] - plan.t[k - m]
    t2 = plan.t[k + m] - plan.t[k]
    turn = directions(data, at[b], data, at[b + 1], u)
    common = 0.0
    if past > 0.0:
        period = limits.period
        near = tolerance / math.sqrt(2.0)
        common = min(
            time_remaining(near / j1, past) + time_remaining(near / j2, past),
            PHASE_SHARE * t1,
            PHASE_SHARE * t2,
        )
        common = min(
            common, 8.0 * limits.chord_error / (period * period * math.sqrt(j1 * j1 + j2 * j2))
        )
    elif j1 > 0.0 and j2 > 0.0 and abs(plan.a[k - 1] + j1 * t1) <= SPLIT * j1:
        length1 = min(LEGS_SHARE * path.length[b], plan.s[k] - plan.s[k - 1])
        length2 = min(LEGS_SHARE * path.length[b + 1], plan.s[k + 1] - plan.s[k])
        before = Leg(j1, t1, length1)
        after = Leg(j2, t2, length2)
        common = overlap_time(u, turn, before, after, tolerance, limits)
    return common


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
    pieces = len(kind)
    cuts = Cuts(np.zeros(pieces), np.zeros(pieces), np.zeros(pieces), np.zeros(pieces, np.int64))
    u = np.zeros((2, len(limits.axis_jerk)))
    begins = np.zeros(4)
    ends = np.zeros(4)
    found = 0
    b = 0
    for k in range(1, len(plan.j)):
        if plan.v[k] != 0.0 or plan.a[k] != 0.0:
            continue
        while b + 1 < pieces and piece_s[b + 1] < plan.s[k] - REST:
            b += 1
        if (
            b + 1 >= pieces
            or path.stop_after[b]
            or not path.tolerance[b] > 0.0
            or kind[b] != LINE
            or kind[b + 1] != LINE
        ):
            continue
        if abs(plan.s[k] - piece_s[b + 1]) > REST:
            continue
        m = phases_of_ramp(past[b])
        if k < m or k + m > len(plan.j):
            continue
        common = overlap_at(path, plan, k, b, past[b], limits, u)
        if common > 0.0:
            at_time(plan.t[k] - common, k - m, plan, begins)
            at_time(plan.t[k] + common, k + m - 1, plan, ends)
            cuts.after[b] = plan.s[k] - begins[S]
            cuts.before[b + 1] = ends[S] - plan.s[k]
        most = max(cuts.after[b] / length[b], cuts.before[b + 1] / length[b + 1])
        if past[b] > 0.0 and (common <= 2.0 * BACK * past[b] or most > LEGS_SHARE):
            return -1, cuts
        if common > 0.0:
            found = 1
            cuts.common[b] = common
            cuts.rest[b] = k
    for b in range(pieces):
        if past[b] > 0.0 and cuts.common[b] == 0.0:
            return -1, cuts
    return found, cuts


@njit
def copy_phases(
    plan: PlanArrays, first: int, end: int, out: PlanArrays, progress: Progress
) -> None:
    """Append the phases first .. end - 1 at their new times and arc lengths."""
    written = progress.counts[PHASES]
    earlier, shift = progress.places[EARLIER], progress.places[SHIFT]
    for k in range(first, end):
        out.t[written] = plan.t[k] - earlier
        out.s[written] = plan.s[k] + shift
        out.v[written] = plan.v[k]
        out.a[written] = plan.a[k]
        out.j[written] = plan.j[k]
        written += 1
    progress.counts[PHASES] = written


@njit
def copy_piece(
    path: PathArrays,
    b: int,
    lowest: int,
    cuts: Cuts,
    out: PathArrays,
    out_s: Floats,
    progress: Progress,
) -> None:
    """Append piece ``b`` without the parts that overlaps take.

    Args:
        path: the path.
        b: the piece.
        lowest: index in the old data of the first record in the new data.
        cuts: the overlaps.
        out: the new path.
        out_s: receives the arc length at the start of the piece.
        progress: state of the construction.
    """
    count, data = progress.counts[PIECES], out.pieces.data
    at = path.pieces.at[b] - lowest
    before, after = cuts.before[b], cuts.after[b]
    out.pieces.kind[count] = path.pieces.kind[b]
    out.pieces.at[count] = at
    out.length[count] = path.length[b]
    if before > 0.0 or after > 0.0:
        used = progress.counts[NUMBERS]
        out.pieces.at[count] = used
        progress.counts[NUMBERS] = write_line(data, used, at, before, after)
        out.length[count] = data[used + LENGTH]
    out.feed[count] = path.feed[b]
    out.line[count] = path.line[b]
    out.stop_after[count] = path.stop_after[b]
    out.tolerance[count] = 0.0 if cuts.common[b] > 0.0 else path.tolerance[b]
    out_s[count] = progress.places[REACHED]
    progress.places[REACHED] += out.length[count]
    progress.counts[PIECES] += 1


@njit
def begin_overlap(path: PathArrays, b: int, out: PathArrays, count: int, corner: Corner) -> None:
    """Prepare ``corner`` for the overlap behind piece ``b``, written as piece ``count`` - 1."""
    data, at = path.pieces.data, path.pieces.at
    n = len(corner.place)
    left = out.pieces.at[count - 1] + START + n
    directions(data, at[b], data, at[b + 1], corner.u)
    for i in range(n):
        corner.place[i] = data[at[b + 1] + START + i]
        corner.ends[3, i] = out.pieces.data[left + i]


@njit
def control_points(
    plan: PlanArrays,
    cuts: Cuts,
    b: int,
    first: int,
    second: int,
    t: float,
    until: float,
    corner: Corner,
) -> None:
    """Compute the Bezier curve of the next part of an overlap.

    Args:
        plan: the phases.
        cuts: the overlaps.
        b: the piece before the overlap.
        first: the phase of the ramp to rest.
        second: the phase of the ramp from rest.
        t: start of the part, from the start of the overlap, s.
        until: its end, s.
        corner: receives the result in ``ends``, and the states at the end.
    """
    u, ends, one, two = corner.u, corner.ends, corner.state[0], corner.state[1]
    common, r = cuts.common[b], cuts.rest[b]
    rest_t, rest_s = plan.t[r], plan.s[r]
    begin = rest_t - common
    dt = until - t
    ends[0] = ends[3]
    at_time(begin + t, first, plan, one)
    at_time(rest_t + t, second, plan, two)
    for i in range(u.shape[1]):
        v = one[V] * u[0, i] + two[V] * u[1, i]
        acc = one[A] * u[0, i] + two[A] * u[1, i]
        ends[1, i] = v * dt / 3.0
        ends[2, i] = 2.0 * v * dt / 3.0 + acc * dt * dt / 6.0
    at_time(begin + until, first, plan, one)
    at_time(rest_t + until, second, plan, two)
    for i in range(u.shape[1]):
        place = corner.place[i]
        ends[3, i] = place + (one[S] - rest_s) * u[0, i] + (two[S] - rest_s) * u[1, i]
        if until == common:
            ends[3, i] = place + cuts.before[b + 1] * u[1, i]


@njit
def write_part(
    path: PathArrays,
    b: int,
    at: int,
    t: float,
    dt: float,
    out: PathArrays,
    out_plan: PlanArrays,
    progress: Progress,
) -> None:
    """Append a timed piece of the overlap behind piece ``b``, and its phase.

    The line is that of the faster move, so that the speed of a traverse is not assigned to a feed
    move.

    Args:
        path: the path.
        b: the piece before the overlap.
        at: index of the record.
        t: time at its start, in the plan so far, s.
        dt: its duration, s.
        out: the new path.
        out_plan: its phases.
        progress: state of the construction.
    """
    counts, places = progress.counts, progress.places
    count, written = counts[PIECES], counts[PHASES]
    length = out.pieces.data[at + LENGTH]
    out.pieces.kind[count] = SPAN
    out.pieces.at[count] = at
    out.length[count] = length
    feed1, feed2 = path.feed[b], path.feed[b + 1]
    both = feed1 == feed1 and feed2 == feed2
    out.feed[count] = max(feed1, feed2) if both else math.nan
    faster = feed1 < feed2 or (feed1 == feed1 and feed2 != feed2)
    out.line[count] = path.line[b + 1] if faster else path.line[b]
    out.stop_after[count] = False
    out.tolerance[count] = 0.0
    out_plan.piece_s[count] = places[REACHED]
    out_plan.t[written] = t - places[EARLIER]
    out_plan.s[written] = places[REACHED]
    out_plan.v[written] = length / dt
    out_plan.a[written] = 0.0
    out_plan.j[written] = 0.0
    counts[PIECES] += 1
    counts[PHASES] += 1
    places[REACHED] += length


@njit
def end_overlap(
    plan: PlanArrays,
    cuts: Cuts,
    b: int,
    m: int,
    corner: Corner,
    out_plan: PlanArrays,
    progress: Progress,
) -> None:
    """Append the rest of the phase of the second ramp, and shift the phases behind it.

    Args:
        plan: the phases.
        cuts: the overlaps.
        b: the piece before the overlap.
        m: number of phases on either side that reach into it.
        corner: the state at the end of the overlap.
        out_plan: the new phases.
        progress: state of the construction.
    """
    places, two = progress.places, corner.state[1]
    common, r = cuts.common[b], cuts.rest[b]
    written = progress.counts[PHASES]
    places[EARLIER] += common
    out_plan.t[written] = (plan.t[r] - common) + common - (places[EARLIER] - common)
    out_plan.s[written] = places[REACHED]
    out_plan.v[written] = two[V]
    out_plan.a[written] = two[A]
    out_plan.j[written] = plan.j[r + m - 1]
    progress.counts[PHASES] += 1
    places[SHIFT] = places[REACHED] - (plan.s[r] + cuts.before[b + 1])


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

    Both motions of an overlap go on with constant jerks up to the next end of a phase of either:
    there a timed piece ends.

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
    for k in range(pieces):
        lowest = min(lowest, path.pieces.at[k])
        used = max(used, record_end(path.pieces, k))
    used -= lowest
    out.pieces.data[:used] = path.pieces.data[lowest : lowest + used]
    progress = Progress(np.zeros(3, np.int64), np.zeros(3))
    counts, places = progress.counts, progress.places
    counts[NUMBERS] = used
    n = int(path.pieces.data[path.pieces.at[0]])
    q = np.zeros((4, n))
    corner = Corner(np.zeros((2, n)), np.zeros(n), np.zeros((4, n)), np.zeros((2, 4)))
    ends = corner.ends
    k = 0
    for b in range(pieces):
        copy_piece(path, b, lowest, cuts, out, out_plan.piece_s, progress)
        common, r = cuts.common[b], cuts.rest[b]
        if common == 0.0:
            continue
        m = phases_of_ramp(past[b])
        # The phases up to the start of the second ramp.
        copy_phases(plan, k, r - m + 1, out_plan, progress)
        begin_overlap(path, b, out, counts[PIECES], corner)
        left = out.pieces.at[counts[PIECES] - 1]
        begin = plan.t[r] - common
        first = r - m
        second = r
        t = 0.0
        while t < common:
            until = min(common, plan.t[first + 1] - begin, plan.t[second + 1] - plan.t[r])
            if first + 1 == r and second + 1 == r + m:
                until = common
            control_points(plan, cuts, b, first, second, t, until, corner)
            used = counts[NUMBERS]
            counts[NUMBERS] = write_timed(
                out.pieces.data, used, left, ends[0], ends[1], ends[2], ends[3], q
            )
            write_part(path, b, used, begin + t, until - t, out, out_plan, progress)
            t = until
            if plan.t[first + 1] - begin <= t and first + 1 < r:
                first += 1
            if plan.t[second + 1] - plan.t[r] <= t and second + 1 < r + m:
                second += 1
        end_overlap(plan, cuts, b, m, corner, out_plan, progress)
        k = r + m
    out_plan.piece_s[counts[PIECES]] = places[REACHED]
    copy_phases(plan, k, len(plan.j), out_plan, progress)
    last, end = counts[PHASES], len(plan.j)
    out_plan.t[last] = plan.t[end] - places[EARLIER]
    out_plan.s[last] = plan.s[end] + places[SHIFT]
    out_plan.v[last] = plan.v[end]
    out_plan.a[last] = plan.a[end]
    return counts[PIECES], counts[PHASES], counts[NUMBERS]


@njit
def overlap_size(axes: int) -> int:
    """Return the largest size of the records of an overlap and the line before it, in numbers."""
    return PIECES_OF_CORNER * (TIMED_SIZE + axes * TIMED_SIZE_PER_AXIS) + START + 2 * axes
