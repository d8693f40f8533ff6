"""The motion at a corner, sought with the states of a plan beside it.

What the search ends with depends on rounding. So its input is rounded, to more than the rounding
errors of plans. But for rare cases the same motion is found wherever a plan is cut, and it need not
be sought twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import START, Floats, Ints
from cnc.kernels.planner.corner_motion import State, fastest_corner, place_ends
from cnc.kernels.planner.corner_places import legs_used, phase_of_time, reach_of, state_at, time_of
from cnc.kernels.planner.corner_rows import (
    POINTS,
    ROOM,
    STEPS,
    CornerLimits,
    Rows,
    write_rows,
)
from cnc.kernels.planner.legs import (
    REST,
    directions,
)
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import UNSEEN
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.plan_arrays import PlanArrays

PARTS = (1.0, 0.6)
"""Parts of the reach that are tried. The steps of a short motion are finer."""

UNTOUCHED = 1e-3
"""Part of the time to the start or end of a plan that stays as it is."""

SHORTEST_STEP = 1e-6
"""s; steps of a corner are longer, or it stays a stop."""

GAIN = 1e-3
"""Part of its duration that the motion at a corner has to save."""

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
