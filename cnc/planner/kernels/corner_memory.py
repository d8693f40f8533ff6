"""Motions past corners of earlier searches: taken again, or the start of a search.

A plan that is cut elsewhere asks for the same motion, with the same input to the last bit. It is
taken as it is.

Rows of a surface end in corners that are alike, and none equals another. A tube is given in the
directions of its own legs, so neither the place of a corner nor a turn or a mirror image in space
changes it, but for the limits of the axes. The search begins with the motion past the most similar
corner, moved to the new legs. Where that motion gained too little, nothing is sought. A micrometre
more between two control points may be as much as all of the jerk, so they are moved by what changes
the jerk least, in the sum of squares.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.path.kernels.fit_program import factorise
from cnc.path.kernels.fit_program import solve as solve_band
from cnc.planner.kernels.corner_legs import GROUPS, MOST_DIRECTIONS, MOST_STEPS
from cnc.planner.kernels.corner_motion import fastest_motion, motion_near
from cnc.planner.kernels.corner_places import MOST_CORNERS
from cnc.planner.kernels.corner_rows import Rows
from cnc.planner.kernels.corner_tube import (
    CORNER,
    FIXED,
    JERK,
    Tube,
    place_ends,
    set_knots,
    write_stencil,
)

SOLUTIONS = 64
"""Motions that are kept."""

NUMBERS = 1536
"""Most numbers of the input of a motion that is kept."""

SIMILAR = 0.2
"""Largest distance of a similar corner: about that of a turn by 0.2 rad, or of a feed of 1.2 times
as much. Farther motions are mostly outside the limits of the other corner, and cost time in vain.
"""

WORK = 300_000.0
"""Work that each second of motion allows, about 0.1 s: rows of the steps of Newton's method.
A count does not depend on the machine, as a clock would.
"""

FIRST_WORK = 3_000_000.0
"""Work that is allowed at first: that of about 100 corners."""

JERK_SHARE, TOLERANCE_SHARE = 0.1, 0.2
"""Where a motion is moved to other legs, these parts of the jerk and of the tolerance count alike.
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
        gain: (SOLUTIONS,): time that it saves, s.
        next: (1,): the one to be replaced next.
        work: (1,): that of all searches: rows of the steps of Newton's method, added up.
        most_work: (1,): above this nothing is sought. It grows with the motion.
    """

    input: Floats
    length: Ints
    shape: Ints
    points: Floats
    spans: Floats
    exists: Ints
    gain: Floats
    next: Ints
    work: Ints
    most_work: Floats


def new_solutions() -> Solutions:
    """Return space for solutions."""
    return Solutions(
        np.full((SOLUTIONS, NUMBERS), math.nan),
        np.zeros(SOLUTIONS, np.int64),
        np.zeros((SOLUTIONS, 2), np.int64),
        np.empty((SOLUTIONS, MOST_STEPS + 3, MOST_DIRECTIONS)),
        np.empty((SOLUTIONS, GROUPS * (MOST_CORNERS + 1))),
        np.zeros(SOLUTIONS, np.int64),
        np.zeros(SOLUTIONS),
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
def solve(
    tube: Tube,
    rows: Rows,
    c: Floats,
    spans: Floats,
    times: tuple[float, float],
    solutions: Solutions,
) -> tuple[bool, float]:
    """Make a first guess of the motion the fastest one.

    Nothing is sought where the searches before took more work than the motion allows, or where the
    motion past the most similar corners saved less than is worth a search.

    Args:
        tube: the legs, and the states at both ends.
        rows: space for the limits.
        c: (steps + 3, d): control points, replaced by those of the result.
        spans: (groups,): logarithms of the durations of the groups, replaced likewise.
        times: that the motion with stops takes, and that is worth a search, s.
        solutions: of earlier searches, receives the result.

    Returns:
        Whether there is one, and the time that it would save where it is not worth a search, s.
    """
    wanted = np.empty(NUMBERS)
    count = _write_input(tube, c, spans, wanted)
    points, d = c.shape
    k = _same_search(wanted, count, solutions) if count else -1
    if k >= 0:
        c[:] = solutions.points[k, :points, :d]
        spans[:] = solutions.spans[k, : len(spans)]
        return solutions.exists[k] > 0, 0.0
    if solutions.work[0] > solutions.most_work[0]:
        return False, 0.0
    k = _most_similar(tube, wanted, count, solutions) if count else -1
    if k >= 0 and solutions.gain[k] < times[1]:
        return False, max(solutions.gain[k], 0.0)
    exists = False
    rows.work[0] = 0
    if k >= 0:
        near_spans = solutions.spans[k, : len(spans)].copy()
        near = _moved(tube, rows.t, solutions.input[k], solutions.points[k], near_spans)
        exists = motion_near(tube, rows, c, spans, near, near_spans)
    if not exists:
        exists = fastest_motion(tube, rows, c, spans)
    solutions.work[0] += rows.work[0]
    if count:
        k = solutions.next[0]
        solutions.next[0] = (k + 1) % SOLUTIONS
        solutions.input[k] = wanted
        solutions.length[k] = count
        solutions.shape[k, 0], solutions.shape[k, 1] = len(tube.feed), d
        solutions.points[k, :points, :d] = c
        solutions.spans[k, : len(spans)] = spans
        solutions.exists[k] = 1 if exists else 0
        set_knots(tube, spans, rows.t)
        solutions.gain[k] = times[0] - (rows.t[points - 1] - rows.t[2])
    return exists, 0.0


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


@njit
def _moved(tube: Tube, t: Floats, earlier: Floats, points: Floats, spans: Floats) -> Floats:
    """Return the control points (steps + 3, d) of an earlier motion, moved to the legs of a tube.

    On each leg the motion shall stay where it was beside the leg, and at the same part of its
    length. The states at the ends are those of the tube.

    Args:
        tube: the legs.
        t: (steps + 5,): receives the knots.
        earlier: the input of the earlier search.
        points: its control points.
        spans: (groups,): logarithms of the durations of its groups.
    """
    steps, (legs, d) = len(tube.leg), tube.start.shape
    along, start = 1 + legs, 1 + legs + legs * d
    set_knots(tube, spans, t)
    c = points[: steps + 3, :d].copy()
    place_ends(tube, t, c)
    free = steps + 3 - 2 * FIXED
    band, right = np.zeros((free, 4)), np.zeros((free, d))
    jerk = tube.along_jerk
    for i in range(len(tube.jerk)):
        jerk = min(jerk, tube.jerk[i])
    stencil, place, wanted = np.empty(4), np.empty(d), np.empty(d)
    for k in range(steps):
        write_stencil(JERK, k, t, stencil)
        wanted[:] = 0.0
        _add_row(stencil, k, 1.0 / (JERK_SHARE * jerk), wanted, c, points, band, right)
        if k == 0:
            continue
        write_stencil(CORNER, k, t, stencil)
        leg = tube.leg[k]
        on = 0.0
        for q in range(d):
            place[q] = 0.0
            for j in range(4):
                place[q] += stencil[j] * points[k + j, q]
            on += (place[q] - earlier[start + leg * d + q]) * earlier[along + leg * d + q]
        longer = _length(tube, leg) / _earlier_length(earlier, leg, legs, d)
        for q in range(d):
            wanted[q] = tube.start[leg, q] - earlier[start + leg * d + q]
            wanted[q] += on * (longer * tube.along[leg, q] - earlier[along + leg * d + q])
        weight = 1.0 / (TOLERANCE_SHARE * tube.tolerance)
        _add_row(stencil, k, weight, wanted, c, points, band, right)
    factorise(band)
    for q in range(d):
        column = right[:, q].copy()
        solve_band(band, column)
        for i in range(free):
            c[FIXED + i, q] = points[FIXED + i, q] + column[i]
    return c


@njit
def _add_row(
    stencil: Floats,
    k: int,
    weight: float,
    wanted: Floats,
    c: Floats,
    points: Floats,
    band: Floats,
    right: Floats,
) -> None:
    """Add a row of the sum of squares: the weighted changes of four points, and ``wanted``.

    The changes of the fixed points are those from ``points`` to ``c``.
    """
    free, d = right.shape
    for j in range(4):
        at = k + j - FIXED
        if not 0 <= at < free:
            continue
        by = weight * weight * stencil[j]
        for q in range(d):
            right[at, q] += by * wanted[q]
        for i in range(4):
            to = k + i - FIXED
            if not 0 <= to < free:
                for q in range(d):
                    right[at, q] -= by * stencil[i] * (c[k + i, q] - points[k + i, q])
            elif i >= j:
                band[at, i - j] += by * stencil[i]


@njit
def _length(tube: Tube, leg: int) -> float:
    """Return the length of a leg between corners or ends of the motion, mm."""
    legs, d = tube.start.shape
    square = 0.0
    for q in range(d):
        end = tube.ends[1, 0, q] if leg + 1 == legs else tube.start[leg + 1, q]
        square += (end - (tube.ends[0, 0, q] if leg == 0 else tube.start[leg, q])) ** 2
    return math.sqrt(square)


@njit
def _earlier_length(earlier: Floats, leg: int, legs: int, d: int) -> float:
    """Return the length of a leg in the input of a search, mm."""
    start = 1 + legs + legs * d
    ends = start + legs * d
    begin = ends if leg == 0 else start + leg * d
    end = ends + 3 * d if leg + 1 == legs else start + (leg + 1) * d
    square = 0.0
    for q in range(d):
        square += (earlier[end + q] - earlier[begin + q]) ** 2
    return math.sqrt(square)
