"""A stretch of path as intervals with constant bounds: made, cut and joined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.intervals import LEVELS, SAMPLES, Intervals
from cnc.kernels.planner.lifts import TOUCH
from cnc.kernels.planner.limits import Junction, piece_junction
from cnc.kernels.planner.subdivision import chunk_intervals
from cnc.path.chunk import PathChunk
from cnc.planner.limits import Limits

STANDSTILL = Junction(0.0, True, 1.0, 0.0)
"""A junction at which the motion rests."""

ROUNDING = 1e-4
"""Part of TOUCH that is left for rounding."""

REFINED = 2.0
"""Usual ratio of the speed for which intervals are cut to their bound of the speed."""


def junction_between(before: PathChunk, after: PathChunk, limits: Limits) -> Junction:
    """Return the junction of two chunks that follow each other."""
    return _junction(before, len(before) - 1, after, 0, limits)


def _junction(before: PathChunk, m: int, after: PathChunk, k: int, limits: Limits) -> Junction:
    """Return the junction of piece ``m`` of a chunk with piece ``k`` of the same or the next."""
    if before.stop_after[m]:
        return STANDSTILL
    return piece_junction(
        Pieces(before.kind, before.at, before.data),
        m,
        limits.feeds(before)[m],
        Pieces(after.kind, after.at, after.data),
        k,
        limits.feeds(after)[k],
        min(before.length[m], after.length[k]),
        limits.arrays,
        np.zeros((2, 4, len(before.axes))),
    )


def intervals_of(
    path: PathChunk,
    limits: Limits,
    before: Junction,
    after: Junction,
    refined: float = REFINED,
    begin: float = 0.0,
) -> Intervals:
    """Cut a chunk into intervals with constant bounds; arc lengths begin with ``begin``, mm.

    The refinement may cross an interval faster than the bound that leaves acceleration for any
    direction. ``refined`` is the ratio for which the intervals are cut. Faster motion is compared
    with the path itself.
    """
    # Six intervals of a move from stop to stop are usual. Space that is not used costs nothing.
    found = _space(8 * len(path) + 1024, len(path.axes))
    done = count = 0
    while True:
        cut, more = chunk_intervals(
            Pieces(path.kind[done:], path.at[done:], path.data),
            path.length[done:],
            limits.feeds(path)[done:],
            path.stop_after[done:],
            before,
            after,
            limits.arrays,
            refined,
            begin,
            Intervals._make(array[count:] for array in found),
        )
        done, count = done + cut, count + more
        if done == len(path):
            return Intervals._make(array[:count] for array in found)
        larger = _space(4 * len(found.end), len(path.axes))
        for array, old in zip(larger, found, strict=True):
            array[:count] = old[:count]
        found = larger
        if done > 0:
            before = _junction(path, done - 1, path, done, limits)
            begin = float(found.end[count - 1])


def _space(intervals: int, axes: int) -> Intervals:
    """Return space for so many intervals."""
    return Intervals(
        end=np.empty(intervals),
        speed=np.empty(intervals),
        top=np.empty(intervals),
        accel=np.empty((intervals, LEVELS)),
        jerk=np.empty((intervals, LEVELS)),
        flat=np.empty(intervals, np.bool_),
        share=np.empty(intervals),
        reliable=np.empty(intervals),
        sampled=np.empty((intervals, 2)),
        samples=np.empty((intervals, SAMPLES, 3, axes)),
    )


def between(known: Intervals, start: float, stop: float) -> Intervals:
    """Return the intervals from ``start`` to ``stop``, mm; the last one is cut there.

    A stop at ``stop`` is one of them, a stop at ``start`` is not.
    """
    count = len(known.end)
    first = int(np.searchsorted(known.end, start, side="right"))
    last = int(np.searchsorted(known.end, stop, side="right"))
    cut = last < count and (last == 0 or known.end[last - 1] < stop) and last >= first
    part = Intervals._make(array[first : last + cut] for array in known)
    return part._replace(end=np.minimum(part.end, stop)) if cut else part


def lowered(known: Intervals) -> Intervals:
    """Return intervals for a search, which may exceed their speeds by TOUCH.

    A motion at the speeds of ``known`` itself is legal over them.
    """
    return known._replace(top=known.top / (1.0 + (1.0 - ROUNDING) * TOUCH))


def joined(parts: Sequence[Intervals], bases: Sequence[float]) -> Intervals:
    """Return the intervals of stretches that follow each other and begin at ``bases``, mm."""
    moved = [
        part._replace(end=part.end + base, sampled=part.sampled + base)
        for part, base in zip(parts, bases, strict=True)
    ]
    return Intervals._make(np.concatenate(arrays) for arrays in zip(*moved, strict=True))
