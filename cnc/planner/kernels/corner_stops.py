r"""A plan in which the motion no longer stops on corners under a tolerance.

The part of the motion near a chain of stops is replaced by the fastest one within the tolerance
(:mod:`cnc.planner.kernels.corner_motion`). It begins and ends with the speed and acceleration of
the plan.

        v |``\                 ,--            ``\              ,--
          |   \               /                  \            /
          |    `.           ,'          ──►       `-.______,-'
          |______`-.____,-'______ t                 a  b

The path gets a timed piece (:mod:`cnc.planner.kernels.timed`) for each step of that motion, the
lines beside it become shorter, those between its corners are left out, and all later phases begin
earlier.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import LENGTH, START, Floats
from cnc.planner.kernels.arrays import LimitArrays, PathArrays, PlanArrays
from cnc.planner.kernels.corner_legs import LEG_STEPS, MOST_DIRECTIONS, MOST_STEPS
from cnc.planner.kernels.corner_pieces import (
    EARLIER,
    NUMBERS,
    PHASES,
    PIECES,
    REACHED,
    SHIFT,
    Progress,
    TimedSteps,
    begun,
    steps_size,
    write_steps,
)
from cnc.planner.kernels.corner_places import (
    MOST_CORNERS,
    Chain,
    chain_from,
    passes_corner,
    phase_of_time,
    state_at,
)
from cnc.planner.kernels.corner_rows import new_rows
from cnc.planner.kernels.corner_search import (
    Solutions,
    find_motion,
    goes_on,
    times_of_motion,
)
from cnc.planner.kernels.legs import write_line

CORNER_STEPS = 2 * LEG_STEPS
"""Largest number of steps for each corner."""


WORTH = 2e-3
"""Part of the time since the chain before that a search has to promise."""

FALL, RISE = 0.25, 1.15
"""Factors of the promised gain: of a search that gained less, and of a chain that is left out. So
one of ten chains is sought where all gain too little.
"""


class Before(NamedTuple):
    """The motion before a plan.

    Attributes:
        shared: whether the first leg begins with a corner that the motion passes.
        time: from the end of the last chain of corners to the start of the plan, s.
    """

    shared: bool
    time: float


class PassedChains(NamedTuple):
    """The chains of stops that motions past corners replace.

    Attributes:
        begin: (corners,): time in the old plan at which the motion there begins, s.
        end: (corners,): time in the old plan at which it ends.
        earlier: (corners,): time by which the phases behind it are earlier, s.
    """

    begin: Floats
    end: Floats
    earlier: Floats


@njit
def _chain_and_times(
    path: PathArrays,
    plan: PlanArrays,
    b: int,
    shared: bool,
    bound: Floats,
    limits: LimitArrays,
) -> tuple[Chain, tuple[float, float]]:
    """Return the chain that begins behind piece ``b``, and the times of the motion past it, s.

    A chain ends before a corner at which the motion has to rest.
    """
    most = MOST_CORNERS
    while True:
        chain = chain_from(path, plan, b, shared, bound, limits, most)
        times = times_of_motion(path, plan, chain, shared, bound, limits)
        if chain.last == b or goes_on(times, plan, limits)[1]:
            return chain, times
        most = chain.last - b


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
    earlier: Before,
    bound: Floats,
    limits: LimitArrays,
    travel: Floats,
    solutions: Solutions,
    out: PathArrays,
    out_plan: PlanArrays,
    chains: PassedChains,
) -> tuple[int, int, int, int, float]:
    """Replace the motion at the stops on corners of a plan.

    A search promises to save the part of its motion that the last ones saved. Where that is too
    little of the motion since the chain before, all corners of the chain stay stops.

    Args:
        path: of the motion.
        plan: its phases.
        earlier: the motion before.
        bound: (pieces,): largest feeds, mm/s.
        limits: of the machine.
        travel: (2, axes): lowest and highest positions, mm.
        solutions: of earlier searches.
        out: space for the new path: CORNER_STEPS + 1 more pieces for each corner. The data needs
            the size of all records, and :func:`corner_size` for each corner and one more.
        out_plan: space for its phases: CORNER_STEPS + 1 more for each corner.
        chains: receives the chains of corners that are passed.

    Returns:
        The numbers of pieces, of phases, of numbers in records of the new motion, and of chains
        that are passed; the time from the end of the last chain to the end of the plan, s.
    """
    pieces, end = len(path.length), len(plan.j)
    progress, lowest = begun(path, out)
    data = out.pieces.data
    counts, places = progress.counts, progress.places
    n = len(limits.axis_jerk)
    given = np.empty((2, n))
    rows = new_rows(MOST_STEPS, n, MOST_DIRECTIONS)
    passed = 0
    k = 0
    before = 0.0
    reached = -earlier.time
    left_out = -1
    b = 0
    while b < pieces:
        count = counts[PIECES]
        at = path.pieces.at[b] - lowest
        after = 0.0
        if b > left_out and passes_corner(path, plan, b, bound, limits):
            chain, times = _chain_and_times(path, plan, b, earlier.shared, bound, limits)
            duration, promised = times[1] - times[0], solutions.promised
            if promised[0] * duration < WORTH * (times[1] - reached):
                promised[0] *= RISE
                left_out = chain.last
            else:
                motion = find_motion(
                    path, plan, chain, times, bound, limits, travel, solutions, rows
                )
                if solutions.left[0] > 0.0:
                    promised[0] = max(FALL * promised[0], motion.saved / duration)
                if motion.saved > 0.0:
                    after = motion.before
            reached = max(reached, times[1])
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
        b += 1
        if after == 0.0:
            continue
        first = phase_of_time(motion.begin, plan)
        _copy_phases(
            plan, k, first + (1 if motion.begin > plan.t[first] else 0), out_plan, progress
        )
        left, corner = out.pieces.at[count] + START + n, path.pieces.at[chain.first + 1] + START
        for i in range(n):
            given[0, i], given[1, i] = data[left + i], path.pieces.data[corner + i]
        steps = TimedSteps(motion.begin, motion.basis, motion.tube.leg, motion.t, motion.c)
        write_steps(path, chain.first, out.pieces.at[count], given, steps, out, out_plan, progress)
        # The rest of the phase in which the motion ends.
        k = phase_of_time(motion.end, plan)
        s, v, a = state_at(motion.end, k, plan)
        places[EARLIER] += motion.saved
        chains.begin[passed] = motion.begin
        chains.end[passed] = motion.end
        chains.earlier[passed] = places[EARLIER]
        passed += 1
        written = counts[PHASES]
        out_plan.t[written] = motion.end - places[EARLIER]
        out_plan.s[written] = places[REACHED]
        out_plan.v[written] = v
        out_plan.a[written] = a
        out_plan.j[written] = plan.j[k]
        counts[PHASES] += 1
        k += 1
        before = motion.after
        places[SHIFT] = places[REACHED] - s
        b = chain.last + 1
    _copy_phases(plan, k, end, out_plan, progress)
    out_plan.piece_s[counts[PIECES]] = places[REACHED]
    last = counts[PHASES]
    out_plan.t[last] = plan.t[end] - places[EARLIER]
    out_plan.s[last] = plan.s[end] + places[SHIFT]
    out_plan.v[last] = plan.v[end]
    out_plan.a[last] = plan.a[end]
    alone = plan.t[end] - reached
    return counts[PIECES], counts[PHASES], counts[NUMBERS], passed, alone


@njit
def corner_size(axes: int) -> int:
    """Return the largest size of the records of a corner and the line before it, in numbers."""
    return steps_size(CORNER_STEPS, axes) + START + 2 * axes
