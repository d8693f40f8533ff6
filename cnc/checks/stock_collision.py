"""Rapid moves into the stock where no feed move has removed material.

    rapid                The box is a grid of columns over X and Y. A feed move lowers the columns
  ----.   .-----         that the centre of the tool passes. A rapid move below the surface of its
 _____v___|______ stock  column is a finding. Peck drilling and a second pass through a slot are
|     |xxx|      |       none, because a feed move was there before. The tool has no radius here,
|     '---' feed |       apart from the columns next to its own.
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

COLUMN_WIDTH = 0.1
"""mm. Width of a column, unless an axis would have more than MAX_COLUMNS."""
MAX_COLUMNS = 1000
TOLERANCE = 1e-3
"""mm. Rounding alone may take a rapid move this far below the surface."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class StockCheck:
    """Follows the remaining stock along a path. The machine must have the axes x, y and z."""

    def __init__(self, machine: Machine, stock: Stock) -> None:
        self._columns = [machine.axis_names.index(axis) for axis in "xyz"]
        self._low, self._high = np.array([stock.x, stock.y, stock.z]).T
        width = max(COLUMN_WIDTH, float((self._high - self._low)[:2].max()) / MAX_COLUMNS)
        self._width = width
        shape = np.ceil((self._high - self._low)[:2] / width).astype(np.int64)
        # One more column at each side, so that every column has neighbours.
        self._surface: Floats = np.full(shape + 2, self._high[2])
        self._reported: set[int] = set()

    def add(self, chunk: PathChunk) -> Iterator[Diagnostic]:
        """Remove the material along ``chunk`` and report rapid moves into the rest.

        Yields:
            A ``rapid-into-stock`` for each source line, without the text of the line.
        """
        low, high = bounding_box(chunk)
        outside = (high[:, self._columns] <= self._low) | (low[:, self._columns] >= self._high)
        pieces: Ints = np.flatnonzero(~outside.any(axis=1))
        if not len(pieces):
            return
        rapid = np.isnan(chunk.feed[pieces])
        # Feed moves are taken together. Rapid moves are taken one by one, because a rapid move
        # through material that another has passed is not reported again.
        for run in np.split(pieces, np.flatnonzero(rapid[1:] | rapid[:-1]) + 1):
            points, owner = points_along(chunk, self._width / 2.0, run)
            points = points[:, self._columns]
            inside = ((points > self._low) & (points < self._high)).all(axis=1)
            points, owner = points[inside], owner[inside]
            where = tuple(((points[:, :2] - self._low[:2]) / self._width).astype(np.int64).T + 1)
            if np.isnan(chunk.feed[run[0]]):
                yield from self._rapid_findings(chunk, points, owner, where)
            np.minimum.at(self._surface, where, points[:, 2])

    def _rapid_findings(
        self, chunk: PathChunk, points: Floats, owner: Ints, where: tuple[Ints, ...]
    ) -> Iterator[Diagnostic]:
        """Yield the findings for points (n, 3) of rapid moves inside the box."""
        i, j = where
        surface = np.min(
            [self._surface[i + a, j + b] for a in (-1, 0, 1) for b in (-1, 0, 1)], axis=0
        )
        depth = surface - points[:, 2]
        for piece in np.unique(owner[depth > TOLERANCE]).tolist():
            line = int(chunk.line[piece])
            if line not in self._reported:
                self._reported.add(line)
                mine = np.flatnonzero((owner == piece) & (depth > TOLERANCE))
                x, y, z = points[mine[0]].tolist()
                message = (
                    f"a rapid move enters the stock at X{x:.6g} Y{y:.6g} Z{z:.6g} and goes "
                    f"{float(depth[mine].max()):.6g} mm deep where no feed move has been"
                )
                hint = (
                    "plunge with G1, or start above the stock; "
                    "positions are machine coordinates, after all offsets"
                )
                yield Diagnostic(
                    "rapid-into-stock", message, chunk.file, line, hint=hint, severity="warning"
                )
