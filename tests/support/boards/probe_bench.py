"""A loopback board whose motors move a machine with errors, and whose probe touches blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.boards.protocols import BoardTraits
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Probe
from cnc.model.streams import PulseChunk
from tests.support.faulty_machine import FaultyMachine, pushed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Slab:
    """A block on the table, turned about an axis of the machine.

    Attributes:
        low: Its lowest corner, in its own directions, mm.
        high: Its highest corner, mm.
        angle: Turn of its first direction towards its second one, degrees.
        pair: Columns of these directions.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    angle: float = 0.0
    pair: tuple[int, int] = (0, 1)

    def distance(self, places: Floats) -> Floats:
        """Return the distances of places (n, 3), mm; negative inside."""
        own, (a, b), turn = places.copy(), self.pair, math.radians(self.angle)
        own[:, a] = math.cos(turn) * places[:, a] + math.sin(turn) * places[:, b]
        own[:, b] = math.cos(turn) * places[:, b] - math.sin(turn) * places[:, a]
        beside = np.maximum(np.array(self.low) - own, own - np.array(self.high))
        outside = np.linalg.norm(np.maximum(beside, 0.0), axis=1)
        distances: Floats = outside + np.minimum(beside.max(axis=1), 0.0)
        return distances


class Part:
    """Blocks, and the ball that touches them.

    Args:
        slabs: The blocks.
        radius: Radius of the ball, mm.
        noise: Repeatability of the probe: standard deviation of the distance of a contact, mm.
        seed: Of the noise.
    """

    def __init__(
        self, slabs: Sequence[Slab], radius: float = 1.0, noise: float = 0.0, seed: int = 0
    ) -> None:
        self.slabs, self.radius, self.noise = list(slabs), radius, noise
        self._dice = np.random.default_rng(seed)

    def contact_distance(self) -> float:
        """Return the distance from a block at which the next contact is, mm."""
        return self.radius + self.noise * float(self._dice.normal())

    def distance(self, places: Floats) -> Floats:
        """Return the distances of the ball's centre (n, 3) from the nearest block, mm."""
        nearest: Floats = np.min([slab.distance(places) for slab in self.slabs], axis=0)
        return nearest


class ProbeBench(Loopback):
    """A board of a machine with errors and a probe; it plays as fast as it is sent pulses.

    Args:
        machine: The machine, whose axes are its motors.
        start: Places of the motors, mm.
        faulty: Its errors.
        part: What the probe touches.
    """

    traits = BoardTraits(has_port=False)

    def __init__(
        self, machine: Machine, start: Sequence[float], faulty: FaultyMachine, part: Part
    ) -> None:
        super().__init__(len(machine.axes), 1e9 / machine.board.max_step_rate)
        self._scale = np.array(machine.steps_per_mm)
        self._position = np.rint(np.array(start) * self._scale).astype(np.int64)
        self._faulty, self._part = faulty, part
        plays = [faulty.backlash.get(letter, 0.0) for letter in "xyz"]
        self._nuts = self._position / self._scale - 0.5 * np.array(plays)
        self._screws = replace(faulty, backlash={})
        self._armed: Probe | None = None
        self._met = False
        self._threshold = 0.0

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis: the machine is homed."""
        return tuple(self._position.tolist())

    @property
    def tool(self) -> Floats:
        """Place of the tool (3,), mm."""
        place: Floats = self._screws.tool(self._nuts[None])[0]
        return place

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Record the block; a probing move ends at the contact."""
        expected = super().execute(block, time_ns)
        if not isinstance(block, Probe):
            return expected
        self._armed, self._met = block, False
        self._threshold = self._part.contact_distance()
        return None

    def send(self, chunk: PulseChunk) -> None:
        """Move the nuts by the grid moves, up to a contact that is waited for."""
        if self._armed is not None and self._met:
            return
        motors = (self._position + np.cumsum(chunk.step, axis=0)) / self._scale
        nuts = self._followed(motors)
        if self._armed is not None and len(nuts):
            near = self._part.distance(self._screws.tool(nuts)) <= self._threshold
            if near.any():
                rows = int(np.argmax(near)) + 1
                self._met, nuts = True, nuts[:rows]
                chunk = PulseChunk(chunk.time_ns[:rows], chunk.step[:rows], chunk.line[:rows])
        if len(nuts):
            self._nuts = nuts[-1]
        super().send(chunk)

    def probe_result(self) -> tuple[float, ...] | None:
        """Return whether the last probing move met something, and the places of the motors."""
        if self._armed is None:
            return None
        self._armed = None
        return (float(self._met), *(self._position / self._scale).tolist())

    def _followed(self, motors: Floats) -> Floats:
        """Return the places of the nuts (n, 3) that the motors (n, 3) push."""
        nuts = motors.copy()
        for column, letter in enumerate("xyz"):
            if play := self._faulty.backlash.get(letter, 0.0):
                nuts[:, column] = pushed(motors[:, column], play, float(self._nuts[column]))
        return nuts
