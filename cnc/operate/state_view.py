"""The present state for the operator, from the readings of the machine and the progress of a run.

The worker writes it, and any thread reads it: each attribute is replaced as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from cnc.gcode.reader.parameters import read_parameters
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.parameter_numbers import SYSTEMS
from cnc.operate.events import Activity, MachineState, Overrides, State
from cnc.operate.machines import OperatedMachine, Readings
from cnc.session.run_pulses import Progress

MS_PER_S = 1000.0


class StateView:
    """The present state.

    Attributes:
        board: Name of the board; "" without one.
        readings: The last readings.
        offsets: Offsets by name and axis, mm.
        rotations: Rotations of the systems that are turned, degrees.
        system: Coordinate system of the work position.
        modes: Modes that the next entered line begins with.
        paused: The question of the pause at which the operator uses the machine; "" for none.
    """

    def __init__(self, machine: Machine) -> None:
        self.board = ""
        self.readings = Readings()
        self.offsets: dict[str, dict[str, float]] = {}
        self.rotations: dict[str, float] = {}
        self._machine = machine
        self._program = ""
        self._progress: Progress | None = None
        self.system, self.modes, self.paused = "G54", "", ""

    def connected(self, board: str, machine: OperatedMachine) -> None:
        """Show a board."""
        self.board = board
        self.read(machine)

    def disconnected(self) -> None:
        """Show no board."""
        self.board, self.readings, self.offsets, self.rotations = "", Readings(), {}, {}

    def read(self, machine: OperatedMachine) -> None:
        """Take the readings of a machine at rest."""
        self.readings = machine.readings()

    def take(self, readings: Readings) -> None:
        """Take readings in motion."""
        homed, inputs = self.readings.homed, self.readings.inputs
        if not readings.homed:
            readings.homed.update(homed)
        if not readings.inputs:
            readings.inputs.update(inputs)
        self.readings = readings

    def begin(self, program: str) -> tuple[str, Progress | None]:
        """Show a program; return what was shown before, for :meth:`end`."""
        before = self._program, self._progress
        self._program, self._progress = program, None
        return before

    def end(self, before: tuple[str, Progress | None]) -> None:
        """Show what was shown before a program."""
        self._program, self._progress = before

    def progress(self, progress: Progress, readings: Readings) -> None:
        """Show the progress of a program."""
        self._progress = progress
        self.take(readings)

    def select(self, system: str) -> None:
        """Choose the coordinate system of the work position. UsageError ``no-such-system``."""
        _refuse_unknown(system)
        self.system = system

    def work_position(self, system: str) -> dict[str, float]:
        """Return the position by axis in a coordinate system, mm; G92 belongs to G54."""
        named = "G54" if system == "G92" else system
        zero = work_zero(self.offsets, named, self.rotations)
        distance = {
            letter: place - zero.get(letter, 0.0)
            for letter, place in self.readings.position.items()
        }
        return turned(distance, -self.rotations.get(named, 0.0))

    def state(self, activity: Activity, overrides: Control) -> State:
        """Return the state."""
        if not self.board:
            return State(activity=activity)
        readings, progress = self.readings, self._progress
        machine = None if progress is None else progress.machine
        reported = readings.overrides
        chosen = Overrides(
            feed=overrides.feed_override,
            rapid=float(overrides.rapid_override),
            spindle=overrides.spindle_override,
        )
        if reported is not None:
            chosen = Overrides(feed=reported[0], rapid=reported[1], spindle=reported[2])
        state = State(
            board=self.board,
            state="held"
            if self.paused and activity in ("program", "measure")
            else _state(readings.state, activity),
            activity=activity,
            machine=readings.position,
            work=self.work_position(self.system),
            system=self.system,
            zero=work_zero(self.offsets, self.system, self.rotations),
            rotation=self.rotations.get(self.system, 0.0),
            homed=readings.homed,
            feed=readings.feed,
            spindle=readings.spindle,
            overrides=chosen,
            inputs=readings.inputs,
            program=self._program,
            held=self.paused,
            modes=self.modes,
        )
        if progress is None:
            return state
        ahead = progress.ahead
        buffered = progress.buffered if ahead is None else round(ahead * MS_PER_S)
        return replace(
            state,
            feed=state.feed if machine is None or machine.feed is None else machine.feed,
            tool=progress.tool,
            # As in the text: what the board plays, not what it has taken.
            line=progress.at or progress.line,
            text=progress.text,
            run_time=progress.time - (ahead or 0.0),
            left=progress.left,
            buffered=buffered,
            pending=progress.pending,
            held=self.paused or progress.hold_reason or ("hold request" if progress.held else ""),
        )


def turned(values: Mapping[str, float], degrees: float) -> dict[str, float]:
    """Return lengths by axis with X and Y turned about Z, counter-clockwise."""
    if not degrees or not {"x", "y"} <= set(values):
        return dict(values)
    angle, x, y = math.radians(degrees), values["x"], values["y"]
    return dict(values) | {
        "x": x * math.cos(angle) - y * math.sin(angle),
        "y": x * math.sin(angle) + y * math.cos(angle),
    }


def stored_rotations(machine: Machine) -> dict[str, float]:
    """Return the rotations other than 0 of the coordinate systems, degrees, by name.

    Boards keep offsets, but no rotations: these are in the parameter file alone.
    """
    file = machine.program.parameters
    values = read_parameters(file) if file is not None and file.exists() else {}
    stored = {
        name: values.get(numbers.origin(k) + numbers.ROTATION, 0.0)
        for k, name in enumerate(SYSTEMS)
    }
    return {name: angle for name, angle in stored.items() if angle}


def refuse_turned(system: str, rotations: Mapping[str, float], what: str) -> None:
    """Refuse what is only right along the axes. UsageError ``system-rotated``."""
    if angle := rotations.get("G54" if system == "G92" else system, 0.0):
        message = f"{system} is turned by {angle:g} degrees: {what}"
        hint = "choose another coordinate system, or remove the rotation: G10 L2 P1 R0 for G54"
        raise UsageError(Diagnostic("system-rotated", message, hint=hint))


def work_zero(
    offsets: Mapping[str, Mapping[str, float]],
    system: str,
    rotations: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, float]:
    """Return the machine position of the zero of a system by axis, mm; empty without offsets.

    Args:
        offsets: Offsets by name and axis, mm.
        system: G54 to G59.3.
        rotations: Rotations by name, degrees: the shift of G92 turns with the system.

    Raises:
        UsageError: ``no-such-system``.
    """
    _refuse_unknown(system)
    origin = offsets.get(system, {})
    shift = turned(offsets.get("G92", {}), rotations.get(system, 0.0))
    return {letter: value + shift.get(letter, 0.0) for letter, value in origin.items()}


def _refuse_unknown(system: str) -> None:
    if system not in SYSTEMS:
        hint = f"systems are {', '.join(SYSTEMS)}"
        message = f"there is no coordinate system {system}"
        raise UsageError(Diagnostic("no-such-system", message, hint=hint))


def _state(reported: MachineState, activity: Activity) -> MachineState:
    """Return the state by the board, and by the activity where a board at rest says nothing."""
    if reported not in ("idle", "running"):
        return reported
    if activity == "jog":
        return "jogging"
    if activity == "home":
        return "homing"
    return "running" if activity in ("program", "mdi", "probe") else reported
