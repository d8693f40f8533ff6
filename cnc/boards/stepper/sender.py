"""What goes to the stepper board: grid moves and commands, compressed, in pieces, ahead of time but
no farther than a horizon.

      board plays        promised to the board          next piece
    ──────●──────────────────────────────────┤····················┤
          └────────── HORIZON_S ─────────────┘     PIECE_S

What the board has been given is what a hold can't take back. The board keeps time: where it is
comes with its status, several times a second. A program's clock goes on through dwells (pauses in
the stream), and stands still while the motion is held (the stream ends, and is started anew).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.connection import ANSWER_S, BREATH_S, Connection
from cnc.boards.stepper.line_tracker import Trail
from cnc.boards.stepper.protocol import Kind, State, Status
from cnc.boards.stepper.segments import SegmentEncoder, command
from cnc.model.streams import PulseChunk

HORIZON_S = 0.11
"""The board is given no more than this ahead of what it plays."""
PIECE_S = 0.01
"""Moves are compressed and sent in pieces of this length."""
PREFILL_S = 0.1
"""So much is there before the motion starts."""
TOLERANCE_NS = 2000
"""How far from its time a move may be made."""


class Stream:
    """The stream of one board. Times are ns of the program's clock, positions steps (axes,).

    pump: sends and takes in what there is, waits so many seconds for more, and raises whatever has
    gone wrong. taken: bytes that the board had taken before. position: where all that was sent
    leads. until_ns: when it is over. cut: an armed input has ended the motion, so that what is sent
    now is dropped.
    """

    def __init__(
        self, connection: Connection, axes: int, pump: Callable[[float], object], taken: int
    ) -> None:
        self.position = np.zeros(axes, np.int64)
        self.until_ns = 0
        self.cut = False
        self.running = False
        self.trail = Trail()
        self._connection = connection
        self._axes = axes
        self._pump = pump
        self._taken_before = taken
        self._began_at = 0.0
        self._base_ns = 0
        self._encoder = SegmentEncoder(axes, TOLERANCE_NS)
        self._gathered: list[tuple[bytes, NDArray[np.int64], NDArray[np.int32]]] = []
        self._gathered_from = self._gathered_until = 0

    def begin(self, position: NDArray[np.int64]) -> None:
        """A program begins at a grid point, at time 0."""
        self.position = position
        self._encoder = SegmentEncoder(self._axes, TOLERANCE_NS)
        self._base_ns = self.until_ns = 0

    def begin_after(self, status: Status) -> None:
        """Go on where an input has ended the motion: what was sent behind that is gone, and time
        goes on.
        """
        self.cut = self.running = False
        self._taken_before = status.taken
        self.trail.clear()
        self.trail = Trail(self.trail.line)
        self._encoder.skip(self.until_ns)
        self._base_ns = self._encoder.clock_ns

    # ------------------------------------------------------------------------------------------------------------------
    # sending

    def gather(self, chunk: PulseChunk, places: NDArray[np.int64]) -> None:
        """Compress a chunk that leads through ``places`` (n, axes); send it in pieces that may
        begin in one chunk and end in another.
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
                self._gathered.append((data, places[part], chunk.line[part]))
                self._gathered_until = int(time_ns[until - 1])
                self.until_ns = max(self.until_ns, self._gathered_until)
            if until < rows:
                self.send_gathered()
            at = until

    def send_gathered(self) -> None:
        """Send what was gathered."""
        if self._gathered:
            data, places, lines = (list(each) for each in zip(*self._gathered, strict=True))
            self._gathered.clear()
            if self.cut:
                self._encoder.flush()
                return
            self._wait_for_horizon(self._gathered_until)
            self.position = places[-1][-1]
            self._put(
                b"".join((*data, self._encoder.flush())),
                np.concatenate(places),
                np.concatenate(lines),
            )

    def command(self, code: int, *arguments: int, line: int = 0) -> None:
        """Have the board do something when all before it has been played."""
        self._put_between(command(code, *arguments), line)

    def idle_until(self, time_ns: int) -> None:
        """What was gathered, then pauses, no longer than the horizon allows."""
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
        """End the stream, return when it has been played: the program's clock stands still until
        the next move.

        What the board said then, which :meth:`wholly_taken` judges; None where an input has ended
        the motion before.
        """
        self.idle_until(time_ns)
        self.until_ns = max(self.until_ns, time_ns)
        if self.cut:
            return None
        link, clock = self._connection.link, self._encoder.clock_ns
        data = self._encoder.flush() + command(0, end=True)
        self.trail.add(len(data), np.array([self.position]), np.zeros(1, np.int32))
        link.stream(data, (clock - self._base_ns) // 1_000_000, end=True)
        while link.unconfirmed:
            if link.full and not self.running:
                self._run()
            self._pump(BREATH_S)
        if not self.running:
            self._run()
        waited = self._connection.clock.now()
        while not (
            link.state == State.IDLE
            and self._connection.status is not None
            and self.wholly_taken(self._connection.status)
        ):
            if self.cut:
                return None
            if link.state != State.IDLE:
                waited = self._connection.clock.now()
            elif self._connection.clock.now() - waited > ANSWER_S:
                break
            self._pump(BREATH_S)
        self.running = False
        self._base_ns = clock
        self.trail.clear()
        return self._connection.status or self._connection.ask(self._pump)

    def wholly_taken(self, status: Status) -> bool:
        """Whether the board has decoded all that was sent."""
        return self._taken(status) == self.trail.sent

    def _idle_towards(self, time_ns: int) -> None:
        """Fill a long time without moves, until shortly before the next one."""
        if time_ns - self._encoder.clock_ns > 2 * PIECE_S * 1e9:
            self.idle_until(time_ns - round(PIECE_S * 1e9))

    def _put_between(self, data: bytes, line: int) -> None:
        self._put(data, np.array([self.position]), np.array([line], dtype=np.int32))

    def _put(self, data: bytes, places: NDArray[np.int64], lines: NDArray[np.int32]) -> None:
        """Hand bytes of the stream to the link and wait until they are on their way."""
        if self.cut:
            return
        link, clock_ns = self._connection.link, self._encoder.clock_ns
        self.trail.add(len(data), places, lines)
        link.stream(data, (clock_ns - self._base_ns) // 1_000_000, note=int(lines[-1]))
        while link.unsent and not self.cut:
            if link.full and not self.running:
                self._run()
            self._pump(BREATH_S)
        self._run_if_filled(clock_ns)

    # --------------------------------------------------------------------------------------------------------------------
    # time

    @property
    def played_ns(self) -> int:
        """The program's time that the board has come to."""
        return self._base_ns + round((self._connection.clock.now() - self._began_at) * 1e9)

    @property
    def ahead_s(self) -> float:
        """Seconds of motion that the board has been given and has not played."""
        return max(self._encoder.clock_ns - self.played_ns, 0) * 1e-9 if self.running else 0.0

    def heard(self, status: Status) -> None:
        """The board has said how far it is."""
        if status.board_ms is not None and self.running:
            self._began_at = self._connection.clock.now() - status.board_ms * 1e-3
        self.trail.passed(self._taken(status))

    def _wait_for_horizon(self, time_ns: int) -> None:
        """Return when the board may be given what is played until ``time_ns``."""
        self._run_if_filled(time_ns)
        while self.running and not self.cut and time_ns - self.played_ns > HORIZON_S * 1e9:
            self._pump(BREATH_S)

    def _run_if_filled(self, time_ns: int) -> None:
        if not self.running and time_ns - self._base_ns > PREFILL_S * 1e9:
            self._run()

    def _run(self) -> None:
        """Start what has been sent."""
        link = self._connection.link
        while link.unconfirmed and not link.full and not self.cut:
            self._pump(BREATH_S)
        self.running = True
        self._began_at = self._connection.clock.now()
        self._connection.request(Kind.RUN, b"", self._pump)

    def _taken(self, status: Status) -> int:
        return (status.taken - self._taken_before) % 2**32
