"""The calls of a board that plays pulses: their order, their lock, and their common part.

A driver adds what its board does: start, blocks, probing, the end of a motion.
"""

from __future__ import annotations

import math
import threading
import time
from abc import abstractmethod
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from cnc.boards.errors import board_error
from cnc.boards.protocols import BoardTraits, MotionState, PulseSink
from cnc.boards.pulse_board.supervisor import PulseSupervisor
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held, Probe
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk


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
