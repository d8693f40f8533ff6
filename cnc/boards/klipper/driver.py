"""The Klipper board: a microcontroller with Klipper's firmware, which plays queued steps.

:mod:`cnc.boards.klipper.sender` sends the motion, :mod:`cnc.boards.klipper.supervisor` checks the
messages of the board. This module implements the protocols of all boards
(:mod:`cnc.boards.protocols`).
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.alarms import RELEASE
from cnc.boards.klipper.connection import BAUD
from cnc.boards.klipper.feasibility import KlipperFeasibility
from cnc.boards.klipper.guards import ArmedInput
from cnc.boards.klipper.layout import InputObject, section
from cnc.boards.klipper.outputs import AHEAD_S, OutputState, actions
from cnc.boards.klipper.profile import profile_of
from cnc.boards.klipper.sender import PIECE_S, TooLate
from cnc.boards.klipper.supervisor import Supervisor
from cnc.boards.port import Clock, Port, SystemClock
from cnc.boards.protocols import BoardTraits, Capabilities, MotionState, board_error
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell, Held, Probe, Spindle, SwitchMove
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk

BACKGROUND_S = 0.01
"""Time between two exchanges of bytes between calls."""


class Klipper:
    """A board on an open port; :meth:`from_machine` opens one.

    Args:
        port: The port.
        machine: The machine, with the table [board.klipper].
        name: Name of the port, for messages.
        clock: Clock of the port.
        background: Exchange bytes between calls in a thread, so that the board is not alone.
        identity: Identity under which the position is kept for the next program; "" for none.

    Raises:
        BoardError: No Klipper board answers, or it refuses its configuration.
        MachineFileError: The board lacks a pin of the machine file.
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
        identity: str = "",
    ) -> None:
        self._machine = machine
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._began = False
        self._supervisor = Supervisor(port, machine, name, clock or SystemClock(), identity)
        self._sender = self._supervisor.sender
        self._checks = self._supervisor.checks
        self._position = self._supervisor.position
        axes = len(machine.axes)
        self._next = np.ones(axes, np.bool_), np.ones(axes, np.bool_)
        self._next_alone: tuple[int, int] | None = None
        if background:
            threading.Thread(target=self._keep_alive, daemon=True, name="Klipper board").start()

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Klipper:
        """Open the board on the port ``target``, else on that of the machine file."""
        from cnc.boards.serial_port import identity, open_port

        section(machine)
        name = str(target) if target is not None else machine.board.port
        if not name:
            hint = (
                "name it with --port, or board.port in the machine file; "
                "cncrun boards lists the ports"
            )
            raise UsageError(Diagnostic("no-port", "the Klipper board needs a port", hint=hint))
        port = open_port(name, baud_of(machine))
        try:
            return cls(port, machine, name, background=True, identity=identity(name))
        except BaseException:
            port.close()
            raise

    @property
    def capabilities(self) -> Capabilities:
        """Pulses at ticks of the board's clock."""
        tick_ns = 1e9 / self._supervisor.connection.board_clock.frequency
        return _capabilities(self._machine, tick_ns)

    @classmethod
    def expected_capabilities(cls, machine: Machine) -> Capabilities:
        """Return the capabilities of a board with the microcontroller of the machine file."""
        return _capabilities(machine, 1e9 / profile_of(machine).frequency)

    def feasibility_check(self) -> KlipperFeasibility:
        """Return a check of a program for this board."""
        supervisor = self._supervisor
        known = profile_of(self._machine, supervisor.connection.dictionary, supervisor.slots)
        return KlipperFeasibility(self._machine, known)

    @classmethod
    def expected_feasibility_check(cls, machine: Machine) -> KlipperFeasibility:
        """Return a check for a board with the microcontroller of the machine file."""
        return KlipperFeasibility(machine, profile_of(machine))

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command accepted."""
        if self._supervisor.fault is None:
            return self._checks.confirmed_line
        return self._sender.tracker.line or self._checks.confirmed_line

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point at the end of the motion (axes,); after a fault or an abort, as counted."""
        if self._began and not self._supervisor.stopped_short:
            return self._checks.position_steps
        return self._sender.position.copy()

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis, None where the board has lost it, as after each reset."""
        return self._position.known_steps(self._sender.position)

    @property
    def motion_state(self) -> MotionState:
        """State by the estimate of the board's clock."""
        with self._lock:
            sender = self._sender
            point = sender.tracker.played(sender.now) if sender.running else None
            mm = self._position.mm(sender.position if point is None else point)
            return MotionState(sender.tracker.line, mm, sender.ahead_s)

    @property
    def switches(self) -> tuple[bool, ...]:
        """Whether each limit switch is closed, for the first axes that have one."""
        return tuple(any(each) for each in self.motor_switches)

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis is closed, for the first axes that have one."""
        found: list[tuple[bool, ...]] = []
        supervisor = self._supervisor
        with self._lock:
            supervisor.refuse_after_fault()
            for column in range(len(self._machine.axes)):
                limits = supervisor.layout.limits(column)
                if not limits:
                    break
                found.append(tuple(supervisor.is_pressed(limit) for limit in limits))
        return tuple(found)

    def move_alone(self, column: int, motor: int) -> None:
        """Let only one motor of an axis move between the next start and its end."""
        self._next_alone = column, motor

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Set conditions for the next start alone.

        Args:
            watched: Axes whose limit switches end the motion with an alarm.
            known: Axes whose position is that of the origin.
        """
        axes = len(self._machine.axes)
        wanted = np.ones(axes, np.bool_)
        wanted[: len(watched)] = watched
        self._next = wanted, np.array(known, np.bool_)

    def connect_operator(self, control: Control) -> None:
        """Let a fault during a hold request a stop of ``control``; the board has no buttons."""
        self._supervisor.control = control

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Set the position of the machine to ``origin_steps``, and switch the motor drivers on."""
        supervisor = self._supervisor
        with self._lock:
            supervisor.refuse_after_fault()
            self._checks.start(origin_steps)
            watched, known = self._next
            axes = len(origin_steps)
            self._next = np.ones(axes, np.bool_), np.ones(axes, np.bool_)
            supervisor.guards.watched = set(np.flatnonzero(watched).tolist())
            supervisor.guards.armed = ()
            supervisor.select(self._next_alone)
            self._next_alone = None
            self._refuse_pressed(supervisor.guards.watched)
            supervisor.end_stalls()
            supervisor.check_drivers()
            self._position.set(supervisor.read_positions(), self._checks.position_steps)
            self._position.known = known
            supervisor.store(moving=True)
            self._sender.begin(self._checks.position_steps)
            supervisor.stopped_short = False
            supervisor.active = self._began = True
            supervisor.set_outputs(OutputState(enabled=True, fan=True))
            supervisor.pump(0.0)

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when all but a horizon and a reserve have been played."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            begin = self._checks.position_steps
            try:
                self._checks.send(chunk)
            except BoardError:
                self._send_rows(chunk, begin)
                self._sender.flush()
                raise
            self._send_rows(chunk, begin)

    def _send_rows(self, chunk: PulseChunk, begin: NDArray[np.int64]) -> None:
        rows, self._checks.rows = self._checks.rows, 0
        if not rows:
            return
        part = PulseChunk(chunk.time_ns[:rows], chunk.step[:rows], chunk.line[:rows])
        points = begin + np.cumsum(part.step, axis=0, dtype=np.int64)
        try:
            self._sender.gather(part, points)
        except TooLate:
            raise self._supervisor.too_late() from None

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            self._checks.execute(block, time_ns)
            match block:
                case Held():
                    self._supervisor.rest(time_ns)
                case Probe():
                    self._begin_probe(block, time_ns)
                case _:
                    self._set_outputs(block, time_ns)
        return None

    def probe_result(self) -> tuple[float, ...] | None:
        """Return 1 or 0 for contact or none, and the exact position (axes,) of it, mm."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            return self._end_probe() if self._supervisor.probing else None

    def finish(self) -> None:
        """Wait until everything sent has been carried out."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            if self._checks.state == "running":
                self._end()
            self._checks.finish()

    def stop(self) -> None:
        """Come to rest after everything sent, and refuse later calls."""
        with self._lock:
            self._supervisor.raise_pending()
            if self._supervisor.active:
                self._end()
            self._checks.stop()

    def abort(self) -> None:
        """Come to rest on the path at once, and discard everything that waits."""
        with self._lock:
            self._checks.abort()
            if self._supervisor.active:
                self._supervisor.active = False
                self._supervisor.halt()
                self._supervisor.store(moving=False)

    def revive(self) -> None:
        """Accept a next program after a stop; BoardError after a fault."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            self._checks.revive()

    def close(self) -> None:
        """Stop the motion and close the port."""
        with self._lock:
            if not self._closed.is_set():
                with suppress(BoardError):
                    self.abort()
                self._closed.set()
                self._checks.close()
                self._supervisor.connection.port.close()

    def _set_outputs(self, block: Block, time_ns: int) -> None:
        """Schedule the outputs of a block; a dwell passes by the board's clock."""
        supervisor, sender = self._supervisor, self._sender
        before = supervisor.outputs.state
        after = before.after(block, self._machine)
        seconds = block.seconds if isinstance(block, Dwell) else 0.0
        if after == before and not seconds:
            return
        if not (isinstance(block, Spindle) and block.with_motion):
            sender.flush()  # The motion rests at such a block.
        if after != before:
            supervisor.set_outputs(after, sender.clock_of(time_ns) if sender.running else None)
            supervisor.pump(0.0)
        if sender.running:
            sender.until_ns = max(sender.until_ns, time_ns + round(seconds * 1e9))
        elif seconds:
            supervisor.wait(seconds + AHEAD_S)

    def _end(self) -> None:
        """Play the rest of the motion, then switch spindle, coolant and fan off."""
        supervisor = self._supervisor
        supervisor.rest(self._sender.until_ns)
        supervisor.set_outputs(supervisor.outputs.state.off())
        supervisor.connection.flush(supervisor.pump)
        supervisor.active = False
        supervisor.store(moving=False)

    def _refuse_pressed(self, watched: set[int]) -> None:
        """Raise a fault if the e-stop or a limit switch that is watched is pressed."""
        supervisor = self._supervisor
        stop = supervisor.layout.input("e-stop")
        if stop is not None and supervisor.is_pressed(stop):
            raise board_error("board-emergency-stop", "the e-stop is pressed", hint=RELEASE)
        pressed = [
            self._position.letter(each.column)
            for each in supervisor.layout.inputs
            if each.column in watched and each.column >= 0 and supervisor.is_pressed(each)
        ]
        if pressed:
            hint = (
                "cncrun home moves axes off their switches; else by hand, with the drivers off "
                "(a switch that opens when it is pressed: remove or add ! at its pin)"
            )
            message = f"the limit switch of {' and '.join(pressed)} is pressed"
            raise board_error("board-limit", message, hint=hint)

    def _begin_probe(self, block: Probe, time_ns: int) -> None:
        """Arm the input of a probing move: the probe, or a limit switch in a homing move."""
        supervisor, towards = self._supervisor, block.towards
        found: list[InputObject]
        if isinstance(block, SwitchMove):
            name, found = "switch", supervisor.layout.limits(block.switch)
            if block.motor is not None and len(found) > 1:
                found = [found[block.motor]]
        else:
            probe = supervisor.layout.input("probe")
            name, found = "probe", [] if probe is None else [probe]
        if not found:
            hint = "name its pin in the machine file: board.klipper.probe"
            message = f"the board has no {name}"
            raise supervisor.fail(
                board_error("board-senseless", message, line=block.line, hint=hint)
            )
        supervisor.rest(time_ns)
        if any(supervisor.is_pressed(each) == towards for each in found):
            state = "makes contact already" if towards else "makes no contact"
            hint = "move it off first" if towards else "G38.4 and G38.5 start in contact"
            message = f"the {name} {state}"
            raise supervisor.fail(
                board_error(f"{name}-contact", message, line=block.line, hint=hint)
            )
        if isinstance(block, SwitchMove):
            scale = float(self._machine.steps_per_mm[block.switch])
            supervisor.watch_stalls(block.switch, block.feed * scale)
        supervisor.guards.armed = tuple(
            ArmedInput(each, each.active if towards else 1 - each.active) for each in found
        )
        supervisor.probing = True

    def _end_probe(self) -> tuple[float, ...]:
        """Wait for the end of a probing move, and continue from its position."""
        supervisor, sender = self._supervisor, self._sender
        supervisor.rest(sender.until_ns)
        touched = sender.cut
        point = supervisor.end_cut() if touched else sender.position
        supervisor.guards.armed = ()
        supervisor.probing = False
        supervisor.end_stalls()
        self._checks.stand_at(point)
        supervisor.stopped_short = False
        sender.stand_at(point)
        return (float(touched), *self._position.mm(point))

    def _keep_alive(self) -> None:
        """Exchange bytes between calls: the board stops after some tenths of a second."""
        while not self._closed.wait(BACKGROUND_S):
            with self._lock:
                if not self._closed.is_set():
                    self._supervisor.pump_in_background()


def baud_of(machine: Machine) -> int:
    """Return the speed of the machine file, else that of the firmware, bits/s."""
    return machine.board.baud if "baud" in machine.board.model_fields_set else BAUD


def _capabilities(machine: Machine, tick_ns: float) -> Capabilities:
    known = machine.board.klipper
    return Capabilities(
        len(machine.axes),
        machine.board.max_step_rate,
        tick_ns,
        pulses=True,
        lines=False,
        senses=False,
        probes=known is not None and known.probe is not None,
        slice_s=PIECE_S / 2,
        actions=actions(known),
        separate_axes=True,
    )
