"""Where the stepper board's machine stands: the board's counts as grid points of the program, and
as people say them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.protocol import Alarm, Status
from cnc.machine.models import Machine

LOST = 1 << 30
"""Steps. An axis whose place is not known counts from here, so that the board says so, whatever
becomes of this program.
"""


class Place:
    """Of one machine. known (axes,): whose place is known. turned (axes,): -1 where the direction
    pin is, else 1.
    """

    def __init__(self, machine: Machine) -> None:
        axes = machine.axes.values()
        self.turned = np.array([-1 if axis.invert else 1 for axis in axes], dtype=np.int8)
        self.known = np.zeros(len(axes), np.bool_)
        self._letters = [letter.upper() for letter in machine.axes]
        self._steps_per_mm = machine.steps_per_mm
        self._homes = machine.can_home

    def found(self, status: Status) -> NDArray[np.int64]:
        """What a board that was just opened remembers, grid point (axes,); 0 of an axis that is not
        known.
        """
        counted = np.array(status.position[: len(self.turned)], dtype=np.int64)
        # Motors that a switch has stopped at once may have lost steps: a machine that can find its
        # place has to.
        doubtful = self._homes and status.alarm in (Alarm.LIMIT, Alarm.EMERGENCY_STOP)
        self.known = (np.abs(counted) < LOST // 2) & (status.position_known and not doubtful)
        return np.where(self.known, counted * self.turned, 0)

    def of(self, status: Status) -> NDArray[np.int64]:
        """Grid point (axes,) of a status."""
        counted = np.array(status.position[: len(self.turned)], dtype=np.int64)
        return (counted - np.where(self.known, 0, LOST)) * self.turned

    def counted(self, steps: NDArray[np.int64]) -> bytes:
        """What the board is to count from at a grid point (axes,): the payload of SET_POSITION."""
        counts = (steps * self.turned + np.where(self.known, 0, LOST)).tolist()
        return struct.pack("<4i", *[*counts, 0, 0, 0, 0][:4])

    def forget(self) -> None:
        """Nobody knows where the machine stands."""
        self.known = np.zeros_like(self.known)

    def standing(self, steps: NDArray[np.int64]) -> tuple[int | None, ...]:
        """A grid point (axes,), None for each axis that is not known."""
        return tuple(
            count if known else None
            for count, known in zip(steps.tolist(), self.known.tolist(), strict=True)
        )

    def mm(self, steps: NDArray[np.int64]) -> tuple[float, ...]:
        """Machine coordinates of a grid point (axes,)."""
        return tuple((steps / self._steps_per_mm).tolist())

    def words(self, steps: NDArray[np.int64]) -> str:
        """The same, for people."""
        return " ".join(
            f"{letter}{value:.4f}".rstrip("0").rstrip(".")
            for letter, value in zip(self._letters, self.mm(steps), strict=True)
        )

    def letters(self, bits: int) -> Sequence[str]:
        """The axes that a mask has."""
        return [letter for k, letter in enumerate(self._letters) if bits >> k & 1]
