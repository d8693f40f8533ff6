"""Check before any motion whether a stepper board can play a program.

Two buffers between the computer and the pins smooth short bursts: the queue of grid moves before
the interrupt, and the buffer of segments behind the serial line. Each is modelled as a bucket. The
program fills it, and it empties at the sustained rate:

    grid moves ──► queue ──► one every `least_ns`
    segments   ──► buffer ──► bytes that the line transfers and the board decodes in that time

An overflow is a fault at its source line. The encoder and the pieces are those of the run.
"""

from __future__ import annotations

import numpy as np

from cnc.boards.stepper.outputs import MotorOutputs
from cnc.boards.stepper.segments import SegmentEncoder, split
from cnc.boards.stepper.sender import PIECE_S, TOLERANCE_NS
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.model.streams import PulseChunk

LATE_NS = 1_000_000
"""Largest delay of grid moves in a burst."""
KEPT = 510
"""Bytes by which the buffer may be emptied before the board signals silence: half its capacity."""
PAYLOAD = 0.55
"""Share of the stream in the bytes on the line, measured in the simulator."""
DECODED_PER_S, HEAD = 65_000, 6
"""Bytes that the board decodes per second, with HEAD extra bytes for each segment. The limit lies
between 200 random programs that it played and 35 that it did not, measured in the simulator
(docs/how-to/stepper-board.md).
"""


class StepperFeasibility:
    """Check of a program for a board.

    Args:
        outputs: The motors at the outputs of the board.
        least_ns: Sustained time between grid moves, ns.
        baud: Speed of the serial line, bits/s.

    Attributes:
        most_late_ns: Largest delay of a grid move so far, ns.
        most_filled: Largest fill of the buffer so far, bytes.
    """

    def __init__(self, outputs: MotorOutputs, least_ns: int, baud: int) -> None:
        self._least_ns = least_ns
        self._bytes_per_s = baud / 10 * PAYLOAD
        self._encoder = SegmentEncoder(outputs.count, TOLERANCE_NS)
        self._outputs = outputs
        self._step_ns = 0
        self._piece_ns = round(PIECE_S * 1e9)
        self._filled = self._undecoded = 0.0
        self._filled_at = 0
        self.most_late_ns = 0
        self.most_filled = 0.0

    def add(self, chunk: PulseChunk) -> None:
        """Add the next grid moves.

        Raises:
            MotionLimitError: ``board-step-rate``, ``board-too-dense``.
        """
        if not len(chunk.time_ns):
            return
        self._count(chunk)
        time_ns = chunk.time_ns
        step = self._outputs.expanded(chunk.step)
        cuts = np.searchsorted(
            time_ns, np.arange(time_ns[0] + self._piece_ns, time_ns[-1], self._piece_ns)
        )
        for span in np.split(np.arange(len(time_ns)), cuts):
            if len(span):
                rows = slice(int(span[0]), int(span[-1]) + 1)
                part = PulseChunk(time_ns[rows], step[rows], chunk.line[rows])
                data = self._encoder.push(part) + self._encoder.flush()
                self._send(data, int(time_ns[rows][-1]), int(chunk.line[rows][0]))

    def _count(self, chunk: PulseChunk) -> None:
        """Update the queue: the delay of each grid move at one move per ``least_ns``."""
        # t_k = max(due_k, t_(k-1) + least), for all moves at once.
        k = np.arange(len(chunk.time_ns), dtype=np.int64) * self._least_ns
        first = max(int(chunk.time_ns[0]), self._step_ns + self._least_ns)
        made = np.maximum(np.maximum.accumulate(chunk.time_ns - k), first) + k
        late = made - chunk.time_ns
        self._step_ns = int(made[-1])
        self.most_late_ns = max(self.most_late_ns, int(late.max()))
        if self.most_late_ns > LATE_NS:
            row = int(np.argmax(late > LATE_NS))
            line, rate = int(chunk.line[row]), 1e9 / self._least_ns
            message = f"the grid moves here are faster than the {rate:.0f} per second of the board"
            hint = "lower the feed or max_velocity, use fewer microsteps, or omit --algorithm"
            raise MotionLimitError(Diagnostic("board-step-rate", message, line=line, hint=hint))

    def _send(self, data: bytes, time_ns: int, line: int) -> None:
        """Update the buffer: bytes that must be transferred and decoded by a time."""
        seconds = (time_ns - self._filled_at) * 1e-9
        self._filled_at = time_ns
        self._filled = max(0.0, self._filled + len(data) - seconds * self._bytes_per_s)
        work = len(data) + HEAD * sum(1 for _ in split(data))
        self._undecoded = max(0.0, self._undecoded + work - seconds * DECODED_PER_S)
        self.most_filled = max(self.most_filled, self._filled, self._undecoded)
        if self.most_filled > KEPT:
            if self._filled > KEPT:
                message = (
                    "the grid moves of this line are too dense for the serial line, "
                    f"which transfers about {self._bytes_per_s:.0f} bytes/s"
                )
                hint = (
                    "lower the feed, omit --algorithm, or make the line faster "
                    "(board.baud, and BAUD of the firmware)"
                )
            else:
                message = (
                    "the grid moves of this line are too dense and too irregular "
                    "for the board to decode in time"
                )
                hint = "lower the feed, or omit --algorithm"
            raise MotionLimitError(Diagnostic("board-too-dense", message, line=line, hint=hint))
