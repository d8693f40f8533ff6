"""Execution of the steps of cycles: machine positions and blocks.

G64 is suspended during a cycle: holes and threads need the exact path.
"""

from __future__ import annotations

from collections.abc import Iterable

from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.codes.tip_control import refuse_under_tip_control
from cnc.gcode.cycles.steps import (
    Cut,
    OperatorStop,
    OrientSpindle,
    Pause,
    Point,
    Rapid,
    SetOverrides,
    Step,
    Synchronise,
    TurnSpindle,
)
from cnc.gcode.state.modal_groups import ModalState
from cnc.gcode.syntax.words import AXES, LineWords, Word, fault
from cnc.kernels.gcode.holes import machine_coordinate
from cnc.kernels.jit import interpreted
from cnc.model.blocks import (
    PLANE_AXES,
    Block,
    Dwell,
    Orient,
    Overrides,
    PathMode,
    Plane,
    Spindle,
    SpindleSync,
    Stop,
)

_machine_coordinate = interpreted(machine_coordinate)


def refuse_modes(
    motion: Motion, state: ModalState, name: str, at: Word, *, inverse_time: bool = True
) -> None:
    """Check the modes in effect before a cycle.

    Args:
        motion: The moves, with their cutter compensation.
        state: The modal state.
        name: The code, for messages.
        at: Word at which errors are reported.
        inverse_time: Refuse G93.

    Raises:
        GcodeError: ``compensation-active``, ``inverse-time-active``, ``tip-control-active``.
    """
    refuse_under_tip_control(motion, at, name)
    if motion.compensated:
        raise fault(
            "compensation-active", f"{name} under cutter compensation", at, "give G40 before"
        )
    if inverse_time and state.feed_mode == "inverse-time":
        raise fault("inverse-time-active", f"{name} under G93", at, "give G94 or G95 before")


def refuse_axes(words: LineWords, name: str, allowed: str) -> None:
    """Raise GcodeError ``axis-not-allowed`` at an axis word that ``name`` does not use."""
    for letter in words.rest:
        if letter in AXES and letter not in allowed:
            raise fault(
                "axis-not-allowed",
                f"{name} does not move {letter}",
                words.rest[letter],
                f"its axes are {' '.join(allowed)}",
            )


class CyclePlane:
    """The plane in effect at the start of a line with a cycle, or another one.

    Attributes:
        across: Letter of the axis across the plane.
        columns: Columns of the plane's two axes and of the axis across it. None is an axis that the
            machine lacks; its coordinate is 0.
        start: The position as a point of the plane, mm in the coordinate system in use.
    """

    def __init__(self, motion: Motion, state: ModalState, plane: Plane | None = None) -> None:
        plane = plane or state.plane
        first, second = PLANE_AXES[plane]
        (across,) = {"x", "y", "z"} - {first, second}
        self.across = across.upper()
        self.columns = tuple(motion.column.get(axis.upper()) for axis in (first, second, across))
        self._plane = plane
        self._axes = (first, second, across)
        self._coordinates = motion.coordinates
        self._machine = motion.position
        self._program = motion.coordinates.to_program(motion.position)
        self.start = self.seen(self._program)

    def needs(self, axes: str, name: str, at: Word) -> None:
        """Raise GcodeError ``axis-missing`` if the machine lacks one of the axes (letters)."""
        for axis, column in zip(self._axes, self.columns, strict=True):
            if column is None and axis.upper() in axes:
                raise fault(
                    "axis-missing",
                    f"{name} in the {self._plane} plane needs the {axis.upper()} axis, "
                    "which the machine lacks",
                    at,
                )

    def seen(self, program: list[float]) -> Point:
        """Return a position in program coordinates as a point of the plane."""
        first, second, height = (
            0.0 if column is None else program[column] for column in self.columns
        )
        return first, second, height

    def in_plane(self, values: dict[int, float]) -> tuple[float | None, float | None]:
        """Return the values, by column, of the plane's two axes."""
        first, second = (
            None if column is None else values.get(column) for column in self.columns[:2]
        )
        return first, second

    def place(self, point: Point) -> list[float]:
        """Return the machine position of a point.

        Axes that do not leave the start keep their exact value.
        """
        place, coordinates = self._machine.copy(), self._coordinates
        if not coordinates.turned:
            for column, value, start in zip(self.columns, point, self.start, strict=True):
                if column is not None:
                    here, zero = place[column], coordinates.zero[column]
                    place[column] = _machine_coordinate(value, start, here, zero)
            return place
        program = self._program.copy()
        for column, value in zip(self.columns, point, strict=True):
            if column is not None:
                program[column] = value
        pairs = enumerate(zip(program, self._program, strict=True))
        placed = coordinates.to_machine(program)
        # Under a rotation either axis of the program moves both of the machine.
        for index in coordinates.coupled({index for index, (new, old) in pairs if new != old}):
            place[index] = placed[index]
        return place


class CycleRunner(MotionCodes):
    """Execution of steps: moves go to ``motion``, other blocks to ``out``."""

    def start_spindle(self) -> None:
        """Start the spindle as the modal state says."""
        state = self._state
        self._out.add(Spindle(self._here.file, self._here.line, state.spindle, state.speed or 0.0))

    def perform(self, steps: Iterable[Step], plane: CyclePlane) -> None:
        """Execute steps in order. The position is the end of the last one."""
        motion, out, file, line = self._motion, self._out, self._here.file, self._here.line
        blending = self._state.path == "blend"
        if blending:
            out.add(PathMode(file, line, "exact-path"))
        for step in steps:
            if isinstance(step, Rapid):
                motion.traverse(plane.place(step.to))
            elif isinstance(step, Cut):
                motion.feed_to(plane.place(step.to), step.feed)
            else:
                out.add(self._block(step))
        if blending:
            out.add(PathMode(file, line, "blend", self._state.tolerance))

    def _block(self, step: Step) -> Block:
        """The block of a step that is not a move."""
        file, line = self._here.file, self._here.line
        match step:
            case Pause(seconds):
                return Dwell(file, line, seconds)
            case TurnSpindle():
                return self._spindle(step)
            case OrientSpindle():
                return Orient(file, line, 0.0)
            case OperatorStop():
                return Stop(file, line)
            case SetOverrides():
                return self._overrides(step)
            case Synchronise(pitch):
                return SpindleSync(file, line, pitch)
        raise AssertionError(step)

    def _spindle(self, turn: TurnSpindle) -> Spindle:
        """The block of a step of the spindle. The modal state of the spindle stays."""
        state, file, line = self._state, self._here.file, self._here.line
        speed = state.speed or 0.0
        if turn.state == "off":
            return Spindle(file, line, "off", 0.0)
        if state.constant_surface:
            return Spindle(file, line, turn.state, state.most_rpm, speed)
        return Spindle(file, line, turn.state, speed * turn.times)

    def _overrides(self, step: SetOverrides) -> Overrides:
        """The overrides that the program allows, without those that the step disables."""
        state = self._state
        feed, spindle = state.feed_override, state.speed_override
        if not step.overrides:
            feed, spindle = False, spindle and not step.spindle
        return Overrides(
            self._here.file, self._here.line, feed, spindle, state.adaptive_feed, state.feed_stop
        )
