"""Sending of grid moves and commands to the stepper board, in pieces and within a horizon.

      board plays        sent to the board              next piece
    ──────●──────────────────────────────────┤····················┤
          └────────── HORIZON_S ─────────────┘     PIECE_S

A hold cannot recall motion that was sent. The board keeps time: its status, several times a second,
contains its time in the stream. The program's clock runs during dwells (pauses in the stream) and
stands still during a hold (the stream ends and is started again).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.connection import ANSWER_TIMEOUT_S, POLL_S, Connection, Pump
from cnc.boards.stepper.protocol import Kind, State, Status
from cnc.boards.stepper.segments import SegmentEncoder, command
from cnc.model.streams import PulseChunk

# Source lines of the grid moves that were sent, kept until the board has played them.

READ_AHEAD = 64
"""Bytes of the stream that the board may have decoded but not played yet."""


@dataclass(slots=True)
class _Part:
    """A part of the stream.

    Attributes:
        until: Its end, in bytes of the stream.
        points: Grid point after each move (n, axes).
        lines: Source line of each move (n,).
    """

    until: int
    points: NDArray[np.int64]
    lines: NDArray[np.int32]


class LineTracker:
    """The parts of the stream that were sent.

    Attributes:
        sent: Length of the stream, bytes.
        line: First source line of the last part that the board has completed, so the board is at
            this line or a later one; 0 before the first part is completed.
    """

    def __init__(self, line: int = 0) -> None:
        self.sent = 0
        self.line = line
        self._parts: deque[_Part] = deque()

    def add(self, size: int, points: NDArray[np.int64], lines: NDArray[np.int32]) -> None:
        """Add a part to the stream.

        Args:
            size: Its length, bytes.
            points: Grid point after each move (n, axes).
            lines: Source line of each move (n,).
        """
        self.sent += size
        self._parts.append(_Part(self.sent, points, lines))

    def taken(self, size: int) -> None:
        """Remove completed parts: all before the last one that ends within ``size`` bytes."""
        while len(self._parts) > 1 and self._parts[0].until + READ_AHEAD < size:
            self.line = _first(self._parts.popleft().lines) or self.line

    def clear(self) -> None:
        """Remove all parts, because the board has played everything."""
        for part in self._parts:
            self.line = int(part.lines[-1]) or self.line
        self._parts.clear()

    def line_at(self, point: NDArray[np.int64]) -> int:
        """Return the source line of the last move to a grid point (axes,), 0 if it is not known."""
        for part in reversed(self._parts):
            rows = np.flatnonzero((part.points == point).all(axis=1))
            if len(rows):
                return int(part.lines[rows[-1]])
        return 0


def _first(lines: NDArray[np.int32]) -> int:
    """Return the first line that is not 0, else 0."""
    numbered = lines[lines > 0]
    return int(numbered[0]) if len(numbered) else 0


HORIZON_S = 0.11
"""Longest motion sent ahead of the motion that the board plays."""
PIECE_S = 0.01
"""Length of the pieces in which moves are compressed and sent."""
PREFILL_S = 0.1
"""Motion that is sent before the motion starts."""
TOLERANCE_NS = 2000
"""Largest deviation of a move from its time."""


class Sender:
    """The stream to one board. Times are ns of the program's clock.

    Args:
        connection: The connection.
        outputs: Number of outputs.
        pump: Sends, receives, and raises all faults.
        taken: Bytes that the board has decoded before.

    Attributes:
        position: Grid point at the end of the stream (axes,).
        until_ns: End of the stream, ns.
        cut: An armed input has ended the motion, so that moves are dropped.
        running: The board plays.
        tracker: Source lines of the stream.
    """

    def __init__(self, connection: Connection, outputs: int, pump: Pump, taken: int) -> None:
        self.position = np.zeros(outputs, np.int64)
        self.until_ns = 0
        self.cut = False
        self.running = False
        self.tracker = LineTracker()
        self._connection = connection
        self._outputs = outputs
        self._pump = pump
        self._taken_before = taken
        self._began_at = 0.0
        self._base_ns = 0
        self._encoder = SegmentEncoder(outputs, TOLERANCE_NS)
        self._gathered: list[tuple[bytes, NDArray[np.int64], NDArray[np.int32]]] = []
        self._gathered_from = self._gathered_until = 0

    def begin(self, position: NDArray[np.int64]) -> None:
        """Begin a program at a grid point (axes,), at time 0."""
        self.position = position
        self._encoder = SegmentEncoder(self._outputs, TOLERANCE_NS)
        self._base_ns = self.until_ns = 0

    def begin_after(self, status: Status) -> None:
        """Continue after an input has ended the motion; the board has dropped the later moves."""
        self.cut = self.running = False
        self._taken_before = status.taken
        self.tracker.clear()
        self.tracker = LineTracker(self.tracker.line)
        self._encoder.skip(self.until_ns)
        self._base_ns = self._encoder.clock_ns

    def gather(self, chunk: PulseChunk, points: NDArray[np.int64]) -> None:
        """Compress a chunk and send it in pieces, which may extend over several chunks.

        Args:
            chunk: Grid moves of the outputs, in the directions of the board.
            points: Grid point after each move (n, axes).
        """
        time_ns, rows, at = chunk.time_ns, len(chunk.time_ns), 0
        while at < rows:
            if not self._gathered:
                self._idle_towards(int(time_ns[at]))
                self._gathered_from = int(time_ns[at])
            until = int(np.searchsorted(time_ns, self._gathered_from + round(PIECE_S * 1e9)))
            if until > at:
                part = slice(at, until)
                data = self._encoder.push(
                    PulseChunk(time_ns[part], chunk.step[part], chunk.line[part])
                )
                self._gathered.append((data, points[part], chunk.line[part]))
                self._gathered_until = int(time_ns[until - 1])
                self.until_ns = max(self.until_ns, self._gathered_until)
            if until < rows:
                self.send_gathered()
            at = until

    def send_gathered(self) -> None:
        """Send the moves gathered so far."""
        if self._gathered:
            data, points, lines = (list(parts) for parts in zip(*self._gathered, strict=True))
            self._gathered.clear()
            if self.cut:
                self._encoder.flush()
                return
            self._wait_for_horizon(self._gathered_until)
            self.position = points[-1][-1]
            self._put(
                b"".join((*data, self._encoder.flush())),
                np.concatenate(points),
                np.concatenate(lines),
            )

    def command(self, code: int, *arguments: int, line: int = 0) -> None:
        """Send a command, which the board carries out after all earlier moves."""
        self._put_between(command(code, *arguments), line)

    def idle_until(self, time_ns: int) -> None:
        """Send the gathered moves, then pauses until a time, within the horizon."""
        self.send_gathered()
        piece = round(PIECE_S * 1e9)
        while self._encoder.clock_ns + 1000 < time_ns:
            until = min(self._encoder.clock_ns + piece, time_ns)
            self._wait_for_horizon(until)
            data = self._encoder.idle(until)
            if not data:
                break
            self._put_between(data, 0)

    def rest(self, time_ns: int) -> Status | None:
        """End the stream at a time and wait until the board has played it.

        The program's clock stands still until the next move.

        Returns:
            The status of the board (see :meth:`is_complete`), or None if an input has ended the
            motion before.
        """
        self.idle_until(time_ns)
        self.until_ns = max(self.until_ns, time_ns)
        if self.cut:
            return None
        link, clock = self._connection.link, self._encoder.clock_ns
        data = self._encoder.flush() + command(0, end=True)
        self.tracker.add(len(data), np.array([self.position]), np.zeros(1, np.int32))
        link.stream(data, (clock - self._base_ns) // 1_000_000, end=True)
        while link.unconfirmed:
            if link.full and not self.running:
                self._run()
            self._pump(POLL_S)
        if not self.running:
            self._run()
        waited = self._connection.clock.now()
        while not (
            link.state == State.IDLE
            and self._connection.status is not None
            and self.is_complete(self._connection.status)
        ):
            if self.cut:
                return None
            if link.state != State.IDLE:
                waited = self._connection.clock.now()
            elif self._connection.clock.now() - waited > ANSWER_TIMEOUT_S:
                break
            self._pump(POLL_S)
        self.running = False
        self._base_ns = clock
        self.tracker.clear()
        return self._connection.status or self._connection.ask(self._pump)

    def is_complete(self, status: Status) -> bool:
        """Return whether the board has decoded the whole stream."""
        return self._taken(status) == self.tracker.sent

    def _idle_towards(self, time_ns: int) -> None:
        """Fill a long time without moves by a pause that ends shortly before the next move."""
        if time_ns - self._encoder.clock_ns > 2 * PIECE_S * 1e9:
            self.idle_until(time_ns - round(PIECE_S * 1e9))

    def _put_between(self, data: bytes, line: int) -> None:
        self._put(data, np.array([self.position]), np.array([line], dtype=np.int32))

    def _put(self, data: bytes, points: NDArray[np.int64], lines: NDArray[np.int32]) -> None:
        """Append bytes to the stream and wait until they are sent."""
        if self.cut:
            return
        link, clock_ns = self._connection.link, self._encoder.clock_ns
        self.tracker.add(len(data), points, lines)
        link.stream(data, (clock_ns - self._base_ns) // 1_000_000, note=int(lines[-1]))
        while link.unsent and not self.cut:
            if link.full and not self.running:
                self._run()
            self._pump(POLL_S)
        self._run_if_filled(clock_ns)

    @property
    def played_ns(self) -> int:
        """Program time of the motion that the board plays, ns."""
        return self._base_ns + round((self._connection.clock.now() - self._began_at) * 1e9)

    @property
    def ahead_s(self) -> float:
        """Motion that was sent and is not played yet, s."""
        return max(self._encoder.clock_ns - self.played_ns, 0) * 1e-9 if self.running else 0.0

    def update(self, status: Status) -> None:
        """Take the board's time and progress from a status."""
        if status.board_ms is not None and self.running:
            self._began_at = self._connection.clock.now() - status.board_ms * 1e-3
        self.tracker.taken(self._taken(status))

    def _wait_for_horizon(self, time_ns: int) -> None:
        """Wait until motion up to ``time_ns`` is within the horizon."""
        self._run_if_filled(time_ns)
        while self.running and not self.cut and time_ns - self.played_ns > HORIZON_S * 1e9:
            self._pump(POLL_S)

    def _run_if_filled(self, time_ns: int) -> None:
        if not self.running and time_ns - self._base_ns > PREFILL_S * 1e9:
            self._run()

    def _run(self) -> None:
        """Start the motion."""
        link = self._connection.link
        while link.unconfirmed and not link.full and not self.cut:
            self._pump(POLL_S)
        self.running = True
        self._began_at = self._connection.clock.now()
        self._connection.request(Kind.RUN, b"", self._pump)

    def _taken(self, status: Status) -> int:
        return (status.taken - self._taken_before) % 2**32
