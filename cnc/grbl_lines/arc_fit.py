"""The fewest lines and arcs along a stretch of path, found by the kernel of the same name."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.moves import Move, PlaneArc
from cnc.grbl_lines.number_format import LETTERS, PLANE_COLUMNS
from cnc.grbl_lines.path_samples import NO_ARC, PathSamples
from cnc.grbl_lines.speed_limits import NOTHING, SpeedLimits, corner_speeds
from cnc.grbl_lines.travel_margin import TravelMargin
from cnc.kernels.grbl_lines.arc_fit import STRAIGHT, FitLimits, fit_fewest

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

SAME_LINE = math.cos(math.radians(0.05))
"""Cosine above which two straight moves count as one line."""
AS_FAST = 0.98
"""Part of the speed along straight moves that an arc must have to replace them."""
BLOCKS = 15
"""Moves that the planner of a GRBL board holds: so many may follow each other faster than lines."""


class Fit(NamedTuple):
    """Limits of the moves that replace a path.

    Attributes:
        tolerance: Largest distance of a move from the path, mm.
        chord: Largest distance of the board's own chords from an arc, mm ($12).
        junction: The board's $11, mm.
        line_time: Time in which the board reads a short line, s.
        travel: The limits within which arcs must stay.
        speeds: Limits of the speed.
    """

    tolerance: float
    chord: float
    junction: float
    line_time: float
    travel: TravelMargin
    speeds: SpeedLimits


def fit_moves(samples: PathSamples, fit: Fit) -> Iterator[Move]:
    """Fit moves from the start of the samples to their end.

    The program's own straight moves stay as they are where the board reads them fast enough. The
    board is as fast then as with any other sender, and passes their corners as it is set up to.

    Args:
        samples: Points of the path.
        fit: Limits of the moves.

    Yields:
        The moves in their order.
    """
    k = len(samples)
    end, plane, arc = np.empty(k, np.int64), np.empty(k, np.int64), np.empty((k, 3))
    may_turn = (samples.arc == NO_ARC) & ~np.isnan(samples.feed) & ~samples.rotates
    speeds = _own_speeds(samples, fit)
    own = samples.rotates | (samples.straight & ~_starving(samples, speeds, fit.line_time))
    cuts = samples.cuts()
    cuts[:-1] |= own
    cuts[1:] |= own
    first_three = slice(len(LETTERS))
    low, high = fit.travel.low[first_three], fit.travel.high[first_three]
    limits = FitLimits(fit.tolerance, fit.chord, low, high)
    points = np.ascontiguousarray(samples.points[:, first_three])
    count = fit_fewest(points, cuts, may_turn, limits, end, plane, arc)
    end, plane, arc = _without_slow_arcs(
        samples, fit, speeds, (end[:count], plane[:count], arc[:count])
    )
    first = np.concatenate(([0], end[:-1]))
    straight = (plane == STRAIGHT) & (samples.arc[end - 1] == NO_ARC)
    columns = (
        map(tuple, samples.points[end].tolist()),
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
    for place, begin, speed, feed, line, rests, programmed, kind, (cx, cy, sweep) in zip(
        *columns, strict=True
    ):
        if programmed != NO_ARC:
            used: PlaneArc | None = samples.arcs[programmed]
        else:
            used = None if kind == STRAIGHT else PlaneArc(kind, (cx, cy), sweep, fitted=True)
        carried = () if commands is None else commands[begin] or ()
        yield Move(place, used, begin, speed, feed, line, rests, carried)


def _own_speeds(samples: PathSamples, fit: Fit) -> Floats:
    """Return the speed of the board along the intervals as straight moves (k,), mm/s."""
    corners = corner_speeds(samples.points, fit.speeds.accelerations, fit.junction)
    ends = np.concatenate(([np.inf], corners, [np.inf]))
    speeds = samples.speed
    mean: Floats = 0.5 * (np.minimum(speeds, ends[:-1]) + np.minimum(speeds, ends[1:]))
    return mean


def _starving(samples: PathSamples, speeds: Floats, line_time: float) -> Flags:
    """Return the intervals (k,) around which moves end faster than the board reads lines."""
    lengths = np.linalg.norm(np.diff(samples.points, axis=0), axis=1)
    sums = np.concatenate(([0.0], np.cumsum(lengths / np.maximum(speeds, NOTHING))))
    places = np.arange(len(lengths))
    first = np.maximum(places - BLOCKS // 2, 0)
    last = np.minimum(places + BLOCKS // 2 + 1, len(lengths))
    starving: Flags = sums[last] - sums[first] < line_time * (last - first)
    return starving


def _without_slow_arcs(
    samples: PathSamples, fit: Fit, speeds: Floats, moves: tuple[Ints, Ints, Floats]
) -> tuple[Ints, Ints, Floats]:
    """Return the moves with the program's own straight moves where an arc would be slower.

    Args:
        samples: Points of the path.
        fit: Limits of the moves.
        speeds: Of the straight moves on the board (k,), mm/s.
        moves: Last point, plane and arc of each move.
    """
    end, plane, arc = moves
    first = np.concatenate(([0], end[:-1]))
    turned = np.flatnonzero((plane != STRAIGHT) & samples.straight[first])
    lengths = np.linalg.norm(np.diff(samples.points, axis=0), axis=1)
    seconds = np.maximum(lengths / np.maximum(speeds, NOTHING), fit.line_time)
    slow = []
    for k in turned.tolist():
        inside = slice(int(first[k]), int(end[k]))
        i, j, across = PLANE_COLUMNS[int(plane[k])]
        start, stop = samples.points[inside.start], samples.points[inside.stop]
        used = PlaneArc(int(plane[k]), (float(arc[k, 0]), float(arc[k, 1])), float(arc[k, 2]))
        radius = math.dist((float(start[i]), float(start[j])), used.center)
        most, length = fit.speeds.arc(used, radius, float(stop[across] - start[across]))
        if length / most > float(seconds[inside].sum()) / AS_FAST:
            slow.append(k)
    if not slow:
        return end, plane, arc
    parts = np.ones(len(end), np.int64)
    parts[slow] = (end - first)[slow]
    owner = np.repeat(np.arange(len(end)), parts)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts) + 1
    split = parts[owner] > 1
    ends = np.where(split, first[owner] + step, end[owner])
    planes = np.where(split, STRAIGHT, plane[owner])
    return ends, planes, arc[owner]


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
