"""Steps of cycles to canonical blocks: points of a plane become machine positions, the spindle's
steps become blocks.

Holes and threads are made on the exact path: G64 rests meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterable

from cnc.gcode.codes.motion import Motion
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
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.modal_groups import ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.words import AXES, LineWords, Word, fault
from cnc.model.blocks import (
    PLANE_AXES,
    Dwell,
    Orient,
    Overrides,
    PathMode,
    Spindle,
    SpindleSync,
    Stop,
)


def refuse_modes(
    motion: Motion, state: ModalState, name: str, at: Word, *, inverse_time: bool = True
) -> None:
    """GcodeError where ``name`` can't be made: under cutter compensation, and under G93 if that is
    refused.
    """
    if motion.compensated:
        raise fault(
            "compensation-active", f"{name} under cutter compensation", at, "give G40 before"
        )
    if inverse_time and state.feed_mode == "inverse-time":
        raise fault("inverse-time-active", f"{name} under G93", at, "give G94 or G95 before")


def refuse_axes(words: LineWords, name: str, allowed: str) -> None:
    """GcodeError ``axis-not-allowed`` at an axis word that ``name`` has no use for."""
    for letter in words.rest:
        if letter in AXES and letter not in allowed:
            raise fault(
                "axis-not-allowed",
                f"{name} does not move {letter}",
                words.rest[letter],
                f"its axes are {' '.join(allowed)}",
            )


class CyclePlane:
    """The plane in effect, as a line with a cycle finds it.

    ``columns`` are those of the plane's two axes and of the axis across it, None for one that the
    machine lacks: it stands at 0. ``start`` is the position seen from there, mm in the coordinate
    system in use.
    """

    def __init__(self, motion: Motion, state: ModalState) -> None:
        first, second = PLANE_AXES[state.plane]
        (across,) = {"x", "y", "z"} - {first, second}
        self.across = across.upper()
        self.columns = tuple(motion.column.get(axis.upper()) for axis in (first, second, across))
        self._plane = state.plane
        self._axes = (first, second, across)
        self._coordinates = motion.coordinates
        self._machine = motion.position
        self._turning = [index for index, axis in enumerate(motion.axes) if axis in "xy"]
        self._program = motion.coordinates.to_program(motion.position)
        self.start = self.seen(self._program)

    def needs(self, axes: str, name: str, at: Word) -> None:
        """GcodeError ``axis-missing`` where the machine lacks one of the axes (their letters) that
        ``name`` moves whatever its words.
        """
        for axis, column in zip(self._axes, self.columns, strict=True):
            if column is None and axis.upper() in axes:
                raise fault(
                    "axis-missing",
                    f"{name} in the {self._plane} plane, but the machine has no {axis.upper()} axis",
                    at,
                )

    def seen(self, program: list[float]) -> Point:
        """A position in program coordinates as a point of the plane."""
        first, second, height = (
            0.0 if column is None else program[column] for column in self.columns
        )
        return first, second, height

    def in_plane(self, values: dict[int, float]) -> tuple[float | None, float | None]:
        """What axis values (by column) say of the plane's two axes."""
        first, second = (
            None if column is None else values.get(column) for column in self.columns[:2]
        )
        return first, second

    def place(self, point: Point) -> list[float]:
        """The machine position of a point. Axes that don't leave the start stay there to the
        bit.
        """
        program = self._program.copy()
        for column, value in zip(self.columns, point, strict=True):
            if column is not None:
                program[column] = value
        placed = self._coordinates.to_machine(program)
        stays = [new == old for new, old in zip(program, self._program, strict=True)]
        if self._coordinates.rotation:
            # X and Y of the machine move if either of the program does.
            both = all(stays[index] for index in self._turning)
            for index in self._turning:
                stays[index] = both
        return [
            here if same else there
            for here, there, same in zip(self._machine, placed, stays, strict=True)
        ]


class CycleRunner:
    """Carries steps out: moves through ``motion``, everything else straight to ``out``."""

    def __init__(
        self, motion: Motion, state: ModalState, here: SourceLocation, out: BlockBuffer
    ) -> None:
        self._motion = motion
        self._state = state
        self._here = here
        self._out = out

    def perform(self, steps: Iterable[Step], stage: CyclePlane) -> None:
        """The blocks of the steps, in order; the position is where they end."""
        motion, out, file, line = self._motion, self._out, self._here.file, self._here.line
        blending = self._state.path == "blend"
        if blending:
            out.add(PathMode(file, line, "exact-path"))
        for step in steps:
            match step:
                case Rapid(to):
                    motion.traverse(stage.place(to))
                case Cut(to, feed):
                    motion.feed_to(stage.place(to), feed)
                case Pause(seconds):
                    out.add(Dwell(file, line, seconds))
                case TurnSpindle():
                    out.add(self._spindle(step))
                case OrientSpindle():
                    out.add(Orient(file, line, 0.0))
                case OperatorStop():
                    out.add(Stop(file, line))
                case SetOverrides():
                    out.add(self._overrides(step))
                case Synchronise(pitch):
                    out.add(SpindleSync(file, line, pitch))
        if blending:
            out.add(PathMode(file, line, "blend", self._state.tolerance))

    def _spindle(self, turn: TurnSpindle) -> Spindle:
        """A turn of the spindle at the speed in effect; what the program has said of the spindle
        stays as it is.
        """
        state, file, line = self._state, self._here.file, self._here.line
        speed = state.speed or 0.0
        if turn.state == "off":
            return Spindle(file, line, "off", 0.0)
        if state.constant_surface:
            return Spindle(file, line, turn.state, state.most_rpm, speed)
        return Spindle(file, line, turn.state, speed * turn.times)

    def _overrides(self, step: SetOverrides) -> Overrides:
        """The operator's overrides as the program has set them, less what the step takes away."""
        state = self._state
        feed, spindle = state.feed_override, state.speed_override
        if not step.overrides:
            feed, spindle = False, spindle and not step.spindle
        return Overrides(
            self._here.file, self._here.line, feed, spindle, state.adaptive_feed, state.feed_stop
        )
