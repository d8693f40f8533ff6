r"""The steppers: the running block over time, in closed form.

v ^        ______           at most three phases of constant acceleration, computed again from the
|       /      \          present motion whenever the plan, an override or a hold changes the rest;
|      /        \___      a hold brakes with the block's acceleration, across as many blocks as it
|_____/________________> t      takes
"""

from __future__ import annotations

import math
from collections.abc import Callable

from cnc.boards.grbl.simulator.planner import Move, Phase, Planner, Point

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
