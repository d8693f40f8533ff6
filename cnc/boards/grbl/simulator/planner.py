r"""The planner: the speed at which each block may be entered.

The method is that of GRBL's documentation (settings.md ``$11``; S. Jeon, "Improving Grbl: Cornering
Algorithm", 2011). At a corner the tool is assumed to follow a circle that touches both lines and
misses the corner by the junction deviation d:

            \  |  /
             \ | /  d        half angle between the lines: theta/2,
              \|/            R = d sin(theta/2) / (1 - sin(theta/2)),   v_junction^2 = a R
          -----*-----

One pass goes from the newest block back: each must be able to brake to the speed of the next. One
pass goes from the running block on: each must be able to accelerate to that speed.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

Point = tuple[float, ...]
"""Position of each axis: X, Y, Z and the further ones that the board has."""

STRAIGHT = 0.999999
"""Cosine above which two directions are the same or opposite."""


@dataclass(frozen=True, slots=True)
class Phase:
    """A part of a block with one acceleration.

    It begins at ``time`` s and takes ``duration`` s, from path length ``s`` mm at ``v`` mm/s with
    ``a`` mm/s^2.
    """

    time: float
    duration: float
    s: float
    v: float
    a: float

    def at(self, time: float) -> tuple[float, float]:
        """Return path length (mm) and speed (mm/s) at a time."""
        t = min(max(time - self.time, 0.0), self.duration)
        return self.s + (self.v + 0.5 * self.a * t) * t, max(self.v + self.a * t, 0.0)

    def when(self, s: float) -> float | None:
        """Return the time at which the path length ``s`` is reached; None outside this phase."""
        distance = s - self.s
        end, _ = self.at(self.time + self.duration)
        if distance < 0.0 or s > end:
            return None
        # The smaller root of v t + a t^2 / 2 = distance, in the form that loses no digits.
        root = math.sqrt(max(self.v * self.v + 2.0 * self.a * distance, 0.0))
        return self.time + (2.0 * distance / (self.v + root) if self.v + root > 0.0 else 0.0)


@dataclass(slots=True)
class Move:
    """A block of the planner, and afterwards its record.

    Attributes:
        kind: rapid, feed, jog, probe or home.
        start: Machine position in mm, on the grid of steps.
        end: Machine position in mm, on the grid of steps.
        unit: Direction.
        length: mm.
        acceleration: mm/s^2.
        rapid_rate: Highest speed in this direction, mm/s.
        programmed: Programmed speed, mm/s.
        number: The N word; 0 without.
        source: Number of the received line, from 1.
        spindle: State and speed of the spindle.
        junction_sq: Square of the highest speed at its beginning.
        entry_sq: Square of the planned speed at its beginning.
        phases: How it was carried out.
        cut: Whether it ended before ``end``.
    """

    kind: str
    start: Point
    end: Point
    unit: Point
    length: float
    acceleration: float
    rapid_rate: float
    programmed: float
    number: int
    source: int
    spindle: tuple[str, float]
    junction_sq: float = 0.0
    entry_sq: float = 0.0
    phases: list[Phase] = field(default_factory=list)
    cut: bool = False

    def point(self, s: float) -> Point:
        """Return the machine position after ``s`` mm of the block."""
        if s >= self.length:
            return self.end
        return tuple(a + s * u for a, u in zip(self.start, self.unit, strict=True))

    @property
    def reached(self) -> Point:
        """Machine position where the block ended."""
        if not self.cut:
            return self.end
        last = self.phases[-1]
        return self.point(last.at(last.time + last.duration)[0])

    @property
    def begin_time(self) -> float:
        """Time of its beginning, s."""
        return self.phases[0].time

    @property
    def end_time(self) -> float:
        """Time of its end, s."""
        return self.phases[-1].time + self.phases[-1].duration


def smallest_over_axes(limits: Point, unit: Point) -> float:
    """Return the largest value along ``unit`` at which no axis exceeds its own limit."""
    return min(
        limit / abs(part) if part else math.inf for limit, part in zip(limits, unit, strict=True)
    )


def junction_speed_sq(before: Point, after: Point, accelerations: Point, deviation: float) -> float:
    """Return the square of the speed (mm/s) through the corner between two directions."""
    cosine = -sum(a * b for a, b in zip(before, after, strict=True))
    if cosine > STRAIGHT:
        return 0.0
    if cosine < -STRAIGHT:
        return math.inf
    change = tuple(b - a for a, b in zip(before, after, strict=True))
    size = math.hypot(*change)
    acceleration = smallest_over_axes(accelerations, tuple(part / size for part in change))
    half_sine = math.sqrt(0.5 * (1.0 - cosine))
    return acceleration * deviation * half_sine / (1.0 - half_sine)


class Planner:
    """The waiting blocks, the running one first."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.blocks: deque[Move] = deque()
        self.feed_override = 100
        self.rapid_override = 100

    @property
    def free(self) -> int:
        """Number of blocks that may be added."""
        return self.capacity - len(self.blocks)

    def nominal(self, move: Move) -> float:
        """Return the speed of a block, mm/s, with overrides; jogs and probes have none."""
        if move.kind == "rapid":
            return move.rapid_rate * self.rapid_override / 100.0
        if move.kind == "feed":
            return min(move.programmed * self.feed_override / 100.0, move.rapid_rate)
        return min(move.programmed, move.rapid_rate)

    def add(self, move: Move, accelerations: Point, deviation: float) -> None:
        """Append a block."""
        if self.blocks:
            move.junction_sq = junction_speed_sq(
                self.blocks[-1].unit, move.unit, accelerations, deviation
            )
        self.blocks.append(move)

    def plan(self, speed: float, left: float) -> None:
        """Compute the entry speeds of all blocks.

        Args:
            speed: Present speed of the running block, mm/s.
            left: Length that is left of it, mm.
        """
        blocks = self.blocks
        if not blocks:
            return
        nominal = [self.nominal(move) for move in blocks]
        exit_sq = 0.0
        for index in range(len(blocks) - 1, 0, -1):
            move = blocks[index]
            most = min(move.junction_sq, nominal[index] ** 2, nominal[index - 1] ** 2)
            exit_sq = move.entry_sq = min(most, exit_sq + 2.0 * move.acceleration * move.length)
        blocks[0].entry_sq = speed * speed
        length = left
        for index in range(len(blocks) - 1):
            move, following = blocks[index], blocks[index + 1]
            following.entry_sq = min(
                following.entry_sq, move.entry_sq + 2.0 * move.acceleration * length
            )
            length = following.length

    @property
    def exit_sq(self) -> float:
        """Square of the speed at the end of the running block."""
        return self.blocks[1].entry_sq if len(self.blocks) > 1 else 0.0
