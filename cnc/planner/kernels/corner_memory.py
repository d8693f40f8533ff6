"""Motions past corners of earlier searches: taken again, or the start of a search.

A plan that is cut elsewhere asks for the same motion, with the same input to the last bit. It is
taken as it is.

Rows of a surface end in corners that are alike, and none equals another. A tube is given in the
directions of its own legs, so neither the place of a corner nor a turn or a mirror image in space
changes it, but for the limits of the axes. The search begins with the motion past the most similar
corner. Its control points are moved by the difference between the first guesses at both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.planner.kernels.corner_legs import GROUPS, MOST_DIRECTIONS, MOST_STEPS
from cnc.planner.kernels.corner_motion import fastest_motion, motion_near
from cnc.planner.kernels.corner_places import MOST_CORNERS
from cnc.planner.kernels.corner_rows import Rows
from cnc.planner.kernels.corner_tube import Tube

SOLUTIONS = 64
"""Motions that are kept."""

NUMBERS = 1536
"""Most numbers of the input of a motion that is kept."""

SIMILAR = 0.2
"""Largest distance of a similar corner: about that of a turn by 0.2 rad, or of a feed of 1.2 times
as much. Farther motions are mostly outside the limits of the other corner, and cost time in vain.
"""


class Solutions(NamedTuple):
    """Results of searches, kept with their input.

    Attributes:
        input: (SOLUTIONS, NUMBERS): the input of each search; NaN for none.
        length: (SOLUTIONS,): number of these numbers.
        shape: (SOLUTIONS, 2): numbers of legs and of directions.
        points: (SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS): its control points.
        spans: (SOLUTIONS, groups): logarithms of the durations of its groups.
        exists: (SOLUTIONS,): 1 if there is a motion, or 0.
        next: (1,): the one to be replaced next.
    """

    input: Floats
    length: Ints
    shape: Ints
    points: Floats
    spans: Floats
    exists: Ints
    next: Ints


def new_solutions() -> Solutions:
    """Return space for solutions."""
    return Solutions(
        np.full((SOLUTIONS, NUMBERS), math.nan),
        np.zeros(SOLUTIONS, np.int64),
        np.zeros((SOLUTIONS, 2), np.int64),
        np.empty((SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS)),
        np.empty((SOLUTIONS, GROUPS * (MOST_CORNERS + 1))),
        np.zeros(SOLUTIONS, np.int64),
        np.zeros(1, np.int64),
    )


@njit
def solve(tube: Tube, rows: Rows, c: Floats, spans: Floats, solutions: Solutions) -> bool:
    """Make a first guess of the motion the fastest one; return whether there is one.

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
        return solutions.exists[k] > 0
    exists = False
    k = _most_similar(tube, wanted, count, solutions) if count else -1
    if k >= 0:
        near = c + solutions.points[k, :points, :d]
        near -= solutions.input[k, count - c.size : count].reshape(c.shape)
        exists = motion_near(tube, rows, c, spans, near, solutions.spans[k, : len(spans)])
    if not exists:
        exists = fastest_motion(tube, rows, c, spans)
    if count:
        k = solutions.next[0]
        solutions.next[0] = (k + 1) % SOLUTIONS
        solutions.input[k] = wanted
        solutions.length[k] = count
        solutions.shape[k, 0], solutions.shape[k, 1] = len(tube.feed), d
        solutions.points[k, :points, :d] = c
        solutions.spans[k, : len(spans)] = spans
        solutions.exists[k] = 1 if exists else 0
    return exists


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


@njit
def _most_similar(tube: Tube, wanted: Floats, count: int, solutions: Solutions) -> int:
    """Return the index of the motion past the most similar corners, or -1."""
    legs, d = tube.start.shape
    best, least = -1, SIMILAR**2
    for k in range(SOLUTIONS):
        if (
            solutions.exists[k]
            and solutions.length[k] == count
            and solutions.shape[k, 0] == legs
            and solutions.shape[k, 1] == d
        ):
            square = _distance(wanted, solutions.input[k], legs, d, least)
            if square < least:
                best, least = k, square
    return best


@njit
def _distance(one: Floats, two: Floats, legs: int, d: int, most: float) -> float:
    """Return the square of the distance of two inputs; it is not exact above ``most``.

    Directions of the legs, lengths as parts of the whole, speeds as parts of the largest one, and
    ratios of the feeds and of the tolerances count alike.
    """
    square = (one[0] / two[0] - 1.0) ** 2
    for leg in range(legs):
        if one[1 + leg] != two[1 + leg]:
            square += (one[1 + leg] / two[1 + leg] - 1.0) ** 2
    along, start = 1 + legs, 1 + legs + legs * d
    ends = start + legs * d
    size = speed = 0.0
    for q in range(d):
        size += (one[ends + 3 * d + q] - one[ends + q]) ** 2
    for end in range(2):
        fast = 0.0
        for q in range(d):
            fast += one[ends + (3 * end + 1) * d + q] ** 2
        speed = max(speed, fast)
    if not (square < most and size > 0.0 and speed > 0.0):
        return math.inf
    for i in range(legs * d):
        square += (one[along + i] - two[along + i]) ** 2
        square += (one[start + i] - two[start + i]) ** 2 / size
    for end in range(2):
        place = ends + 3 * end * d
        for q in range(d):
            square += (one[place + q] - two[place + q]) ** 2 / size
            square += (one[place + d + q] - two[place + d + q]) ** 2 / speed
    return square
