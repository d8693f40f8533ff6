"""A stretch of path as arrays: what travels from the path floor down to the pulses.

Each piece is smooth inside (a line, an arc or helix, one knot span of a NURBS) and is a record in
``data`` that the kernels of :mod:`cnc.kernels.path.curve` read. Pieces follow each other without a
gap; where two meet, the direction or the curvature may jump.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class PathChunk:
    """Consecutive pieces of a path.

    axes: names, one a column of every position. kind int64 (m,): LINE, ARC or SPAN of
    :mod:`cnc.kernels.path.curve`. at int64 (m,): where each piece's record starts in ``data``.
    length (m,): arc length in mm (degrees for a move of rotary axes alone), > 0. feed (m,): mm/s,
    NaN for a traverse. line int32 (m,): source lines in ``file``. stop_after bool (m,): motion
    comes to rest at the end of the piece. tolerance (m,): mm, how far the motion may leave the path
    at the joint behind the piece (0: not at all).
    """

    axes: tuple[str, ...]
    file: str
    kind: NDArray[np.int64]
    at: NDArray[np.int64]
    data: NDArray[np.float64]
    length: NDArray[np.float64]
    feed: NDArray[np.float64]
    line: NDArray[np.int32]
    stop_after: NDArray[np.bool_]
    tolerance: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.kind)

    def part(self, first: int, last: int) -> PathChunk:
        """The pieces [first, last)."""
        each = {
            field.name: getattr(self, field.name)[first:last]
            for field in fields(self)
            if field.name not in ("axes", "file", "data")
        }
        return replace(self, **each)
