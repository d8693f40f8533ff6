"""The timed pieces of a motion past corners, written into a path and its plan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import LENGTH, SPAN, Floats, Ints
from cnc.planner.kernels.arrays import PathArrays, PlanArrays
from cnc.planner.kernels.corner_tube import EARLY, FIRST_POINT, LATE, write_stencil
from cnc.planner.kernels.legs import record_end
from cnc.planner.kernels.timed import TIMED_SIZE, TIMED_SIZE_PER_AXIS, write_timed


class TimedSteps(NamedTuple):
    """A motion past corners, or to rest.

    Attributes:
        begin: time at its start, s.
        basis: (d, axes): the directions in which its control points are given.
        leg: (steps,): the leg of each step.
        t: (steps + 5,): the knots, from its start, s.
        c: (steps + 3, d): control points, from the first corner, mm.
    """

    begin: float
    basis: Floats
    leg: Ints
    t: Floats
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


@njit
def begun(path: PathArrays, out: PathArrays) -> tuple[Progress, int]:
    """Begin a new path with the records of another one; new records come behind them.

    Returns:
        The progress, and by how much the indices of records are smaller in ``out``.
    """
    lowest = path.pieces.at[0]
    used = 0
    for b in range(len(path.length)):
        lowest = min(lowest, path.pieces.at[b])
        used = max(used, record_end(path.pieces, b))
    used -= lowest
    for i in range(used):
        out.pieces.data[i] = path.pieces.data[lowest + i]
    progress = Progress(np.zeros(3, np.int64), np.zeros(3))
    progress.counts[NUMBERS] = used
    return progress, lowest


@njit
def write_steps(
    path: PathArrays,
    first: int,
    like: int,
    given: Floats,
    timed: TimedSteps,
    out: PathArrays,
    out_plan: PlanArrays,
    progress: Progress,
) -> None:
    """Append the timed pieces of a motion, and a phase for each.

    Args:
        path: the legs, which are lines.
        first: the first leg.
        like: index in the records of ``out`` of one with the same metric axes.
        given: (2, axes): where the motion begins, and the first corner, mm.
        timed: the motion.
        out: receives the pieces.
        out_plan: receives the phases.
        progress: what is written so far.
    """
    counts, places = progress.counts, progress.places
    basis, t, c = timed.basis, timed.t, timed.c
    d, n = basis.shape
    q = np.empty((4, n))
    ends = np.empty((4, n))
    for i in range(n):
        ends[3, i] = given[0, i]
    weights, points = np.empty(4), np.empty((3, d))
    steps = len(timed.leg)
    for k in range(steps):
        for place in range(3):
            # The last point of a step is the first of the next.
            kind, at = (EARLY, LATE, FIRST_POINT)[place], k + (1 if place == 2 else 0)
            write_stencil(kind, at, t, weights)
            for r in range(d):
                points[place, r] = 0.0
                for j in range(4 if at < steps else 3):
                    points[place, r] += weights[j] * c[at + j, r]
        for i in range(n):
            start = ends[3, i]
            ends[0, i] = start
            for place in range(3):
                at_place = given[1, i]
                for r in range(d):
                    at_place += basis[r, i] * points[place, r]
                ends[place + 1, i] = at_place if place == 2 else at_place - start
        used, count, written = counts[NUMBERS], counts[PIECES], counts[PHASES]
        counts[NUMBERS] = write_timed(
            out.pieces.data, used, like, ends[0], ends[1], ends[2], ends[3], q
        )
        length = out.pieces.data[used + LENGTH]
        leg = first + timed.leg[k]
        lasts = t[k + 3] - t[k + 2]
        out.pieces.kind[count] = SPAN
        out.pieces.at[count] = used
        out.length[count] = length
        out.feed[count] = path.feed[leg]
        out.line[count] = path.line[leg]
        out.stop_after[count] = False
        out.tolerance[count] = 0.0
        out_plan.piece_s[count] = places[REACHED]
        out_plan.t[written] = timed.begin + t[k + 2] - places[EARLIER]
        out_plan.s[written] = places[REACHED]
        out_plan.v[written] = length / lasts
        out_plan.a[written] = 0.0
        out_plan.j[written] = 0.0
        counts[PIECES] += 1
        counts[PHASES] += 1
        places[REACHED] += length


@njit
def steps_size(steps: int, axes: int) -> int:
    """Return the largest size of the records of so many steps, in numbers."""
    return steps * (TIMED_SIZE + axes * TIMED_SIZE_PER_AXIS)
