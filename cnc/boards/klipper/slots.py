"""Entries of the move queue of a Klipper board."""

from __future__ import annotations

import heapq


class Slots:
    """Entries of the board's queue, by the clocks at which they are free again.

    Args:
        count: Number of entries.

    Attributes:
        slack: Ticks that an entry counts longer: the board may be late, and the present clock is
            an estimate.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.slack = 0
        self._ends: list[int] = []

    def add(self, clock: int) -> None:
        """Add an entry that is free again at a clock."""
        heapq.heappush(self._ends, clock)

    def used(self, clock: int) -> int:
        """Return the number of entries in use at a clock."""
        while self._ends and self._ends[0] <= clock - self.slack:
            heapq.heappop(self._ends)
        return len(self._ends)

    def clear(self) -> None:
        """Forget all entries: the board has dropped them."""
        self._ends.clear()
