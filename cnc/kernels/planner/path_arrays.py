"""A path with the data that planning needs of each piece, as kernels take it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.pieces import Pieces


class PathArrays(NamedTuple):
    """Consecutive pieces of a path: the arrays of a :class:`cnc.path.chunk.PathChunk`.

    Kernels that make a path write into one that has space for more.

    Attributes:
        pieces: the curves.
        length: (n,): arc length of each piece, mm.
        feed: (n,): programmed feed, mm/s; NaN for a traverse.
        line: (n,) int32: source line.
        stop_after: (n,) bool: the motion rests at the end of the piece.
        tolerance: (n,): largest distance of the motion from the corner behind the piece, mm.
    """

    pieces: Pieces
    length: NDArray[np.float64]
    feed: NDArray[np.float64]
    line: NDArray[np.int32]
    stop_after: NDArray[np.bool_]
    tolerance: NDArray[np.float64]
