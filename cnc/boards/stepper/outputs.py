"""Outputs of the stepper board: spindle, coolant, motor drivers; and its outputs for motors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import Action
from cnc.boards.pulse_board import OutputState
from cnc.machine.models import Machine

ENABLED, SPINDLE, BACKWARD, FLOOD, MIST = 1, 2, 4, 8, 16
"""Bits of the outputs."""


def actions(motors: int) -> frozenset[Action]:
    """Return the actions that a board supports between moves.

    Step and direction of a fourth motor use the pins of two outputs.

    Args:
        motors: Number of motors of the board.
    """
    usual: frozenset[Action] = frozenset(("spindle", "flood"))
    return usual if motors == 4 else usual | {"spindle backward", "mist"}


def output_bytes(state: OutputState) -> tuple[int, int]:
    """Return the arguments of the command in the stream: bits, and duty of the spindle's PWM."""
    on = ENABLED * state.enabled | FLOOD * state.flood | MIST * state.mist
    if state.spindle != "off":
        on |= SPINDLE | BACKWARD * (state.spindle == "ccw")
    return on, round(255 * state.share)


# Outputs of the stepper board and the motors of a machine.
#
# Each axis has an output with its first motor, in the order of the axes. Further motors of an axis,
# as in a gantry, have the outputs after these. An output has the limit input of the same number.
#
#       axes      x         y         z
#       outputs   0: x      1: y      2: z      3: second motor of y

MAX_OUTPUTS = 4
FOURTH = 0x08
"""Bit of the limit input of the fourth output."""


class MotorOutputs:
    """The motors of a machine at the outputs of a board.

    Attributes:
        column: Column of the axis of each output (outputs,).
        motor: Number of the motor among those of its axis, for each output.
        direction: -1 for each output with an inverted direction pin, else 1 (outputs,).
        moving: Whether each output takes part in the motion (outputs,).
    """

    def __init__(self, machine: Machine) -> None:
        axes = list(machine.axes.values())
        places = [(column, 0) for column in range(len(axes))]
        places += [
            (column, motor)
            for column, axis in enumerate(axes)
            for motor in range(1, len(axis.motors))
        ]
        self._places = places
        self.column = np.array([column for column, _ in places])
        self.motor = tuple(motor for _, motor in places)
        inverted = [axes[c].invert != axes[c].motors[m].invert for c, m in places]
        self.direction = np.where(inverted, -1, 1).astype(np.int8)
        self.moving = np.ones(len(places), np.bool_)
        self.axes = len(axes)

    @property
    def count(self) -> int:
        """Number of outputs."""
        return len(self._places)

    @property
    def is_gantry(self) -> bool:
        """Whether an axis has several motors."""
        return self.count > self.axes

    @property
    def has_fourth_limit(self) -> bool:
        """Whether the fourth output is a further motor, so that it needs a limit input."""
        return self.is_gantry and self.count == MAX_OUTPUTS

    @property
    def limits(self) -> int:
        """Bits of the limit inputs."""
        switches = MAX_OUTPUTS if self.has_fourth_limit else MAX_OUTPUTS - 1
        return (1 << min(self.count, switches)) - 1

    def select(self, alone: tuple[int, int] | None) -> None:
        """Let one motor of an axis (column, motor) take part in the motion, or all."""
        self.moving = np.array(
            [alone is None or place[0] != alone[0] or place == alone for place in self._places]
        )

    def of_axis(self, column: int) -> list[int]:
        """Return the outputs of an axis, in the order of its motors."""
        return [k for k, place in enumerate(self._places) if place[0] == column]

    def bits(self, watched: Sequence[bool]) -> int:
        """Return the bits of the limit inputs of some axes."""
        return self.limits & sum(
            1 << k for k, (column, _) in enumerate(self._places) if watched[column]
        )

    def expanded(self, step: NDArray[np.int8]) -> NDArray[np.int8]:
        """Return steps (n, axes) as steps of the outputs (n, outputs), in their directions."""
        steps = step[:, self.column] * (self.direction * self.moving)
        return np.ascontiguousarray(steps, np.int8)
