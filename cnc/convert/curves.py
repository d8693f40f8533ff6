"""Curves and short moves as lines and arcs within a tolerance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    cuts = np.zeros(len(points), np.bool_)
    turns = np.einsum("ij,ij->i", steps[1:], steps[:-1])
    cuts[1:-1] = turns < CORNER * lengths[1:] * lengths[:-1]
    others = [k for k in range(len(axes)) if k not in columns]
    rotates = (steps[:, others] != 0.0).any(axis=1) if others else np.zeros(len(steps), np.bool_)
    cuts[:-1] |= rotates
    cuts[1:] |= rotates
    far = np.full(3, 1e9)
    limits = FitLimits(FITTING * fit.tolerance, fit.chord, -far, far)
    count = len(steps)
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
