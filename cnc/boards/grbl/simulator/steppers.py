r"""The steppers: the running block over time, in closed form.

v ^        ______           at most three phases of constant acceleration, computed anew from where the motion is
|       /      \          whenever the plan, an override or a hold changes what is to come; a hold brakes as
|      /        \___      hard as the block allows, across as many blocks as that takes
|_____/________________> t
"""

from __future__ import annotations

import math
from collections.abc import Callable

from cnc.boards.grbl.simulator.planner import Move, Phase, Planner, Point

TINY = 1e-12
"""mm, or mm/s: rounding."""


class Steppers:
    """What moves. ``moves``: the record of every block that has begun. ``trip_at``: on which way of
    a block a switch or the probe trips.
    """

    def __init__(self, planner: Planner, trip_at: Callable[[Move], float | None]) -> None:
        self.planner = planner
        self.trip_at = trip_at
        self.moves: list[Move] = []
        self.position: Point = (0.0, 0.0, 0.0)
        self.running = False
        self.holding = False
        self.stop_at: float | None = None
        """Way (mm) of the running block at which a switch or a probe will trip."""
        self._phases: list[Phase] = []
        self._s = 0.0
        self._v = 0.0

    @property
    def event(self) -> float:
        """When the running block ends, comes to rest, or trips something, s."""
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
        """Begin, if there is something to run."""
        if not self.running and self.planner.blocks:
            self.running = True
            self._s = self._v = 0.0
            self._enter()
            self.replan(now)

    def resume(self, now: float) -> None:
        """Go on with the block that a hold has stopped in."""
        self.holding = False
        if not self.running and self.planner.blocks:
            self.running = True
            self._v = 0.0
            if not self.moves or self.moves[-1] is not self.planner.blocks[0]:
                self._enter()
            self.replan(now)

    def hold(self, now: float) -> None:
        """Brake to a rest."""
        self.holding = True
        if self.running:
            self.replan(now)

    def replan(self, now: float) -> None:
        """The plan has changed: go on from here by the new one."""
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
        """Machine position (mm) and speed (mm/s)."""
        if not self.running:
            return self.position, 0.0
        s, v = self._now(now)
        return self.planner.blocks[0].point(s), v

    def settle(self, now: float) -> str:
        """What happened at :attr:`event`: ``tripped``, ``held``, ``next`` (a further block begins)
        or ``done``.
        """
        s, v = self._now(now)
        move = self.planner.blocks[0]
        if self.stop_at is not None and s >= self.stop_at - TINY and s < move.length:
            self.stop_at = None
            return "tripped"
        self._phases = []
        if self.holding and v <= TINY and s < move.length - TINY:
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
        if self.holding and v <= TINY:
            self.running = False
            return "held"
        self._enter()
        self.replan(now)
        return "next"

    def halt(self, now: float) -> None:
        """Stop dead, forget what waits."""
        if self.running:
            s, _ = self._now(now)
            self.position = self.planner.blocks[0].point(s)
            self._cut_record(now)
        self.flush()

    def flush(self) -> None:
        """Forget the blocks; the record keeps what was run of the first."""
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
        """Way and speed in the running block."""
        for phase in self._phases:
            if now < phase.time + phase.duration:
                return phase.at(now)
        if self._phases:
            last = self._phases[-1]
            return last.at(last.time + last.duration)
        return self._s, self._v

    def _cut_record(self, now: float) -> None:
        """Take from the running block's record what has not been run."""
        phases = self.planner.blocks[0].phases
        while phases and phases[-1].time >= now:
            phases.pop()
        if phases:
            last = phases[-1]
            if last.time + last.duration > now:
                phases[-1] = Phase(last.time, now - last.time, last.s, last.v, last.a)

    def _profile(self, move: Move, now: float) -> list[Phase]:
        """The phases from here to the end of the block, or to the rest that a hold asks for."""
        s, v, a, left = self._s, self._v, move.acceleration, move.length - self._s
        phases: list[Phase] = []

        def run(way: float, end_speed: float) -> None:
            """One phase of constant acceleration over ``way``."""
            nonlocal s, v
            if way <= TINY or v + end_speed <= 0.0:
                return
            time = phases[-1].time + phases[-1].duration if phases else now
            duration = 2.0 * way / (v + end_speed)
            phases.append(Phase(time, duration, s, v, (end_speed - v) / duration))
            s, v = s + way, end_speed

        if self.holding:
            way = v * v / (2.0 * a)
            if way < left:
                run(way, 0.0)
            else:
                run(left, math.sqrt(max(v * v - 2.0 * a * left, 0.0)))
            return phases or [Phase(now, 0.0, s, v, 0.0)]
        nominal, leave = self.planner.nominal(move), math.sqrt(self.planner.exit_sq)
        if v > nominal:
            way = min((v * v - nominal * nominal) / (2.0 * a), left)
            run(way, math.sqrt(max(v * v - 2.0 * a * way, 0.0)))
            left -= way
        if left > 0.0:
            peak = math.sqrt(a * left + 0.5 * (v * v + leave * leave))
            if peak <= max(v, leave):
                # Only up or only down: what the distance allows, which may be more than what was
                # asked for.
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
