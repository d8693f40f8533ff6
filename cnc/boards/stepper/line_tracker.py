"""Which source line made which grid move, kept until the board has left it behind."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

READ_AHEAD = 64
"""Bytes of the stream that the board has taken and may not have played yet."""


@dataclass(slots=True)
class _Stretch:
    """A stretch of the stream: its end in bytes, where the machine stands after each grid move, and
    the moves' lines.
    """

    until: int
    places: NDArray[np.int64]
    lines: NDArray[np.int32]


class Trail:
    """What was sent, stretch by stretch. sent: bytes of the stream.

    line: the source line at which the stretch begins that the board left last, 0 before it has left
    one: no later one than it is at.
    """

    def __init__(self, line: int = 0) -> None:
        self.sent = 0
        self.line = line
        self._stretches: deque[_Stretch] = deque()

    def add(self, size: int, places: NDArray[np.int64], lines: NDArray[np.int32]) -> None:
        """So many bytes more, which lead through ``places`` (n, axes)."""
        self.sent += size
        self._stretches.append(_Stretch(self.sent, places, lines))

    def passed(self, taken: int) -> None:
        """The board has taken so many bytes: all but the last stretch before them is over."""
        while len(self._stretches) > 1 and self._stretches[0].until + READ_AHEAD < taken:
            self.line = _first(self._stretches.popleft().lines) or self.line

    def clear(self) -> None:
        """All that was sent has been played."""
        for stretch in self._stretches:
            self.line = int(stretch.lines[-1]) or self.line
        self._stretches.clear()

    def line_at(self, place: NDArray[np.int64]) -> int:
        """Source line of the last move that leads to a grid point (axes,), 0 if that is none of a
        program or not known.
        """
        for stretch in reversed(self._stretches):
            here = np.flatnonzero((stretch.places == place).all(axis=1))
            if len(here):
                return int(stretch.lines[here[-1]])
        return 0


def _first(lines: NDArray[np.int32]) -> int:
    """The first line of a program, 0 if there is none."""
    known = lines[lines > 0]
    return int(known[0]) if len(known) else 0
