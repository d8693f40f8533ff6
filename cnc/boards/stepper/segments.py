"""Pulses as segments for a board, and back: compressed, in the order and at the times that were
asked for.

The format is in ``docs/explanation/segments.md``; :mod:`cnc.kernels.stepper.segments` plays it,
:mod:`cnc.kernels.stepper.segment_encoder` makes it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.stepper import segment_encoder as encoder
from cnc.kernels.stepper import segments as form
from cnc.kernels.stepper.windows import CORNERS
from cnc.model.streams import PulseChunk

ROWS = 65536
"""Grid moves in the buffers of the encoder and the decoder."""
MANY = 2 * encoder.AHEAD
"""So many grid moves are worth a call of the kernel: chunks may be of a few."""
BYTES = 65536
"""Most bytes written at once."""
PAUSE = encoder.PAUSE * form.SUB
"""Longest slot of a pause, 1/256 tick."""

OUTPUTS, ARM = 1, 2
"""Commands: what the outputs are from here on; which inputs end the motion from here on."""


def command(code: int, *arguments: int, end: bool = False) -> bytes:
    """A command between segments; code 0 does nothing. ``end``: nothing need follow, the board may
    run dry after it.
    """
    return bytes((len(arguments), code << 4 | form.COMMAND | (form.END if end else 0), *arguments))


class SegmentEncoder:
    """Turns pulses, chunk by chunk, into segments; memory doesn't grow with their number.

    axes: how many, up to 4. tolerance_ns: the farthest from its time that a move may be made, at
    least a tick. spacing_ns: the board's least time between two grid moves, and before the first;
    moves that come sooner are put off (:attr:`put_off_ns`), the tolerance counts from there.
    """

    def __init__(self, axes: int, tolerance_ns: int = 2000, spacing_ns: int = 0) -> None:
        if not 1 <= axes <= form.MOST_AXES:
            raise ValueError(f"A segment holds 1 to {form.MOST_AXES} axes, not {axes}.")
        if tolerance_ns < form.TICK_NS:
            raise ValueError(f"The tolerance can't be less than a tick, {form.TICK_NS} ns.")
        if not 0 <= spacing_ns < encoder.PAUSE * form.TICK_NS:
            raise ValueError("The spacing must lie between 0 and the slots of a pause, 16 ms.")
        self.axes = axes
        self.tolerance_ns = tolerance_ns
        self._spacing = -(-spacing_ns // form.TICK_NS)
        self._state = np.zeros(encoder.STATE, dtype=np.int64)
        self._state[encoder.GLANCE] = encoder.FIRST_GLANCE
        self._rows = 0
        self._moving = np.empty(ROWS, dtype=np.int64)
        self._backward = np.empty(ROWS, dtype=np.int64)
        self._due = np.empty(ROWS, dtype=np.int64)
        self._out = np.empty(BYTES, dtype=np.uint8)
        self._trial = np.empty((3, form.LONGEST), dtype=np.uint8)
        self._tick = np.empty(form.MOST_ROWS, dtype=np.int64)
        self._mask = np.empty(form.MOST_ROWS, dtype=np.uint8)
        self._ends = np.empty(form.MOST_SLOTS, dtype=np.int64)
        self._windows = np.empty((4, form.MOST_SLOTS))
        self._polygon = np.empty((2, 2, CORNERS))

    @property
    def put_off_ns(self) -> int:
        """The longest that a move was put off for the board's spacing."""
        return int(self._state[encoder.LATEST_NS])

    @property
    def waiting(self) -> int:
        """Grid moves taken that no segment holds yet."""
        return self._rows

    def push(self, chunk: PulseChunk) -> bytes:
        """Take grid moves; returns the segments that are ready. The last moves wait for the next
        ones, or for :meth:`flush`.
        """
        parts: list[bytes] = []
        at = 0
        while at < len(chunk.time_ns):
            until = min(len(chunk.time_ns), at + ROWS - self._rows)
            encoder.take(
                chunk.time_ns[at:until], chunk.step[at:until], self._spacing * form.TICK_NS, self._state, self._rows, self._moving,
                self._backward, self._due,
            )  # fmt: skip
            self._rows += until - at
            at = until
            if self._rows > MANY:
                self._encode(encoder.AHEAD, parts)
        return b"".join(parts)

    def flush(self, *, end: bool = False) -> bytes:
        """The segments of all moves that wait. ``end``: nothing follows, so that the board may run
        dry after the last one.
        """
        parts: list[bytes] = []
        self._encode(0, parts)
        if end and parts:
            last = bytearray(parts[-1])
            last[self._state[encoder.LAST_AT] + 1] |= form.END
            parts[-1] = bytes(last)
        return b"".join(parts)

    def idle(self, until_ns: int) -> bytes:
        """The segments of all moves that wait, and of a pause that ends at ``until_ns``, or as much
        as a tick before.
        """
        parts: list[bytes] = []
        self._encode(0, parts)
        left = until_ns * form.SUB // form.TICK_NS - int(self._state[encoder.CLOCK])
        while left >= form.SUB:
            slots = min(-(-left // PAUSE), form.MOST_SLOTS)
            interval = min(left // slots, PAUSE)
            parts.append(bytes((slots, form.EVEN)) + interval.to_bytes(3, "little") + bytes(3))
            self._state[encoder.CLOCK] += slots * interval
            left -= slots * interval
        return b"".join(parts)

    def skip(self, until_ns: int) -> None:
        """Nothing waits, and the player's clock is taken to stand at ``until_ns``."""
        self._state[encoder.CLOCK] = until_ns * form.SUB // form.TICK_NS

    @property
    def clock_ns(self) -> int:
        """When all segments so far have been played."""
        return int(self._state[encoder.CLOCK]) * form.TICK_NS // form.SUB

    def _encode(self, keep: int, parts: list[bytes]) -> None:
        """Write segments until no more than ``keep`` moves wait."""
        buffers = (self._moving, self._backward, self._due)
        while self._rows > keep:
            done, size = encoder.encode(
                *buffers, self._rows, keep, self.tolerance_ns, self._spacing, self._state, self._out, self._trial, self._tick, self._mask,
                self._ends, self._windows, self._polygon[0], self._polygon[1],
            )  # fmt: skip
            parts.append(self._out[:size].tobytes())
            if done < self._rows:
                for buffer in buffers:
                    buffer[: self._rows - done] = buffer[done : self._rows].copy()
            self._rows -= done


class SegmentDecoder:
    """Plays segments as the board does, bit for bit."""

    def __init__(self, axes: int) -> None:
        self._clock = 0
        self._time_ns = np.empty(ROWS, dtype=np.int64)
        self._step = np.empty((ROWS, axes), dtype=np.int8)
        self._tick = np.empty(form.MOST_ROWS, dtype=np.int64)
        self._mask = np.empty(form.MOST_ROWS, dtype=np.uint8)

    def play(self, segments: bytes) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int8]]]:
        """The grid moves of whole segments: times (n,) in ns since the first one's start and steps
        (n, axes), some thousands at a time.
        """
        data = np.frombuffer(segments, dtype=np.uint8)
        at = 0
        while at < len(data):
            begin = at
            at, self._clock, rows = form.play_all(
                data, at, self._clock, self._time_ns, self._step, self._tick, self._mask
            )
            if at == begin:
                raise ValueError(
                    f"No segment begins at byte {at}: {segments[at : at + form.HEAD].hex(' ')}."
                )
            yield self._time_ns[:rows].copy(), self._step[:rows].copy()


def split(segments: bytes) -> Iterator[bytes]:
    """The single segments and commands."""
    data = np.frombuffer(segments, dtype=np.uint8)
    at = 0
    while at < len(data):
        size = form.segment_bytes(data, at)
        if size < 0:
            raise ValueError(
                f"No segment begins at byte {at}: {segments[at : at + form.HEAD].hex(' ')}."
            )
        yield segments[at : at + size]
        at += size
