"""The fewest lines and arcs along a stretch of path, found by the kernel of the same name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc.grbl_lines.moves import Move, PlaneArc
from cnc.grbl_lines.path_samples import NO_ARC, PathSamples
from cnc.grbl_lines.travel_margin import TravelMargin
from cnc.kernels.grbl_lines.arc_fit import STRAIGHT, FitLimits, fit_fewest


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
    columns = (
        samples.points[end].tolist(),
        first.tolist(),
        np.maximum.reduceat(samples.speed, first).tolist(),
        samples.feed[end - 1].tolist(),
        samples.line[end - 1].tolist(),
        samples.rest[end].tolist(),
        samples.arc[end - 1].tolist(),
        plane.tolist(),
        arc.tolist(),
    )
    for (x, y, z), begin, speed, feed, line, rests, programmed, kind, (cx, cy, sweep) in zip(
        *columns, strict=True
    ):
        if programmed != NO_ARC:
            used: PlaneArc | None = samples.arcs[programmed]
        else:
            used = None if kind == STRAIGHT else PlaneArc(kind, (cx, cy), sweep, fitted=True)
        yield Move((x, y, z), used, begin, speed, feed, line, rests)
