"""The stepper board: an Arduino with the firmware in ``firmware/``, which plays grid moves.

:mod:`cnc.boards.stepper.sender` sends the moves, :mod:`cnc.boards.stepper.protocol` has the frames,
and :mod:`cnc.boards.stepper.supervisor` checks the reports of the board. This module implements the
protocols of all boards (:mod:`cnc.boards.protocols`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.port import Clock, Port, SystemClock
from cnc.boards.protocols import Capabilities, board_error
from cnc.boards.pulse_board import OutputState, PulseBoard, port_name
from cnc.boards.serial_port import open_port
from cnc.boards.stepper.connection import (
    PROBE,
    STATUS_PERIOD_S,
    UNO,
)
from cnc.boards.stepper.feasibility import StepperFeasibility
from cnc.boards.stepper.outputs import MotorOutputs, actions, output_bytes
from cnc.boards.stepper.protocol import Kind
from cnc.boards.stepper.segments import ARM, OUTPUTS
from cnc.boards.stepper.sender import PIECE_S
from cnc.boards.stepper.supervisor import (
    Supervisor,
    baud_of,
    clear_alarm,
    configure,
    incompatibilities,
    min_spacing_ns,
)
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell, Probe, SwitchMove
from cnc.model.diagnostics import MotionLimitError
from cnc.model.streams import PulseChunk

STOP_LATENCY = 0.14
"""Motion that the board has taken when a hold is planned, s."""


class Stepper(PulseBoard):
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

    def __init__(
        self,
        port: Port,
        machine: Machine,
        name: str = "the port",
        *,
        clock: Clock | None = None,
        background: bool = False,
    ) -> None:
        self._supervisor = Supervisor(port, machine, name, clock or SystemClock())
        super().__init__(machine, self._supervisor)
        self._outputs = OutputState()
        self._sender = self._supervisor.sender
        self._position = self._supervisor.position
        self._motors = self._position.outputs
        self._next = self._motors.limits, np.ones(len(machine.axes), np.bool_)
        if background:
            self.run_in_background(2 * STATUS_PERIOD_S)

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Stepper:
        """Open the board on the port ``target``, else on that of the machine file."""
        name = port_name(machine, target, "stepper")
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
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis is closed; a fourth axis has none."""
        with self._lock:
            self._supervisor.refuse_after_fault()
            inputs = self._supervisor.ask().inputs
        limits = self._motors.limits
        pressed = (
            tuple(bool(inputs >> k & 1) for k in self._motors.of_axis(column) if limits >> k & 1)
            for column in range(len(self._machine.axes))
        )
        return tuple(axis for axis in pressed if axis)

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Set conditions for the next start alone.

        Args:
            watched: Axes whose limit switches end the motion with an alarm.
            known: Axes whose position is that of the origin.
        """
        wanted = [*watched, *[True] * (len(self._machine.axes) - len(watched))]
        self._next = self._motors.bits(wanted), np.array(known, np.bool_)

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
            self._outputs = OutputState(enabled=True)
            supervisor.active = self._began = True
            self._sender.command(OUTPUTS, *output_bytes(self._outputs))

    def _gather(self, chunk: PulseChunk, points: NDArray[np.int64]) -> None:
        outputs = self._motors.expanded(chunk.step)
        self._sender.gather(PulseChunk(chunk.time_ns, outputs, chunk.line), points)

    def _flush(self) -> None:
        self._sender.send_gathered()

    def _rest(self, time_ns: int) -> None:
        self._supervisor.rest(time_ns)

    def _set_outputs(self, block: Block, time_ns: int) -> None:
        before = self._outputs
        self._sender.send_gathered()
        self._outputs = before.after(block, self._machine)
        if self._outputs != before:
            self._sender.idle_until(time_ns)
            self._sender.command(OUTPUTS, *output_bytes(self._outputs), line=block.line)
        seconds = block.seconds if isinstance(block, Dwell) else 0.0
        end_ns = time_ns + round(seconds * 1e9)
        self._sender.until_ns = max(self._sender.until_ns, end_ns)

    def _end(self) -> None:
        """Play the rest of the stream, then switch spindle and coolant off."""
        self._sender.idle_until(self._sender.until_ns)
        self._outputs = self._outputs.off()
        self._sender.command(OUTPUTS, *output_bytes(self._outputs))
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


def _capabilities(machine: Machine, spacing_ns: int) -> Capabilities:
    return Capabilities(
        len(machine.axes),
        1e9 / spacing_ns,
        500.0,
        senses=False,
        stop_latency_s=STOP_LATENCY,
        probes=True,
        slice_s=PIECE_S,
        actions=actions(MotorOutputs(machine).count),
        limit_switches=True,
        kernels=("segments",),
    )
