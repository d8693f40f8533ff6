"""Common parts of the drivers of boards that play pulses (stepper board, Klipper board)."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from binascii import crc_hqx
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.boards.protocols import BoardTraits, MotionState, PulseSink, board_error
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Coolant, End, Held, Probe, Spindle
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.model.units import decimal_text

# Faults of an open board: the first one ends its use, those of a thread are raised by a call.


class PulseSupervisor(ABC):
    """An open board, whose every message is checked.

    Args:
        checks: Checks of all pulses before they are sent, and their counts.

    Attributes:
        checks: The checks.
        active: A program runs, so that alarms and resets are faults.
        probing: An armed input may end the motion.
        stopped_short: The board is elsewhere than the pulses sent lead to.
        fault: The fault that ended the use of the board.
        pending_fault: A fault of the background thread, not raised yet.
        control: Requests of the operator.
    """

    def __init__(self, checks: Loopback) -> None:
        self.checks = checks
        self.active = self.probing = self.stopped_short = False
        self.fault: BoardError | None = None
        self.pending_fault: BoardError | None = None
        self.control: Control | None = None

    @property
    @abstractmethod
    def confirmed_line(self) -> int:
        """Source line that the board has reached for certain."""

    @property
    @abstractmethod
    def grid_point(self) -> NDArray[np.int64]:
        """Grid point at the end of what was sent (axes,), or where the board stopped."""

    @property
    @abstractmethod
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis, None where it is not known."""

    @property
    @abstractmethod
    def motion_state(self) -> MotionState:
        """State of the motion."""

    @abstractmethod
    def pump(self, seconds: float) -> object:
        """Send, receive, and raise all faults; wait at most ``seconds`` for bytes."""

    @abstractmethod
    def halt(self) -> None:
        """Come to rest on the path, and take over the position."""

    @abstractmethod
    def close_port(self) -> None:
        """Close the port."""

    def pump_in_background(self) -> None:
        """Exchange bytes between calls; a fault ends a hold and is raised by the next call."""
        if self.fault is None:
            try:
                self.pump(0.0)
            except BoardError as error:
                self.pending_fault = error
                if self.control is not None:
                    self.control.stop()  # A thread that waits for the end of a hold must wake up.

    def raise_pending(self) -> None:
        """Raise a fault of the background thread."""
        if self.pending_fault is not None:
            error, self.pending_fault = self.pending_fault, None
            raise error

    def refuse_after_fault(self) -> None:
        """Raise a pending fault, and refuse calls after a fault."""
        self.raise_pending()
        if self.fault is not None:
            raise board_error("board-stopped", "the board has been stopped", hint="open it again")

    def fail(self, error: BoardError) -> BoardError:
        """End the use of the board by a fault, and return the fault."""
        if self.fault is None:
            self.fault = error
        self.checks.abort()
        self.active = False
        return error


# The calls of a board that plays pulses: their order, their lock, and their common part.
#
# A driver adds what its board does: start, blocks, probing, the end of a motion.


class PulseBoard(PulseSink):
    """A board on an open port.

    Args:
        machine: The machine.
        supervisor: The board.
    """

    traits = BoardTraits()

    def __init__(self, machine: Machine, supervisor: PulseSupervisor) -> None:
        self._machine = machine
        self._board = supervisor
        self._checks = supervisor.checks
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._began = False
        self._next_alone: tuple[int, int] | None = None
        self._period_s, self._pumped_at = math.inf, 0.0

    def run_in_background(self, period_s: float) -> None:
        """Exchange bytes between calls in a thread, so that the board is not alone."""
        self._period_s = period_s
        name = type(self).__name__
        threading.Thread(target=self._keep_alive, args=(period_s,), daemon=True, name=name).start()

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command accepted.

        After a fault, it is the last line that the board is known to have received.
        """
        if self._board.fault is None:
            return self._checks.confirmed_line
        return self._board.confirmed_line

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point at the end of the motion (axes,); after a fault or an abort, as counted."""
        if self._began and not self._board.stopped_short:
            return self._checks.position_steps
        return self._board.grid_point.copy()

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis, None where the board has lost it, as after each reset."""
        return self._board.known_steps

    @property
    def motion_state(self) -> MotionState:
        """State of the motion that the board plays."""
        with self._lock:
            return self._board.motion_state

    @property
    @abstractmethod
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis is closed, for the axes that have one."""

    def move_alone(self, column: int, motor: int) -> None:
        """Let only one motor of an axis move between the next start and its end."""
        self._next_alone = column, motor

    def connect_operator(self, control: Control) -> None:
        """Send the presses of the board's buttons to ``control``, if it has some.

        A fault during a hold requests a stop.
        """
        self._board.control = control

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when all but a horizon has been played."""
        with self._lock:
            self._board.refuse_after_fault()
            begin = self._checks.position_steps
            try:
                self._checks.send(chunk)
            except BoardError:
                self._send_rows(chunk, begin)
                self._flush()
                raise
            self._send_rows(chunk, begin)
            # A planner at work gives the interpreter's lock back so often, and so shortly, that the
            # thread may wait for some tenths of a second.
            if time.monotonic() - self._pumped_at >= self._period_s:
                self._pump()

    def _send_rows(self, chunk: PulseChunk, begin: NDArray[np.int64]) -> None:
        """Send the rows that have passed the checks."""
        rows, self._checks.rows = self._checks.rows, 0
        if rows:
            part = PulseChunk(chunk.time_ns[:rows], chunk.step[:rows], chunk.line[:rows])
            self._gather(part, begin + np.cumsum(part.step, axis=0, dtype=np.int64))

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time."""
        with self._lock:
            self._board.refuse_after_fault()
            self._checks.execute(block, time_ns)
            match block:
                case Held():
                    self._rest(time_ns)
                case Probe():
                    self._begin_probe(block, time_ns)
                case _:
                    self._set_outputs(block, time_ns)
        return None

    def probe_result(self) -> tuple[float, ...] | None:
        """Return 1 or 0 for contact or none, and the exact position (axes,) of it, mm."""
        with self._lock:
            self._board.refuse_after_fault()
            return self._end_probe() if self._board.probing else None

    def finish(self) -> None:
        """Wait until everything sent has been carried out."""
        with self._lock:
            self._board.refuse_after_fault()
            if self._checks.state == "running":
                self._end()
            self._checks.finish()

    def stop(self) -> None:
        """Come to rest after everything sent, and refuse later calls."""
        with self._lock:
            self._board.raise_pending()
            if self._board.active:
                self._end()
            self._checks.stop()

    def abort(self) -> None:
        """Come to rest on the path at once, and discard everything that waits."""
        with self._lock:
            self._checks.abort()
            if self._board.active:
                self._board.active = False
                self._board.halt()

    def revive(self) -> None:
        """Take the next program after a stop. BoardError after a fault, or after lost motion."""
        with self._lock:
            self._board.refuse_after_fault()
            if self._checks.state == "stopped":
                if self._board.stopped_short:
                    message = "the motion was broken off"
                    raise board_error("board-stopped", message, hint="connect the board again")
                self._checks.revive()

    def close(self) -> None:
        """Stop the motion and close the port."""
        with self._lock:
            if not self._closed.is_set():
                with suppress(BoardError):
                    self.abort()
                self._closed.set()
                self._checks.close()
                self._board.close_port()

    @abstractmethod
    def _gather(self, chunk: PulseChunk, points: NDArray[np.int64]) -> None:
        """Send grid moves, with the grid point after each (n, axes)."""

    @abstractmethod
    def _flush(self) -> None:
        """Send what was gathered: the motion ends."""

    @abstractmethod
    def _rest(self, time_ns: int) -> None:
        """Wait until the motion up to a time has been played."""

    @abstractmethod
    def _begin_probe(self, block: Probe, time_ns: int) -> None:
        """Arm the input of a probing move: the probe, or a limit switch in a homing move."""

    @abstractmethod
    def _end_probe(self) -> tuple[float, ...]:
        """Wait for the end of a probing move, and continue from its position."""

    @abstractmethod
    def _set_outputs(self, block: Block, time_ns: int) -> None:
        """Set the outputs of a block at its time."""

    @abstractmethod
    def _end(self) -> None:
        """Play the rest of the motion, then switch spindle and coolant off."""

    def _keep_alive(self, period_s: float) -> None:
        """Exchange bytes between calls: a board stops after some tenths of a second of silence."""
        while not self._closed.wait(period_s):
            with self._lock:
                if not self._closed.is_set():
                    self._pump()

    def _pump(self) -> None:
        self._pumped_at = time.monotonic()
        self._board.pump_in_background()


def port_name(machine: Machine, target: object, board: str) -> str:
    """Return the name of the port of a board: ``target``, else that of the machine file.

    Raises:
        UsageError: ``no-port``.
    """
    name = str(target) if target is not None else machine.board.port
    if not name:
        hint = (
            "name it with --port, or board.port in the machine file; cncrun boards lists the ports"
        )
        raise UsageError(Diagnostic("no-port", f"the {board} board needs a port", hint=hint))
    return name


# State of the outputs of a board: spindle, coolant, motor drivers, fan.


@dataclass(frozen=True, slots=True)
class OutputState:
    """State of all outputs. ``share`` is the speed of the spindle as a share of the highest."""

    enabled: bool = False
    spindle: Literal["cw", "ccw", "off"] = "off"
    share: float = 0.0
    flood: bool = False
    mist: bool = False
    fan: bool = False

    def after(self, block: Block, machine: Machine) -> OutputState:
        """Return the state after a block."""
        match block:
            case Spindle(state=state, rpm=rpm):
                share = 0.0 if state == "off" else rpm / machine.board.max_spindle_rpm
                return replace(self, spindle=state, share=min(max(share, 0.0), 1.0))
            case Coolant(mist=mist, flood=flood):
                return replace(self, flood=flood, mist=mist)
            case End():
                return self.off()
        return self

    def off(self) -> OutputState:
        """Return the state with spindle, coolant and fan off."""
        return replace(self, spindle="off", share=0.0, flood=False, mist=False, fan=False)


# Position of a machine on a board that counts steps: which axes are known, coordinates, text.


class MachinePosition:
    """Positions of a machine.

    Attributes:
        known: Whether the position of each axis is known (axes,).
        letters: Letter of each axis.
    """

    def __init__(self, machine: Machine) -> None:
        self.letters = [letter.upper() for letter in machine.axes]
        self.known = np.zeros(len(machine.axes), np.bool_)
        self._steps_per_mm = machine.steps_per_mm

    def forget(self) -> None:
        """Mark the position of all axes as unknown."""
        self.known = np.zeros_like(self.known)

    def known_steps(self, steps: NDArray[np.int64]) -> tuple[int | None, ...]:
        """Return a grid point (axes,) with None for each axis whose position is not known."""
        return tuple(
            count if certain else None
            for count, certain in zip(steps.tolist(), self.known.tolist(), strict=True)
        )

    def mm(self, steps: NDArray[np.int64]) -> tuple[float, ...]:
        """Return the machine coordinates of a grid point (axes,), mm."""
        return tuple((steps / self._steps_per_mm).tolist())

    def text(self, steps: NDArray[np.int64]) -> str:
        """Return the machine coordinates of a grid point (axes,) as text."""
        return " ".join(
            letter + decimal_text(value, 4)
            for letter, value in zip(self.letters, self.mm(steps), strict=True)
        )


# CRC-16 of the frames of stepper boards and Klipper boards.

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc16(data: bytes) -> int:
    """Return CRC-16/MCRF4XX: polynomial 0x1021 reflected, initial value 0xFFFF.

    It is 0 over data followed by its CRC, low byte first.
    """
    straight = crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return _REVERSED[straight >> 8] | _REVERSED[straight & 0xFF] << 8
