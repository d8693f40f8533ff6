r"""The choice between blends and one motion past corners whose legs are short.

Where the jerk is limited along the path alone, a blend is about as fast as any motion past its
corner if the legs have room for it. Where they are short, corners that are passed together may be
faster, by up to a fifth: the motion swings out before a turn. Which is faster depends on how the
limits of jerk and acceleration compare. So both are timed, from rest to rest.

           o                         o
     .-----'`----.             .--.     .--.
    /   blends    \          /     `-'     \      together
   o               o        o               o

Without the choice, 100 polygons with legs of 3 to 24 tolerances take 1.00 times as long in the
median, and 1.155 times at worst (limits along the path).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.diagnostics import MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE, Pieces
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.corners import CornerBlending
from cnc.planner.kernels.corner_places import MOST_CORNERS
from cnc.planner.kernels.corner_search import Solutions
from cnc.planner.kernels.corners import only_along
from cnc.planner.kernels.legs import record_end
from cnc.planner.limits import Limits
from cnc.planner.window import LONG, Window

SHORT = 25.0
"""In tolerances. Corners with longer legs have blends."""

ENDS_SHORT = 100.0
"""In tolerances. So have corners beside longer legs: a longer ramp gains little, and most programs
have such legs.
"""

BESIDE = 100.0
"""In tolerances: length on each side that is timed with them. Beside a blend or a curve they may be
slower than alone.
"""

FASTER = 0.998
"""Corners are passed together where that takes less than this part of the time with blends."""


def passed_together(
    path: PathChunk, rests: bool, limits: Limits, solutions: Solutions
) -> NDArray[np.bool_]:
    """Return for each piece of a path whether the corner behind it is passed with those beside it.

    Args:
        path: pieces that follow each other.
        rests: whether the motion rests at their start.
        limits: of the columns of the path.
        solutions: receives those of its searches.
    """
    chosen = np.zeros(len(path), np.bool_)
    if only_along(limits.arrays):
        s = np.concatenate(([0.0], np.cumsum(path.length)))
        for first, last in _rows(path):
            far = BESIDE * path.tolerance[first : last + 1].max()
            if (s[first + 1] < far and not rests) or (
                s[-1] - s[last + 1] < far and not path.stop_after[-1]
            ):
                # The path goes on: from or to a rest at its end the times would be wrong.
                continue
            begin = max(int(np.searchsorted(s, s[first + 1] - far, side="right")) - 1, 0)
            end = min(int(np.searchsorted(s, s[last + 1] + far)), len(path)) - 1
            legs = _alone(path, begin, end)
            blends = chosen[begin : end + 1]
            together = blends.copy()
            together[first - begin : last + 1 - begin] = True
            allowed = solutions.most_work.copy()
            chosen[first : last + 1] = _faster(legs, limits, solutions, together, blends)
            # Trials are no motion that allows more work.
            np.minimum(solutions.most_work, allowed, out=solutions.most_work)
    return chosen


def _rows(path: PathChunk) -> Iterator[tuple[int, int]]:
    """Yield the first and the last corner of each row of corners between short legs.

    Rows of more corners than one motion passes are left out, and those that end with longer legs.
    """
    line = path.kind == LINE
    corner = (path.tolerance[:-1] > 0.0) & ~path.stop_after[:-1] & line[:-1] & line[1:]
    short = path.length < SHORT * np.maximum(
        path.tolerance, np.concatenate(([0.0], path.tolerance[:-1]))
    )
    joined = corner[1:] & corner[:-1] & short[1:-1]
    corners = np.flatnonzero(corner & (short[1:] | short[:-1]))
    begin = 0
    for k in range(len(corners)):
        if k + 1 == len(corners) or corners[k + 1] > corners[k] + 1 or not joined[corners[k]]:
            first, last = int(corners[begin]), int(corners[k])
            ends = (path.length[first], path.length[last + 1])
            if last - first < MOST_CORNERS and max(ends) < ENDS_SHORT * path.tolerance[first]:
                yield first, last
            begin = k + 1


def _alone(path: PathChunk, first: int, last: int) -> PathChunk:
    """Return the pieces ``first`` to ``last`` as a path that ends at rest, without commands."""
    legs = path.part(first, last + 1)
    stops, tolerance = legs.stop_after.copy(), legs.tolerance.copy()
    stops[-1], tolerance[-1] = True, 0.0
    begin = int(legs.at[0])
    end = record_end(Pieces(legs.kind, legs.at, legs.data), len(legs) - 1)
    return replace(
        legs,
        at=legs.at - begin,
        data=legs.data[begin:end],
        stop_after=stops,
        tolerance=tolerance,
        commands=None,
    )


def _faster(
    legs: PathChunk,
    limits: Limits,
    solutions: Solutions,
    together: NDArray[np.bool_],
    blends: NDArray[np.bool_],
) -> bool:
    """Return whether the motion past corners is faster with ``together`` than with ``blends``.

    A refinement takes most of the computing time, and saves more on blends. So there is none where
    they are faster without.
    """
    for refines in (False, True):
        past, rounded = (
            _time(legs, limits, solutions, which, refines=refines) for which in (together, blends)
        )
        if not past < (FASTER if refines else 1.0) * rounded:
            return False
    return True


def _time(
    legs: PathChunk,
    limits: Limits,
    solutions: Solutions,
    together: NDArray[np.bool_],
    *,
    refines: bool,
) -> float:
    """Return the time of the motion past corners from rest to rest, s; infinity for none."""
    window = Window(limits, refines=refines)
    corners = CornerMotions(limits, Audit(limits), solutions)
    blending = CornerBlending(limits, together=lambda *_: together)
    time = 0.0
    try:
        for chunk in blending.blended(iter((legs,))):
            assert isinstance(chunk, PathChunk)
            window.add(chunk, None, None)
        while window.prepared():
            time += sum(part.plan.duration for part in corners.passed(window.take(LONG)))
        return time + sum(part.plan.duration for part in corners.flush())
    except MotionLimitError:
        return math.inf
