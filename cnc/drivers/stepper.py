"""The stepper board: an Arduino with the firmware in ``firmware/``, which plays grid moves as they were planned.

Moves go ahead of time, but no farther than a horizon: what the board has been given is what a hold can't take back.

      board plays        promised to the board          next piece
    ──────●──────────────────────────────────┤····················┤
          └────────── HORIZON_S ─────────────┘     PIECE_S

The board keeps time: where it is comes with its status, several times a second. A program's clock goes on through dwells (pauses in the
stream), and stands still while the motion is held (the stream ends, and is started anew).
"""

from __future__ import annotations

import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.drivers.base import Capabilities, Command, board_error
from cnc.drivers.loopback import Loopback
from cnc.drivers.port import Clock, Port, SystemClock
from cnc.drivers.stepper_outputs import Outputs
from cnc.drivers.stepper_protocol import Alarm, Kind, State, Status
from cnc.drivers.stepper_wire import ALARMS, ANSWER_S, ASK_S, BAUD, BREATH_S, PROBE, Wire, least_ns, opened
from cnc.errors import BoardError, Diagnostic, UsageError
from cnc.machine.models import Machine
from cnc.segments import ARM, OUTPUTS, SegmentEncoder, command
from cnc.stream import PulseChunk

HORIZON_S = 0.11
"""The board is given no more than this ahead of what it plays."""
PIECE_S = 0.01
"""Moves are compressed and sent in pieces of this length."""
PREFILL_S = 0.1
"""So much is there before the motion starts."""
TOLERANCE_NS = 2000
"""How far from its time a move may be made."""


@dataclass(slots=True)
class _Piece:
    """A stretch of the stream: its end in bytes, its source line, where the machine stands after each row, and the rows' lines."""

    until: int
    line: int
    rows: NDArray[np.int64]
    lines: NDArray[np.int32]


class Stepper:
    """A board on an open port; :meth:`from_machine` opens one.

    machine: must have as many axes as the board. clock: the port's. background: keep the link alive between calls, from a thread.
    BoardError where no stepper board answers, or one that this program can't drive.
    """

    def __init__(
        self, port: Port, machine: Machine, name: str = "the port", *, clock: Clock | None = None, background: bool = False
    ) -> None:
        self._clock = clock or SystemClock()
        self._machine = machine
        self._wire = Wire(port, self._clock, name)
        self._link = self._wire.link
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._began_at = 0.0
        self._running = False
        self._base_ns = 0
        self._sent_bytes = 0
        self._pieces: deque[_Piece] = deque()
        self._until_ns = 0
        self._gathered: list[tuple[bytes, NDArray[np.int64], NDArray[np.int32]]] = []
        self._gathered_from = self._gathered_until = 0
        self._outputs = Outputs()
        self._active = self._began = self._stopped_short = False
        self._probing = self._touched = False
        self._fault: BoardError | None = None
        self._untold: BoardError | None = None
        self._turned = np.array([-1 if axis.invert else 1 for axis in machine.axes.values()], dtype=np.int8)
        self._steps_per_mm = np.array([axis.steps_per_mm for axis in machine.axes.values()])
        welcome, status = opened(self._wire, machine)
        self._first_byte = status.taken
        self._least_ns = least_ns(welcome)
        self._checks = Loopback(len(machine.axes), self._least_ns)
        self._encoder = SegmentEncoder(len(machine.axes), TOLERANCE_NS)
        self._position = np.array(status.position[: len(machine.axes)], dtype=np.int64) * self._turned
        self._knows_position = status.position_known
        if background:
            threading.Thread(target=self._keep_alive, daemon=True, name="stepper board").start()

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Stepper:
        """The board on the port ``target``, else on that of the machine file."""
        from cnc.drivers.serial_link import open_port

        name = str(target) if target is not None else machine.board.port
        if not name:
            hint = "name it with --port, or board.port in the machine file; cncrun boards lists the ports"
            raise UsageError(Diagnostic("no-port", "the stepper board needs to know its port", hint=hint))
        port = open_port(name, machine.board.baud if "baud" in machine.board.model_fields_set else BAUD)
        try:
            return cls(port, machine, name, background=True)
        except BaseException:
            port.close()
            raise

    # ---------------------------------------------------------------------------------------------------------- as every board

    @property
    def capabilities(self) -> Capabilities:
        """Pulses at half microseconds."""
        return Capabilities(
            len(self._machine.axes), 1e9 / self._least_ns, 500.0, pulses=True, lines=False, senses=False, probes=True, slice_s=PIECE_S
        )

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command taken; after a fault, of the last that is known to have reached the board."""
        return self._checks.confirmed_line if self._fault is None else self._link.confirmed_note

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Where all that was sent leads; after a fault or an abort, where the board says it stands."""
        return self._checks.position_steps if self._began and not self._stopped_short else self._position.copy()

    @property
    def standing_steps(self) -> NDArray[np.int64] | None:
        """Where the board knows that it stands (axes,); None if it lost its position, as it does with every reset."""
        return self._position.copy() if self._knows_position else None

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Take where the machine stands for ``origin_steps``, switch the drivers on."""
        with self._lock:
            self._refuse_after_fault()
            self._checks.start(origin_steps)
            self._position = self._checks.position_steps
            position = [*(self._position * self._turned).tolist(), 0, 0, 0, 0][:4]
            self._request(Kind.SET_POSITION, b"".join(int(each).to_bytes(4, "little", signed=True) for each in position))
            self._encoder = SegmentEncoder(len(self._machine.axes), TOLERANCE_NS)
            self._base_ns = self._until_ns = 0
            self._outputs = Outputs(enabled=True)
            self._active = self._began = True
            self._stream(command(OUTPUTS, *self._outputs.bytes), 0, 0)

    def send(self, chunk: PulseChunk) -> None:
        """Take grid moves; returns when all but a horizon of them has been played."""
        with self._lock:
            self._refuse_after_fault()
            begin = self._checks.position_steps
            try:
                self._checks.send(chunk)
            finally:
                rows = self._checks.rows
                self._checks.rows = 0
                if rows:
                    self._gather(chunk, rows, begin)

    def execute(self, block: Command, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time."""
        with self._lock:
            self._refuse_after_fault()
            self._checks.execute(block, time_ns)
            self._send_gathered()
            if type(block).__name__ == "Held":
                self._rest(time_ns)
                return None
            if type(block).__name__ == "Probe":
                self._begin_probe(bool(getattr(block, "towards", True)), time_ns, block.line)
                return None
            before = self._outputs
            self._outputs = before.after(block, self._machine)
            if self._outputs != before:
                self._idle_until(time_ns)
                self._stream(command(OUTPUTS, *self._outputs.bytes), self._encoder.clock_ns, block.line)
            seconds = getattr(block, "seconds", 0.0)
            self._until_ns = max(self._until_ns, time_ns + round(seconds * 1e9))
        return None

    def sensed(self) -> tuple[float, ...] | None:
        """Whether the probe's motion ended by its input, 1 or 0, and where (axes,) mm, exact to the grid move."""
        with self._lock:
            self._refuse_after_fault()
            return self._end_probe() if self._probing else None

    def finish(self) -> None:
        """Return when everything sent has been carried out."""
        with self._lock:
            self._refuse_after_fault()
            if self._checks.state == "running":
                self._end()
            self._checks.finish()

    def stop(self) -> None:
        """Come to rest after what has been sent, and refuse what comes later."""
        with self._lock:
            if self._active:
                self._end()
            self._checks.stop()

    def abort(self) -> None:
        """Come to rest on the path at once, whatever is still waiting."""
        with self._lock:
            self._checks.abort()
            if self._active:
                self._active = False
                self._halt()

    def close(self) -> None:
        """Stop what moves and let go of the port."""
        with self._lock:
            if not self._closed.is_set():
                with suppress(BoardError):
                    self.abort()
                self._closed.set()
                self._checks.close()
                self._wire.port.close()

    # ------------------------------------------------------------------------------------------------------------------ probing

    def _begin_probe(self, towards: bool, time_ns: int, line: int) -> None:
        """From here on the motion ends where the probe's input changes."""
        self._rest(time_ns)
        if bool(self._ask().inputs & PROBE) == towards:
            what = "makes contact already" if towards else "makes no contact"
            hint = "move it off first" if towards else "G38.4 and G38.5 begin in contact"
            raise self._failed(board_error("probe-contact", f"the probe {what}", line=line, hint=hint))
        self._stream(command(ARM, PROBE, 0 if towards else PROBE), self._encoder.clock_ns, line)
        self._probing = True

    def _end_probe(self) -> tuple[float, ...]:
        """The motion is over, by contact or at its end: what was sent behind the contact is gone, and time goes on behind it."""
        self._send_gathered()
        if not self._touched:
            self._rest(self._until_ns)
        touched = self._touched
        if touched:
            self._request(Kind.CLEAR, b"")
        else:
            self._stream(command(ARM, 0, 0), self._encoder.clock_ns, 0)
            self._rest(self._until_ns)
        status = self._ask()
        self._probing = self._touched = self._running = False
        self._checks.stand_at(self._stands_at(status))
        self._stopped_short = False
        self._first_byte, self._sent_bytes = status.taken, 0
        self._pieces.clear()
        self._encoder.skip(self._until_ns)
        self._base_ns = self._encoder.clock_ns
        return (float(touched), *(self._position / self._steps_per_mm).tolist())

    # ------------------------------------------------------------------------------------------------------------------ sending

    def _end(self) -> None:
        """The last of what was sent, then spindle and coolant off."""
        self._idle_until(self._until_ns)
        self._outputs = replace(self._outputs, spindle="off", duty=0, flood=False, mist=False)
        self._stream(command(OUTPUTS, *self._outputs.bytes), self._encoder.clock_ns, 0)
        self._rest(self._until_ns)
        self._active = False

    def _gather(self, chunk: PulseChunk, rows: int, begin: NDArray[np.int64]) -> None:
        """Compress the first rows of a chunk; send them in pieces that may begin in one chunk and end in another."""
        time_ns = chunk.time_ns[:rows]
        places = begin + np.cumsum(chunk.step[:rows], axis=0, dtype=np.int64)
        turned = (chunk.step[:rows] * self._turned).astype(np.int8)
        at = 0
        while at < rows:
            if not self._gathered:
                self._idle_towards(int(time_ns[at]))
                self._gathered_from = int(time_ns[at])
            until = int(np.searchsorted(time_ns, self._gathered_from + round(PIECE_S * 1e9)))
            if until > at:
                part = slice(at, until)
                data = self._encoder.push(PulseChunk(time_ns[part], turned[part], chunk.line[part]))
                self._gathered.append((data, places[part], chunk.line[part]))
                self._gathered_until = int(time_ns[until - 1])
                self._until_ns = max(self._until_ns, self._gathered_until)
            if until < rows:
                self._send_gathered()
            at = until

    def _send_gathered(self) -> None:
        """Send what was gathered."""
        if self._gathered:
            data, places, lines = (list(each) for each in zip(*self._gathered, strict=True))
            self._gathered.clear()
            if self._touched:
                self._encoder.flush()
                return
            self._wait_for_horizon(self._gathered_until)
            self._position = places[-1][-1]
            stream = b"".join((*data, self._encoder.flush()))
            self._stream(stream, self._encoder.clock_ns, int(lines[-1][-1]), np.concatenate(places), np.concatenate(lines))

    def _idle_towards(self, time_ns: int) -> None:
        """Fill a long time without moves, until shortly before the next one."""
        if time_ns - self._encoder.clock_ns > 2 * PIECE_S * 1e9:
            self._idle_until(time_ns - round(PIECE_S * 1e9))

    def _idle_until(self, time_ns: int) -> None:
        """What was gathered, then pauses, no longer than the horizon allows."""
        self._send_gathered()
        piece = round(PIECE_S * 1e9)
        while self._encoder.clock_ns + 1000 < time_ns:
            until = min(self._encoder.clock_ns + piece, time_ns)
            self._wait_for_horizon(until)
            data = self._encoder.idle(until)
            if not data:
                break
            self._stream(data, self._encoder.clock_ns, 0)

    def _stream(
        self, data: bytes, clock_ns: int, line: int, rows: NDArray[np.int64] | None = None, lines: NDArray[np.int32] | None = None
    ) -> None:
        """Hand bytes of the stream to the link and wait until they are on their way."""
        if self._touched:
            return
        self._sent_bytes += len(data)
        if rows is None or lines is None:
            rows, lines = np.array([self._position]), np.array([line], dtype=np.int32)
        self._pieces.append(_Piece(self._sent_bytes, line, rows, lines))
        self._link.stream(data, (clock_ns - self._base_ns) // 1_000_000, note=line)
        while self._link.unsent and not self._touched:
            if self._link.full and not self._running:
                self._run()
            self._pump(BREATH_S)
        self._run_if_filled(clock_ns)

    def _wait_for_horizon(self, time_ns: int) -> None:
        """Return when the board may be given what is played until ``time_ns``."""
        self._run_if_filled(time_ns)
        while self._running and not self._touched and time_ns - self._played_ns() > HORIZON_S * 1e9:
            self._pump(BREATH_S)

    def _run_if_filled(self, time_ns: int) -> None:
        if not self._running and time_ns - self._base_ns > PREFILL_S * 1e9:
            self._run()

    def _run(self) -> None:
        """Start what has been sent."""
        while self._link.unconfirmed and not self._link.full and not self._touched:
            self._pump(BREATH_S)
        self._running = True
        self._began_at = self._clock.now()
        self._request(Kind.RUN, b"")

    def _played_ns(self) -> int:
        """The program's time that the board has come to."""
        return self._base_ns + round((self._clock.now() - self._began_at) * 1e9)

    def _rest(self, time_ns: int) -> None:
        """End the stream, return when it has been played: the program's clock stands still until the next move."""
        self._idle_until(time_ns)
        self._until_ns = max(self._until_ns, time_ns)
        if self._touched:
            return
        clock = self._encoder.clock_ns
        data = self._encoder.flush() + command(0, end=True)
        self._sent_bytes += len(data)
        self._pieces.append(_Piece(self._sent_bytes, 0, np.array([self._position]), np.zeros(1, np.int32)))
        self._link.stream(data, (clock - self._base_ns) // 1_000_000, end=True)
        while self._link.unconfirmed:
            if self._link.full and not self._running:
                self._run()
            self._pump(BREATH_S)
        if not self._running:
            self._run()
        waited = self._clock.now()
        while not (self._link.state == State.IDLE and self._wire.status is not None and self._taken(self._wire.status) == self._sent_bytes):
            if self._touched:
                return
            if self._link.state != State.IDLE:
                waited = self._clock.now()
            elif self._clock.now() - waited > ANSWER_S:
                raise self._failed(
                    board_error("board-stream", "the board did not play all that it was sent", hint=ALARMS[Alarm.BAD_STREAM][2])
                )
            self._pump(BREATH_S)
        self._running = False
        self._base_ns = clock
        self._pieces.clear()
        self._compare(self._wire.status)

    def _taken(self, status: Status) -> int:
        return (status.taken - self._first_byte) % 2**32

    def _compare(self, status: Status) -> None:
        """The board's count and ours are one, or nothing is known any more."""
        sent = self._position
        there = self._stands_at(status)
        if not np.array_equal(there, sent):
            hint = "home the machine; please report this with the program"
            raise self._failed(board_error("board-position", f"the board stands at {self._place(there)}, not where it was sent", hint=hint))

    # ---------------------------------------------------------------------------------------------------------------- the link

    def _pump(self, seconds: float) -> None:
        """Send what is to be sent, take in what has come, waiting at most so long for it. BoardError for whatever has gone wrong."""
        try:
            said = self._wire.pump(seconds)
        except BoardError as error:
            raise self._failed(self._at_line(error)) from error
        for status in said:
            if status.board_ms is not None and self._running:
                self._began_at = self._clock.now() - status.board_ms * 1e-3
            while len(self._pieces) > 1 and self._pieces[0].until + 64 < self._taken(status):
                self._pieces.popleft()
            if self._active and not status.position_known:
                hint = "look at its supply and at its reset line; home the machine before the next run"
                raise self._failed(board_error("board-reset", f"the board on {self._wire.name} was reset; its position is lost", hint=hint))
            if self._probing and status.state == State.TOUCHED and not self._touched:
                self._touched = True
                self._link.drop()
            if self._active and status.state == State.ALARM:
                raise self._alarmed(status)

    def _ask(self) -> Status:
        return self._wire.ask(self._pump)

    def _request(self, kind: Kind, payload: bytes) -> None:
        self._wire.request(kind, payload, self._pump)

    def _keep_alive(self) -> None:
        """The board stops when it hears nothing for a quarter of a second, such as while a program is held."""
        while not self._closed.wait(2 * ASK_S):
            with self._lock:
                if self._fault is None and not self._closed.is_set():
                    try:
                        self._pump(0.0)
                    except BoardError as error:
                        self._untold = error

    def _halt(self) -> None:
        """Have the board come to rest on its path; what it says after that is where it stands."""
        with suppress(BoardError):
            self._link.drop()
            self._request(Kind.STOP, b"\1")
            began = self._clock.now()
            while self._link.state == State.RAMPING and self._clock.now() - began < ANSWER_S:
                self._pump(BREATH_S)
            self._stands_at(self._ask())
        self._running = False

    # ------------------------------------------------------------------------------------------------------------------- faults

    def _refuse_after_fault(self) -> None:
        if self._untold is not None:
            error, self._untold = self._untold, None
            raise error
        if self._fault is not None:
            raise board_error("board-stopped", "the board has been stopped", hint="open it anew")

    def _at_line(self, error: BoardError) -> BoardError:
        """With the last line that is known to have reached the board."""
        known = error.diagnostic
        return error if known.line else type(error)(replace(known, line=self._link.confirmed_note))

    def _failed(self, error: BoardError) -> BoardError:
        """Nothing more is sent."""
        if self._fault is None:
            self._fault = error
        self._checks.abort()
        self._running = self._active = False
        return error

    def _alarmed(self, status: Status) -> BoardError:
        """The board has stopped: why, and where it stands."""
        self._stands_at(status)
        code, what, hint = ALARMS.get(status.alarm, ("board-alarm", "the board has stopped", "open it anew"))
        if status.alarm == Alarm.LIMIT:
            hit = [axis.upper() for k, axis in enumerate(self._machine.axes) if status.inputs >> k & 1]
            what = f"the limit switch of {' and '.join(hit)} was hit" if hit else what
        message = f"{what}; the machine stands at {self._place(self._position)}"
        return self._failed(board_error(code, message, line=self._line_at(status), hint=hint))

    def _stands_at(self, status: Status) -> NDArray[np.int64]:
        """Where the board says it is, which counts from here on."""
        self._position = np.array(status.position[: len(self._position)], dtype=np.int64) * self._turned
        self._stopped_short = not np.array_equal(self._position, self._checks.position_steps)
        return self._position

    def _line_at(self, status: Status) -> int:
        """The source line of the move after which the board stands."""
        for piece in reversed(self._pieces):
            here = np.flatnonzero((piece.rows == self._position).all(axis=1))
            if len(here):
                return int(piece.lines[here[-1]]) or self._link.confirmed_note
        return self._link.confirmed_note

    def _place(self, steps: NDArray[np.int64]) -> str:
        places = (steps / self._steps_per_mm).tolist()
        return " ".join(
            f"{letter.upper()}{value:.4f}".rstrip("0").rstrip(".") for letter, value in zip(self._machine.axes, places, strict=True)
        )
