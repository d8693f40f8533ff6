"""Bounding boxes of pieces: exact, with the bulges of arcs and splines between their end points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.extremes import piece_boxes
from cnc.path.chunk import PathChunk


def bounding_box(chunk: PathChunk) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest coordinate (m, n) of each piece in each axis, mm."""
    low = np.empty((len(chunk), len(chunk.axes)))
    high = np.empty_like(low)
    piece_boxes(chunk.kind, chunk.at, chunk.data, low, high)
    return low, high
