"""Position of a machine on the stepper board: counts of the board, grid points, coordinates."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.boards.pulse_board.position import MachinePosition
from cnc.boards.stepper.motor_outputs import MotorOutputs
from cnc.boards.stepper.protocol import Alarm, Status
from cnc.machine.models import Machine

LOST = 1 << 30
"""Count at which an axis with an unknown position starts, so that the board remembers this."""


class BoardPosition(MachinePosition):
    """Conversion between the counts of the board and the grid points of a machine.

    Attributes:
        outputs: The motors at the outputs of the board.
    """

    def __init__(self, machine: Machine) -> None:
        super().__init__(machine)
        self.outputs = MotorOutputs(machine)
        self._can_home = machine.can_home

    def restore(self, status: Status) -> NDArray[np.int64]:
        """Take over the position that a board remembers when it is opened.

        Returns:
            Grid point (axes,), 0 for each axis whose position is not known.
        """
        counts = self._counts(status)
        first = counts[: len(self.known)]
        # Motors that a switch stopped at once may have lost steps. A machine that can home must
        # then home again.
        doubtful = self._can_home and status.alarm in (Alarm.LIMIT, Alarm.EMERGENCY_STOP)
        self.known = (np.abs(first) < LOST // 2) & (status.position_known and not doubtful)
        # Motors of an axis that differ were stopped while homing squared them.
        np.logical_and.at(self.known, self.outputs.column, counts == first[self.outputs.column])
        return np.where(self.known, first, 0)

    def of(self, status: Status) -> NDArray[np.int64]:
        """Return the grid point (axes,) of a status; of several motors that move the first."""
        counts = self._counts(status) - self._lost()
        point = np.zeros(len(self.known), np.int64)
        for output in reversed(np.flatnonzero(self.outputs.moving).tolist()):
            point[self.outputs.column[output]] = counts[output]
        return point

    def differing(self, status: Status) -> Sequence[str]:
        """Return the letters of the axes whose moving motors do not agree."""
        counts, point = self._counts(status) - self._lost(), self.of(status)
        wrong = self.outputs.moving & (counts != point[self.outputs.column])
        return [self.letters[column] for column in np.unique(self.outputs.column[wrong])]

    def payload(self, steps: NDArray[np.int64]) -> bytes:
        """Return the payload of SET_POSITION for a grid point (axes,)."""
        outputs = self.outputs
        counts = ((steps[outputs.column] + self._lost()) * outputs.direction).tolist()
        return struct.pack("<4i", *[*counts, 0, 0, 0, 0][:4])

    def _counts(self, status: Status) -> NDArray[np.int64]:
        """Return the counts of the outputs (outputs,) in the directions of their axes."""
        outputs = self.outputs
        return np.array(status.position[: outputs.count], np.int64) * outputs.direction

    def _lost(self) -> NDArray[np.int64]:
        """Return where the counts of the outputs (outputs,) start: LOST for a lost position."""
        outputs = self.outputs
        lost: NDArray[np.int64] = np.where(self.known[outputs.column], 0, LOST).astype(np.int64)
        return lost * outputs.direction

    def letters_of(self, bits: int) -> Sequence[str]:
        """Return the letters of the axes of the limit inputs in a mask."""
        columns = {int(c) for k, c in enumerate(self.outputs.column) if bits >> k & 1}
        return [self.letters[column] for column in sorted(columns)]
