"""The stepper board: an Arduino with the firmware in ``firmware/``, which plays grid moves as they
were planned.

How moves go to it is in :mod:`cnc.boards.stepper.sender`, what goes over the connection in
:mod:`cnc.boards.stepper.protocol`. Here it is a board as every other (:mod:`cnc.boards.protocols`),
with its faults.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.boards.port import Clock, Port, SystemClock
from cnc.boards.protocols import BoardTraits, Capabilities, MotionState, board_error
from cnc.boards.stepper.connection import (
    ALARMS,
    ANSWER_S,
    ASK_S,
    BAUD,
    BREATH_S,
    LIMITS,
    PROBE,
    UNO,
    Connection,
    cleared,
    configured,
    least_ns,
    opened,
    unfit,
)
from cnc.boards.stepper.feasibility import FeasibilityCheck
from cnc.boards.stepper.outputs import Outputs, actions
from cnc.boards.stepper.position import Place
from cnc.boards.stepper.protocol import Alarm, Kind, State, Status
from cnc.boards.stepper.segments import ARM, OUTPUTS
from cnc.boards.stepper.sender import PIECE_S, Stream
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import BoardError, Diagnostic, MotionLimitError, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk


class Stepper:
    """A board on an open port; :meth:`from_machine` opens one.

    machine: must have as many axes as the board. clock: the port's. background: keep the link alive
    between calls, from a thread. BoardError where no stepper board answers, or one that this
    program can't drive.
    """

    traits = BoardTraits()

    def __init__(
        self,
        port: Port,
        machine: Machine,
        name: str = "the port",
        *,
        clock: Clock | None = None,
        background: bool = False,
    ) -> None:
        self._clock = clock or SystemClock()
        self._machine = machine
        self._connection = Connection(port, self._clock, name)
        self._link = self._connection.link
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._outputs = Outputs()
        self._active = self._began = self._stopped_short = False
        self._probing = False
        self._control: Control | None = None
        self._pressed = (0, 0)
        self._fault: BoardError | None = None
        self._untold: BoardError | None = None
        self._place = Place(machine)
        self._welcome, self._told = opened(self._connection, machine)
        status = self._told
        self._least_ns = least_ns(self._welcome, machine)
        self._checks = Loopback(len(machine.axes), self._least_ns)
        self._stream = Stream(self._connection, len(machine.axes), self._pump, status.taken)
        self._pressed = status.holds, status.resumes
        self._stream.position = self._place.found(status)
        self._limits = LIMITS
        self._next = LIMITS, np.ones(len(machine.axes), np.bool_)
        if background:
            threading.Thread(target=self._keep_alive, daemon=True, name="stepper board").start()

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Stepper:
        """The board on the port ``target``, else on that of the machine file."""
        from cnc.boards.serial_port import open_port

        name = str(target) if target is not None else machine.board.port
        if not name:
            hint = "name it with --port, or board.port in the machine file; cncrun boards lists the ports"
            raise UsageError(
                Diagnostic("no-port", "the stepper board needs to know its port", hint=hint)
            )
        port = open_port(name, _baud(machine))
        try:
            return cls(port, machine, name, background=True)
        except BaseException:
            port.close()
            raise

    # ----------------------------------------------------------------------------------------------------------
    # as every board

    @property
    def capabilities(self) -> Capabilities:
        """Pulses at half microseconds."""
        return _capabilities(self._machine, self._least_ns)

    @classmethod
    def expected_capabilities(cls, machine: Machine) -> Capabilities:
        """Of an Uno with the firmware of this version."""
        return _capabilities(machine, least_ns(UNO, machine))

    def feasibility_check(self) -> FeasibilityCheck:
        """What a program asks of this board."""
        return FeasibilityCheck(len(self._machine.axes), self._least_ns, _baud(self._machine))

    @classmethod
    def expected_feasibility_check(cls, machine: Machine) -> FeasibilityCheck:
        """What a program asks of an Uno with the firmware of this version. MotionLimitError where
        that is not for this machine.
        """
        for fault in unfit(machine, least_ns(UNO, machine)):
            raise MotionLimitError(fault)
        return FeasibilityCheck(len(machine.axes), least_ns(UNO, machine), _baud(machine))

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command taken; after a fault, of the last that is known
        to have reached the board.
        """
        return self._checks.confirmed_line if self._fault is None else self._link.confirmed_note

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Where all that was sent leads; after a fault or an abort, where the board says it stands,
        or last said.
        """
        return (
            self._checks.position_steps
            if self._began and not self._stopped_short
            else self._stream.position.copy()
        )

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Where the board knows that each axis stands; None where it lost that, as it does with
        every reset.
        """
        return self._place.standing(self._stream.position)

    @property
    def motion_state(self) -> MotionState:
        """By the board's last status: some hundredths of a second ago."""
        with self._lock:
            return MotionState(
                self._stream.trail.line,
                self._place.mm(self._place.of(self._told)),
                self._stream.ahead_s,
            )

    @property
    def switches(self) -> tuple[bool, ...]:
        """Which limit switches are closed; the fourth axis has none."""
        with self._lock:
            self._refuse_after_fault()
            inputs = self._ask().inputs
        return tuple(
            bool(inputs >> axis & 1)
            for axis in range(min(LIMITS.bit_count(), len(self._machine.axes)))
        )

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """For the next start alone: whose switches end the motion, and which axes stand where its
        origin says.
        """
        self._next = (
            sum(1 << axis for axis, wanted in enumerate(watched) if wanted),
            np.array(known, np.bool_),
        )

    def connect_operator(self, control: Control) -> None:
        """Whom the shield's buttons move from here on: A1 holds, A2 resumes. A fault that comes
        while the motion is held ends the run.
        """
        self._control = control

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Take where the machine stands for ``origin_steps``, switch the drivers on."""
        with self._lock:
            self._refuse_after_fault()
            self._checks.start(origin_steps)
            self._stream.begin(self._checks.position_steps)
            (self._limits, self._place.known), self._next = (
                self._next,
                (LIMITS, np.ones(len(origin_steps), np.bool_)),
            )
            status = configured(
                self._connection, self._machine, self._welcome, self._limits, self._pump
            )
            cleared(self._connection, self._machine, status, self._limits, self._pump)
            self._request(Kind.SET_POSITION, self._place.counted(self._stream.position))
            self._outputs = Outputs(enabled=True)
            self._active = self._began = True
            self._stream.command(OUTPUTS, *self._outputs.bytes)

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
                    places = begin + np.cumsum(chunk.step[:rows], axis=0, dtype=np.int64)
                    turned = (chunk.step[:rows] * self._place.turned).astype(np.int8)
                    self._stream.gather(
                        PulseChunk(chunk.time_ns[:rows], turned, chunk.line[:rows]), places
                    )

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time."""
        with self._lock:
            self._refuse_after_fault()
            self._checks.execute(block, time_ns)
            self._stream.send_gathered()
            if type(block).__name__ == "Held":
                self._rest(time_ns)
                return None
            if type(block).__name__ in ("Probe", "SwitchMove"):
                switch = getattr(block, "switch", None)
                self._begin_probe(
                    PROBE if switch is None else 1 << switch,
                    bool(getattr(block, "towards", True)),
                    time_ns,
                    block.line,
                )
                return None
            before = self._outputs
            self._outputs = before.after(block, self._machine)
            if self._outputs != before:
                self._stream.idle_until(time_ns)
                self._stream.command(OUTPUTS, *self._outputs.bytes, line=block.line)
            seconds = getattr(block, "seconds", 0.0)
            self._stream.until_ns = max(self._stream.until_ns, time_ns + round(seconds * 1e9))
        return None

    def probe_result(self) -> tuple[float, ...] | None:
        """Whether the probe's motion ended by its input, 1 or 0, and where (axes,) mm, exact to the
        grid move.
        """
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
            self._tell_what_is_untold()
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
                self._connection.port.close()

    # ------------------------------------------------------------------------------------------------------------------
    # probing

    def _begin_probe(self, bit: int, towards: bool, time_ns: int, line: int) -> None:
        """From here on the motion ends where the input changes: the probe's, or a limit
        switch's.
        """
        self._rest(time_ns)
        if bool(self._ask().inputs & bit) == towards:
            name = "probe" if bit == PROBE else "switch"
            what = "makes contact already" if towards else "makes no contact"
            hint = "move it off first" if towards else "G38.4 and G38.5 begin in contact"
            raise self._failed(
                board_error(f"{name}-contact", f"the {name} {what}", line=line, hint=hint)
            )
        self._stream.command(ARM, bit, 0 if towards else bit, line=line)
        self._probing = True

    def _end_probe(self) -> tuple[float, ...]:
        """The motion is over, by contact or at its end: what was sent behind the contact is gone,
        and time goes on behind it.
        """
        stream = self._stream
        stream.send_gathered()
        self._rest(stream.until_ns)
        touched = stream.cut
        if touched:
            self._request(Kind.CLEAR, b"")
        else:
            stream.command(ARM, 0, 0)
            self._rest(stream.until_ns)
        status = self._ask()
        self._probing = False
        self._checks.stand_at(self._stands_at(status))
        self._stopped_short = False
        stream.begin_after(status)
        return (float(touched), *self._place.mm(stream.position))

    # -------------------------------------------------------------------------------------------------------------------
    # moving

    def _end(self) -> None:
        """The last of what was sent, then spindle and coolant off."""
        self._stream.idle_until(self._stream.until_ns)
        self._outputs = replace(self._outputs, spindle="off", duty=0, flood=False, mist=False)
        self._stream.command(OUTPUTS, *self._outputs.bytes)
        self._rest(self._stream.until_ns)
        self._active = False

    def _rest(self, time_ns: int) -> None:
        """Return when all that was sent has been played. The board's count and ours are one, or
        nothing is known any more.
        """
        status = self._stream.rest(time_ns)
        if status is None:
            return
        if not self._stream.wholly_taken(status):
            raise self._failed(
                board_error(
                    "board-stream",
                    "the board did not play all that it was sent",
                    hint=ALARMS[Alarm.BAD_STREAM][2],
                )
            )
        sent = self._stream.position
        there = self._stands_at(status)
        if not np.array_equal(there, sent):
            hint = "home the machine; please report this with the program"
            raise self._failed(
                board_error(
                    "board-position",
                    f"the board stands at {self._place.words(there)}, not where it was sent",
                    hint=hint,
                )
            )

    # ----------------------------------------------------------------------------------------------------------------
    # the link

    def _pump(self, seconds: float) -> None:
        """Send what is to be sent, take in what has come, waiting at most so long for it.
        BoardError for whatever has gone wrong.
        """
        try:
            said = self._connection.pump(seconds)
        except BoardError as error:
            raise self._lost(self._at_line(error)) from error
        for status in said:
            self._stream.heard(status)
            self._heed_buttons(status)
            if self._active and not status.position_known:
                hint = (
                    "look at its supply and at its reset line; home the machine before the next run"
                )
                raise self._lost(
                    board_error(
                        "board-reset",
                        f"the board on {self._connection.name} was reset; its position is lost",
                        hint=hint,
                    )
                )
            self._told = status
            if self._probing and status.state == State.TOUCHED and not self._stream.cut:
                self._stream.cut = True
                self._link.drop()
            if self._active and status.state == State.ALARM:
                raise self._alarmed(status)

    def _heed_buttons(self, status: Status) -> None:
        """What the buttons of the shield want. Both at once is a hold."""
        (holds, resumes), self._pressed = self._pressed, (status.holds, status.resumes)
        if self._control is not None:
            if status.holds != holds:
                self._control.hold()
            elif status.resumes != resumes:
                self._control.resume()

    def _ask(self) -> Status:
        return self._connection.ask(self._pump)

    def _request(self, kind: Kind, payload: bytes) -> None:
        self._connection.request(kind, payload, self._pump)

    def _keep_alive(self) -> None:
        """The board stops when it hears nothing for a quarter of a second, such as while a program
        is held.
        """
        while not self._closed.wait(2 * ASK_S):
            with self._lock:
                if self._fault is None and not self._closed.is_set():
                    try:
                        self._pump(0.0)
                    except BoardError as error:
                        self._untold = error
                        if self._control is not None:
                            self._control.stop()  # who waits for the end of a hold waits no longer

    def _halt(self) -> None:
        """Have the board come to rest on its path; what it says after that is where it stands."""
        with suppress(BoardError):
            self._link.drop()
            self._request(Kind.STOP, b"\1")
            began = self._clock.now()
            while self._link.state == State.RAMPING and self._clock.now() - began < ANSWER_S:
                self._pump(BREATH_S)
            self._stands_at(self._ask())
        self._stream.running = False

    # -------------------------------------------------------------------------------------------------------------------
    # faults

    def _tell_what_is_untold(self) -> None:
        """Raise what has gone wrong since the last call."""
        if self._untold is not None:
            error, self._untold = self._untold, None
            raise error

    def _refuse_after_fault(self) -> None:
        self._tell_what_is_untold()
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
        self._stream.running = self._active = False
        return error

    def _lost(self, error: BoardError) -> BoardError:
        """Where the machine stands nobody knows any more: what counts is where the board last said
        it was.
        """
        if self._active:
            self._stands_at(self._told)
        self._place.forget()
        return self._failed(error)

    def _alarmed(self, status: Status) -> BoardError:
        """The board has stopped: why, and where it stands."""
        self._stands_at(status)
        code, what, hint = ALARMS.get(
            status.alarm, ("board-alarm", "the board has stopped", "open it anew")
        )
        if status.alarm == Alarm.LIMIT:
            hit = self._place.letters(status.inputs & self._limits)
            what = f"the limit switch of {' and '.join(hit)} was hit" if hit else what
        message = f"{what}; the machine stands at {self._place.words(self._stream.position)}"
        line = self._stream.trail.line_at(self._stream.position) or self._link.confirmed_note
        return self._failed(board_error(code, message, line=line, hint=hint))

    def _stands_at(self, status: Status) -> NDArray[np.int64]:
        """Where the board says it is, which counts from here on."""
        there = self._place.of(status)
        self._stopped_short = not np.array_equal(there, self._checks.position_steps)
        self._stream.position = there
        return there


def _baud(machine: Machine) -> int:
    return machine.board.baud if "baud" in machine.board.model_fields_set else BAUD


def _capabilities(machine: Machine, least: int) -> Capabilities:
    axes = len(machine.axes)
    return Capabilities(
        axes,
        1e9 / least,
        500.0,
        pulses=True,
        lines=False,
        senses=False,
        probes=True,
        slice_s=PIECE_S,
        actions=actions(axes),
    )
