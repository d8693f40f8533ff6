"""A loopback board with limit switches that follow its motors, and machines with a gantry."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import SwitchedLoopback, SwitchPlaces
from cnc.machine.models import Axis, Homing, Machine, Motor
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


PLACES: SwitchPlaces = {
    (0, 0): (-1, -300),
    (1, 0): (-1, -410),
    (1, 1): (-1, -410),
    (2, 0): (1, 150),
}


class RecordedLoopback(SwitchedLoopback):
    """A board that keeps the rows of each chunk, and the motor that alone was to move.

    Args:
        machine: The machine.
        places: The switches.
    """

    def __init__(self, machine: Machine, places: SwitchPlaces = PLACES) -> None:
        super().__init__(machine, places)
        self.rows_sent: list[tuple[tuple[int, int] | None, NDArray[np.int8]]] = []

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        if isinstance(block, SwitchMove):
            each = self.motor_switches[block.switch]
            wanted = each if block.motor is None else (each[block.motor],)
            assert not any(closed == block.towards for closed in wanted)
        return super().execute(block, time_ns)

    def send(self, chunk: PulseChunk) -> None:
        before = self.rows
        super().send(chunk)
        self.rows_sent.append((self._alone, chunk.step[: self.rows - before]))
