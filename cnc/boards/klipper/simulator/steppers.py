"""Motors of the simulator: their queues, and the edges of their step pins."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WRAP = 2**32
HALF = 2**31
"""Timers compare clocks by the sign of their 32-bit difference."""
NEVER = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Move:
    """An entry of the queue; ``forward`` is the level of the direction pin."""

    interval: int
    count: int
    add: int
    forward: int


class Motor:
    """A motor and its queue. Times are ticks of the board, 64 bits.

    Attributes:
        oid: Its object.
        step_pin: Number of its step pin.
        direction_pin: Number of its direction pin.
        pulse: Ticks from an edge of the step pin to the opposite one.
        position: Steps with the direction pin high minus those with it low.
        last: Clock of the last step, or of the last reset.
        needs_reset: Steps are dropped until ``reset_step_clock``.
        due: Clock of the next step, NEVER if none is due.
        fastest: Least ticks between two steps of all moves so far.
        past: Why the motor cannot go on; "" if it can.
    """

    def __init__(self, oid: int, step_pin: int, direction_pin: int, pulse: int) -> None:
        self.oid = oid
        self.step_pin = step_pin
        self.direction_pin = direction_pin
        self.pulse = pulse
        self.position = 0
        self.last = 0
        self.needs_reset = False
        self.past = ""
        self.due = NEVER
        self.fastest = HALF
        self._next_forward = 0
        self._queue: deque[Move] = deque()
        self._times: NDArray[np.int64] | None = None
        self._at = 0
        self._forward = 0

    @property
    def active(self) -> bool:
        """Whether steps are due."""
        return self._times is not None

    @property
    def queued(self) -> int:
        """Number of moves in the queue."""
        return len(self._queue)

    @property
    def next_due(self) -> int | None:
        """Clock of the next step, None if none is due."""
        return None if self._times is None else self.due

    @property
    def interval(self) -> int | None:
        """Ticks from the last step to the next one, None if none is due."""
        if self._times is None:
            return None
        before = int(self._times[self._at - 1]) if self._at else self.last
        return self.due - before

    def set_direction(self, forward: int) -> None:
        """Set the direction of the next moves."""
        self._next_forward = forward

    def reset(self, clock: int) -> None:
        """Set the clock from which the next interval counts."""
        self.last = clock
        self.needs_reset = False

    def add(self, interval: int, count: int, add: int, clock: int) -> str:
        """Append a move at a clock; return the reason of a shutdown, else ""."""
        move = Move(interval, count, add, self._next_forward)
        self.fastest = min(self.fastest, interval, interval + add * (count - 1))
        if self._times is not None:
            self._queue.append(move)
            return ""
        # The firmware adds 32-bit numbers and compares with the present clock.
        ahead = (self.last + interval - clock) % WRAP
        if ahead >= HALF:
            return "Timer too close"
        self.last = clock + ahead - interval
        self._load(move)
        return ""

    def play(self, until: int) -> tuple[NDArray[np.int64], int]:
        """Make all steps due up to a clock.

        Returns:
            Clock of each step (n,), positive for steps forward, and number of moves loaded.
        """
        made: list[NDArray[np.int64]] = []
        loaded = 0
        while self._times is not None:
            end = int(np.searchsorted(self._times, until, side="right"))
            part = self._times[self._at : end]
            if len(part):
                made.append(part if self._forward else -part)
                self.position += len(part) if self._forward else -len(part)
            self._at = end
            if end < len(self._times):
                self.due = int(self._times[end])
                break
            self.last = int(self._times[-1])
            self._times = None
            self.due = NEVER
            if self._queue:
                move = self._queue.popleft()
                loaded += 1
                if move.interval >= HALF:
                    self.past = "Rescheduled timer in the past"
                self._load(move)
        return (np.concatenate(made) if made else np.empty(0, np.int64)), loaded

    def stop(self) -> int:
        """Drop all moves until the next reset; return the number of moves that were queued."""
        freed = len(self._queue)
        if self._times is not None and self._at:
            self.last = int(self._times[self._at - 1])
        self._queue.clear()
        self._times = None
        self.due = NEVER
        self.needs_reset = True
        self._next_forward = 0
        return freed

    def _load(self, move: Move) -> None:
        k = np.arange(move.count, dtype=np.int64)
        self._times = self.last + (k + 1) * move.interval + move.add * (k * (k + 1) // 2)
        # Intervals rise or fall steadily, so the least is the second or the last.
        last = move.count - 1
        if last and move.interval + min(move.add, move.add * last) < 0:
            self.past = "Rescheduled timer in the past"
        self._at = 0
        self.due = int(self._times[0])
        self._forward = move.forward
