r"""A plan in which the motion no longer stops on corners under a tolerance.

The part of the motion near a stop is replaced by the fastest one within the tolerance
(:mod:`cnc.kernels.planner.corner_motion`). It begins and ends with the speed and acceleration of
the plan.

        v |``\                 ,--            ``\              ,--
          |   \               /                  \            /
          |    `.           ,'          ──►       `-.______,-'
          |______`-.____,-'______ t                 a  b

The path gets a timed piece (:mod:`cnc.kernels.planner.timed`) for each step of that motion, the
lines beside it become shorter, and all later phases begin earlier.

Where the machine limits the jerk along the path, every stop stays: the direction of a slow motion
turns fast, and takes more jerk than its axes.

What the search ends with depends on rounding. So its input is rounded to less than rounding errors
of plans reach. The same motion is found again wherever a plan is cut, and need not be searched for
twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LENGTH, LINE, SPAN, START, Floats, Ints
from cnc.kernels.planner.corner_motion import State, fastest_corner, place_ends
from cnc.kernels.planner.corner_rows import (
    POINTS,
    ROOM,
    STEPS,
    CornerLimits,
    Rows,
    new_rows,
    rows_size,
    write_rows,
)
from cnc.kernels.planner.legs import (
    LEGS_SHARE,
    REST,
    REVERSED,
    STRAIGHTEST,
    Turn,
    corner_time,
    directions,
    line_bounds,
    record_end,
    write_line,
)
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import UNSEEN
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.timed import TIMED_SIZE, TIMED_SIZE_PER_AXIS, write_timed

REACH = 4.0
"""The motion is replaced for so many times :func:`corner_time` before and behind a stop."""

PARTS = (1.0, 0.6)
"""Parts of the reach that are tried. The steps of a short motion are finer."""

UNTOUCHED = 1e-3
"""Part of the time to the start or end of a plan that stays as it is."""

SHORTEST_STEP = 1e-6
"""s; steps of a corner are longer, or it stays a stop."""

GAIN = 1e-3
"""Part of its duration that the motion at a corner has to save."""

SPARE = 0.01
"""Part of the reach by which more of a plan is held back: its start has to stay as it is."""

WITHIN = 1.0 - 1e-6
"""Part of the tolerance that is used."""

DIGITS = 27
"""Binary digits of the search's input."""

KNOWN = 64
"""Motions that are kept, so that they need not be searched for again."""


class Known(NamedTuple):
    """Motions that were found.

    Attributes:
        input: (KNOWN, numbers): what each was searched for with; nan for none.
        points: (KNOWN, POINTS, 2): its control points.
        step: (KNOWN,): duration of its steps, s; 0 if there is none.
        next: (1,): the one to be replaced next.
    """

    input: Floats
    points: Floats
    step: Floats
    next: Ints


class Scratch(NamedTuple):
    """Arrays that are used again for each corner.

    Attributes:
        rows: its limits.
        u: (2, axes): the directions of its plane: of the first leg, and at right angles.
        c: (POINTS, 2): control points of its motion.
    """

    rows: Rows
    u: Floats
    c: Floats


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


class Corner(NamedTuple):
    """The motion at a corner.

    Attributes:
        saved: time that it saves, s; 0 for a stop.
        begin: time in the plan at which it begins, s.
        end: time in the plan at which it ends, s.
        before: the state at its start.
        after: the state at its end.
        turn: index of the first step behind the corner.
        duration: of a step, s.
    """

    saved: float
    begin: float
    end: float
    before: State
    after: State
    turn: int
    duration: float


@njit
def state_at(t: float, k: int, plan: PlanArrays) -> tuple[float, float, float]:
    """Return arc length, speed and acceleration at time ``t`` by phase ``k``."""
    dt = t - plan.t[k]
    v, a, j = plan.v[k], plan.a[k], plan.j[k]
    s = plan.s[k] + dt * (v + dt * (0.5 * a + dt * j / 6.0))
    return s, v + dt * (a + 0.5 * dt * j), a + dt * j


@njit
def phase_of_time(t: float, plan: PlanArrays) -> int:
    """Return the phase at time ``t``."""
    return min(max(int(np.searchsorted(plan.t, t, side="right")) - 1, 0), len(plan.j) - 1)


@njit
def time_of(s: float, plan: PlanArrays) -> float:
    """Return the first time at which the motion is at arc length ``s``."""
    k = min(max(int(np.searchsorted(plan.s, s, side="left")) - 1, 0), len(plan.j) - 1)
    low, high = plan.t[k], plan.t[k + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        if state_at(middle, k, plan)[0] < s:
            low = middle
        else:
            high = middle
    return float(high)


@njit
def leaves_path(path: PathArrays, b: int) -> bool:
    """Return whether the motion may leave the path at the end of piece ``b``."""
    return bool(
        0 <= b < len(path.pieces.kind)
        and path.tolerance[b] > 0.0
        and not path.stop_after[b]
        and path.pieces.kind[b] == LINE
    )


@njit
def rest_at(path: PathArrays, plan: PlanArrays, b: int) -> int:
    """Return the phase that begins with a rest on the corner behind piece ``b``, or -1."""
    following = b + 1 < len(path.pieces.kind) and path.pieces.kind[b + 1] == LINE
    if not (following and leaves_path(path, b)):
        return -1
    k = int(np.searchsorted(plan.s, plan.piece_s[b + 1] - REST))
    while 0 < k < len(plan.j) and plan.s[k] <= plan.piece_s[b + 1] + REST:
        if plan.v[k] == 0.0 and plan.a[k] == 0.0:
            return k
        k += 1
    return -1


@njit
def count_corners(path: PathArrays, plan: PlanArrays) -> int:
    """Return the number of stops on corners at which the motion may leave the path."""
    count = 0
    for b in range(len(path.pieces.kind)):
        if rest_at(path, plan, b) >= 0:
            count += 1
    return count


@njit
def legs_used(path: PathArrays, b: int, shared: bool) -> tuple[float, float]:
    """Return the lengths that the motion at the corner behind piece ``b`` may take of its legs, mm.

    A leg between two corners belongs to both. ``shared``: whether the first leg of the path begins
    with a corner that the motion passes.
    """
    before = leaves_path(path, b - 1) if b > 0 else shared
    share1 = LEGS_SHARE if before else 2.0 * LEGS_SHARE
    share2 = LEGS_SHARE if leaves_path(path, b + 1) else 2.0 * LEGS_SHARE
    return share1 * path.length[b], share2 * path.length[b + 1]


@njit
def reach_of(
    path: PathArrays, b: int, bound: Floats, limits: LimitArrays, u: Floats
) -> tuple[float, float]:
    """Return the times before and behind the stop behind piece ``b`` that may change, s.

    They are 0 where the corner stays a stop. ``u`` (2, axes) receives the directions of its legs.
    """
    data, at = path.pieces.data, path.pieces.at
    turn = directions(data, at[b], data, at[b + 1], u)
    if not STRAIGHTEST < turn.sine < REVERSED:
        return 0.0, 0.0
    before = corner_time(line_bounds(u[0], bound[b], limits).j, turn, path.tolerance[b])
    after = corner_time(line_bounds(u[1], bound[b + 1], limits).j, turn, path.tolerance[b])
    return REACH * before, REACH * after


@njit
def _limits_of(
    path: PathArrays,
    b: int,
    feeds: tuple[float, float],
    limits: LimitArrays,
    travel: Floats,
    u: Floats,
) -> CornerLimits:
    """Return the limits in the plane of a corner; ``u[1]`` becomes its second direction."""
    n = u.shape[1]
    data, at = path.pieces.data, path.pieces.at
    turn = directions(data, at[b], data, at[b + 1], u)
    cos = 1.0 - 2.0 * turn.sine * turn.sine
    sin = 2.0 * turn.sine * math.sqrt(1.0 - turn.sine * turn.sine)
    eps = path.tolerance[b]
    axes, space = np.empty((n, 2)), np.empty((2, n))
    widest = 1.0
    for i in range(n):
        u[1, i] = (u[1, i] - cos * u[0, i]) / sin
        axes[i, 0] = u[0, i]
        axes[i, 1] = u[1, i]
        wide = math.hypot(axes[i, 0], axes[i, 1])
        widest = max(widest, wide)
        corner = data[at[b + 1] + START + i]
        # An end of the travel that is out of reach is none, so that it makes no other input.
        for side in range(2):
            room = travel[side, i] - corner
            space[side, i] = room if abs(room) < ROOM * eps * wide else (side - 0.5) * math.inf
    bend = 8.0 * limits.chord_error / limits.period**2
    pull = min(limits.tangential_acceleration, limits.normal_acceleration, bend)
    return CornerLimits(
        axes,
        limits.axis_velocity * (1.0 - UNSEEN),
        limits.axis_acceleration * (1.0 - UNSEEN),
        limits.axis_jerk * (1.0 - 2.0 * UNSEEN),
        space,
        feeds,
        pull * (1.0 - UNSEEN),
        WITHIN * eps / widest,
        (cos, sin),
    )


@njit
def _rounded(value: float, scale: float) -> float:
    """Return the value rounded to DIGITS binary digits of the scale."""
    unit = 2.0 ** (math.floor(math.log2(scale)) - DIGITS)
    return math.floor(value / unit + 0.5) * unit


def new_known(axes: int) -> Known:
    """Return space for motions that are found."""
    numbers = 13 + 4 * axes + 2 * POINTS
    return Known(
        np.full((KNOWN, numbers), math.nan),
        np.empty((KNOWN, POINTS, 2)),
        np.zeros(KNOWN),
        np.zeros(1, np.int64),
    )


@njit
def _write_input(
    here: CornerLimits,
    corner: int,
    before: State,
    after: State,
    c: Floats,
    h: float,
    to: Floats,
) -> None:
    """Write all that the search depends on, but for the machine's limits."""
    to[0], to[1], to[2] = before
    to[3], to[4], to[5] = after
    to[6], to[7] = here.feed
    to[8], to[9] = here.turn
    to[10] = here.tolerance
    to[11] = h
    to[12] = corner
    at = 13
    for i in range(len(here.jerk)):
        to[at], to[at + 1] = here.axes[i, 0], here.axes[i, 1]
        to[at + 2], to[at + 3] = here.travel[0, i], here.travel[1, i]
        at += 4
    for k in range(POINTS):
        to[at], to[at + 1] = c[k, 0], c[k, 1]
        at += 2


@njit
def _known_as(wanted: Floats, known: Known) -> int:
    """Return the index of the motion that was found with the same input, or -1."""
    for k in range(KNOWN):
        same = True
        for i in range(len(wanted)):
            if wanted[i] != known.input[k, i]:
                same = False
                break
        if same:
            return k
    return -1


@njit
def _passed(
    plan: PlanArrays,
    corner: float,
    times: tuple[float, float],
    middle: int,
    here: CornerLimits,
    known: Known,
    scratch: Scratch,
) -> Corner:
    """Return the motion at a corner between two times of the plan.

    Args:
        plan: its phases.
        corner: arc length of the corner, mm.
        times: of the start and of the end, s.
        middle: the step that begins at the rest.
        here: limits in the plane of the corner.
        known: the motions that were found before.
        scratch: receives the control points.
    """
    begin, end = times
    c = scratch.c
    none = State(0.0, 0.0, 0.0)
    stop = Corner(0.0, begin, end, none, none, 0, 0.0)
    s1, v1, a1 = state_at(begin, phase_of_time(begin, plan), plan)
    s2, v2, a2 = state_at(end, phase_of_time(end, plan), plan)
    first, second = State(corner - s1, v1, a1), State(s2 - corner, v2, a2)
    length, time = first.s + second.s, end - begin
    h = time / STEPS
    if not (h > SHORTEST_STEP and first.s > REST and second.s > REST):
        return stop
    # The first and the last difference of control points are given.
    if v1 + 0.5 * h * a1 > here.feed[0] or v2 - 0.5 * h * a2 > here.feed[1]:
        return stop
    for k in range(POINTS):
        now = min(max(begin + (k - 1.0) * h, plan.t[0]), plan.t[-1])
        s = state_at(now, phase_of_time(now, plan), plan)[0] - corner
        on = _rounded(s, length)
        c[k, 0] = on if on <= 0.0 else on * here.turn[0]
        c[k, 1] = 0.0 if on <= 0.0 else on * here.turn[1]
    speed, pull = length / time, length / (time * time)
    before = State(_rounded(first.s, length), _rounded(v1, speed), _rounded(a1, pull))
    after = State(_rounded(second.s, length), _rounded(v2, speed), _rounded(a2, pull))
    h = _rounded(h, h)
    wanted = np.empty(known.input.shape[1])
    _write_input(here, middle, before, after, c, h, wanted)
    k = _known_as(wanted, known)
    if k < 0:
        k = known.next[0]
        write_rows(here, middle, scratch.rows)
        known.step[k] = fastest_corner(scratch.rows, here, before, after, c, h)
        known.points[k] = c
        known.input[k] = wanted
        known.next[0] = (k + 1) % KNOWN
    step = known.step[k]
    saved = time - STEPS * step
    if step < SHORTEST_STEP or saved < GAIN * time:
        return stop
    c[:] = known.points[k]
    place_ends(c, step, first, second, here.turn)
    return Corner(saved, begin, end, first, second, middle, step)


@njit
def find_motion(
    path: PathArrays,
    plan: PlanArrays,
    b: int,
    rest: int,
    shared: bool,
    bound: Floats,
    limits: LimitArrays,
    travel: Floats,
    known: Known,
    scratch: Scratch,
) -> Corner:
    """Return the motion at a corner.

    Args:
        path: of the motion.
        plan: its phases.
        b: the piece before the corner.
        rest: the phase that begins with the rest there.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
        travel: (2, axes): lowest and highest positions, mm.
        known: the motions that were found before.
        scratch: receives the directions of the plane and the control points.
    """
    none, u = State(0.0, 0.0, 0.0), scratch.u
    best = np.empty((POINTS, 2))
    found = Corner(0.0, 0.0, 0.0, none, none, 0, 0.0)
    reach1, reach2 = reach_of(path, b, bound, limits, u)
    if reach1 == 0.0:
        return found
    corner, t = plan.piece_s[b + 1], plan.t[rest]
    before, after = legs_used(path, b, shared)
    earliest = max(
        time_of(corner - before, plan),
        plan.t[0] + UNTOUCHED * (t - plan.t[0]),
    )
    latest = min(
        time_of(corner + after, plan),
        plan.t[-1] - UNTOUCHED * (plan.t[-1] - t),
    )
    feeds = (bound[b], bound[b + 1])
    here = _limits_of(path, b, feeds, limits, travel, u)
    for part in PARTS:
        first, second = min(part * reach1, t - earliest), min(part * reach2, latest - t)
        # The rest is between two steps, because the direction of the plan's jerk changes there.
        corner_step = min(max(round(STEPS * first / (first + second)), 3), STEPS - 3)
        h = min(first / corner_step, second / (STEPS - corner_step))
        begin, end = t - corner_step * h, t + (STEPS - corner_step) * h
        tried = _passed(plan, corner, (begin, end), corner_step, here, known, scratch)
        if tried.saved > found.saved:
            found = tried
            best[:] = scratch.c
    scratch.c[:] = best
    return found


@njit
def _write_steps(
    path: PathArrays,
    b: int,
    corner: Corner,
    scratch: Scratch,
    out: PathArrays,
    out_plan: PlanArrays,
    progress: Progress,
) -> None:
    """Append the timed pieces of a corner behind piece ``b``, and a phase for each."""
    counts, places, u, c = progress.counts, progress.places, scratch.u, scratch.c
    n = u.shape[1]
    q = np.empty((4, n))
    ends = np.empty((4, n))
    left = out.pieces.at[counts[PIECES] - 1]
    centre = path.pieces.at[b + 1] + START
    for i in range(n):
        ends[3, i] = out.pieces.data[left + START + n + i]
    for k in range(STEPS):
        for i in range(n):
            p0 = u[0, i] * c[k, 0] + u[1, i] * c[k, 1]
            p1 = u[0, i] * c[k + 1, 0] + u[1, i] * c[k + 1, 1]
            p2 = u[0, i] * c[k + 2, 0] + u[1, i] * c[k + 2, 1]
            p3 = u[0, i] * c[k + 3, 0] + u[1, i] * c[k + 3, 1]
            start = (p0 + 4.0 * p1 + p2) / 6.0
            ends[0, i] = ends[3, i]
            ends[1, i] = (2.0 * p1 + p2) / 3.0 - start
            ends[2, i] = (p1 + 2.0 * p2) / 3.0 - start
            ends[3, i] = path.pieces.data[centre + i] + (p1 + 4.0 * p2 + p3) / 6.0
        used, count, written = counts[NUMBERS], counts[PIECES], counts[PHASES]
        counts[NUMBERS] = write_timed(
            out.pieces.data, used, left, ends[0], ends[1], ends[2], ends[3], q
        )
        length = out.pieces.data[used + LENGTH]
        leg = b if k < corner.turn else b + 1
        out.pieces.kind[count] = SPAN
        out.pieces.at[count] = used
        out.length[count] = length
        out.feed[count] = path.feed[leg]
        out.line[count] = path.line[leg]
        out.stop_after[count] = False
        out.tolerance[count] = 0.0
        out_plan.piece_s[count] = places[REACHED]
        out_plan.t[written] = corner.begin + k * corner.duration - places[EARLIER]
        out_plan.s[written] = places[REACHED]
        out_plan.v[written] = length / corner.duration
        out_plan.a[written] = 0.0
        out_plan.j[written] = 0.0
        counts[PIECES] += 1
        counts[PHASES] += 1
        places[REACHED] += length


@njit
def _copy_phases(
    plan: PlanArrays, first: int, end: int, out_plan: PlanArrays, progress: Progress
) -> None:
    """Append phases first .. end - 1 of the plan."""
    counts, places = progress.counts, progress.places
    for p in range(first, end):
        written = counts[PHASES]
        out_plan.t[written] = plan.t[p] - places[EARLIER]
        out_plan.s[written] = plan.s[p] + places[SHIFT]
        out_plan.v[written] = plan.v[p]
        out_plan.a[written] = plan.a[p]
        out_plan.j[written] = plan.j[p]
        counts[PHASES] += 1


@njit
def pass_corners(
    path: PathArrays,
    plan: PlanArrays,
    shared: bool,
    bound: Floats,
    limits: LimitArrays,
    travel: Floats,
    known: Known,
    out: PathArrays,
    out_plan: PlanArrays,
) -> tuple[int, int, int, int]:
    """Replace the motion at the stops on corners of a plan.

    Args:
        path: of the motion.
        plan: its phases.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
        travel: (2, axes): lowest and highest positions, mm.
        known: the motions that were found before.
        out: space for the new path: STEPS + 1 more pieces for each corner. The data needs the size
            of all records, and :func:`corner_size` for each corner and one more.
        out_plan: space for its phases: STEPS + 1 more for each corner.

    Returns:
        The numbers of pieces, of phases, of numbers in records of the new motion, and of corners
        that are passed.
    """
    pieces, end = len(path.length), len(plan.j)
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
    n = len(limits.axis_jerk)
    scratch = Scratch(new_rows(rows_size(n)), np.empty((2, n)), np.empty((POINTS, 2)))
    passed = 0
    k = 0
    before = 0.0
    for b in range(pieces):
        count = counts[PIECES]
        at = path.pieces.at[b] - lowest
        rest = rest_at(path, plan, b)
        after = 0.0
        if rest >= 0:
            corner = find_motion(path, plan, b, rest, shared, bound, limits, travel, known, scratch)
            if corner.saved > 0.0:
                after = corner.before.s
        out.pieces.kind[count] = path.pieces.kind[b]
        out.pieces.at[count] = at
        out.length[count] = path.length[b]
        if before > 0.0 or after > 0.0:
            out.pieces.at[count] = counts[NUMBERS]
            counts[NUMBERS] = write_line(data, counts[NUMBERS], at, before, after)
            out.length[count] = data[out.pieces.at[count] + LENGTH]
        out.feed[count] = path.feed[b]
        out.line[count] = path.line[b]
        out.stop_after[count] = path.stop_after[b]
        out.tolerance[count] = 0.0 if after > 0.0 else path.tolerance[b]
        out_plan.piece_s[count] = places[REACHED]
        places[REACHED] += out.length[count]
        counts[PIECES] += 1
        before = 0.0
        if after == 0.0:
            continue
        passed += 1
        first = phase_of_time(corner.begin, plan)
        _copy_phases(
            plan, k, first + (1 if corner.begin > plan.t[first] else 0), out_plan, progress
        )
        _write_steps(path, b, corner, scratch, out, out_plan, progress)
        # The rest of the phase in which the corner ends.
        k = phase_of_time(corner.end, plan)
        s, v, a = state_at(corner.end, k, plan)
        places[EARLIER] += corner.saved
        written = counts[PHASES]
        out_plan.t[written] = corner.end - places[EARLIER]
        out_plan.s[written] = places[REACHED]
        out_plan.v[written] = v
        out_plan.a[written] = a
        out_plan.j[written] = plan.j[k]
        counts[PHASES] += 1
        k += 1
        before = corner.after.s
        places[SHIFT] = places[REACHED] - s
    _copy_phases(plan, k, end, out_plan, progress)
    out_plan.piece_s[counts[PIECES]] = places[REACHED]
    last = counts[PHASES]
    out_plan.t[last] = plan.t[end] - places[EARLIER]
    out_plan.s[last] = plan.s[end] + places[SHIFT]
    out_plan.v[last] = plan.v[end]
    out_plan.a[last] = plan.a[end]
    return counts[PIECES], counts[PHASES], counts[NUMBERS], passed


@njit
def corner_size(axes: int) -> int:
    """Return the largest size of the records of a corner and the line before it, in numbers."""
    return STEPS * (TIMED_SIZE + axes * TIMED_SIZE_PER_AXIS) + START + 2 * axes


@njit
def first_undecided(
    path: PathArrays, plan: PlanArrays, shared: bool, bound: Floats, limits: LimitArrays
) -> float:
    """Return the time from which on a later plan may change the motion at a corner.

    That is the start of the motion at the last stop on a corner, if the plan ends before that
    motion does, or of that at a stop that may follow.

    Args:
        path: of the motion.
        plan: its phases.
        shared: whether the first leg begins with a corner that the motion passes.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
    """
    u = np.empty((2, len(limits.axis_jerk)))
    last, now = len(path.length) - 1, plan.t[-1]
    time = now
    if leaves_path(path, last):
        # The turn at the end of the last piece is not known, but the longest reach is.
        data, at = path.pieces.data, path.pieces.at[last]
        directions(data, at, data, at, u)
        line = line_bounds(u[0], bound[last], limits)
        straightest = Turn(STRAIGHTEST, STRAIGHTEST)
        reach = REACH * corner_time(line.j, straightest, path.tolerance[last])
        before = leaves_path(path, last - 1) if last > 0 else shared
        share = LEGS_SHARE if before else 2.0 * LEGS_SHARE
        begin = plan.piece_s[last + 1] - share * path.length[last]
        fastest = max(line.v, plan.v[-1])
        soonest = now + (plan.piece_s[last + 1] - plan.s[-1]) / fastest
        time = min(time, max(soonest - reach * (1.0 + SPARE), time_of(begin, plan) - SPARE * reach))
    b = last - 1
    if b >= 0:
        rest = rest_at(path, plan, b)
        reach1, reach2 = reach_of(path, b, bound, limits, u) if rest >= 0 else (0.0, 0.0)
        if reach1 > 0.0:
            length1, length2 = legs_used(path, b, shared)
            corner = plan.piece_s[b + 1]
            if plan.t[rest] + reach2 > now and plan.s[-1] < corner + length2:
                sooner = plan.t[rest] - reach1 * (1.0 + SPARE)
                begin = time_of(corner - length1, plan) - SPARE * reach1
                time = min(time, max(sooner, begin))
    return max(time, plan.t[0])
