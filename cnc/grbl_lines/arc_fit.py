"""The fewest moves along a samples: lines and arcs within the tolerance, by the kernel of the same
name.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cnc.grbl_lines.path_samples import NO_ARC, PathSamples, PlaneArc
from cnc.grbl_lines.travel_margin import TravelMargin
from cnc.grbl_lines.writer import Point
from cnc.kernels.grbl_lines.arc_fit import STRAIGHT, fewest


@dataclass(frozen=True, slots=True)
class Move:
    """A line to ``end``, or an arc if there is one. first: the interval of the samples where it
    begins.

    speed: the highest planned along it, feed: the programmed one (NaN: traverse), mm/s. line:
    source line of what it ends in. rests: the motion rests behind it.
    """

    end: Point
    arc: PlaneArc | None
    first: int
    speed: float
    feed: float
    line: int
    rests: bool


def moves(
    samples: PathSamples, tolerance: float, chord: float, room: TravelMargin
) -> Iterator[Move]:
    """Moves from the start of the samples to its end; ``chord`` is by how much the board's own
    chords may be off an arc, mm.
    """
    k = len(samples)
    end, plane, arc = np.empty(k, np.int64), np.empty(k, np.int64), np.empty((k, 3))
    may_turn = (samples.arc == NO_ARC) & ~np.isnan(samples.feed)
    count = fewest(
        samples.points,
        samples.cuts(),
        may_turn,
        tolerance,
        chord,
        room.low,
        room.high,
        end,
        plane,
        arc,
    )
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
    for (x, y, z), begin, speed, feed, line, rests, true, kind, (cx, cy, sweep) in zip(
        *columns, strict=True
    ):
        if true != NO_ARC:
            turned: PlaneArc | None = samples.arcs[true]
        else:
            turned = None if kind == STRAIGHT else PlaneArc(kind, (cx, cy), sweep, fitted=True)
        yield Move((x, y, z), turned, begin, speed, feed, line, rests)
