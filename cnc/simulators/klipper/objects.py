"""Objects of the simulated board: motors, triggers, switches, outputs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

# Motors of the simulator: their queues, and the edges of their step pins.

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


# Switches and trigger synchronisation of the simulator: what stops motors at once.


@dataclass(slots=True)
class Trigger:
    """A trsync object.

    Attributes:
        oid: Its object.
        can_trigger: Whether it is armed.
        reason: Reason of the last trigger, 0 for none.
        expire_reason: Reason of a timeout.
        report_ticks: Ticks between two reports, 0 for none.
        motors: Motors that it stops.
        epoch: Counts the arming, so that old timers have no effect.
    """

    oid: int
    can_trigger: bool = False
    reason: int = 0
    expire_reason: int = 0
    report_ticks: int = 0
    motors: list[Motor] = field(default_factory=list)
    epoch: int = 0
    timeout_epoch: int = 0


@dataclass(slots=True)
class Switch:
    """An endstop object.

    Attributes:
        oid: Its object.
        pin: Number of its pin.
        pull_up: Whether the open pin is high.
        armed: Whether it is sampled.
        next_clock: Clock of the next sample.
        trigger: Trigger that it fires.
        trigger_reason: Reason that it gives.
        sample_ticks, sample_count, rest_ticks: Ticks between samples that confirm, their number,
            and ticks between samples at rest.
        wanted: Level that fires.
        left: Samples that still have to confirm.
        epoch: Counts the arming.
    """

    oid: int
    pin: int
    pull_up: bool
    armed: bool = False
    next_clock: int = 0
    trigger: Trigger | None = None
    trigger_reason: int = 0
    sample_ticks: int = 0
    sample_count: int = 0
    rest_ticks: int = 0
    wanted: int = 0
    left: int = 0
    epoch: int = 0

    def arm(self, clock: int, times: Sequence[int], wanted: int) -> None:
        """Begin to sample at a clock; ``times`` are sample_ticks, sample_count, rest_ticks."""
        self.sample_ticks, self.sample_count, self.rest_ticks = times
        self.next_clock, self.wanted, self.left = clock, wanted, self.sample_count
        self.armed = True
        self.epoch += 1

    def sample(self, level: int) -> bool:
        """Take a sample; return whether the switch fires."""
        if level != self.wanted:
            self.left = self.sample_count
            self.next_clock += self.rest_ticks
            return False
        self.left -= 1
        if self.left > 0:
            self.next_clock += self.sample_ticks
            return False
        self.armed = False
        return True

    def sample_at(self, clock: int) -> int:
        """Return the clock of the first sample at a clock or after it, at rest."""
        if self.next_clock >= clock or self.rest_ticks <= 0:
            return self.next_clock
        behind = clock - self.next_clock
        return self.next_clock + -(-behind // self.rest_ticks) * self.rest_ticks

    def skip_to(self, clock: int) -> None:
        """Skip the samples before a clock, while the level does not change."""
        self.next_clock = self.sample_at(clock)


Level = Callable[[], int]
"""A source of a level that depends on the motion."""


@dataclass(slots=True)
class EndLevel:
    """Level of a switch at an end of a motor's travel.

    Attributes:
        positions: Count of steps of each motor by its step pin.
        step_pin: The motor's step pin.
        end: Direction in which the motor presses it, 1 or -1, and its place in steps of this count.
        active: Level of the pressed switch.
    """

    positions: Mapping[int, int]
    step_pin: int
    end: tuple[int, float]
    active: int

    def __call__(self) -> int:
        """Return the present level."""
        return self.active if self._beyond >= 0 else 1 - self.active

    @property
    def steps(self) -> int:
        """Least number of steps until the level changes."""
        beyond = self._beyond
        return math.floor(beyond) + 1 if beyond >= 0 else math.ceil(-beyond)

    @property
    def _beyond(self) -> float:
        towards, place = self.end
        return (self.positions.get(self.step_pin, 0) - place) * towards


# Outputs of the simulator: scheduled levels, and the longest time without an update.


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
