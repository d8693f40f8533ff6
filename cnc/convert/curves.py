"""Curves and short moves as lines, arcs and cubic B-splines within a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from cnc.compare.programs import points_along
from cnc.grbl_lines.kernels.arc_fit import STRAIGHT, FitLimits, fit_fewest
from cnc.model.blocks import NurbsFeed, Plane
from cnc.model.choices import Curves
from cnc.path.build import exact_path
from cnc.path.chunk import PathChunk

PLANES: tuple[Plane, ...] = get_args(Plane)
CORNER = np.cos(np.radians(30.0))
"""Moves that turn by more meet at a corner, which stays."""
FITTING, SAMPLING = 0.7, 0.1
"""Shares of the tolerance: distance of a curve from points, and of the points' chords."""
SMALL = 0.05
"""mm between the points on a spline, at most."""

Floats = NDArray[np.float64]


class Curve(NamedTuple):
    """A straight move or an arc to ``end`` (axes,), mm.

    Attributes:
        plane: Plane of an arc; None for a straight move.
        center: Centre in its two axes, mm.
        counter_clockwise: Its direction.
        moves: Number of moves that it stands for.
    """

    end: Floats
    plane: Plane | None = None
    center: tuple[float, float] = (0.0, 0.0)
    counter_clockwise: bool = True
    moves: int = 1


class Spline(NamedTuple):
    """A cubic B-spline with clamped ends and equal intervals between its knots.

    Attributes:
        points: Control points (n, axes), n >= 4, the start among them, mm.
        moves: Number of moves that it stands for.
    """

    points: Floats
    moves: int


@dataclass(frozen=True)
class FitTo:
    """How curves are written.

    Attributes:
        tolerance: Largest distance from the program, mm.
        curves: How short moves are written.
        chord: Largest distance of the control's own chords from an arc, mm (GRBL's $12).
    """

    tolerance: float
    curves: Curves
    chord: float = 0.002

    def points_on(self, curve: NurbsFeed, axes: tuple[str, ...]) -> Floats:
        """Return points on a spline (n, axes), its start and end among them."""
        start = curve.control_points[0]
        parts = [start[None]]
        for item in exact_path([curve], axes=axes, start=start):
            if isinstance(item, PathChunk):
                length = float(item.length.sum())
                spacing = min(SMALL, max(length / 4000.0, 1e-4))
                parts.append(points_along(item, spacing)[0])
        return np.concatenate(parts)


def curves_of(points: Floats, axes: tuple[str, ...], fit: FitTo) -> Iterator[Curve]:
    """Yield lines and arcs through points (n, axes) from the first one on, corners kept."""
    columns = [axes.index(axis) if axis in axes else -1 for axis in "xyz"]
    placed = np.zeros((len(points), 3))
    for place, column in enumerate(columns):
        if column >= 0:
            placed[:, place] = points[:, column]
    cuts, rotates = _corners(points, axes)
    far = np.full(3, 1e9)
    limits = FitLimits(FITTING * fit.tolerance, fit.chord, -far, far)
    count = len(points) - 1
    end, plane, arc = np.empty(count, np.int64), np.empty(count, np.int64), np.empty((count, 3))
    made = fit_fewest(placed, cuts, ~rotates, limits, end, plane, arc)
    moves = np.diff(end[:made], prepend=0).tolist()
    for k in range(made):
        there = points[end[k]]
        if plane[k] == STRAIGHT:
            yield Curve(there, moves=moves[k])
        else:
            x, y, sweep = arc[k].tolist()
            yield Curve(there, PLANES[int(plane[k])], (x, y), sweep > 0.0, moves[k])


def _corners(points: Floats, axes: tuple[str, ...]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the points at which curves end (n,), and the moves that rotate an axis (n - 1,)."""
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    cuts = np.zeros(len(points), np.bool_)
    turns = np.einsum("ij,ij->i", steps[1:], steps[:-1])
    cuts[1:-1] = turns < CORNER * lengths[1:] * lengths[:-1]
    others = [k for k, axis in enumerate(axes) if axis not in "xyz"]
    rotates = (steps[:, others] != 0.0).any(axis=1) if others else np.zeros(len(steps), np.bool_)
    cuts[:-1] |= rotates
    cuts[1:] |= rotates
    return cuts, rotates


# Cubic B-splines. The parameter is the length along the moves, so that the motion along the spline
# is as even as that along the moves. A spline begins in the direction in which the one before ends.

LONGEST_SPLINE, SHORTEST_SPLINE = 160, 10
"""Moves of one spline."""
MOVES_A_POINT = 2.0
"""A spline with fewer moves for each control point is not worth its lines."""
GROWTH = 1.5
PLACES = 4
"""Places on each move, and in each interval of knots, at which the distance is measured."""


def splines_of(
    points: Floats, axes: tuple[str, ...], fit: FitTo, *, planar: bool
) -> Iterator[Curve | Spline]:
    """Yield splines through points (n, axes) from the first one on, corners kept.

    Moves that no spline of few points follows are lines and arcs.

    Args:
        points: The points, mm.
        axes: Letters of the axes.
        fit: The tolerance.
        planar: Whether a spline lies in a plane of constant Z.
    """
    cuts, rotates = _corners(points, axes)
    bends = ~rotates
    if planar and "z" in axes:
        level = np.diff(points[:, axes.index("z")]) == 0.0
        bends &= level
        cuts[1:-1] |= level[1:] != level[:-1]
    ends = [0, *np.flatnonzero(cuts[1:-1] + 0) + 1, len(points) - 1]
    left = 0
    for first, last in pairwise(ends):
        if not bends[first]:
            continue
        at, direction = first, None
        while last - at >= SHORTEST_SPLINE:
            made = _longest(points[at : last + 1], direction, FITTING * fit.tolerance)
            if made is None:
                at += SHORTEST_SPLINE
                direction = None
                continue
            if at > left:
                yield from curves_of(points[left : at + 1], axes, fit)
            yield made
            direction = made.points[-1] - made.points[-2]
            at += made.moves
            left = at
    if left < len(points) - 1:
        yield from curves_of(points[left:], axes, fit)


def _longest(points: Floats, direction: Floats | None, tolerance: float) -> Spline | None:
    """Return a spline through the first of the points, as many as one takes; None if few do."""
    count = min(len(points) - 1, LONGEST_SPLINE)
    if count < len(points) - 1 < 2 * LONGEST_SPLINE:
        count = len(points) // 2
    while count >= SHORTEST_SPLINE:
        size = 4
        while size * MOVES_A_POINT <= count:
            control = _least_squares(points[: count + 1], size, direction, tolerance)
            if control is not None:
                return Spline(control, count)
            size = math.ceil(GROWTH * size)
        count //= 2
    return None


def _least_squares(
    points: Floats, size: int, direction: Floats | None, tolerance: float
) -> Floats | None:
    """Return control points (size, axes) of a spline within a tolerance of moves; else None."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate(([0.0], np.cumsum(lengths)))
    total, spans = float(at[-1]), size - 3
    control = np.empty((size, points.shape[1]))
    control[0], control[-1] = points[0], points[-1]
    first = 1
    if direction is not None:
        # The speed at the end of clamped knots is three times the first leg in an interval.
        leg = total / (3.0 * spans) / float(np.linalg.norm(direction))
        control[1], first = points[0] + leg * direction, 2
    # Each interval between knots has several places, also where a move covers many intervals.
    count = np.ceil(PLACES * np.maximum(1.0, lengths * (spans / total))).astype(np.int64)
    move = np.repeat(np.arange(len(lengths)), count)
    share = (np.arange(len(move)) - np.repeat(np.cumsum(count) - count, count)) / count[move]
    between = points[move] + share[:, None] * np.diff(points, axis=0)[move]
    u = at[move] + share * lengths[move]
    basis = _basis(u * (spans / total), size)
    known = np.r_[0:first, size - 1]
    free = np.arange(first, size - 1)
    rest = between - basis[:, known] @ control[known]
    control[free] = np.linalg.lstsq(basis[:, free], rest, rcond=None)[0]
    off = np.linalg.norm(basis @ control - between, axis=1)
    return control if float(off.max()) <= tolerance else None


def _basis(u: Floats, size: int) -> Floats:
    """Return the cubic B-splines (n, size) on clamped knots 0, 0, 0, 0, 1, 2 .. at u (n,).

    By the recursion of Cox and de Boor (Piegl, Tiller, The NURBS Book, equation 2.5).
    """
    spans = size - 3
    knots = np.clip(np.arange(size + 4) - 3.0, 0.0, spans)
    span = np.minimum(u.astype(np.int64), spans - 1) + 3
    values = np.zeros((len(u), 4))
    values[:, 0] = 1.0
    for degree in (1, 2, 3):
        saved = np.zeros(len(u))
        for k in range(degree):
            right, left = knots[span + k + 1], knots[span + k + 1 - degree]
            part = values[:, k] / (right - left)
            values[:, k] = saved + (right - u) * part
            saved = (u - left) * part
        values[:, degree] = saved
    out = np.zeros((len(u), size))
    out[np.arange(len(u))[:, None], span[:, None] - 3 + np.arange(4)] = values
    return out
