"""The toolpath of a planned motion as points, corner blends included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import ARC, LINE, SPAN, START, TABLE
from cnc.path.sample import points_along
from cnc.planner.plan import PlanChunk

CHORD = 1e-4
"""mm. Largest distance of a chord from its arc."""
SPAN_SPACING, MAX_SPAN_POINTS = 0.05, 2000
"""mm between points on a span of a spline, and the largest number of points on it."""
TIMED_PARTS = 8
"""Parts of a step of a motion past a corner: it may bend much on a short way."""
ROUNDING = 1e-9
"""mm of path length."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Track:
    """A toolpath as a polygon.

    Attributes:
        points: (n, axes) vertices, mm.
        line: (n,) source line of the move to each vertex.
        file: (n,) index of its file.
        files: the files; empty for the program itself.
    """

    points: Floats
    line: Ints
    file: Ints
    files: tuple[str, ...]


class Recorder:
    """Collects the toolpath of plans in order; ``start`` (axes,) is its first point, mm."""

    def __init__(self, start: Floats) -> None:
        self._points = [start[None]]
        self._lines = [np.zeros(1, np.int64)]
        self._file = [np.zeros(1, np.int64)]
        self._files: list[str] = [""]
        self._done = 0.0

    def add(self, plan: PlanChunk) -> None:
        """Add the pieces that the motion has completed.

        A piece that a plan ends in comes again with the next plan.
        """
        path = plan.path
        ends = plan.s0 + plan.piece_s[1:]
        reached = plan.s0 + float(plan.phase_s[-1])
        pieces: Ints = np.flatnonzero((ends > self._done + ROUNDING) & (ends <= reached + ROUNDING))
        if not len(pieces):
            return
        self._done = float(ends[pieces[-1]])
        at, length = path.at[pieces], path.length[pieces]
        body = at + START + 2 * len(path.axes)
        arc = path.kind[pieces] == ARC
        spacing = np.where(
            path.kind[pieces] == LINE, np.inf, np.maximum(SPAN_SPACING, length / MAX_SPAN_POINTS)
        )
        timed = (path.kind[pieces] == SPAN) & (path.data[at + TABLE] == 0.0)
        spacing[timed] = np.minimum(spacing[timed], length[timed] / TIMED_PARTS)
        radius, sweep = path.data[body[arc] + 2], np.abs(path.data[body[arc] + 4])
        # sagitta = r (1 - cos(angle / 2)), about r angle^2 / 8
        spacing[arc] = length[arc] / np.ceil(sweep / np.sqrt(8.0 * CHORD / radius))
        points, owner = points_along(path, spacing, pieces)
        self._points.append(points)
        self._lines.append(path.line[owner].astype(np.int64))
        if path.file not in self._files:
            self._files.append(path.file)
        self._file.append(np.full(len(points), self._files.index(path.file)))

    def track(self) -> Track:
        """Return the whole toolpath."""
        return Track(
            np.concatenate(self._points),
            np.concatenate(self._lines),
            np.concatenate(self._file),
            tuple(self._files),
        )
