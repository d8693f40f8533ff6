"""Switches and trigger synchronisation of the simulator: what stops motors at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from cnc.boards.klipper.simulator.steppers import Motor


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
