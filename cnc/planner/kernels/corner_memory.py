"""Motions past corners of earlier searches, taken again.

A plan that is cut elsewhere asks for the same motion, with the same input to the last bit. It is
taken as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.planner.kernels.corner_legs import GROUPS, MOST_DIRECTIONS, MOST_STEPS
from cnc.planner.kernels.corner_motion import fastest_motion
from cnc.planner.kernels.corner_places import MOST_CORNERS
from cnc.planner.kernels.corner_rows import Rows
from cnc.planner.kernels.corner_tube import Tube

SOLUTIONS = 64
"""Motions that are kept."""

NUMBERS = 1536
"""Most numbers of the input of a motion that is kept."""

WORK = 300_000.0
"""Work that each second of motion allows, about 0.1 s: rows of the steps of Newton's method.
A count does not depend on the machine, as a clock would.
"""

FIRST_WORK = 3_000_000.0
"""Work that is allowed at first: that of about 100 corners."""


class Solutions(NamedTuple):
    """Results of searches, kept with their input.

    Attributes:
        input: (SOLUTIONS, NUMBERS): the input of each search; NaN for none.
        length: (SOLUTIONS,): number of these numbers.
        points: (SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS): its control points.
        spans: (SOLUTIONS, groups): logarithms of the durations of its groups.
        exists: (SOLUTIONS,): 1 if there is a motion, or 0.
        next: (1,): the one to be replaced next.
        work: (1,): that of all searches: rows of the steps of Newton's method, added up.
        most_work: (1,): above this nothing is sought. It grows with the motion.
    """

    input: Floats
    length: Ints
    points: Floats
    spans: Floats
    exists: Ints
    next: Ints
    work: Ints
    most_work: Floats


def new_solutions() -> Solutions:
    """Return space for solutions."""
    return Solutions(
        np.full((SOLUTIONS, NUMBERS), math.nan),
        np.zeros(SOLUTIONS, np.int64),
        np.empty((SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS)),
        np.empty((SOLUTIONS, GROUPS * (MOST_CORNERS + 1))),
        np.zeros(SOLUTIONS, np.int64),
        np.zeros(1, np.int64),
        np.zeros(1, np.int64),
        np.full(1, FIRST_WORK),
    )


@njit
def allow_work(solutions: Solutions, duration: float) -> None:
    """Allow the work for so many seconds of motion. Of what is not used, FIRST_WORK stays."""
    left = solutions.most_work[0] - solutions.work[0] + WORK * duration
    solutions.most_work[0] = solutions.work[0] + min(left, FIRST_WORK + WORK * duration)


@njit
def solve(tube: Tube, rows: Rows, c: Floats, spans: Floats, solutions: Solutions) -> bool:
    """Make a first guess of the motion the fastest one; return whether there is one.

    Nothing is sought where the searches before took more work than the motion allows.

    Args:
        tube: the legs, and the states at both ends.
        rows: space for the limits.
        c: (steps + 3, d): control points, replaced by those of the result.
        spans: (groups,): logarithms of the durations of the groups, replaced likewise.
        solutions: of earlier searches, receives the result.
    """
    wanted = np.empty(NUMBERS)
    count = _write_input(tube, c, spans, wanted)
    points, d = c.shape
    k = _same_search(wanted, count, solutions) if count else -1
    if k >= 0:
        c[:] = solutions.points[k, :points, :d]
        spans[:] = solutions.spans[k, : len(spans)]
        return bool(solutions.exists[k] > 0)
    if solutions.work[0] > solutions.most_work[0]:
        return False
    rows.work[0] = 0
    exists = fastest_motion(tube, rows, c, spans)
    solutions.work[0] += rows.work[0]
    if count:
        k = solutions.next[0]
        solutions.next[0] = (k + 1) % SOLUTIONS
        solutions.input[k] = wanted
        solutions.length[k] = count
        solutions.points[k, :points, :d] = c
        solutions.spans[k, : len(spans)] = spans
        solutions.exists[k] = 1 if exists else 0
    return bool(exists)


@njit
def _write_input(tube: Tube, c: Floats, spans: Floats, to: Floats) -> int:
    """Write all that the search depends on, but for the machine's limits; return the count.

    ``c`` comes last. The count is 0 where there is no space.
    """
    parts = (
        tube.feed,
        tube.along.ravel(),
        tube.start.ravel(),
        tube.ends.ravel(),
        tube.axes.ravel(),
        tube.travel.ravel(),
        spans,
        c.ravel(),
    )
    to[0] = tube.tolerance
    at = 1
    for part in parts:
        if at + len(part) > NUMBERS:
            return 0
        to[at : at + len(part)] = part
        at += len(part)
    return at


@njit
def _same_search(wanted: Floats, count: int, solutions: Solutions) -> int:
    """Return the index of the search with the same input, or -1."""
    for k in range(SOLUTIONS):
        same = solutions.length[k] == count
        i = 0
        while same and i < count:
            same = wanted[i] == solutions.input[k, i]
            i += 1
        if same:
            return k
    return -1
