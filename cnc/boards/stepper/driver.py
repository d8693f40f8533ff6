"""The stepper board: an Arduino with the firmware in ``firmware/``, which plays grid moves.

:mod:`cnc.boards.stepper.sender` sends the moves, :mod:`cnc.boards.stepper.protocol` has the frames,
and :mod:`cnc.boards.stepper.supervisor` checks the reports of the board. This module implements the
protocols of all boards (:mod:`cnc.boards.protocols`).
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.port import Clock, Port, SystemClock
from cnc.boards.protocols import BoardTraits, Capabilities, MotionState, board_error
from cnc.boards.stepper.connection import (
    PROBE,
    STATUS_PERIOD_S,
    UNO,
    baud_of,
    clear_alarm,
    configure,
    incompatibilities,
    min_spacing_ns,
)
from cnc.boards.stepper.feasibility import StepperFeasibility
from cnc.boards.stepper.motor_outputs import MotorOutputs
from cnc.boards.stepper.outputs import Outputs, actions
from cnc.boards.stepper.protocol import Kind
from cnc.boards.stepper.segments import ARM, OUTPUTS
from cnc.boards.stepper.sender import PIECE_S
from cnc.boards.stepper.supervisor import Supervisor
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell, Held, Probe, SwitchMove
from cnc.model.diagnostics import BoardError, Diagnostic, MotionLimitError, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk


class Stepper:
    """A board on an open port; :meth:`from_machine` opens one.

    Args:
        port: The port.
        machine: The machine, with as many axes as the board.
        name: Name of the port, for messages.
        clock: Clock of the port.
        background: Exchange bytes between calls in a thread, so that the board is not alone.

    Raises:
        BoardError: No stepper board answers, or the board does not suit the machine.
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
        self._machine = machine
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._outputs = Outputs()
        self._began = False
        self._supervisor = Supervisor(port, machine, name, clock or SystemClock())
        self._sender = self._supervisor.sender
        self._checks = self._supervisor.checks
        self._position = self._supervisor.position
        self._motors = self._position.outputs
        self._next = self._motors.limits, np.ones(len(machine.axes), np.bool_)
        self._next_alone: tuple[int, int] | None = None
        if background:
            threading.Thread(target=self._keep_alive, daemon=True, name="stepper board").start()

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Stepper:
        """Open the board on the port ``target``, else on that of the machine file."""
        from cnc.boards.serial_port import open_port

        name = str(target) if target is not None else machine.board.port
        if not name:
            hint = (
                "name it with --port, or board.port in the machine file; "
                "cncrun boards lists the ports"
            )
            raise UsageError(Diagnostic("no-port", "the stepper board needs a port", hint=hint))
        port = open_port(name, baud_of(machine))
        try:
            return cls(port, machine, name, background=True)
        except BaseException:
            port.close()
            raise

    @property
    def capabilities(self) -> Capabilities:
        """Pulses in a grid of half microseconds."""
        return _capabilities(self._machine, self._supervisor.least_ns)

    @classmethod
    def expected_capabilities(cls, machine: Machine) -> Capabilities:
        """Return the capabilities of an Uno with the firmware of this version."""
        return _capabilities(machine, min_spacing_ns(UNO, machine))

    def feasibility_check(self) -> StepperFeasibility:
        """Return a check of a program for this board."""
        least_ns = self._supervisor.least_ns
        return StepperFeasibility(MotorOutputs(self._machine), least_ns, baud_of(self._machine))

    @classmethod
    def expected_feasibility_check(cls, machine: Machine) -> StepperFeasibility:
        """Return a check of a program for an Uno with the firmware of this version.

        Raises:
            MotionLimitError: An Uno does not suit the machine.
        """
        spacing_ns = min_spacing_ns(UNO, machine)
        for fault in incompatibilities(machine, spacing_ns):
            raise MotionLimitError(fault)
        return StepperFeasibility(MotorOutputs(machine), spacing_ns, baud_of(machine))

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command accepted.

        After a fault, it is the last line that the board is known to have received.
        """
        if self._supervisor.fault is None:
            return self._checks.confirmed_line
        return self._supervisor.connection.link.confirmed_note

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point at the end of the stream (axes,); after a fault or an abort, as reported."""
        if self._began and not self._supervisor.stopped_short:
            return self._checks.position_steps
        return self._sender.position.copy()

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis, None where the board has lost it, as after each reset."""
        return self._position.known_steps(self._sender.position)

    @property
    def motion_state(self) -> MotionState:
        """State according to the last status, some hundredths of a second old."""
        with self._lock:
            return MotionState(
                self._sender.tracker.line,
                self._position.mm(self._position.of(self._supervisor.status)),
                self._sender.ahead_s,
            )

    @property
    def switches(self) -> tuple[bool, ...]:
        """Whether each axis has a closed limit switch; a fourth axis has none."""
        return tuple(any(each) for each in self.motor_switches)

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis is closed; a fourth axis has none."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            inputs = self._supervisor.ask().inputs
        limits = self._motors.limits
        found = (
            tuple(bool(inputs >> k & 1) for k in self._motors.of_axis(column) if limits >> k & 1)
            for column in range(len(self._machine.axes))
        )
        return tuple(each for each in found if each)

    def move_alone(self, column: int, motor: int) -> None:
        """Let only one motor of an axis move between the next start and its end."""
        self._next_alone = column, motor

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Set conditions for the next start alone.

        Args:
            watched: Axes whose limit switches end the motion with an alarm.
            known: Axes whose position is that of the origin.
        """
        wanted = [*watched, *[True] * (len(self._machine.axes) - len(watched))]
        self._next = self._motors.bits(wanted), np.array(known, np.bool_)

    def connect_operator(self, control: Control) -> None:
        """Send the presses of the shield's buttons to ``control``: A1 holds, A2 resumes.

        A fault during a hold requests a stop.
        """
        self._supervisor.control = control

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Set the position of the machine to ``origin_steps``, and switch the motor drivers on."""
        supervisor = self._supervisor
        with self._lock:
            supervisor.refuse_after_fault()
            self._checks.start(origin_steps)
            self._sender.begin(self._checks.position_steps)
            supervisor.limits, self._position.known = self._next
            self._next = self._motors.limits, np.ones(len(origin_steps), np.bool_)
            self._motors.select(self._next_alone)
            self._next_alone = None
            connection, limits = supervisor.connection, supervisor.limits
            status = configure(
                connection, self._machine, supervisor.welcome, limits, supervisor.pump
            )
            clear_alarm(connection, self._machine, status, limits, supervisor.pump)
            supervisor.request(Kind.SET_POSITION, self._position.payload(self._sender.position))
            self._outputs = Outputs(enabled=True)
            supervisor.active = self._began = True
            self._sender.command(OUTPUTS, *self._outputs.bytes)

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when all but a horizon of them has been played."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            begin = self._checks.position_steps
            try:
                self._checks.send(chunk)
            finally:
                rows = self._checks.rows
                self._checks.rows = 0
                if rows:
                    step = chunk.step[:rows]
                    points = begin + np.cumsum(step, axis=0, dtype=np.int64)
                    outputs = self._motors.expanded(step)
                    self._sender.gather(
                        PulseChunk(chunk.time_ns[:rows], outputs, chunk.line[:rows]), points
                    )

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            self._checks.execute(block, time_ns)
            self._sender.send_gathered()
            match block:
                case Held():
                    self._supervisor.rest(time_ns)
                case Probe():
                    self._begin_probe(block, time_ns)
                case _:
                    self._set_outputs(block, time_ns)
                    seconds = block.seconds if isinstance(block, Dwell) else 0.0
                    end_ns = time_ns + round(seconds * 1e9)
                    self._sender.until_ns = max(self._sender.until_ns, end_ns)
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
        before = self._outputs
        self._outputs = before.after(block, self._machine)
        if self._outputs != before:
            self._sender.idle_until(time_ns)
            self._sender.command(OUTPUTS, *self._outputs.bytes, line=block.line)

    def _end(self) -> None:
        """Play the rest of the stream, then switch spindle and coolant off."""
        self._sender.idle_until(self._sender.until_ns)
        self._outputs = self._outputs.off()
        self._sender.command(OUTPUTS, *self._outputs.bytes)
        self._supervisor.rest(self._sender.until_ns)
        self._supervisor.active = False

    def _begin_probe(self, block: Probe, time_ns: int) -> None:
        """Arm the input of a probing move: the probe, or a limit switch in a homing move."""
        supervisor, towards = self._supervisor, block.towards
        name, bit = "probe", PROBE
        if isinstance(block, SwitchMove):
            name, motors = "switch", self._motors.of_axis(block.switch)
            if block.motor is not None and len(motors) > 1:
                motors = [motors[block.motor]]
            bit = sum(1 << output for output in motors) & self._motors.limits
        supervisor.rest(time_ns)
        active = supervisor.ask().inputs & bit
        if active if towards else active != bit:
            state = "makes contact already" if towards else "makes no contact"
            hint = "move it off first" if towards else "G38.4 and G38.5 start in contact"
            message = f"the {name} {state}"
            raise supervisor.fail(
                board_error(f"{name}-contact", message, line=block.line, hint=hint)
            )
        self._sender.command(ARM, bit, 0 if towards else bit, line=block.line)
        supervisor.probing = True

    def _end_probe(self) -> tuple[float, ...]:
        """Wait for the end of a probing move, and continue from its position."""
        supervisor, sender = self._supervisor, self._sender
        sender.send_gathered()
        supervisor.rest(sender.until_ns)
        touched = sender.cut
        if touched:
            supervisor.request(Kind.CLEAR, b"")
        else:
            sender.command(ARM, 0, 0)
            supervisor.rest(sender.until_ns)
        status = supervisor.ask()
        supervisor.probing = False
        self._checks.stand_at(supervisor.take_position(status))
        supervisor.stopped_short = False
        sender.begin_after(status)
        return (float(touched), *self._position.mm(sender.position))

    def _keep_alive(self) -> None:
        """Exchange bytes between calls: the board stops after a quarter of a second of silence."""
        while not self._closed.wait(2 * STATUS_PERIOD_S):
            with self._lock:
                if not self._closed.is_set():
                    self._supervisor.pump_in_background()


def _capabilities(machine: Machine, spacing_ns: int) -> Capabilities:
    return Capabilities(
        len(machine.axes),
        1e9 / spacing_ns,
        500.0,
        pulses=True,
        lines=False,
        senses=False,
        probes=True,
        slice_s=PIECE_S,
        actions=actions(MotorOutputs(machine).count),
    )
