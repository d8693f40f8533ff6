"""The fewest lines and arcs along a stretch of path, found by the kernel of the same name."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.moves import Move, PlaneArc
from cnc.grbl_lines.path_samples import NO_ARC, PathSamples
from cnc.grbl_lines.travel_margin import TravelMargin
from cnc.kernels.grbl_lines.arc_fit import STRAIGHT, FitLimits, fit_fewest

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

SAME_LINE = math.cos(math.radians(0.05))
"""Cosine above which two straight moves count as one line."""


def fit_moves(
    samples: PathSamples, tolerance: float, chord: float, travel: TravelMargin
) -> Iterator[Move]:
    """Fit moves from the start of the samples to their end.

    Args:
        samples: Points of the path.
        tolerance: Largest distance of a move from the path, mm.
        chord: Largest distance of the board's own chords from an arc, mm.
        travel: The limits within which arcs must stay.

    Yields:
        The moves in their order.
    """
    k = len(samples)
    end, plane, arc = np.empty(k, np.int64), np.empty(k, np.int64), np.empty((k, 3))
    may_turn = (samples.arc == NO_ARC) & ~np.isnan(samples.feed)
    limits = FitLimits(tolerance, chord, travel.low, travel.high)
    count = fit_fewest(samples.points, samples.cuts(), may_turn, limits, end, plane, arc)
    end, plane, arc = end[:count], plane[:count], arc[:count]
    first = np.concatenate(([0], end[:-1]))
    straight = (plane == STRAIGHT) & (samples.arc[end - 1] == NO_ARC)
    columns = (
        samples.points[end].tolist(),
        first.tolist(),
        _speeds(samples, first, end, straight).tolist(),
        samples.feed[end - 1].tolist(),
        samples.line[end - 1].tolist(),
        samples.rest[end].tolist(),
        samples.arc[end - 1].tolist(),
        plane.tolist(),
        arc.tolist(),
    )
    commands = samples.commands
    for (x, y, z), begin, speed, feed, line, rests, programmed, kind, (cx, cy, sweep) in zip(
        *columns, strict=True
    ):
        if programmed != NO_ARC:
            used: PlaneArc | None = samples.arcs[programmed]
        else:
            used = None if kind == STRAIGHT else PlaneArc(kind, (cx, cy), sweep, fitted=True)
        carried = () if commands is None else commands[begin] or ()
        yield Move((x, y, z), used, begin, speed, feed, line, rests, carried)


def _speeds(samples: PathSamples, first: Ints, end: Ints, straight: Flags) -> Floats:
    """Return the highest planned speed along each move, mm/s.

    Straight moves that continue each other are like one: the board makes its own ramps on them.
    """
    speeds: Floats = np.maximum.reduceat(samples.speed, first)
    steps = samples.points[end] - samples.points[first]
    lengths = np.linalg.norm(steps, axis=1)
    feeds = np.nan_to_num(samples.feed[end - 1], nan=-1.0)
    continued = (
        straight[1:]
        & straight[:-1]
        & ~samples.rest[first[1:]]
        & (feeds[1:] == feeds[:-1])
        & (np.einsum("ij,ij->i", steps[1:], steps[:-1]) >= SAME_LINE * lengths[1:] * lengths[:-1])
    )
    starts = np.flatnonzero(np.concatenate(([True], ~continued)))
    highest = np.maximum.reduceat(speeds, starts)
    return np.repeat(highest, np.diff(np.append(starts, len(speeds))))
