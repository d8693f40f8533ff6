"""A machine as a session operates it, behind a board for lines or for pulses.

Readings, jogs, offsets; and the boards for an operator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import LineOperation, LineSink, PulseSink, board_error
from cnc.boards.registry import open_board
from cnc.gcode.reader.parameters import read_parameters, write_parameters
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.operate.events import MachineState
from cnc.operate.jogging import REST_TIME, JogMove, jog
from cnc.planner.joints import Joints
from cnc.session import homing
from cnc.session.homing import homed_steps
from cnc.session.kernel_cache import load_kernels
from cnc.session.kernel_needs import moving_jobs
from cnc.session.position_check import (
    CHANGED,
    PositionCheck,
    named_offsets,
    recall_shift,
    record_shift,
    write_offsets,
)
from cnc.session.program_reader import start_position
from cnc.session.run_pulses import Progress

STATE_PERIOD = 0.1
"""Time between two states, s."""


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings of a machine.

    Attributes:
        position: Machine position by axis, mm.
        state: Its state.
        homed: Whether each axis is homed; empty for a machine without homing.
        feed: mm/min; None if it is not reported.
        spindle: rev/min; None if it is not reported.
        inputs: Active inputs by name.
        overrides: Of feed, traverses and spindle, per cent; None if not reported.
    """

    position: dict[str, float] = field(default_factory=dict)
    state: MachineState = "idle"
    homed: dict[str, bool] = field(default_factory=dict)
    feed: float | None = None
    spindle: float | None = None
    inputs: dict[str, bool] = field(default_factory=dict)
    overrides: tuple[float, float, float] | None = None


# A machine behind a board that takes lines, or pulses. Both have the same methods and attributes:
#
#     board          the board
#     machine        the machine, with the travel of the board
#     rest           time that a stop of a jog may take itself, s
#     pause          time until the worker looks for a next task after a poll, s
#     under          the same motors with another compensation
#     stops_outputs  whether spindle and coolant stop at the end of a program without M5 and M9
#
# All methods may raise BoardError.

NEVER = 2**31 - 1
"""A line that no run reaches."""


class LineMachine:
    """A machine behind a board that takes lines.

    Args:
        board: The board.
        operation: Its operation at rest.
        machine: The machine.
    """

    stops_outputs = False
    # The board has been waited for already.
    pause = 0.001

    def __init__(self, board: LineSink, operation: LineOperation, machine: Machine) -> None:
        self.board, self._operation = board, operation
        operation.begin()
        self.machine = board.limited_to_board(machine)
        recall_shift(board, self.machine)
        self._homed = operation.homed
        self.rest = REST_TIME - board.capabilities.stop_latency_s

    def under(self, machine: Machine) -> LineMachine:
        """Return itself: the board knows no compensation, so positions are the same."""
        return self

    def readings(self) -> Readings:
        """Return what the last report of the board says."""
        board, report = self.board, self.board.report
        position = dict(zip(map(str, self.machine.axes), board.position, strict=False))
        if report is None:
            return Readings(position)
        homed = {str(letter): self._homed for letter in self.machine.axes}
        return Readings(
            position,
            report.condition,
            homed if self._operation.homes else {},
            report.feed,
            report.spindle,
            dict(report.inputs),
            report.overrides,
        )

    def of_progress(self, progress: Progress) -> Readings:
        """Return the same during a run."""
        return self.readings()

    def poll(self) -> None:
        """Ask for the status; BoardError for an alarm or a restart."""
        try:
            self._operation.poll()
        except BoardError as error:
            if error.diagnostic.code in ("board-alarm", "board-restarted"):
                self._homed = False
            raise

    def home(self, axes: Sequence[str], control: Control) -> None:
        """Let the board home all axes."""
        self._homed = False
        homing.home_and_record(self.board, self.machine, axes, control)
        self._homed = True
        self._operation.refresh()

    def jog(self, move: JogMove, control: Control, on_report: Callable[[Readings], None]) -> None:
        """Jog by ``$J=``; record the position for the next run."""
        board = self.board
        check = PositionCheck(board, self.machine, None, trusted=False)
        if check.doubtful:
            check.lost_until(NEVER)
        check.begin()
        ended = "broken off"
        try:
            self._operation.jog(
                move.start,
                move.end,
                move.feed,
                lambda: control.held or control.stopped,
                lambda: on_report(self.readings()),
            )
            ended = "stopped"
        except BoardError as error:
            ended = error.diagnostic.code
            raise
        finally:
            check.end(ended, None)

    def offsets(self) -> dict[str, dict[str, float]]:
        """Return the offsets that the board keeps, as read now."""
        self._operation.read_offsets()
        return {
            name: place
            for name, place in named_offsets(self.board, self.machine).items()
            if name not in ("G28", "G30")
        }

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Set an offset on the board, and read it back."""
        self._operation.set_work_position(system, values)
        if self.board.identity is not None:
            write_offsets(self.board.identity, named_offsets(self.board, self.machine))
            if system == "G92":
                record_shift(self.board, self.machine)

    def keep_shift(self, parameters: Mapping[int, float]) -> None:
        """Set the shift of G92 on the board, if it is another one now."""
        kept = named_offsets(self.board, self.machine)
        in_effect = parameters.get(numbers.SHIFT_IN_EFFECT) == 1.0
        wanted = {
            letter: in_effect * parameters.get(numbers.SHIFT + AXIS_LETTERS.index(letter), 0.0)
            for letter in self.machine.axes
        }
        changed = [axis for axis in wanted if abs(wanted[axis] - kept["G92"][axis]) > CHANGED]
        place = self.readings().position
        if changed:
            self.set_work_position(
                "G92", {axis: place[axis] - kept["G54"][axis] - wanted[axis] for axis in changed}
            )

    def revive(self) -> None:
        """Read the offsets again; the board accepts the next program."""
        self._operation.revive()

    def unlock(self, *, at_switch: bool) -> None:
        """Send ``$X``; a position that an alarm has lost stays lost."""
        self._operation.unlock(at_switch=at_switch)

    def for_jogs(self) -> Machine:
        """Return the machine with the rates and accelerations of the board, for jogs."""
        return self._operation.limits_for_jogs(self.machine)


Floats = NDArray[np.float64]


class PulseMachine:
    """A machine behind a board that plays pulses."""

    stops_outputs = True
    pause = STATE_PERIOD

    def __init__(self, board: PulseSink, machine: Machine) -> None:
        self.board, self.machine = board, machine
        self._joints = Joints(machine)
        self._start = start_position(machine)
        self.rest = REST_TIME - board.capabilities.stop_latency_s

    def under(self, machine: Machine) -> PulseMachine:
        """Return the machine with another compensation, its motors where they stand."""
        other = PulseMachine(self.board, machine)
        other._start = other._joints.tip(self._joints.at(self._start))
        return other

    def readings(self) -> Readings:
        """Return the position of the board at rest, and its switches."""
        board, machine = self.board, self.machine
        inputs: dict[str, bool] = {}
        homed: dict[str, bool] = {}
        if board.capabilities.limit_switches:
            names = tuple(self._joints.machine.axes)
            inputs = {
                f"limit {name}": shut for name, shut in zip(names, board.switches, strict=False)
            }
            certain = [steps is not None for steps in board.known_steps or ()]
            homed = dict(zip(map(str, machine.axes), certain, strict=False))
            if machine.kinematics.joints:
                homed = {letter: all(certain) for letter in homed}
        return Readings(
            self._by_axis(self.tip()), "idle", homed if machine.can_home else {}, None, None, inputs
        )

    def of_progress(self, progress: Progress) -> Readings:
        """Return the position that the board plays now."""
        tip = self.tip() if progress.position is None else np.array(progress.position)
        return Readings(self._by_axis(tip), "held" if progress.held else "running")

    def poll(self) -> None:
        """Raise a fault that the board has reported in the background."""
        self.board.switches  # noqa: B018 - it asks for a status, and raises faults

    def home(self, axes: Sequence[str], control: Control) -> None:
        """Home axes one after the other on their switches."""
        homing.home(self.board, self.machine, axes, self._start, control=control)

    def jog(self, move: JogMove, control: Control, on_report: Callable[[Readings], None]) -> None:
        """Jog by a plan that a hold ends."""
        start = self.tip()
        end = start.copy()
        for column, letter in enumerate(self.machine.axes):
            if letter in move.end:
                end[column] = move.end[letter]
        jog(
            self.board,
            self.machine,
            start,
            end,
            move.feed,
            control=control,
            on_progress=lambda progress: on_report(self.of_progress(progress)),
        )
        # The next jog of an axis that is not homed begins where this one ended.
        self._start = self._joints.tip(
            self.board.position_steps / self._joints.machine.steps_per_mm
        )

    def tip(self) -> Floats:
        """Return the position of the axes (axes,), mm."""
        board = self.board
        counted: Sequence[int | None] | None = board.known_steps
        if counted is None:
            counted = board.position_steps.tolist()
        steps = homed_steps(self.machine, (), counted, self._start)
        return self._joints.tip(steps / self._joints.machine.steps_per_mm)

    def offsets(self) -> dict[str, dict[str, float]]:
        """Return the offsets of the parameter file."""
        values = self._values()
        columns = {letter: AXIS_LETTERS.index(letter) for letter in self.machine.axes}
        offsets = {
            name: {
                str(letter): values.get(numbers.origin(system) + column, 0.0)
                for letter, column in columns.items()
            }
            for system, name in enumerate(numbers.SYSTEMS)
        }
        in_effect = values.get(numbers.SHIFT_IN_EFFECT, 0.0) == 1.0
        offsets["G92"] = {
            str(letter): values.get(numbers.SHIFT + column, 0.0) if in_effect else 0.0
            for letter, column in columns.items()
        }
        return offsets

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Write an offset to the parameter file, and read it back.

        Raises:
            UsageError: ``no-parameter-file``, ``no-such-system``.
        """
        file = self._parameter_file()
        stored, offsets, here = self._values(), self.offsets(), self._by_axis(self.tip())
        if system not in offsets:
            hint = f"systems are {', '.join(numbers.SYSTEMS)} and G92"
            raise UsageError(
                Diagnostic("no-such-system", f"there is no coordinate system {system}", hint=hint)
            )
        base = "G54" if system == "G92" else system
        first = numbers.origin(numbers.SYSTEMS.index(base))
        wanted = dict(stored)
        for letter, value in values.items():
            column = AXIS_LETTERS.index(letter)
            if system == "G92":
                wanted[numbers.SHIFT + column] = here[letter] - offsets["G54"][letter] - value
                wanted[numbers.SHIFT_IN_EFFECT] = 1.0
            else:
                wanted[first + column] = here[letter] - offsets["G92"][letter] - value
        write_parameters(file, wanted)
        if self._values() != wanted:
            message = f"the parameter file {file} does not have the offset that was written"
            raise UsageError(Diagnostic("offset-not-kept", message, hint="is the file writable?"))

    def keep_shift(self, parameters: Mapping[int, float]) -> None:
        """Do nothing: the parameter file has it."""

    def revive(self) -> None:
        """Make a board that was stopped ready for the next program."""
        self.board.revive()

    def unlock(self, *, at_switch: bool) -> None:
        """Refuse: such a board leaves an alarm by homing, or by a new connection."""
        raise board_error(
            "no-unlock",
            "this board has no command to unlock it",
            hint="home it, or connect it again",
        )

    def _by_axis(self, tip: Floats) -> dict[str, float]:
        return dict(zip(map(str, self.machine.axes), tip.tolist(), strict=True))

    def _values(self) -> dict[int, float]:
        file = self.machine.program.parameters
        return read_parameters(file) if file is not None and file.exists() else {}

    def _parameter_file(self) -> Path:
        file = self.machine.program.parameters
        if file is None:
            message = "the machine file names no parameter file, so an offset would be lost"
            hint = "write parameters = 'machine.var' under [program]"
            raise UsageError(Diagnostic("no-parameter-file", message, hint=hint))
        return file

    def for_jogs(self) -> Machine:
        """Return the machine with the step rates of the board."""
        machine = self.machine
        if machine.kinematics.joints:
            return machine
        rate, axes = self.board.capabilities.max_step_rate, dict(machine.axes)
        for letter, axis in axes.items():
            fastest = min(axis.max_velocity, rate / axis.steps_per_mm)
            axes[letter] = axis.model_copy(update={"max_velocity": fastest})
        return machine.model_copy(update={"axes": axes})


OperatedMachine = LineMachine | PulseMachine
"""A machine at rest, and its jogs."""

# Boards for an operator: simulated ones run in real time, because somebody watches them.


def open_live(machine: Machine, kind: str, port: str | None) -> PulseSink | LineSink:
    """Open a board for an operator.

    Raises:
        UsageError: ``no-operation`` for a board that writes a file, or as
            :func:`cnc.boards.registry.open_board`.
        BoardError: The board does not answer.
    """
    start = Joints(machine).at(start_position(machine)).tolist()
    return open_board(machine, kind=kind, port=port, start=start)


def operated(board: PulseSink | LineSink, machine: Machine) -> OperatedMachine:
    """Return the machine behind a board.

    Raises:
        UsageError: ``no-operation`` for a board that takes lines and only runs programs.
    """
    if board.takes == "pulses":
        # The first jog would load them while the board plays its beginning.
        load_kernels(moving_jobs(board, machine))
        return PulseMachine(board, machine)
    operation = board.operation
    if operation is None:
        message, hint = "this board cannot be operated", "run programs on it with cncrun PROGRAM"
        raise UsageError(Diagnostic("no-operation", message, hint=hint))
    return LineMachine(board, operation, machine)
