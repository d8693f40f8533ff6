"""Source lines and grid points of the motion that was sent, until the board has played it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class _Part:
    """Some moves.

    Attributes:
        clock: Clock of each move (n,).
        points: Grid point after each move (n, axes).
        lines: Source line of each move (n,).
    """

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
        self._runs: deque[tuple[int, int, int, int]] = deque()
        self._received = np.empty(0, np.int64)
        self._received_line = 0
        self._begin = np.empty(0, np.int64)
        self._left = np.empty(0, np.bool_)
        self._back_at: int | None = None

    def add(
        self, clock: NDArray[np.int64], points: NDArray[np.int64], lines: NDArray[np.int32]
    ) -> None:
        """Add moves: their clocks (n,), grid points (n, axes) and source lines (n,)."""
        self._parts.append(_Part(clock, points, lines))
        if self._back_at is None:
            away = points != self._begin
            left = np.logical_or.accumulate(away, axis=0) | self._left
            self._left = left[-1]
            back = np.flatnonzero((left & ~away).any(axis=1))
            if len(back):
                self._back_at = int(clock[back[0]])

    def add_run(self, command: int, column: int, steps: int, line: int) -> None:
        """Add steps of an axis, which a command with this number has sent."""
        self._runs.append((command, column, steps, line))

    def acknowledge(self, command: int) -> None:
        """Note the number of the last command that the board has acknowledged."""
        while self._runs and self._runs[0][0] <= command:
            _, column, steps, self._received_line = self._runs.popleft()
            self._received[column] += steps

    def end_of_queue(self, acknowledged: int) -> NDArray[np.int64]:
        """Return the grid point after all steps that the board has; the line becomes that there."""
        self.acknowledge(acknowledged)
        self.line = self._received_line or self.line
        return self._received.copy()

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
        self._runs.clear()
        self._point, self._received = point, point.copy()
        self._begin, self._left, self._back_at = point, np.zeros(len(point), np.bool_), None

    def unmoved(self, point: NDArray[np.int64], clock: int) -> bool:
        """Return whether a stopped board with these counts has made no step since it stood still.

        An axis that was there and back has the same count, but may have stopped at speed.

        Args:
            point: Grid point (axes,) by the counts of the board.
            clock: Clock after which no step was made.
        """
        came_back = self._back_at is not None and self._back_at <= clock
        return not came_back and np.array_equal(point, self._begin)

    def line_at(self, point: NDArray[np.int64]) -> int:
        """Return the source line of the last move to a grid point, 0 if it is not known."""
        for part in reversed(self._parts):
            rows = np.flatnonzero((part.points == point).all(axis=1))
            if len(rows):
                return int(part.lines[rows[-1]])
        return 0
