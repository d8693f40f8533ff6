"""Source lines of the grid moves that were sent, kept until the board has played them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

READ_AHEAD = 64
"""Bytes of the stream that the board may have decoded but not played yet."""


@dataclass(slots=True)
class _Part:
    """A part of the stream.

    Attributes:
        until: Its end, in bytes of the stream.
        points: Grid point after each move (n, axes).
        lines: Source line of each move (n,).
    """

    until: int
    points: NDArray[np.int64]
    lines: NDArray[np.int32]


class LineTracker:
    """The parts of the stream that were sent.

    Attributes:
        sent: Length of the stream, bytes.
        line: First source line of the last part that the board has completed, so the board is at
            this line or a later one; 0 before the first part is completed.
    """

    def __init__(self, line: int = 0) -> None:
        self.sent = 0
        self.line = line
        self._parts: deque[_Part] = deque()

    def add(self, size: int, points: NDArray[np.int64], lines: NDArray[np.int32]) -> None:
        """Add a part to the stream.

        Args:
            size: Its length, bytes.
            points: Grid point after each move (n, axes).
            lines: Source line of each move (n,).
        """
        self.sent += size
        self._parts.append(_Part(self.sent, points, lines))

    def taken(self, size: int) -> None:
        """Remove completed parts: all before the last one that ends within ``size`` bytes."""
        while len(self._parts) > 1 and self._parts[0].until + READ_AHEAD < size:
            self.line = _first(self._parts.popleft().lines) or self.line

    def clear(self) -> None:
        """Remove all parts, because the board has played everything."""
        for part in self._parts:
            self.line = int(part.lines[-1]) or self.line
        self._parts.clear()

    def line_at(self, point: NDArray[np.int64]) -> int:
        """Return the source line of the last move to a grid point (axes,), 0 if it is not known."""
        for part in reversed(self._parts):
            rows = np.flatnonzero((part.points == point).all(axis=1))
            if len(rows):
                return int(part.lines[rows[-1]])
        return 0


def _first(lines: NDArray[np.int32]) -> int:
    """Return the first line that is not 0, else 0."""
    known = lines[lines > 0]
    return int(known[0]) if len(known) else 0
