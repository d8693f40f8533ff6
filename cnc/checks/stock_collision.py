"""Rapid moves into material: of the stock box, what no feed move has been through.

    rapid                          The box is a grid of columns over X and Y. A feed move lowers the columns that the tool's centre
  ----.   .-----                   passes, a rapid move below what is left of its column is a finding. Peck drilling and a second
 _____v___|______ stock            pass through a slot are no findings: a feed move was there before. The tool has no radius here, but
|     |xxx|      |                 for a column beside its own.
|     '---' feed |
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine, Stock
from cnc.model.diagnostics import Diagnostic
from cnc.path.bounds import bounding_box
from cnc.path.chunk import PathChunk
from cnc.path.sample import points_along

COLUMN = 0.1
"""mm. Width of a column of the grid, where that does not make more than MOST_COLUMNS along an
axis.
"""
MOST_COLUMNS = 1000
TOUCH = 1e-3
"""mm. What a rapid move may go below the material's surface: on it is not in it, whatever was
rounded.
"""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class Material:
    """What is left of the stock; takes a path chunk by chunk."""

    def __init__(self, machine: Machine, stock: Stock) -> None:
        """The machine must have the axes x, y and z."""
        self._columns = [machine.axis_names.index(axis) for axis in "xyz"]
        self._low, self._high = np.array([stock.x, stock.y, stock.z]).T
        width = max(COLUMN, float((self._high - self._low)[:2].max()) / MOST_COLUMNS)
        self._width = width
        shape = np.ceil((self._high - self._low)[:2] / width).astype(np.int64)
        # a rim of one column all around, so that every column has neighbours
        self._surface: Floats = np.full(shape + 2, self._high[2])
        self._reported: set[int] = set()

    def add(self, chunk: PathChunk) -> Iterator[Diagnostic]:
        """Cut, and yield a ``rapid-into-stock`` for each line that moves rapidly into what is left,
        without its text.
        """
        low, high = bounding_box(chunk)
        beside = (high[:, self._columns] <= self._low) | (low[:, self._columns] >= self._high)
        pieces: Ints = np.flatnonzero(~beside.any(axis=1))
        if not len(pieces):
            return
        rapid = np.isnan(chunk.feed[pieces])
        # feed moves together, rapid ones each on its own: what one went through is no news for the
        # next
        for run in np.split(pieces, np.flatnonzero(rapid[1:] | rapid[:-1]) + 1):
            points, owner = points_along(chunk, self._width / 2.0, run)
            points = points[:, self._columns]
            inside = ((points > self._low) & (points < self._high)).all(axis=1)
            points, owner = points[inside], owner[inside]
            where = tuple(((points[:, :2] - self._low[:2]) / self._width).astype(np.int64).T + 1)
            if np.isnan(chunk.feed[run[0]]):
                yield from self._moved(chunk, points, owner, where)
            np.minimum.at(self._surface, where, points[:, 2])

    def _moved(
        self, chunk: PathChunk, points: Floats, owner: Ints, where: tuple[Ints, ...]
    ) -> Iterator[Diagnostic]:
        """Findings for the points of rapid moves that lie inside the box."""
        i, j = where
        left = np.min([self._surface[i + a, j + b] for a in (-1, 0, 1) for b in (-1, 0, 1)], axis=0)
        depth = left - points[:, 2]
        for piece in np.unique(owner[depth > TOUCH]).tolist():
            line = int(chunk.line[piece])
            if line not in self._reported:
                self._reported.add(line)
                mine = np.flatnonzero((owner == piece) & (depth > TOUCH))
                x, y, z = points[mine[0]].tolist()
                message = (
                    f"a rapid move enters the stock at X{x:.6g} Y{y:.6g} Z{z:.6g} and goes {float(depth[mine].max()):.6g} mm deep "
                    "where no feed move has been"
                )
                hint = "go down with G1, or start above the stock; positions are machine coordinates, after all offsets"
                yield Diagnostic(
                    "rapid-into-stock", message, chunk.file, line, hint=hint, severity="warning"
                )
