"""The material that is left: a grid of heights, lowered along a path."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.pieces import Pieces
from cnc.kernels.stock.sweep import Assembly, Depths, Field, Route, cut_pieces
from cnc.machine.models import Stock
from cnc.path.chunk import PathChunk

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RESOLUTION = 0.1
"""mm. Width of a cell, unless another is asked for."""
MOST_CELLS = 4_000_000
"""Limit on the cells (32 MB) where no resolution is asked for; the cells are wider then."""
CHORD = 0.05
"""Cells. Largest distance of a chord from the short moves that it replaces."""
BAND = 64
"""Least number of columns for each processor."""
WORTH_THREADS = 256
"""Pieces of a path from which on it is cut by all processors."""


class Material:
    """The stock while it is cut.

    Args:
        stock: The cuboid at the start.
        resolution: Width of a cell, mm; None for the default.

    Attributes:
        heights: (nx, ny) height of the material at the centre of each cell, mm.
        low: (3,) lowest corner of the stock, mm.
        high: (3,) highest corner, mm.
        cell: Width of a cell, mm.
    """

    def __init__(self, stock: Stock, resolution: float | None = None) -> None:
        self.low, self.high = np.array([stock.x, stock.y, stock.z]).T.copy()
        self.cell = resolution or default_resolution(stock)
        nx, ny = np.ceil((self.high - self.low)[:2] / self.cell - 1e-9).astype(np.int64)
        self.heights: Floats = np.full((max(1, nx), max(1, ny)), self.high[2])
        bands = min(os.cpu_count() or 1, len(self.heights) // BAND)
        self._pool = ThreadPoolExecutor(bands) if bands > 1 else None
        edges = np.linspace(0, len(self.heights), max(1, bands) + 1).astype(np.int64).tolist()
        self._bands = list(pairwise(edges))

    def cut(self, path: PathChunk, columns: Ints, offset: Floats, tool: Assembly) -> Depths:
        """Remove the material along a path.

        Args:
            path: The path.
            columns: (3,) columns of x, y and z in a position.
            offset: (3,) tool offset, mm.
            tool: The tool.
        """
        # Kernels are compiled for arrays that may be written to.
        kind, at, data = np.array(path.kind), np.array(path.at), np.array(path.data)
        pieces = Pieces(kind, at, data)
        route = Route(pieces, np.isnan(path.feed), columns, offset)
        field = Field(self.heights, self.low[:2].copy(), self.cell, float(self.high[2]))
        count = len(path)

        def cut_band(band: tuple[int, int]) -> Depths:
            depths = Depths(np.zeros((count, 3)), np.zeros((count, 3, 2)))
            cut_pieces(field, band, route, tool, CHORD * self.cell, depths)
            return depths

        if self._pool is None or count < WORTH_THREADS:
            return _deepest([cut_band((0, len(self.heights)))])
        return _deepest(list(self._pool.map(cut_band, self._bands)))

    def removed_volume(self) -> float:
        """Return the volume that was removed so far, mm^3."""
        depth = self.high[2] - np.maximum(self.heights, self.low[2])
        return float(depth.sum()) * self.cell**2


def default_resolution(stock: Stock) -> float:
    """Return the width of a cell for a stock, mm; larger where there would be too many cells."""
    area = math.prod(high - low for low, high in (stock.x, stock.y))
    return max(RESOLUTION, math.sqrt(area / MOST_CELLS))


def _deepest(bands: list[Depths]) -> Depths:
    """Return the depths of all bands together."""
    if len(bands) == 1:
        return bands[0]
    depth = np.stack([each.depth for each in bands])
    best = depth.argmax(axis=0)
    rows, parts = np.indices(best.shape)
    place = np.stack([each.place for each in bands])
    return Depths(depth.max(axis=0), place[best, rows, parts])
