"""Pulses as segments for the stepper board.

Segments are compressed grid moves, in their order and within a tolerance of their times. The format
is in ``docs/explanation/segments.md``; :mod:`cnc.boards.stepper.kernels.segments` plays it,
:mod:`cnc.boards.stepper.kernels.segment_encoder` makes it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc.boards.stepper.kernels import segment_encoder as encoder
from cnc.boards.stepper.kernels import segments as form
from cnc.boards.stepper.kernels.candidates import (
    MAX_CORNERS,
    GridMoves,
    Polygon,
    Rules,
    Scratch,
    Windows,
)
from cnc.model.streams import PulseChunk

ROWS = 65536
"""Capacity of the buffers of the encoder, grid moves."""
BATCH = 2 * encoder.LOOK_AHEAD
"""Grid moves that are worth a call of the kernel, because chunks may be short."""
BYTES = 65536
"""Most bytes written by one call of the kernel."""
PAUSE = encoder.PAUSE * form.SUB
"""Longest slot of a pause, 1/256 tick."""

OUTPUTS, ARM = 1, 2
"""Codes of commands: new levels of the outputs; inputs that end the motion from here on."""


def command(code: int, *arguments: int, end: bool = False) -> bytes:
    """Return a command of the stream.

    Args:
        code: Code of the command; 0 does nothing.
        arguments: Bytes of its arguments.
        end: Nothing need follow, so that an empty buffer is not a fault.
    """
    return bytes((len(arguments), code << 4 | form.COMMAND | (form.END if end else 0), *arguments))


class SegmentEncoder:
    """Encodes pulses, chunk by chunk, in bounded memory.

    Args:
        axes: Number of axes, 1 to 4.
        tolerance_ns: Largest deviation of a move from its time, at least a tick, ns.
        spacing_ns: The board's least time between two grid moves, and before the first, ns. A move
            that is closer is delayed, and the tolerance then counts from its delayed time.

    Raises:
        ValueError: An argument is outside its range.
    """

    def __init__(self, axes: int, tolerance_ns: int = 2000, spacing_ns: int = 0) -> None:
        if not 1 <= axes <= form.MAX_AXES:
            raise ValueError(f"A segment has 1 to {form.MAX_AXES} axes, not {axes}.")
        if tolerance_ns < form.TICK_NS:
            raise ValueError(f"The tolerance must be at least a tick, {form.TICK_NS} ns.")
        if not 0 <= spacing_ns < encoder.PAUSE * form.TICK_NS:
            raise ValueError("The spacing must be from 0 to less than a slot of a pause, 16 ms.")
        self.axes = axes
        self.tolerance_ns = tolerance_ns
        self._rules = Rules(tolerance_ns, -(-spacing_ns // form.TICK_NS))
        self._state = np.zeros(1, dtype=encoder.STATE)[0]
        self._state["reach"] = encoder.FIRST_REACH
        self._rows = 0
        self._moves = GridMoves(*(np.empty(ROWS, dtype=np.int64) for _ in range(3)))
        self._out = np.empty(BYTES, dtype=np.uint8)
        self._scratch = Scratch(
            trial=np.empty((3, form.MAX_BYTES), dtype=np.uint8),
            tick=np.empty(form.MAX_ROWS, dtype=np.int64),
            mask=np.empty(form.MAX_ROWS, dtype=np.uint8),
            ends=np.empty(form.MAX_SLOTS, dtype=np.int64),
            windows=Windows(*(np.empty(form.MAX_SLOTS) for _ in range(3))),
            middles=np.empty(form.MAX_SLOTS),
            polygon=Polygon(np.empty((2, MAX_CORNERS)), np.empty((2, MAX_CORNERS))),
        )

    @property
    def delay_ns(self) -> int:
        """Longest delay of a move by the spacing, ns."""
        return int(self._state["delay_ns"])

    @property
    def waiting(self) -> int:
        """Number of grid moves that are not encoded yet."""
        return self._rows

    def push(self, chunk: PulseChunk) -> bytes:
        """Add grid moves, and return the segments that are ready.

        The last moves wait for the next ones, or for :meth:`flush`.
        """
        parts: list[bytes] = []
        at = 0
        while at < len(chunk.time_ns):
            until = min(len(chunk.time_ns), at + ROWS - self._rows)
            encoder.take(
                chunk.time_ns[at:until],
                chunk.step[at:until],
                self._rules.spacing * form.TICK_NS,
                self._state,
                self._rows,
                self._moves,
            )
            self._rows += until - at
            at = until
            if self._rows > BATCH:
                self._encode(encoder.LOOK_AHEAD, parts)
        return b"".join(parts)

    def flush(self, *, end: bool = False) -> bytes:
        """Return the segments of all waiting moves.

        Args:
            end: Nothing follows, so that an empty buffer of the board is not a fault.
        """
        parts: list[bytes] = []
        self._encode(0, parts)
        if end and parts:
            last = bytearray(parts[-1])
            last[self._state["last_at"] + 1] |= form.END
            parts[-1] = bytes(last)
        return b"".join(parts)

    def idle(self, until_ns: int) -> bytes:
        """Return the segments of all waiting moves and of a pause.

        Args:
            until_ns: End of the pause, ns. The segments may end up to one tick before.
        """
        parts: list[bytes] = []
        self._encode(0, parts)
        left = until_ns * form.SUB // form.TICK_NS - int(self._state["clock"])
        while left >= form.SUB:
            slots = min(-(-left // PAUSE), form.MAX_SLOTS)
            interval = min(left // slots, PAUSE)
            parts.append(bytes((slots, form.EVEN)) + interval.to_bytes(3, "little") + bytes(3))
            self._state["clock"] += slots * interval
            left -= slots * interval
        return b"".join(parts)

    def skip(self, until_ns: int) -> None:
        """Set the clock of the player to ``until_ns``, while no move waits."""
        self._state["clock"] = until_ns * form.SUB // form.TICK_NS

    @property
    def clock_ns(self) -> int:
        """Time at which all segments so far have been played, ns."""
        return int(self._state["clock"]) * form.TICK_NS // form.SUB

    def _encode(self, keep: int, parts: list[bytes]) -> None:
        """Encode moves until at most ``keep`` wait."""
        while self._rows > keep:
            done, size = encoder.encode(
                self._moves, self._rows, keep, self._rules, self._state, self._out, self._scratch
            )
            parts.append(self._out[:size].tobytes())
            if done < self._rows:
                for buffer in self._moves:
                    buffer[: self._rows - done] = buffer[done : self._rows].copy()
            self._rows -= done


def split(segments: bytes) -> Iterator[bytes]:
    """Yield the single segments and commands.

    Raises:
        ValueError: No segment begins at one of the bytes.
    """
    data = np.frombuffer(segments, dtype=np.uint8)
    at = 0
    while at < len(data):
        size = form.segment_bytes(data, at)
        if size < 0:
            begin = segments[at : at + form.HEAD].hex(" ")
            raise ValueError(f"No segment begins at byte {at}: {begin}.")
        yield segments[at : at + size]
        at += size
