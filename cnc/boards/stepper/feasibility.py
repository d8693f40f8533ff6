"""Whether a stepper board can play a program: what its interrupt and the connection have to do for it,
before anything moves.

Two stores between the computer and the pins take up what comes too fast for a moment: the queue of
grid moves before the interrupt, and the store of segments behind the connection. Each is a bucket that
fills with what the program asks for and empties at the speed that can be kept up:

    grid moves ──► queue ──► one every `least_ns`    segments' bytes ──► store ──► what the connection brings in that time, and the board decodes

A bucket that runs over is a fault at its source line. It is the same encoder as in the run, and the
same pieces.
"""

from __future__ import annotations

import numpy as np

from cnc.boards.stepper.segments import SegmentEncoder, split
from cnc.boards.stepper.sender import PIECE_S, TOLERANCE_NS
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.model.streams import PulseChunk

LATE_NS = 1_000_000
"""By so much grid moves may be late in a burst."""
KEPT = 510
"""Bytes by which the store may be emptied before the board takes its host for gone: half of what it
holds.
"""
PAYLOAD = 0.55
"""Share of the connection's bytes that are the stream's, as measured in the simulator."""
DECODED_PER_S, HEAD = 65_000, 6
"""Bytes that the board decodes in a second, each segment counted as so many more: between 200
random programs that it played and 35 that it did not, measured in the simulator
(docs/how-to/stepper-board.md).
"""


class FeasibilityCheck:
    """What a program asks of a board with so many axes. least_ns: time between grid moves that it
    can keep up; baud: bits/s of the connection.
    """

    def __init__(self, axes: int, least_ns: int, baud: int) -> None:
        self._least_ns = least_ns
        self._bytes_per_s = baud / 10 * PAYLOAD
        self._encoder = SegmentEncoder(axes, TOLERANCE_NS)
        self._step_ns = 0
        self._late_ns = 0
        self._piece_ns = round(PIECE_S * 1e9)
        self._filled = self._undecoded = 0.0
        self._filled_at = 0
        self.most_late_ns = 0
        self.most_filled = 0.0

    def add(self, chunk: PulseChunk) -> None:
        """Grid moves, in their order. MotionLimitError ``board-step-rate``, ``board-too-dense``."""
        if not len(chunk.time_ns):
            return
        self._count(chunk)
        time_ns = chunk.time_ns
        cuts = np.searchsorted(
            time_ns, np.arange(time_ns[0] + self._piece_ns, time_ns[-1], self._piece_ns)
        )
        for part in np.split(np.arange(len(time_ns)), cuts):
            if len(part):
                rows = slice(int(part[0]), int(part[-1]) + 1)
                data = (
                    self._encoder.push(
                        PulseChunk(time_ns[rows], chunk.step[rows], chunk.line[rows])
                    )
                    + self._encoder.flush()
                )
                self._send(data, int(time_ns[rows][-1]), int(chunk.line[rows][0]))

    def _count(self, chunk: PulseChunk) -> None:
        """The queue: how late each grid move is, if one comes every ``least_ns``."""
        # A move is made at the latest of the times at which those before it let it: t_k =
        # max(due_k, t_(k-1) + least).
        k = np.arange(len(chunk.time_ns), dtype=np.int64) * self._least_ns
        first = max(int(chunk.time_ns[0]), self._step_ns + self._least_ns)
        made = np.maximum(np.maximum.accumulate(chunk.time_ns - k), first) + k
        late = made - chunk.time_ns
        self._step_ns = int(made[-1])
        self.most_late_ns = max(self.most_late_ns, int(late.max()))
        if self.most_late_ns > LATE_NS:
            row = int(np.argmax(late > LATE_NS))
            line, rate = int(chunk.line[row]), 1e9 / self._least_ns
            message = (
                f"grid moves come faster here than the {rate:.0f} a second that the board can make"
            )
            hint = "lower the feed or max_velocity, use fewer microsteps, or leave --algorithm out"
            raise MotionLimitError(Diagnostic("board-step-rate", message, line=line, hint=hint))

    def _send(self, data: bytes, time_ns: int, line: int) -> None:
        """The store: so many bytes that have to be there, and decoded, by a time."""
        seconds = (time_ns - self._filled_at) * 1e-9
        self._filled_at = time_ns
        self._filled = max(0.0, self._filled + len(data) - seconds * self._bytes_per_s)
        work = len(data) + HEAD * sum(1 for _ in split(data))
        self._undecoded = max(0.0, self._undecoded + work - seconds * DECODED_PER_S)
        self.most_filled = max(self.most_filled, self._filled, self._undecoded)
        if self.most_filled > KEPT:
            if self._filled > KEPT:
                brings = f"{self._bytes_per_s:.0f} bytes a second"
                message = f"the grid moves of this line are too dense for the connection, which brings some {brings}"
                hint = "lower the feed, leave --algorithm out, or let the connection be faster (board.baud, and the firmware's BAUD)"
            else:
                message = "the grid moves of this line are too dense and too uneven for the board to decode in time"
                hint = "lower the feed, or leave --algorithm out"
            raise MotionLimitError(Diagnostic("board-too-dense", message, line=line, hint=hint))
