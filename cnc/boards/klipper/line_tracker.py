"""Source lines and grid points of the motion that was sent, until the board has played it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class _Part:
    """Clock (n,), grid point after (n, axes) and source line (n,) of each move."""

    clock: NDArray[np.int64]
    points: NDArray[np.int64]
    lines: NDArray[np.int32]


class LineTracker:
    """The motion that was sent.

    Attributes:
        line: Source line that the board has reached, or an earlier one.
    """

    def __init__(self) -> None:
        self.line = 0
        self._parts: deque[_Part] = deque()
        self._point: NDArray[np.int64] | None = None

    def add(
        self, clock: NDArray[np.int64], points: NDArray[np.int64], lines: NDArray[np.int32]
    ) -> None:
        """Add moves: their clocks (n,), grid points (n, axes) and source lines (n,)."""
        self._parts.append(_Part(clock, points, lines))

    def played(self, clock: int) -> NDArray[np.int64] | None:
        """Drop what has been played at a clock; return the grid point there if it is known."""
        while self._parts and self._parts[0].clock[-1] <= clock:
            part = self._parts.popleft()
            self.line = int(part.lines[-1]) or self.line
            self._point = part.points[-1]
        if self._parts:
            row = int(np.searchsorted(self._parts[0].clock, clock, side="right")) - 1
            if row >= 0:
                self.line = int(self._parts[0].lines[row]) or self.line
                self._point = self._parts[0].points[row]
        return self._point

    def clear(self, point: NDArray[np.int64]) -> None:
        """Drop everything: the board stands at a grid point (axes,)."""
        self._parts.clear()
        self._point = point

    def line_at(self, point: NDArray[np.int64]) -> int:
        """Return the source line of the last move to a grid point, 0 if it is not known."""
        for part in reversed(self._parts):
            rows = np.flatnonzero((part.points == point).all(axis=1))
            if len(rows):
                return int(part.lines[rows[-1]])
        return 0
