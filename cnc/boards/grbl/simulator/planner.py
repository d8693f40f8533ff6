r"""The planner: how fast each block may be entered.

The method is the one that GRBL documents (settings.md ``$11``; S. Jeon, "Improving Grbl: Cornering
Algorithm", 2011). At a corner the tool is taken to run through a circle that touches both lines and
misses the corner by the junction deviation d:

            \  |  /
             \ | /  d        half angle between the lines: theta/2,   R = d sin(theta/2) / (1 - sin(theta/2))
              \|/            v_junction^2 = a R
          -----*-----

Then one pass from the newest block back (each must be able to brake to what follows) and one from
the running block on (each must be able to get as fast as that) give the entry speeds.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

Point = tuple[float, float, float]

STRAIGHT = 0.999999
"""Cosine above which two lines are one, or the way back."""


@dataclass(frozen=True, slots=True)
class Phase:
    """Motion along a block at one acceleration: from ``time`` s on, ``duration`` s, from ``s`` mm
    on at ``v`` mm/s, ``a`` mm/s^2.
    """

    time: float
    duration: float
    s: float
    v: float
    a: float

    def at(self, time: float) -> tuple[float, float]:
        """Way (mm) and speed (mm/s) at a moment."""
        t = min(max(time - self.time, 0.0), self.duration)
        return self.s + (self.v + 0.5 * self.a * t) * t, max(self.v + self.a * t, 0.0)

    def when(self, s: float) -> float | None:
        """The moment at which the way ``s`` is reached, if it is in this phase."""
        way = s - self.s
        end, _ = self.at(self.time + self.duration)
        if way < 0.0 or s > end:
            return None
        # The smaller root of v t + a t^2 / 2 = way, in the form that loses no digits.
        root = math.sqrt(max(self.v * self.v + 2.0 * self.a * way, 0.0))
        return self.time + (2.0 * way / (self.v + root) if self.v + root > 0.0 else 0.0)


@dataclass(slots=True)
class Move:
    """A block of the planner and, afterwards, the record of it.

    kind: rapid, feed, jog, probe or home. start, end: machine position in mm, on the grid of steps.
    number: the N word, 0 without. source: which received line it is of, from 1. phases: how it was
    run. cut: whether it ended before ``end``.
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
        """Machine position after ``s`` mm of the way."""
        if s >= self.length:
            return self.end
        (x, y, z), (i, j, k) = self.start, self.unit
        return (x + s * i, y + s * j, z + s * k)

    @property
    def reached(self) -> Point:
        """Where it ended."""
        if not self.cut:
            return self.end
        last = self.phases[-1]
        return self.point(last.at(last.time + last.duration)[0])

    @property
    def begin_time(self) -> float:
        """When it began to move, s."""
        return self.phases[0].time

    @property
    def end_time(self) -> float:
        """When it came to its end, s."""
        return self.phases[-1].time + self.phases[-1].duration


def smallest_over_axes(limits: Point, unit: Point) -> float:
    """The largest value along ``unit`` at which no axis exceeds its own limit."""
    return min(
        limit / abs(part) if part else math.inf for limit, part in zip(limits, unit, strict=True)
    )


def junction_speed_sq(before: Point, after: Point, accelerations: Point, deviation: float) -> float:
    """Square of the speed (mm/s) through the corner between two directions."""
    cosine = -(before[0] * after[0] + before[1] * after[1] + before[2] * after[2])
    if cosine > STRAIGHT:
        return 0.0
    if cosine < -STRAIGHT:
        return math.inf
    change = (after[0] - before[0], after[1] - before[1], after[2] - before[2])
    size = math.sqrt(change[0] ** 2 + change[1] ** 2 + change[2] ** 2)
    acceleration = smallest_over_axes(
        accelerations, (change[0] / size, change[1] / size, change[2] / size)
    )
    half_sine = math.sqrt(0.5 * (1.0 - cosine))
    return acceleration * deviation * half_sine / (1.0 - half_sine)


class Planner:
    """The blocks that wait, the running one first."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.blocks: deque[Move] = deque()
        self.feed_override = 100
        self.rapid_override = 100

    @property
    def room(self) -> int:
        """Blocks that may be added."""
        return self.capacity - len(self.blocks)

    def nominal(self, move: Move) -> float:
        """The speed (mm/s) that a block is to be run at, overrides applied. Jogs and probes know
        none.
        """
        if move.kind == "rapid":
            return move.rapid_rate * self.rapid_override / 100.0
        if move.kind == "feed":
            return min(move.programmed * self.feed_override / 100.0, move.rapid_rate)
        return min(move.programmed, move.rapid_rate)

    def add(self, move: Move, accelerations: Point, deviation: float) -> None:
        """One more block behind the others."""
        if self.blocks:
            move.junction_sq = junction_speed_sq(
                self.blocks[-1].unit, move.unit, accelerations, deviation
            )
        self.blocks.append(move)

    def plan(self, speed: float, left: float) -> None:
        """Entry speeds of all blocks. ``speed``: of the running block now, mm/s; ``left``: what is
        left of it, mm.
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
