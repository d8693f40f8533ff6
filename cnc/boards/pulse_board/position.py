"""Position of a machine on a board that counts steps: which axes are known, coordinates, text."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine


class MachinePosition:
    """Positions of a machine.

    Attributes:
        known: Whether the position of each axis is known (axes,).
        letters: Letter of each axis.
    """

    def __init__(self, machine: Machine) -> None:
        self.letters = [letter.upper() for letter in machine.axes]
        self.known = np.zeros(len(machine.axes), np.bool_)
        self._steps_per_mm = machine.steps_per_mm

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
            for letter, value in zip(self.letters, self.mm(steps), strict=True)
        )
