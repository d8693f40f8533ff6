"""Position of a machine on a Klipper board: counts of the motors, grid points, coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.layout import MotorObject
from cnc.machine.models import Machine


class MachinePosition:
    """Conversion between the counts of motors and the grid points of a machine.

    Attributes:
        known: Whether the position of each axis is known (axes,).
        offset: Grid point minus count, for each motor.
        moving: Whether each motor takes part in the motion.
    """

    def __init__(self, machine: Machine, motors: list[MotorObject]) -> None:
        self._motors = motors
        self._letters = [letter.upper() for letter in machine.axes]
        self._steps_per_mm = machine.steps_per_mm
        self.known = np.zeros(len(machine.axes), np.bool_)
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
        grid = np.zeros(len(self._letters), np.int64)
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
                    self._letters[motor.column]
                    for motor, count, offset, moving in zip(
                        self._motors, self.counts(positions), self.offset, self.moving, strict=True
                    )
                    if moving and count + offset != grid[motor.column]
                }
            )
        )

    def forget(self) -> None:
        """Mark the position of all axes as unknown."""
        self.known = np.zeros_like(self.known)

    def known_steps(self, steps: NDArray[np.int64]) -> tuple[int | None, ...]:
        """Return a grid point (axes,) with None for each axis whose position is not known."""
        return tuple(
            count if known else None
            for count, known in zip(steps.tolist(), self.known.tolist(), strict=True)
        )

    def mm(self, steps: NDArray[np.int64]) -> tuple[float, ...]:
        """Return the machine coordinates of a grid point (axes,), mm."""
        return tuple((steps / self._steps_per_mm).tolist())

    def text(self, steps: NDArray[np.int64]) -> str:
        """Return the machine coordinates of a grid point (axes,) as text."""
        return " ".join(
            f"{letter}{value:.4f}".rstrip("0").rstrip(".")
            for letter, value in zip(self._letters, self.mm(steps), strict=True)
        )

    def letter(self, column: int) -> str:
        """Return the letter of an axis."""
        return self._letters[column]
