"""Moves that the planner has given and that were not sent yet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Moves(NamedTuple):
    """Grid moves in the order of their times.

    Attributes:
        time_ns: Time of each move (n,), ns.
        step: Step of each axis (n, axes), -1, 0 or 1.
        line: Source line of each move (n,).
        points: Grid point after each move (n, axes).
    """

    time_ns: NDArray[np.int64]
    step: NDArray[np.int8]
    line: NDArray[np.int32]
    points: NDArray[np.int64]

    def part(self, rows: slice) -> Moves:
        """Return some of the moves."""
        return Moves(self.time_ns[rows], self.step[rows], self.line[rows], self.points[rows])


class WaitingMoves:
    """A queue of moves."""

    def __init__(self) -> None:
        self._parts: list[Moves] = []

    def __bool__(self) -> bool:
        return bool(self._parts)

    @property
    def first_ns(self) -> int:
        """Time of the first move, ns."""
        return int(self._parts[0].time_ns[0])

    @property
    def last_ns(self) -> int:
        """Time of the last move, ns."""
        return int(self._parts[-1].time_ns[-1])

    def append(self, moves: Moves) -> None:
        """Add moves at the end."""
        self._parts.append(moves)

    def joined(self) -> Moves:
        """Return all moves."""
        if len(self._parts) > 1:
            joined = Moves(*(np.concatenate(each) for each in zip(*self._parts, strict=True)))
            self._parts[:] = [joined]
        return self._parts[0]

    def drop(self, rows: int) -> None:
        """Drop the first moves."""
        moves = self.joined()
        self._parts[:] = [moves.part(slice(rows, None))] if rows < len(moves.time_ns) else []

    def clear(self) -> None:
        """Drop all moves."""
        self._parts.clear()
