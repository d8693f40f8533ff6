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
from collections.abc import Callable
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


# The steppers: the running block over time, in closed form.
#
# v ^        ______           at most three phases of constant acceleration, computed again from the
# |       /      \          present motion whenever the plan, override or hold changes the rest;
# |      /        \___      a hold brakes with the block's acceleration, across as many blocks as it
# |_____/________________> t      takes

TINY = 1e-12
"""mm or mm/s: rounding."""
CLOCK_ROUNDING = 1e-6
"""mm or mm/s: rounding of a place or speed by that of the clock, which may have run for days."""


class Steppers:
    """The moving part of the board.

    Attributes:
        moves: The record of every block that has begun.
        trip_at: Returns the path length of a block at which a switch or the probe trips.
        stop_at: Path length (mm) of the running block at which one will trip; None for none.
    """

    def __init__(
        self, planner: Planner, trip_at: Callable[[Move], float | None], axes: int = 3
    ) -> None:
        self.planner = planner
        self.trip_at = trip_at
        self.moves: list[Move] = []
        self.position: Point = (0.0,) * axes
        self.running = False
        self.holding = False
        self.stop_at: float | None = None
        self._phases: list[Phase] = []
        self._s = 0.0
        self._v = 0.0

    @property
    def event(self) -> float:
        """When the running block ends, comes to rest, or trips a switch or the probe, s."""
        if not self.running:
            return math.inf
        if self.stop_at is not None:
            for phase in self._phases:
                when = phase.when(self.stop_at)
                if when is not None:
                    return when
        last = self._phases[-1]
        return last.time + last.duration

    def start(self, now: float) -> None:
        """Begin, if a block waits."""
        if not self.running and self.planner.blocks:
            self.running = True
            self._s = self._v = 0.0
            self._enter()
            self.replan(now)

    def resume(self, now: float) -> None:
        """Continue with the block in which a hold has stopped."""
        self.holding = False
        if not self.running and self.planner.blocks:
            self.running = True
            self._v = 0.0
            if not self.moves or self.moves[-1] is not self.planner.blocks[0]:
                self._enter()
            self.replan(now)

    def hold(self, now: float) -> None:
        """Brake to rest."""
        self.holding = True
        if self.running:
            self.replan(now)

    def replan(self, now: float) -> None:
        """Continue by the new plan."""
        if not self.running:
            self.planner.plan(
                0.0, self.planner.blocks[0].length - self._s if self.planner.blocks else 0.0
            )
            return
        self._s, self._v = self._now(now)
        self._cut_record(now)
        move = self.planner.blocks[0]
        self.planner.plan(self._v, move.length - self._s)
        self._phases = self._profile(move, now)
        move.phases.extend(self._phases)

    def state(self, now: float) -> tuple[Point, float]:
        """Return machine position (mm) and speed (mm/s)."""
        if not self.running:
            return self.position, 0.0
        s, v = self._now(now)
        return self.planner.blocks[0].point(s), v

    def settle(self, now: float) -> str:
        """Return the kind of :attr:`event`: ``tripped``, ``held``, ``next`` block or ``done``."""
        s, v = self._now(now)
        move = self.planner.blocks[0]
        if self.stop_at is not None and s >= self.stop_at - CLOCK_ROUNDING:
            self.stop_at = None
            return "tripped"
        self._phases = []
        if self.holding and v <= CLOCK_ROUNDING and s < move.length - CLOCK_ROUNDING:
            self._s, self._v = s, 0.0
            self.position = move.point(s)
            self.running = False
            return "held"
        self.position = move.end
        self.stop_at = None
        self.planner.blocks.popleft()
        self._s, self._v = 0.0, v
        if not self.planner.blocks:
            self._v = 0.0
            self.running = False
            return "done"
        if self.holding and v <= CLOCK_ROUNDING:
            self.running = False
            return "held"
        self._enter()
        self.replan(now)
        return "next"

    def halt(self, now: float) -> None:
        """Stop at once, and drop the waiting blocks."""
        if self.running:
            s, _ = self._now(now)
            self.position = self.planner.blocks[0].point(s)
            self._cut_record(now)
        self.flush()

    def flush(self) -> None:
        """Drop the blocks; the record keeps the part of the first that was carried out."""
        if self.planner.blocks and self.moves and self.moves[-1] is self.planner.blocks[0]:
            self.moves[-1].cut = True
            if not self.moves[-1].phases:
                self.moves.pop()
        self.planner.blocks.clear()
        self.running = self.holding = False
        self.stop_at = None
        self._phases = []
        self._s = self._v = 0.0

    def _enter(self) -> None:
        move = self.planner.blocks[0]
        self.moves.append(move)
        self.stop_at = self.trip_at(move)

    def _now(self, now: float) -> tuple[float, float]:
        """Return path length and speed in the running block."""
        for phase in self._phases:
            if now < phase.time + phase.duration:
                return phase.at(now)
        if self._phases:
            last = self._phases[-1]
            return last.at(last.time + last.duration)
        return self._s, self._v

    def _cut_record(self, now: float) -> None:
        """Remove from the record of the running block the part that was not carried out."""
        phases = self.planner.blocks[0].phases
        while phases and phases[-1].time >= now:
            phases.pop()
        if phases:
            last = phases[-1]
            if last.time + last.duration > now:
                phases[-1] = Phase(last.time, now - last.time, last.s, last.v, last.a)

    def _profile(self, move: Move, now: float) -> list[Phase]:
        """Return the phases to the end of the block, or to the rest of a hold."""
        s, v, a, left = self._s, self._v, move.acceleration, move.length - self._s
        phases: list[Phase] = []

        def run(distance: float, end_speed: float) -> None:
            """Append a phase of constant acceleration over ``distance``."""
            nonlocal s, v
            if distance <= TINY or v + end_speed <= 0.0:
                return
            time = phases[-1].time + phases[-1].duration if phases else now
            duration = 2.0 * distance / (v + end_speed)
            phases.append(Phase(time, duration, s, v, (end_speed - v) / duration))
            s, v = s + distance, end_speed

        if self.holding:
            distance = v * v / (2.0 * a)
            if distance < left:
                run(distance, 0.0)
            else:
                run(left, math.sqrt(max(v * v - 2.0 * a * left, 0.0)))
            return phases or [Phase(now, 0.0, s, v, 0.0)]
        nominal, leave = self.planner.nominal(move), math.sqrt(self.planner.exit_sq)
        if v > nominal:
            distance = min((v * v - nominal * nominal) / (2.0 * a), left)
            run(distance, math.sqrt(max(v * v - 2.0 * a * distance, 0.0)))
            left -= distance
        if left > 0.0:
            peak = math.sqrt(a * left + 0.5 * (v * v + leave * leave))
            if peak <= max(v, leave):
                # Only acceleration or only braking, as far as the distance allows.
                least, most = (
                    math.sqrt(max(v * v - 2.0 * a * left, 0.0)),
                    math.sqrt(v * v + 2.0 * a * left),
                )
                run(left, min(max(leave, least), most))
            else:
                peak = min(peak, nominal)
                up, down = (
                    max(peak * peak - v * v, 0.0) / (2.0 * a),
                    max(peak * peak - leave * leave, 0.0) / (2.0 * a),
                )
                run(up, peak)
                run(left - up - down, peak)
                run(down, leave)
        return phases or [Phase(now, 0.0, s, v, 0.0)]
