"""Times that the blocks of a path are to take under inverse time feed (G93).

They are taken from the blocks as they are programmed, before a fit or a blend changes the path.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cnc.path.records import Floats

Place = tuple[str, int]
"""File and line of a block."""


class DueTimes:
    """The blocks under G93 that are not taken yet, in the order of their motion."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[Place, float]] = deque()

    def clear(self) -> None:
        """Forget all blocks."""
        self._blocks.clear()

    def add(self, file: str, lines: NDArray[np.int32], seconds: Floats) -> None:
        """Add moves: the source line and the time of each (m,), s; NaN for a traverse."""
        for line, each in zip(lines.tolist(), seconds.tolist(), strict=True):
            self._blocks.append(((file, line), each))

    def before(self, place: Place | None) -> float:
        """Take the moves before the next one of a place, and return the sum of their times, s.

        Args:
            place: None takes all moves.
        """
        return self._taken(lambda found: found != place)

    def at(self, place: Place) -> float:
        """Take the next moves while they are of a place, and return the sum of their times, s."""
        return self._taken(lambda found: found == place)

    def _taken(self, wanted: Callable[[Place], bool]) -> float:
        total, blocks = 0.0, self._blocks
        while blocks and wanted(blocks[0][0]):
            total += blocks.popleft()[1]
        return total
