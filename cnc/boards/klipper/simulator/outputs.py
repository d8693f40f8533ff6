"""Outputs of the simulator: scheduled levels, and the longest time without an update."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field


@dataclass(slots=True)
class Output:
    """A digital or PWM output.

    Attributes:
        oid: Its object.
        pin: Number of its pin.
        value: Present value: 0 or 1, ticks of a software PWM, or of PWM_MAX.
        default: Value in a shutdown.
        max_duration: Longest time at another value without an update, ticks; 0 for no limit.
        pwm: Whether it is a hardware PWM.
        waiting: Scheduled values, with their clocks.
        epoch: Counts the updates.
    """

    oid: int
    pin: int
    value: int
    default: int
    max_duration: int
    pwm: bool = False
    cycle_ticks: int = 0
    waiting: deque[tuple[int, int]] = field(default_factory=deque)
    deadline: int | None = None
    epoch: int = 0

    @property
    def missed(self) -> str:
        """Reason of the shutdown after a missing update."""
        kind = "hard pwm" if self.pwm else "digital out"
        return f"Missed scheduling of next {kind} event"

    @property
    def exceeded(self) -> str:
        """Reason of the shutdown after an update that is scheduled too late."""
        kind = "pwm" if self.pwm else "digital out"
        return f"Scheduled {kind} event will exceed max_duration"

    def is_late(self, clock: int) -> bool:
        """Return whether an update at a clock is later than ``max_duration`` allows."""
        if not self.max_duration:
            return False
        if self.waiting:
            before, value = self.waiting[-1]
            return value != self.default and clock > before + self.max_duration
        return self.deadline is not None and clock > self.deadline

    def set(self, value: int, clock: int) -> None:
        """Set a value at a clock."""
        self.value = value
        limited = self.max_duration and value != self.default
        self.deadline = clock + self.max_duration if limited else None
        self.epoch += 1
