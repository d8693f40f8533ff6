"""Times of blocks under inverse time feed (G93): 1/F minutes, unless a limit forbids it.

The planner never exceeds the feed at which the programmed length of a block takes its time. So a
block that has to speed up, to slow down or to keep a limit takes longer. One whose path a blend or
a fit makes shorter may take less.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic
from cnc.path.due_times import DueTimes, Place
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

LATE = "the machine has to speed up and slow down, or keeps a limit: give a smaller F"
EARLY = "a blend or a fit (G64) shortens the path of the block: use a smaller tolerance, or G61"

HALVINGS = 50
"""Halvings of a phase when a time is searched: more than the digits of a float."""


class BlockTimes:
    """Compares the times of blocks in a plan with those of their F words.

    A fit may make one piece of several blocks; they count as one block at the first line. A blend
    between two blocks counts as part of the one whose line the plan gives it.

    Args:
        due: the times of the F words, in the order of the plan.
        period: difference that is not reported, s.
    """

    def __init__(self, due: DueTimes, period: float) -> None:
        self._due, self._period = due, period
        self._place: Place | None = None
        self._wanted = self._taken = 0.0

    def add(self, item: PlanChunk | Block) -> Iterator[Diagnostic]:
        """Yield a note for each block that has ended before an item, and takes another time."""
        if not isinstance(item, PlanChunk) or not item.path.timed:
            return
        at = np.clip(item.piece_s, item.phase_s[0], item.phase_s[-1])
        taken = np.diff(times_at(item, at))
        file, lines = item.path.file, item.path.line
        begins = np.flatnonzero(np.diff(lines, prepend=lines[0] - 1))
        sums = zip(lines[begins].tolist(), np.add.reduceat(taken, begins).tolist(), strict=True)
        for line, actual in sums:
            if (file, line) != self._place:
                yield from self._ended((file, line))
            self._wanted += self._due.at((file, line))
            self._taken += actual

    def end(self) -> Iterator[Diagnostic]:
        """Yield the note of the last block."""
        yield from self._ended(None)

    def _ended(self, following: Place | None) -> Iterator[Diagnostic]:
        """Yield the note of the present block, when another one begins."""
        between = self._due.before(following)
        late = self._taken - self._wanted - between
        # A traverse has no feed: its time is not a number, and it is not reported.
        if self._place is not None and abs(late) > self._period:
            wanted = self._wanted + between
            message = f"the block takes {self._taken:.4f} s; F is {wanted:.4f} s"
            hint = LATE if late > 0.0 else EARLY
            yield Diagnostic("block-time", message, *self._place, severity="note", hint=hint)
        # Blocks without a piece at the start of the plan count as part of the first one.
        self._wanted = between if self._place is None else 0.0
        self._place, self._taken = following, 0.0


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
