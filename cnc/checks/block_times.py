"""Times of blocks under inverse time feed (G93): 1/F minutes, unless a limit forbids it.

The length of a block at its feed is its time. The planner never exceeds the feed. So a block that
has to speed up, to slow down or to keep a limit takes longer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

HALVINGS = 50
"""Halvings of a phase when a time is searched: more than the digits of a float."""


class BlockTimes:
    """Compares the times of blocks in a plan with those of their F words.

    Args:
        period: difference that is not reported, s.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._place = ("", 0)
        self._wanted = self._taken = 0.0

    def add(self, item: PlanChunk | Block) -> Iterator[Diagnostic]:
        """Yield a note for each block that ends in an item and takes another time."""
        if not isinstance(item, PlanChunk) or not item.path.timed:
            yield from self.end()
            return
        at = np.clip(item.piece_s, item.phase_s[0], item.phase_s[-1])
        taken, length = np.diff(times_at(item, at)), np.diff(at)
        wanted = length / item.path.feed
        file, lines = item.path.file, item.path.line
        begins = np.flatnonzero(np.diff(lines, prepend=lines[0] - 1))
        sums = zip(
            lines[begins].tolist(),
            np.add.reduceat(wanted, begins).tolist(),
            np.add.reduceat(taken, begins).tolist(),
            strict=True,
        )
        for line, due, actual in sums:
            if (file, line) != self._place:
                yield from self.end()
                self._place = file, line
            # A traverse has no feed: its time is not a number, and it is not reported.
            self._wanted += due
            self._taken += actual

    def end(self) -> Iterator[Diagnostic]:
        """Yield the note of the last block."""
        late = self._taken - self._wanted
        if abs(late) > self._period:
            message = f"the block takes {self._taken:.4f} s; F is {self._wanted:.4f} s"
            hint = "the machine has to speed up and slow down, or keeps a limit: give a smaller F"
            yield Diagnostic("block-time", message, *self._place, severity="note", hint=hint)
        self._place = ("", 0)
        self._wanted = self._taken = 0.0


def times_at(plan: PlanChunk, s: Floats) -> Floats:
    """Return the times from the start of a plan chunk at which it reaches arc lengths (m,), mm."""
    phase = np.searchsorted(plan.phase_s, s, side="right") - 1
    phase = np.clip(phase, 0, len(plan.phase_j) - 1)
    v, a, j = plan.phase_v[phase], plan.phase_a[phase], plan.phase_j[phase]
    ahead = s - plan.phase_s[phase]
    low, high = np.zeros(len(s)), np.diff(plan.phase_t)[phase]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        before = middle * (v + middle * (0.5 * a + middle * j / 6.0)) < ahead
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    found: Floats = plan.phase_t[phase] + high
    return found
