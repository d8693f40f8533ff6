"""Squaring of a gantry: each motor of an axis moves to its own limit switch.

      motor 1  ─────────────►│          both move until the first switch closes
      motor 2  ─────────►        │      then each other motor moves alone, until its own closes
                         ◄──────►
                          at most squaring_limit: no motor moves further alone

So the gantry is never pulled out of square by more than the limit. The difference between the
motors is known after that, and a larger one is an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.executor.homing_cycles import AxisHoming
from cnc.model.diagnostics import BoardError


@dataclass(frozen=True, slots=True)
class Squared:
    """The result of squaring an axis.

    Attributes:
        letter: Letter of the axis.
        skew: How far each motor was ahead of the first one, in the direction of the switches, mm.
        limit: Largest difference allowed, mm.
    """

    letter: str
    skew: tuple[float, ...]
    limit: float

    @property
    def description(self) -> str:
        """Description for the operator."""
        letter = self.letter.upper()
        found = " and ".join(
            f"motor {number} was {abs(skew):.3f} mm {'behind' if skew < 0 else 'ahead of'} motor 1"
            for number, skew in enumerate(self.skew[1:], start=2)
        )
        return f"{letter}: {found} (limit {self.limit:g} mm); they are square now"


class Mover(Protocol):
    """What squaring needs of the homing of a machine."""

    steps: NDArray[np.int64]

    def motor_switches(self, cycle: AxisHoming) -> Sequence[bool]:
        """Return whether the switch of each motor is closed."""

    def coordinate(self, cycle: AxisHoming) -> float:
        """Return the coordinate of the axis, mm."""

    def go(
        self,
        cycle: AxisHoming,
        distance: float,
        feed: float,
        until: bool | None = None,
        motor: int | None = None,
        *,
        alone: bool = False,
    ) -> bool:
        """Move towards the switch; return whether it reached the state that ends the move."""

    def failed(self, message: str, hint: str, code: str = "homing-switch") -> BoardError:
        """Return an error."""


def square(mover: Mover, cycle: AxisHoming, began: float) -> Squared | None:
    """Move each motor whose switch is open alone, until its switch closes.

    The common position of the motors stays that at the begin.

    Args:
        mover: The homing of the machine.
        cycle: The cycle of the axis, of which a switch has closed.
        began: Coordinate at the begin of the search, mm.

    Returns:
        What was found, None for an axis with one switch.

    Raises:
        BoardError: ``homing-square``, if the motors differ by more than the limit.
    """
    closed = list(mover.motor_switches(cycle))
    if len(closed) < 2:
        return None
    offsets, limit = cycle.offsets, cycle.settings.squaring_limit
    common = mover.steps.copy()
    here = mover.coordinate(cycle)
    ends = [here] * len(closed)
    # The first motor is the reference; if it is open, the one that is closed.
    first = closed.index(True) if True in closed else 0
    for motor, shut in enumerate(closed):
        if shut:
            continue
        mover.steps = common.copy()
        longest = limit + cycle.towards * (offsets[motor] - offsets[first])
        found = longest > 0.0 and mover.go(
            cycle, longest, cycle.settings.latch, True, motor, alone=True
        )
        ends[motor] = mover.coordinate(cycle)
        if not found:
            back = cycle.towards * (ends[motor] - here)
            if back > 0.0:
                mover.go(cycle, -back, cycle.settings.latch, None, motor, alone=True)
            raise _differ(mover, cycle, began, (first, here), (motor, ends[motor]), found=False)
    mover.steps = common
    skew = tuple(
        -cycle.towards * (end - ends[0] - offset) for end, offset in zip(ends, offsets, strict=True)
    )
    worst = max(range(len(skew)), key=lambda motor: abs(skew[motor]))
    if abs(skew[worst]) > limit:
        raise _differ(mover, cycle, began, (0, ends[0]), (worst, ends[worst]), found=True)
    return Squared(cycle.letter, skew, limit)


def align(mover: Mover, cycle: AxisHoming) -> bool:
    """Move each motor whose switch has an offset alone by this offset.

    Returns:
        Whether a motor has moved.
    """
    common = mover.steps.copy()
    moved = False
    for motor, offset in enumerate(cycle.offsets):
        if offset and len(mover.motor_switches(cycle)) > 1:
            distance = -cycle.towards * offset
            mover.go(cycle, distance, cycle.settings.latch, None, motor, alone=True)
            mover.steps = common.copy()
            moved = True
    return moved


def _differ(
    mover: Mover,
    cycle: AxisHoming,
    began: float,
    one: tuple[int, float],
    other: tuple[int, float],
    *,
    found: bool,
) -> BoardError:
    """Return the error for two motors, each with its number and the coordinate it reached."""
    letter = cycle.letter.upper()
    (a, first), (b, second) = one, other
    tail = "closed its" if found else "had not closed its"
    message = (
        f"the gantry of {letter} is not square: motor {a + 1} closed its switch after "
        f"{abs(first - began):.3f} mm, motor {b + 1} {tail} after {abs(second - began):.3f} mm; "
        f"axes.{cycle.letter}.homing.squaring_limit is {cycle.settings.squaring_limit:g} mm"
    )
    hint = (
        "check both switches and their wires; then push the gantry square by hand with the "
        "drivers off, and home again"
    )
    return mover.failed(message, hint, "homing-square")
