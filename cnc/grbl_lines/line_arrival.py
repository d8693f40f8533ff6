"""The times at which the lines of a program arrive at a GRBL board, and their moves end.

A board that gets short lines too slowly brakes for lack of moves, and may come to rest. See
:mod:`cnc.kernels.grbl_lines.arrival` for the model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.writer import BITS_PER_BYTE, BYTE_TIME, LINE_TIME
from cnc.kernels.grbl_lines.arrival import RING, STATE, Link, Moves, times_of

Floats = NDArray[np.float64]

LINE_END = 1
"""Bytes of the end of a line."""
BUFFER = 124
"""Bytes that may be on their way. GRBL's receive buffer holds 128, one of which stays free, and the
sender keeps three for a question.
"""
ANSWER_BYTES = 4
"""Bytes of an answer."""
USB_DELAY = 1e-3
"""Time of an answer in the USB port, s: a frame."""
GATHERING, LONGEST_GATHERING = 0.25, 8e-3
"""Average time in which the sender lets answers gather: part of the time of a full buffer on the
wire, and its limit, s.
"""
CHECK_BYTES = 3.0 / 20.0
"""Bytes for each line that the sender adds: ``$G`` and the line end for 20 lines."""


class LineArrival:
    """Follows the lines of one program.

    Attributes:
        sizes: Bytes of the lines since the last call of :meth:`times`; the caller appends to it.

    Args:
        limits: The board.
        cases: Number of pairs of overrides.
    """

    def __init__(self, limits: BoardLimits, cases: int) -> None:
        self.sizes: list[int] = []
        self._lines = 0
        self._states = np.zeros(cases, STATE)
        planner = min(limits.blocks + 1, RING - 1)
        if limits.baud:
            byte_time = BITS_PER_BYTE / limits.baud
            gathering = min(GATHERING * BUFFER * byte_time, LONGEST_GATHERING)
            answer = ANSWER_BYTES * byte_time + USB_DELAY + gathering
            self._link = Link(byte_time, CHECK_BYTES, BYTE_TIME, LINE_TIME, answer, BUFFER, planner)
        else:
            self._link = Link(0.0, 0.0, 0.0, 0.0, 0.0, BUFFER, planner)

    def times(self, moves: Moves, lines: NDArray[np.int64], done: int, total: Floats) -> Floats:
        """Return the time from the end of the move before to that of each of the first moves.

        Args:
            moves: The moves, with those that the board looks ahead; their lines are not used.
            lines: Numbers of the lines of the moves in the program (n,), from 0.
            done: Number of the first moves.
            total: Time of the program before them in each case (c,), s.

        Returns:
            Times (done, c), s.
        """
        self._states["end"] = total
        times = np.empty((done, len(self._states)))
        sizes = np.array(self.sizes, np.int64)
        moves = moves._replace(line=lines - self._lines)
        times_of(self._states, moves, sizes, done, self._link, times)
        self._lines += len(sizes)
        self.sizes.clear()
        return times

    def rest(self, total: Floats) -> None:
        """Note that the board rests until a time in each case (c,), s, and reads on then."""
        self._states["board"] = np.maximum(self._states["board"], total)
        self._states["speed"] = 0.0
