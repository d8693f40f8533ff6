"""The way that a planned motion goes, as points: what corners were cut to, not what the program
says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import ARC, LINE, START
from cnc.path.sample import points_along
from cnc.planner.plan import PlanChunk

CHORD = 1e-4
"""mm. How far a chord between two points may lie from the arc that they are on."""
OF_SPAN, MOST_OF_SPAN = 0.05, 2000
"""mm between points on a spline, and the most points on one span of it."""
ROUNDING = 1e-9
"""mm of path length."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Track:
    """points (n, axes): vertices; straight between them. line (n,): source line of the way to each
    point, in ``files[file]``.
    """

    points: Floats
    line: Ints
    file: Ints
    files: tuple[str, ...]


class Recorder:
    """Takes plans in their order; ``start`` (axes,) is where the first begins."""

    def __init__(self, start: Floats) -> None:
        self._points = [start[None]]
        self._lines = [np.zeros(1, np.int64)]
        self._file = [np.zeros(1, np.int64)]
        self._files: list[str] = [""]
        self._done = 0.0

    def add(self, plan: PlanChunk) -> None:
        """The pieces that the motion has gone to the end of; one that it stops in comes again with
        the next plan.
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
            path.kind[pieces] == LINE, np.inf, np.maximum(OF_SPAN, length / MOST_OF_SPAN)
        )
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
        """All of it."""
        return Track(
            np.concatenate(self._points),
            np.concatenate(self._lines),
            np.concatenate(self._file),
            tuple(self._files),
        )
