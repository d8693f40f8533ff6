"""Position of a machine on the stepper board: counts of the board, grid points, coordinates."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.protocol import Alarm, Status
from cnc.machine.models import Machine

LOST = 1 << 30
"""Count at which an axis with an unknown position starts, so that the board remembers this."""


class BoardPosition:
    """Conversion between the counts of the board and the grid points of a machine.

    Attributes:
        known: Whether the position of each axis is known (axes,).
        direction: -1 for each axis with an inverted direction pin, else 1 (axes,).
    """

    def __init__(self, machine: Machine) -> None:
        axes = machine.axes.values()
        self.direction = np.array([-1 if axis.invert else 1 for axis in axes], dtype=np.int8)
        self.known = np.zeros(len(axes), np.bool_)
        self._letters = [letter.upper() for letter in machine.axes]
        self._steps_per_mm = machine.steps_per_mm
        self._can_home = machine.can_home

    def restore(self, status: Status) -> NDArray[np.int64]:
        """Take over the position that a board remembers when it is opened.

        Returns:
            Grid point (axes,), 0 for each axis whose position is not known.
        """
        counts = np.array(status.position[: len(self.direction)], dtype=np.int64)
        # Motors that a switch stopped at once may have lost steps. A machine that can home must
        # then home again.
        doubtful = self._can_home and status.alarm in (Alarm.LIMIT, Alarm.EMERGENCY_STOP)
        self.known = (np.abs(counts) < LOST // 2) & (status.position_known and not doubtful)
        return np.where(self.known, counts * self.direction, 0)

    def of(self, status: Status) -> NDArray[np.int64]:
        """Return the grid point (axes,) of a status."""
        counts = np.array(status.position[: len(self.direction)], dtype=np.int64)
        return (counts - np.where(self.known, 0, LOST)) * self.direction

    def payload(self, steps: NDArray[np.int64]) -> bytes:
        """Return the payload of SET_POSITION for a grid point (axes,)."""
        counts = (steps * self.direction + np.where(self.known, 0, LOST)).tolist()
        return struct.pack("<4i", *[*counts, 0, 0, 0, 0][:4])

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

    def letters(self, bits: int) -> Sequence[str]:
        """Return the letters of the axes in a mask."""
        return [letter for k, letter in enumerate(self._letters) if bits >> k & 1]
