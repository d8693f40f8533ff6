"""The Klipper board: a microcontroller with Klipper's firmware, which plays queued steps.

:mod:`cnc.boards.klipper.sender` sends the motion, :mod:`cnc.boards.klipper.supervisor` checks the
messages of the board. This module implements the protocols of all boards
(:mod:`cnc.boards.protocols`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.accelerometer import Adxl345
from cnc.boards.klipper.connection import BAUD, USUAL_DRIFT, Reopen
from cnc.boards.klipper.feasibility import KlipperFeasibility, firmware_of, profile_of
from cnc.boards.klipper.guards import ArmedInput, TooLate
from cnc.boards.klipper.layout import InputObject, LayoutBuilder, section
from cnc.boards.klipper.outputs import AHEAD_S, actions
from cnc.boards.klipper.sender import JOG, PIECE_S, RUN, ramp_seconds
from cnc.boards.klipper.supervisor import RELEASE, Supervisor
from cnc.boards.port import Clock, Port, SystemClock
from cnc.boards.protocols import Capabilities, board_error
from cnc.boards.pulse_board import OutputState, PulseBoard, port_name
from cnc.boards.serial_port import identity as port_identity
from cnc.boards.serial_port import open_port
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell, Probe, Spindle, SwitchMove
from cnc.model.diagnostics import Diagnostic
from cnc.model.streams import PulseChunk

BACKGROUND_S = 0.01
"""Time between two exchanges of bytes between calls."""
STOP_LATENCY = 0.16
"""Motion that the board has taken in a jog when a hold is planned, with its ramp's reserve, s."""


class Klipper(PulseBoard):
    """A board on an open port; :meth:`from_machine` opens one.

    Args:
        port: The port.
        machine: The machine, with the table [board.klipper].
        name: Name of the port, for messages.
        clock: Clock of the port.
        background: Exchange bytes between calls in a thread, so that the board is not alone.
        identity: Identity under which the position is kept for the next program; "" for none.
        reopen: Opens the port again after a reset of the board; None if the port outlives it.

    Raises:
        BoardError: No Klipper board answers, or it refuses its configuration.
        MachineFileError: The board lacks a pin of the machine file.
    """

    def __init__(
        self,
        port: Port,
        machine: Machine,
        name: str = "the port",
        *,
        clock: Clock | None = None,
        background: bool = False,
        identity: str = "",
        reopen: Reopen | None = None,
    ) -> None:
        clock = clock or SystemClock()
        self._supervisor = Supervisor(port, machine, name, clock, identity, reopen)
        super().__init__(machine, self._supervisor)
        self._sender = self._supervisor.sender
        self._position = self._supervisor.position
        if self._supervisor.accelerometer is not None:
            self._supervisor.accelerometer.lock = self._lock
        axes = len(machine.axes)
        self._next = np.ones(axes, np.bool_), np.ones(axes, np.bool_)
        self._next_jog: float | None = None
        if background:
            self.run_in_background(BACKGROUND_S)

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> Klipper:
        """Open the board on the port ``target``, else on that of the machine file."""
        section(machine)
        name = port_name(machine, target, "Klipper")
        ports: list[Port] = []

        def opened() -> Port:
            ports.append(open_port(name, baud_of(machine)))
            return ports[-1]

        try:
            port = opened()
            return cls(
                port,
                machine,
                name,
                background=True,
                identity=port_identity(name),
                reopen=opened,
            )
        except BaseException:
            for port in ports:
                port.close()
            raise

    def unlike(self, machine: Machine) -> list[Diagnostic]:
        """Return warnings: of a clock far from its rate, and of a damaged file of positions."""
        clock, warnings = self._supervisor.connection.board_clock, self._supervisor.warnings
        if abs(clock.drift) < USUAL_DRIFT:
            return warnings
        pace = "fast" if clock.drift > 0.0 else "slow"
        message = (
            f"the clock of the board runs {100.0 * abs(clock.drift):.1f} % too {pace}, "
            "and so does the motion: its speeds differ from the plan's by as much"
        )
        hint = "build the firmware for the crystal of the board, or use a board with a crystal"
        drift = Diagnostic("board-clock-drift", message, hint=hint, severity="warning")
        return [*warnings, drift]

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
        profile = profile_of(self._machine, supervisor.connection.dictionary, supervisor.slots)
        return KlipperFeasibility(self._machine, profile)

    @classmethod
    def expected_feasibility_check(cls, machine: Machine) -> KlipperFeasibility:
        """Return a check for a board with the microcontroller of the machine file.

        Raises:
            MachineFileError: The machine file names a microcontroller that lacks one of its pins.
        """
        table = machine.board.klipper
        if table is not None and "mcu" in table.model_fields_set:
            LayoutBuilder(machine, firmware_of(machine).dictionary).build()
        return KlipperFeasibility(machine, profile_of(machine))

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis is closed, for the first axes that have one."""
        pressed: list[tuple[bool, ...]] = []
        supervisor = self._supervisor
        with self._lock:
            supervisor.refuse_after_fault()
            for column in range(len(self._machine.axes)):
                limits = supervisor.layout.limits(column)
                if not limits:
                    break
                pressed.append(tuple(self._is_pressed(limit) for limit in limits))
        return tuple(pressed)

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

    @property
    def accelerometer(self) -> Adxl345 | None:
        """The accelerometer that the machine file names; None without one."""
        return self._supervisor.accelerometer

    def prepare_jog(self, feed: float) -> None:
        """Send little ahead of the next motion alone; ``feed``: its highest speed, mm/s."""
        self._next_jog = feed

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Set the position of the machine to ``origin_steps``, and switch the motor drivers on."""
        supervisor = self._supervisor
        with self._lock:
            supervisor.refuse_after_fault()
            self._checks.start(origin_steps)
            watched, known = self._next
            axes = len(origin_steps)
            self._next = np.ones(axes, np.bool_), np.ones(axes, np.bool_)
            feed, self._next_jog = self._next_jog, None
            supervisor.guards.watched = set(np.flatnonzero(watched).tolist())
            supervisor.guards.armed = ()
            supervisor.select(self._next_alone)
            self._next_alone = None
            self._refuse_pressed(supervisor.guards.watched)
            supervisor.drivers.end_stalls()
            supervisor.drivers.check(supervisor.pump)
            self._position.set(supervisor.read_positions(), self._checks.position_steps)
            self._position.known = known
            supervisor.store(moving=True)
            self._sender.begin(self._checks.position_steps)
            if feed is None:
                self._sender.set_pace(RUN)
            else:
                self._sender.set_pace(JOG, ramp_seconds(self._machine, feed))
            supervisor.begin()
            self._began = True
            supervisor.set_outputs(OutputState(enabled=True, fan=True))
            supervisor.pump(0.0)

    def _gather(self, chunk: PulseChunk, points: NDArray[np.int64]) -> None:
        try:
            self._sender.gather(chunk, points)
        except TooLate:
            raise self._supervisor.too_late() from None

    def _flush(self) -> None:
        try:
            self._sender.flush()
        except TooLate:
            raise self._supervisor.too_late() from None

    def _rest(self, time_ns: int) -> None:
        self._supervisor.rest(time_ns)

    def _set_outputs(self, block: Block, time_ns: int) -> None:
        """Schedule the outputs of a block; a dwell passes by the board's clock."""
        supervisor, sender = self._supervisor, self._sender
        before = supervisor.outputs.state
        after = before.after(block, self._machine)
        seconds = block.seconds if isinstance(block, Dwell) else 0.0
        if after == before and not seconds:
            return
        with_motion = isinstance(block, Spindle) and block.with_motion
        if not with_motion:
            self._flush()  # The motion rests at such a block.
        if after != before:
            if sender.running or with_motion or supervisor.outputs.waits:
                supervisor.outputs.set_in_motion(after, time_ns)
            else:
                supervisor.set_outputs(after)
            supervisor.pump(0.0)
        if sender.running:
            sender.until_ns = max(sender.until_ns, time_ns + round(seconds * 1e9))
        elif seconds:
            supervisor.set_outputs(after)
            supervisor.connection.wait(seconds + AHEAD_S, supervisor.pump)

    def _end(self) -> None:
        """Play the rest of the motion, then switch spindle, coolant and fan off."""
        supervisor = self._supervisor
        supervisor.rest(self._sender.until_ns)
        supervisor.set_outputs(supervisor.outputs.state.off())
        supervisor.connection.flush(supervisor.pump)
        supervisor.active = False
        supervisor.store(moving=False)

    def _is_pressed(self, switch: InputObject) -> bool:
        supervisor = self._supervisor
        return supervisor.guards.is_pressed(switch, supervisor.pump)

    def _refuse_pressed(self, watched: set[int]) -> None:
        """Raise a fault if the e-stop or a limit switch that is watched is pressed."""
        supervisor = self._supervisor
        stop = supervisor.layout.input("e-stop")
        if stop is not None and self._is_pressed(stop):
            raise board_error("board-emergency-stop", "the e-stop is pressed", hint=RELEASE)
        pressed = [
            self._position.letter(switch.column)
            for switch in supervisor.layout.inputs
            if switch.column in watched and switch.column >= 0 and self._is_pressed(switch)
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
        inputs: list[InputObject]
        if isinstance(block, SwitchMove):
            name, inputs = "switch", supervisor.layout.limits(block.switch)
            if block.motor is not None and len(inputs) > 1:
                inputs = [inputs[block.motor]]
        else:
            probe = supervisor.layout.input("probe")
            name, inputs = "probe", [] if probe is None else [probe]
        if not inputs:
            hint = "name its pin in the machine file: board.klipper.probe"
            message = f"the board has no {name}"
            raise supervisor.fail(
                board_error("board-senseless", message, line=block.line, hint=hint)
            )
        supervisor.rest(time_ns)
        if any(self._is_pressed(switch) == towards for switch in inputs):
            state = "makes contact already" if towards else "makes no contact"
            hint = "move it off first" if towards else "G38.4 and G38.5 start in contact"
            message = f"the {name} {state}"
            raise supervisor.fail(
                board_error(f"{name}-contact", message, line=block.line, hint=hint)
            )
        if isinstance(block, SwitchMove):
            scale = float(self._machine.steps_per_mm[block.switch])
            supervisor.drivers.begin_stalls(block.switch, block.feed * scale)
        supervisor.guards.armed = tuple(
            ArmedInput(switch, switch.active if towards else 1 - switch.active) for switch in inputs
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
        supervisor.drivers.end_stalls()
        self._checks.stand_at(point)
        supervisor.stopped_short = False
        sender.stand_at(point)
        return (float(touched), *self._position.mm(point))


def baud_of(machine: Machine) -> int:
    """Return the speed of the machine file, else that of the firmware, bits/s."""
    return machine.board.baud if "baud" in machine.board.model_fields_set else BAUD


def _capabilities(machine: Machine, tick_ns: float) -> Capabilities:
    table = machine.board.klipper
    return Capabilities(
        len(machine.axes),
        machine.board.max_step_rate,
        tick_ns,
        senses=False,
        stop_latency_s=STOP_LATENCY,
        probes=table is not None and table.probe is not None,
        slice_s=PIECE_S / 2,
        actions=actions(table),
        separate_axes=True,
        limit_switches=True,
        kernels=("step runs",),
    )
