"""A machine behind a board that plays pulses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.boards.errors import board_error
from cnc.boards.protocols import PulseSink
from cnc.executor import homing
from cnc.executor.homing_cycles import homed_steps
from cnc.executor.jog import jog
from cnc.executor.run import Progress
from cnc.gcode.syntax.parameter_file import read_parameters, write_parameters
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.operate.jogging import REST_TIME, JogMove
from cnc.operate.machines import STATE_PERIOD, Readings
from cnc.planner.joints import Joints
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.kernel_needs import moving_jobs
from cnc.session.program_reader import start_position

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
            known = [steps is not None for steps in board.known_steps or ()]
            homed = dict(zip(map(str, machine.axes), known, strict=False))
            if machine.kinematics.joints:
                homed = {letter: all(known) for letter in homed}
        return Readings(
            self._by_axis(self.tip()), "idle", homed if machine.can_home else {}, None, None, inputs
        )

    def of_progress(self, progress: Progress) -> Readings:
        """Return the position that the board plays now."""
        if progress.position is None:
            return Readings(self._by_axis(self.tip()), "held" if progress.held else "running")
        tip = self._joints.tip(np.array(progress.position))
        return Readings(self._by_axis(tip), "held" if progress.held else "running")

    def poll(self) -> None:
        """Raise a fault that the board has reported in the background."""
        self.board.switches  # noqa: B018 - it asks for a status, and raises faults

    def home(self, axes: Sequence[str], control: Control) -> None:
        """Home axes one after the other on their switches."""
        self._compile()
        homing.home(self.board, self.machine, axes, self._start, control=control)

    def jog(self, move: JogMove, control: Control, on_report: Callable[[Readings], None]) -> None:
        """Jog by a plan that a hold ends."""
        self._compile()
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
        known: Sequence[int | None] | None = board.known_steps
        if known is None:
            known = board.position_steps.tolist()
        steps = homed_steps(self.machine, (), known, self._start)
        return self._joints.tip(steps / self._joints.machine.steps_per_mm)

    def offsets(self) -> dict[str, dict[str, float]]:
        """Return the offsets of the parameter file."""
        values = self._values()
        columns = {letter: AXIS_LETTERS.index(letter) for letter in self.machine.axes}
        found = {
            name: {
                str(letter): values.get(numbers.origin(system) + column, 0.0)
                for letter, column in columns.items()
            }
            for system, name in enumerate(numbers.SYSTEMS)
        }
        in_effect = values.get(numbers.SHIFT_IN_EFFECT, 0.0) == 1.0
        found["G92"] = {
            str(letter): values.get(numbers.SHIFT + column, 0.0) if in_effect else 0.0
            for letter, column in columns.items()
        }
        return found

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Write an offset to the parameter file, and read it back.

        Raises:
            UsageError: ``no-parameter-file``, ``no-such-system``, ``system-rotated``.
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
        if stored.get(first + numbers.ROTATION):
            message = f"{base} is rotated, so that its axes are not those of the machine"
            hint = "set its zero in a program, or remove the rotation: G10 L2 P1 R0"
            raise UsageError(Diagnostic("system-rotated", message, hint=hint))
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

    def _compile(self) -> None:
        ensure_compiled(None, None, moving_jobs(self.board))

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
