"""Commands that go with the motion: the time of each, and their place among the pulses."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block
from cnc.model.motion_commands import places_of
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk

SAME_PLACE = 1e-9
"""mm. A slice of a plan that begins this near to a piece begins at the piece."""
BISECTIONS = 60
"""Halvings of a phase until its time is exact to rounding."""


class CommandsInMotion:
    """Puts commands between the pulses of a plan, in order of time.

    Args:
        carry_out: Carries out a command at a time since the start of the program, ns.
    """

    def __init__(self, carry_out: Callable[[Block, int], object]) -> None:
        self._carry_out = carry_out
        self._due: deque[tuple[int, tuple[Block, ...]]] = deque()
        self._last: tuple[Block, ...] | None = None

    def add(self, chunk: PlanChunk) -> None:
        """Add the commands of a chunk of the plan, each once.

        A piece may extend over several chunks.
        """
        places = places_of(chunk.path.commands)
        if not places:
            return
        assert chunk.path.commands is not None
        starts = chunk.piece_s[places]
        last = float(chunk.phase_s[-1]) - SAME_PLACE
        times = times_at(chunk, starts)
        for place, start, time in zip(places, starts.tolist(), times.tolist(), strict=True):
            blocks = chunk.path.commands[place]
            if start < last and blocks is not self._last:
                self._last = blocks
                self._due.append((round((chunk.t0 + time) * 1e9), blocks))

    def among(self, chunks: Iterable[PulseChunk]) -> Iterator[PulseChunk]:
        """Yield the pulses, and carry out each command before the first pulse that follows it."""
        due = self._due
        for chunk in chunks:
            first, count = 0, len(chunk.time_ns)
            while due and count and due[0][0] <= chunk.time_ns[-1]:
                at = int(np.searchsorted(chunk.time_ns, due[0][0]))
                if at > first:
                    yield _part(chunk, slice(first, at))
                self._carry_out_first()
                first = at
            if first < count:
                yield _part(chunk, slice(first, count)) if first else chunk

    def finish(self) -> None:
        """Carry out the commands behind the last pulse."""
        while self._due:
            self._carry_out_first()

    def _carry_out_first(self) -> None:
        time_ns, blocks = self._due.popleft()
        for block in blocks:
            self._carry_out(block, time_ns)


def times_at(chunk: PlanChunk, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the times at which a plan reaches places of its path.

    Args:
        chunk: The plan.
        places: Arc lengths (n,), mm; those outside the plan give its nearest end.

    Returns:
        Times from ``chunk.t0`` (n,), s.
    """
    last = len(chunk.phase_j) - 1
    k = np.clip(np.searchsorted(chunk.phase_s, places, side="right") - 1, 0, last)
    v, a, j = chunk.phase_v[k], chunk.phase_a[k], chunk.phase_j[k]
    ahead = places - chunk.phase_s[k]
    low, high = np.zeros(len(places)), chunk.phase_t[k + 1] - chunk.phase_t[k]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        short = middle * (v + middle * (0.5 * a + middle * j / 6.0)) < ahead
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    times: NDArray[np.float64] = chunk.phase_t[k] + low
    return times


def _part(chunk: PulseChunk, rows: slice) -> PulseChunk:
    return PulseChunk(chunk.time_ns[rows], chunk.step[rows], chunk.line[rows])
