"""A loopback board with limit switches that follow its motors, and machines with a gantry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.machine.models import Axis, Homing, Machine
from cnc.machine.motors import Motor
from cnc.model.blocks import Block, SwitchMove
from cnc.model.streams import PulseChunk

STEPS_PER_MM = 100.0
QUICK = Homing(seek=20.0, latch=2.0, pull_off=0.5)


def axis(travel: tuple[float, float], homing: Homing = QUICK, **changes: Any) -> Axis:
    return Axis(
        steps_per_mm=STEPS_PER_MM,
        max_velocity=40.0,
        max_acceleration=400.0,
        max_jerk=15_000.0,
        travel=travel,
        homing=homing,
        **changes,
    )


def gantry(*offsets: float, homing: Homing = QUICK, letter: str = "y", **changes: Any) -> Machine:
    """Return a machine with an axis that has several motors; switches have these offsets."""
    motors = tuple(Motor(offset=offset) for offset in (0.0, *offsets))
    axes = {"x": axis((0.0, 8.0)), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))}
    travel = axes[letter].travel
    assert travel is not None
    axes[letter] = axis(travel, homing, motors=motors)
    return Machine(axes=axes).model_copy(update=changes)  # type: ignore[arg-type]


SwitchPlaces = dict[tuple[int, int], tuple[int, float]]
"""Direction and place of the switch of each motor (column, motor), steps of that motor."""
PLACES: SwitchPlaces = {
    (0, 0): (-1, -300),
    (1, 0): (-1, -410),
    (1, 1): (-1, -410),
    (2, 0): (1, 150),
}


class SwitchedLoopback(Loopback):
    """A board in which each motor of a gantry has its switch.

    Args:
        machine: The machine.
        places: The switches.
    """

    def __init__(self, machine: Machine, places: SwitchPlaces = PLACES) -> None:
        super().__init__(
            len(machine.axes), motors=[len(each.motors) for each in machine.axes.values()]
        )
        self.places = dict(places)
        self.known: tuple[bool, ...] = (False,) * self.axes
        self.origin = np.zeros(self.axes, np.int64)
        self.rows_sent: list[tuple[tuple[int, int] | None, NDArray[np.int8]]] = []
        self._armed: SwitchMove | None = None
        self._cut = False

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        steps = self.position_steps.tolist()
        return tuple(s if k else None for s, k in zip(steps, self.known, strict=True))

    def closed(self, column: int, motor: int, place: int | None = None) -> bool:
        towards, at = self.places[column, motor]
        here = self.motor_steps[column][motor] if place is None else place
        return (here - at) * towards >= 0

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        return tuple(
            tuple(self.closed(column, motor) for motor in range(len(motors)))
            for column, motors in enumerate(self.motor_steps)
        )

    @property
    def switches(self) -> tuple[bool, ...]:
        return tuple(any(each) for each in self.motor_switches)

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        self.known = tuple(known)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        super().execute(block, time_ns)
        if isinstance(block, SwitchMove):
            self._armed, self._cut = block, False
            motors = range(len(self.motor_steps[block.switch]))
            wanted = motors if block.motor is None else (block.motor,)
            assert not any(self.closed(block.switch, m) == block.towards for m in wanted)
        return None

    def send(self, chunk: PulseChunk) -> None:
        block = self._armed
        if block is None:
            self._put(chunk)
            return
        if self._cut:
            return
        column = block.switch
        motors = range(len(self.motor_steps[column]))
        for motor in motors if block.motor is None else (block.motor,):
            if self._alone in (None, (column, motor)):
                places = self.motor_steps[column][motor] + np.cumsum(chunk.step[:, column])
                hit = [
                    k
                    for k, place in enumerate(places.tolist())
                    if self.closed(column, motor, place) == block.towards
                ]
                if hit:
                    rows = hit[0] + 1
                    self._cut = True
                    chunk = PulseChunk(chunk.time_ns[:rows], chunk.step[:rows], chunk.line[:rows])
        self._put(chunk)

    def _put(self, chunk: PulseChunk) -> None:
        self.rows_sent.append((self._alone, chunk.step))
        super().send(chunk)

    def probe_result(self) -> tuple[float, ...] | None:
        if self._armed is None:
            return None
        self._armed = None
        at = self.position_steps / STEPS_PER_MM
        return (float(self._cut), *at.tolist())
