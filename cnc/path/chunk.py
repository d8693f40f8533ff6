"""A section of a path as arrays, from the path layer down to the pulses.

Each piece is smooth inside: a line, an arc or helix, or one knot span of a NURBS. It is a record in
``data`` that the kernels of :mod:`cnc.path.kernels.curve` read. Pieces follow each other without a
gap. Where two meet, the direction or the curvature may jump.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from cnc.path.kernels.curve import piece_boxes


@dataclass(frozen=True, slots=True)
class PathChunk:
    """Consecutive pieces of a path.

    Attributes:
        axes: names, one for each column of a position.
        file: source file.
        kind: (m,): LINE, ARC or SPAN of :mod:`cnc.path.kernels.curve`.
        at: (m,): index in ``data`` at which the record of each piece begins.
        data: the records.
        length: (m,): arc length in mm (degrees for a move of rotary axes alone), > 0.
        feed: (m,): mm/s, NaN for a traverse.
        line: (m,): source line in ``file``.
        stop_after: (m,): whether motion comes to rest at the end of the piece.
        tolerance: (m,): largest distance of the motion from the path at the joint behind the piece,
            mm; 0: none.
        commands: (m,): commands that take effect at the start of a piece, see
            :mod:`cnc.model.motion_commands`; None without any.
        timed: whether each block is to take the time of its length at its feed (G93).
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
    commands: NDArray[np.object_] | None = None
    timed: bool = False

    def __len__(self) -> int:
        return len(self.kind)

    def part(self, first: int, last: int) -> PathChunk:
        """Return the pieces from ``first`` to before ``last``."""
        columns = {
            field.name: getattr(self, field.name)[first:last]
            for field in fields(self)
            if field.name not in ("axes", "file", "data", "commands", "timed")
        }
        commands = None if self.commands is None else self.commands[first:last]
        return replace(self, **columns, commands=commands)


# Bounding boxes of pieces: exact, with the bulges of arcs and splines between their end points.


def bounding_box(chunk: PathChunk) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest coordinate (m, n) of each piece in each axis, mm."""
    low = np.empty((len(chunk), len(chunk.axes)))
    high = np.empty_like(low)
    piece_boxes(chunk.kind, chunk.at, chunk.data, low, high)
    return low, high
