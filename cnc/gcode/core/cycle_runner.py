"""Execution of the steps of cycles: machine positions and blocks.

G64 is suspended during a cycle: holes and threads need the exact path.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cnc.compiled.jit import interpreted
from cnc.gcode.core.axis_words import PolarMode, stepped
from cnc.gcode.core.modal_groups import ModalState, Turning
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tip_control import refuse_under_tip_control
from cnc.gcode.kernels import cycles as kernel
from cnc.gcode.kernels.cycles import Hole, HoleSettings, coordinate_of_hole, machine_coordinate
from cnc.gcode.kernels.rows import PAUSE, STRAIGHT
from cnc.gcode.reader.words import AXES, G, LineWords, Word, fault
from cnc.model.blocks import (
    PLANE_AXES,
    Block,
    Dwell,
    Orient,
    Plane,
    Spindle,
    Stop,
)

# Steps of cycles, before they become canonical blocks.
#
# A cycle works in the plane in effect. Its points are (first, second, height): the plane's two axes
# in the order of :data:`cnc.model.blocks.PLANE_AXES` and the height along the axis across it, in mm
# of the coordinate system in use. The cycle runner converts points into machine positions, so
# cycles do not depend on offsets, rotation and tool length.

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Rapid:
    """A traverse to a point, mm."""

    to: Point


@dataclass(frozen=True, slots=True)
class Cut:
    """A straight move to a point, mm, at ``feed`` mm/s."""

    to: Point
    feed: float


@dataclass(frozen=True, slots=True)
class Pause:
    """A dwell, s."""

    seconds: float


@dataclass(frozen=True, slots=True)
class TurnSpindle:
    """A direction of the spindle at ``times`` the programmed speed, or off."""

    state: Turning | Literal["off"]
    times: float = 1.0


@dataclass(frozen=True, slots=True)
class OrientSpindle:
    """The spindle stops at its angle of orientation."""


@dataclass(frozen=True, slots=True)
class OperatorStop:
    """The program waits for the operator."""


@dataclass(frozen=True, slots=True)
class SetOverrides:
    """Whether the overrides are enabled. ``spindle`` False leaves that of the spindle unchanged."""

    overrides: bool
    spindle: bool = True


@dataclass(frozen=True, slots=True)
class Synchronise:
    """From here on moves follow the spindle at ``pitch`` mm a revolution; 0 ends this."""

    pitch: float


Step = Rapid | Cut | Pause | TurnSpindle | OrientSpindle | OperatorStop | SetOverrides | Synchronise


def opposite(turning: Turning) -> Turning:
    """Return the opposite direction."""
    return "ccw" if turning == "cw" else "cw"


def without_standing(position: Point, steps: Iterable[Step]) -> Iterator[Step]:
    """Return the steps without moves of length 0 and dwells of 0 s; ``position`` is their start."""
    for step in steps:
        if isinstance(step, Rapid | Cut):
            if step.to == position:
                continue
            position = step.to
        elif isinstance(step, Pause) and step.seconds <= 0:
            continue
        yield step


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
        self._out.add(Spindle(self._here.file, self._here.line, state.spindle, state.rpm))

    def perform(self, steps: Iterable[Step], plane: CyclePlane) -> None:
        """Execute steps in order. The position is the end of the last one."""
        motion, context = self._motion, self.context
        with context.exact_path():
            for step in steps:
                match step:
                    case Rapid(to):
                        motion.traverse(plane.place(to))
                    case Cut(to, feed):
                        motion.feed_to(plane.place(to), feed)
                    case Synchronise(0.0):
                        context.end_follow()
                    case Synchronise(pitch):
                        # Another pitch within a thread is that of the feed: nothing stops.
                        context.follow_spindle(pitch)
                    case SetOverrides(overrides, spindle):
                        context.add_overrides(feed=overrides, spindle=overrides or not spindle)
                    case _:
                        self._out.add(self._block(step))

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
        raise AssertionError(step)

    def _spindle(self, turn: TurnSpindle) -> Spindle:
        """The block of a step of the spindle. The modal state of the spindle stays."""
        state, file, line = self._state, self._here.file, self._here.line
        if turn.state == "off":
            return Spindle(file, line, "off", 0.0)
        if state.constant_surface:
            return replace(state.surface_speed(file, line), state=turn.state)
        return Spindle(file, line, turn.state, state.within_range(state.rpm * turn.times))


# Places of the holes of one line: repeats of a step, or steps around a pole.

_coordinate = interpreted(coordinate_of_hole)

Heights = tuple[float, float, float]
"""R, the bottom, and the end of the cycle, mm."""


def holes_on_line(
    plane: CyclePlane, given: dict[int, float], heights: Heights, repeats: int, *, absolute: bool
) -> Iterator[Hole]:
    """Yield the holes of a line; ``given`` are its axis values by column, steps under G91."""
    top, bottom, clear = heights
    words = [math.nan if value is None else value for value in plane.in_plane(given)]
    for number in range(1, repeats + 1):
        x, y = (
            _coordinate(number, start, word, absolute)
            for start, word in zip(plane.start, words, strict=False)
        )
        yield Hole(x, y, bottom, top, clear)


def holes_on_circle(
    plane: CyclePlane, polar: tuple[float, float], heights: Heights, repeats: int
) -> Iterator[Hole]:
    """Yield the holes of a line with polar steps: each is a step from the one before."""
    top, bottom, clear = heights
    for number in range(1, repeats + 1):
        x, y = stepped(plane.start[:2], *polar, number)
        yield Hole(x, y, bottom, top, clear)


def holes_in_polar_mode(
    plane: CyclePlane,
    mode: PolarMode,
    given: dict[int, float],
    heights: Heights,
    repeats: int,
) -> Iterator[Hole]:
    """Yield the holes of a line under G16 and G91, whose step is one of the radius and angle.

    ``given`` is the step to the first hole; ``mode`` repeats the words of the line for the others.
    """
    top, bottom, clear = heights
    i, j = plane.columns[:2]
    assert i is not None
    assert j is not None
    x, y = plane.start[0] + given[i], plane.start[1] + given[j]
    for number in range(repeats):
        if number:
            x, y = mode.again((x, y))
        yield Hole(x, y, bottom, top, clear)


# Steps of the canned cycles for holes, from the numbers of :mod:`cnc.gcode.kernels.cycles`.

_add_hole, _most_steps = interpreted(kernel.add_hole), interpreted(kernel.most_steps)


def steps(
    cycle: G, position: Point, holes: Iterable[Hole], settings: HoleSettings, turning: Turning
) -> Iterator[Step]:
    """Return the steps of a line with a cycle.

    Args:
        cycle: The code of the cycle.
        position: The point before the line.
        holes: The holes.
        settings: Their settings.
        turning: Direction of the spindle before the cycle.
    """
    events: dict[int, Step] = {
        kernel.SPINDLE_OFF: TurnSpindle("off"),
        kernel.SPINDLE_BACK: TurnSpindle(opposite(turning)),
        kernel.SPINDLE_AGAIN: TurnSpindle(turning),
        kernel.ORIENT: OrientSpindle(),
        kernel.OPERATOR_STOP: OperatorStop(),
        kernel.OVERRIDES_OFF: SetOverrides(overrides=False),
        kernel.OVERRIDES_ON: SetOverrides(overrides=True),
    }
    number = cycle // 10
    for hole in holes:
        most = _most_steps(number, hole, settings)
        space = kernel.Steps(np.empty(most, np.uint8), np.zeros((most, 4)))
        count = _add_hole(0, number, position, hole, settings, space)
        position = hole.first, hole.second, hole.clear
        for kind, numbers in zip(
            space.kinds[:count].tolist(), space.numbers[:count].tolist(), strict=True
        ):
            if kind == STRAIGHT:
                *to, feed = numbers
                yield Cut(tuple(to), feed) if feed == feed else Rapid(tuple(to))
            else:
                yield Pause(numbers[0]) if kind == PAUSE else events[kind]
