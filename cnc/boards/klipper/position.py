"""Position of a machine on a Klipper board: counts of the motors, grid points, coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.layout import MotorObject
from cnc.boards.pulse_board.position import MachinePosition
from cnc.machine.models import Machine


class MotorPosition(MachinePosition):
    """Conversion between the counts of motors and the grid points of a machine.

    Attributes:
        offset: Grid point minus count, for each motor.
        moving: Whether each motor takes part in the motion.
    """

    def __init__(self, machine: Machine, motors: list[MotorObject]) -> None:
        super().__init__(machine)
        self._motors = motors
        self.offset = [0] * len(motors)
        self.moving = [True] * len(motors)

    def select(self, alone: tuple[int, int] | None) -> None:
        """Let one motor of an axis (column, motor) take part in the motion, or all."""
        self.moving = [
            alone is None or each.column != alone[0] or each.number == alone[1]
            for each in self._motors
        ]

    def counts(self, positions: list[int]) -> list[int]:
        """Return the counts of the motors in the directions of their axes."""
        return [
            count if motor.forward else -count
            for count, motor in zip(positions, self._motors, strict=True)
        ]

    def set(self, positions: list[int], grid: NDArray[np.int64]) -> None:
        """Set the grid point (axes,) at which the motors have these positions."""
        self.offset = [
            int(grid[motor.column]) - count
            for count, motor in zip(self.counts(positions), self._motors, strict=True)
        ]

    def of(self, positions: list[int]) -> NDArray[np.int64]:
        """Return the grid point (axes,) of positions; of several motors that move the first."""
        grid = np.zeros(len(self.letters), np.int64)
        for motor, count, offset, moving in reversed(
            list(zip(self._motors, self.counts(positions), self.offset, self.moving, strict=True))
        ):
            if moving:
                grid[motor.column] = count + offset
        return grid

    def differing(self, positions: list[int]) -> str:
        """Return the letters of the axes whose motors do not agree, "" if all do."""
        grid = self.of(positions)
        return " ".join(
            sorted(
                {
                    self.letters[motor.column]
                    for motor, count, offset, moving in zip(
                        self._motors, self.counts(positions), self.offset, self.moving, strict=True
                    )
                    if moving and count + offset != grid[motor.column]
                }
            )
        )

    def letter(self, column: int) -> str:
        """Return the letter of an axis."""
        return self.letters[column]
