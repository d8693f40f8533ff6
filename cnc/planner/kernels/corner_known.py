"""Motions past corners that were found, so that they need not be searched for again."""

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

KNOWN = 64
"""Motions that are kept, so that they need not be searched for again."""

NUMBERS = 1536
"""Most numbers of the input of a motion that is kept."""


class Known(NamedTuple):
    """Motions that were found.

    Attributes:
        input: (KNOWN, NUMBERS): what each was searched for with; nan for none.
        length: (KNOWN,): number of these numbers.
        points: (KNOWN, MOST_STEPS + 3, MOST_DIRECTIONS): its control points.
        spans: (KNOWN, groups): logarithms of the durations of its groups.
        found: (KNOWN,): 1 if there is a motion, or 0.
        next: (1,): the one to be replaced next.
    """

    input: Floats
    length: Ints
    points: Floats
    spans: Floats
    found: Ints
    next: Ints


def new_known() -> Known:
    """Return space for motions that are found."""
    return Known(
        np.full((KNOWN, NUMBERS), math.nan),
        np.zeros(KNOWN, np.int64),
        np.empty((KNOWN, MOST_STEPS + 3, MOST_DIRECTIONS)),
        np.empty((KNOWN, GROUPS * (MOST_CORNERS + 1))),
        np.zeros(KNOWN, np.int64),
        np.zeros(1, np.int64),
    )


@njit
def _known_as(wanted: Floats, count: int, known: Known) -> int:
    """Return the index of the motion that was found with the same input, or -1."""
    for k in range(KNOWN):
        same = known.length[k] == count
        i = 0
        while same and i < count:
            same = wanted[i] == known.input[k, i]
            i += 1
        if same:
            return k
    return -1


@njit
def _write_input(tube: Tube, c: Floats, spans: Floats, to: Floats) -> int:
    """Write all that the search depends on, but for the machine's limits; return the count."""
    parts = (
        tube.axes.ravel(),
        tube.travel.ravel(),
        tube.feed,
        tube.along.ravel(),
        tube.start.ravel(),
        tube.ends.ravel(),
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
def solved(tube: Tube, rows: Rows, c: Floats, spans: Floats, known: Known) -> bool:
    """Make the motion the fastest one; return whether there is one."""
    wanted = np.empty(NUMBERS)
    count = _write_input(tube, c, spans, wanted)
    points, d = c.shape
    k = _known_as(wanted, count, known) if count else -1
    if k >= 0:
        c[:] = known.points[k, :points, :d]
        spans[:] = known.spans[k, : len(spans)]
        return known.found[k] > 0
    found = fastest_motion(tube, rows, c, spans)
    if count:
        k = known.next[0]
        known.next[0] = (k + 1) % KNOWN
        known.input[k] = wanted
        known.length[k] = count
        known.points[k, :points, :d] = c
        known.spans[k, : len(spans)] = spans
        known.found[k] = 1 if found else 0
    return found
