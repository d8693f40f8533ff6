"""Nuts with backlash at the end of a motion: their motors push them up.

A board counts the steps of a motor, not the side of its nut. So each motion ends with the take-up
of the nuts that are pushed down: their motors move up by the backlash, and the tool rests. Then a
count alone says where the tool is, to the next program, to the display, and after a new start.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Polyline
from cnc.model.streams import PulseChunk
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.session.pipeline import path_of

FILE = "backlash"
"""The file name of the take-up, which belongs to no program."""
PUSHED_UP = 1.0 - 1e-6
"""Side of a nut that counts as pushed up."""


class NutsPushedUp:
    """An interpolator whose motion ends with all nuts pushed up.

    Args:
        pulses: Makes the pulses of the motion.
        joints: The joints of the machine.
        take_up: Makes those of the take-up; it begins anywhere.
    """

    def __init__(self, pulses: ReferencePulse, joints: Joints, take_up: ReferencePulse) -> None:
        self._pulses, self._joints, self._take_up = pulses, joints, take_up
        self._last_ns, self._line = 0, 0
        self._is_up = True

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at the start of the motion (axes,)."""
        return self._pulses.origin_steps

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after all pulses so far (axes,)."""
        return (self._pulses if not self._is_up else self._take_up).position_steps

    @property
    def steps_made(self) -> NDArray[np.int64]:
        """Number of steps of each axis (axes,) in all pulses so far."""
        return self._pulses.steps_made + self._take_up.steps_made

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """Yield the grid moves of a chunk of the plan."""
        self._is_up = False
        self._last_ns = round((chunk.t0 + chunk.duration) * 1e9)
        self._line = int(chunk.path.line[-1])
        yield from self._pulses.pulses(chunk)

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """Set the grid point (axes,) where the machine stands, which was not planned."""
        self._pulses.stand_at(grid)

    def settle(self) -> Iterator[PulseChunk]:
        """Yield the last move of the motion, and the take-up; nothing where that was done."""
        if self._is_up:
            return
        for chunk in self._pulses.settle():
            self._last_ns = max(self._last_ns, int(chunk.time_ns[-1]))
            yield chunk
        self._is_up = True
        here = self._pulses.position_steps
        self._take_up.stand_at(here)
        end = self._pulses.end
        if end is None:
            return
        scale = self._joints.machine.steps_per_mm
        sides = self._joints.sides_at(end)
        target = self._joints.at(self._joints.tip_on(here / scale, sides))
        for column in range(len(here)):
            if sides.get(column, 1.0) >= PUSHED_UP:
                target[column] = here[column] / scale[column]
        yield from self._moved(here / scale, target)

    def _moved(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> Iterator[PulseChunk]:
        """Yield the pulses of a straight move of the motors (axes,), mm."""
        machine = self._joints.machine
        block = Polyline(FILE, 0, end[None], np.array([np.nan]), np.zeros(1, np.int32))
        for item in LookAhead(machine).plan(path_of([block], machine, start)):
            if isinstance(item, PlanChunk):
                yield from map(self._behind, self._take_up.pulses(item))
        yield from map(self._behind, self._take_up.settle())

    def _behind(self, chunk: PulseChunk) -> PulseChunk:
        """Return pulses of the take-up behind the motion."""
        lines = np.full(len(chunk.line), self._line, np.int32)
        return PulseChunk(chunk.time_ns + self._last_ns, chunk.step, lines)


def ending_pushed_up(pulses: ReferencePulse, joints: Joints) -> ReferencePulse | NutsPushedUp:
    """Return an interpolator whose motion ends with all nuts pushed up."""
    if not joints.has_play:
        return pulses
    return NutsPushedUp(pulses, joints, pulses.of_joints())
