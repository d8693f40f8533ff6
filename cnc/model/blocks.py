"""Canonical blocks: the meaning of a program, independent of its dialect.

Positions are machine coordinates in mm (degrees for rotary axes), after units, offsets and plane.
Feeds are in mm/s. Arrays of axes have one column per axis of the machine, in the machine's order.
The language package makes these blocks, the path package turns motion into curves, and the executor
carries out the rest.

A finishing program has millions of short moves. Therefore one :class:`Polyline` holds a run of
straight moves as arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import repeat
from typing import Literal, TypeVar, dataclass_transform, get_args

import numpy as np
from numpy.typing import NDArray

Plane = Literal["XY", "ZX", "YZ"]
PathControl = Literal["exact-stop", "exact-path", "blend"]

PLANE_AXES: dict[Plane, tuple[str, str]] = {"XY": ("x", "y"), "ZX": ("z", "x"), "YZ": ("y", "z")}
"""First and second axis of each plane; counter-clockwise turns the first towards the second."""

AxisLetter = Literal["x", "y", "z", "a", "b", "c", "u", "v", "w"]
AXIS_LETTERS: tuple[AxisLetter, ...] = get_args(AxisLetter)
ROTARY_LETTERS = frozenset("abc")

AnyBlock = TypeVar("AnyBlock")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def canonical(kind: type[AnyBlock]) -> type[AnyBlock]:
    """Make a class of blocks. Nothing changes a block, which only type checkers enforce.

    A frozen dataclass takes six times as long to make an object.
    """
    return dataclass(slots=True, unsafe_hash=True)(kind)


@canonical
class Block:
    """A canonical block.

    Attributes:
        file: Program that the block comes from.
        line: Source line, from 1.
    """

    file: str
    line: int


@canonical
class Polyline(Block):
    """A run of straight moves from the current position. ``line`` is the line of the first move.

    Attributes:
        points: End point of each move (n, axes), mm.
        feeds: Feed of each move (n,), mm/s. NaN marks a traverse (G0), limited only by the axes.
        lines: Source line of each move (n,).
        commands: Commands before each move (n,), see :mod:`cnc.model.motion_commands`; None without
            any.
        timed: Whether F was the time of each block (G93).
    """

    points: NDArray[np.float64]
    feeds: NDArray[np.float64]
    lines: NDArray[np.int32]
    commands: NDArray[np.object_] | None = None
    timed: bool = False


@canonical
class ArcFeed(Block):
    """A circular or helical move.

    The end may lie off the circle by the arc tolerance of the dialect. Then the radius changes
    linearly along the arc, so that both end points are exact.

    Attributes:
        plane: Plane of the arc.
        center: Coordinates of the centre in the two axes of the plane, mm.
        end: End point (axes,), mm.
        radius: Radius at the start, mm.
        turns: Signed number of turns, counter-clockwise positive.
        feed: Feed, mm/s.
        timed: Whether F was the time of the block (G93).
    """

    plane: Plane
    center: tuple[float, float]
    end: NDArray[np.float64]
    radius: float
    turns: float
    feed: float
    timed: bool = False


@canonical
class NurbsFeed(Block):
    """A move along a NURBS curve. The first control point is the start position.

    Attributes:
        degree: Degree of the curve.
        knots: Knots (points + degree + 1,).
        control_points: Control points (points, axes), mm.
        weights: Weights (points,).
        feed: Feed, mm/s.
        timed: Whether F was the time of the block (G93).
    """

    degree: int
    knots: NDArray[np.float64]
    control_points: NDArray[np.float64]
    weights: NDArray[np.float64]
    feed: float
    timed: bool = False


@canonical
class CallBoundary(Block):
    """The main program begins a call at this line (``inside``) or has returned from it.

    Only readers that ask for these blocks get them.
    """

    inside: bool


@canonical
class ToolOffset(Block):
    """The tool offset from here on: position of the axes less ``offset`` is that of the tool tip.

    Only readers that ask for these blocks get them.

    Attributes:
        offset: Offset of each axis (axes,), mm.
    """

    offset: tuple[float, ...]


@canonical
class PathMode(Block):
    """Path control from here on: G61.1 (exact-stop), G61 (exact-path) or G64 (blend).

    Attributes:
        control: The mode.
        tolerance: Tolerance of a blend, mm; 0 is the default of the machine.
    """

    control: PathControl
    tolerance: float = 0.0


@canonical
class TipControl(Block):
    """Tool-tip control begins or ends. The joints do not move.

    Attributes:
        offset: Offset of the tool along X, Y and Z, mm; None ends the control.
        position: Position of the axes from here on (axes,), mm or degrees: under tool-tip control
            that of the tip, with the tool's offset.
    """

    offset: tuple[float, float, float] | None
    position: NDArray[np.float64]


@canonical
class Dwell(Block):
    seconds: float


@canonical
class Spindle(Block):
    """Spindle direction and speed (M3, M4, M5).

    Attributes:
        state: Direction, or off.
        rpm: Speed; under constant surface speed (G96) the highest speed, 0 for no limit.
        surface_speed: Constant surface speed, mm/s; 0 outside G96.
        with_motion: Whether the speed changes in motion: it is the power of a laser.
        least_rpm: Lowest speed under constant surface speed, 0 for no limit.
    """

    state: Literal["cw", "ccw", "off"]
    rpm: float
    surface_speed: float = 0.0
    with_motion: bool = False
    least_rpm: float = 0.0


@canonical
class Orient(Block):
    """Turn the spindle to an angle and hold it there (M19).

    Attributes:
        angle: Angle, degrees.
        direction: Direction of rotation.
        timeout: Longest time for it, s; 0 for no limit.
    """

    angle: float
    direction: Literal["shortest", "cw", "ccw"] = "shortest"
    timeout: float = 0.0


@canonical
class SpindleSync(Block):
    """From here on moves follow the spindle: the time of the plan is the angle of the spindle.

    Attributes:
        pitch: mm per turn at the start of the first move; 0 ends this.
        angle: Angle of the spindle at which the first move begins, degrees from its index.
    """

    pitch: float
    angle: float = 0.0


@canonical
class Coolant(Block):
    mist: bool
    flood: bool


@canonical
class Tool(Block):
    """Change to tool ``number`` (M6), or state that the spindle already has it (M61).

    Attributes:
        number: Number of the tool.
        change: Whether a change is needed.
    """

    number: int
    change: bool = True


@canonical
class Stop(Block):
    """Wait for the operator: M0, M1 (``optional``) or M60 (``pallet``)."""

    optional: bool = False
    pallet: bool = False


def pause_reason(block: Block) -> str:
    """Return why the machine waits for the operator at a block; empty if it does not wait.

    The machine does not wait at M1, unless the user has turned the optional stop on.
    """
    if isinstance(block, Tool) and block.change:
        return f"put in tool {block.number}"
    if isinstance(block, Stop) and not block.optional:
        return "change the pallet" if block.pallet else "the program stops here"
    return ""


@canonical
class End(Block):
    """End of the program (M2, M30)."""


@canonical
class Message(Block):
    """A message ``(MSG, text)`` for the operator; motion continues."""

    text: str


@canonical
class Abort(Block):
    """An abort by the program, ``(ABORT, text)``.

    The motion before it is carried out and comes to rest. The request for the next block raises the
    fault.
    """


@canonical
class Overrides(Block):
    """Overrides that the operator may use from here on (M48 to M53)."""

    feed: bool
    spindle: bool
    adaptive_feed: bool
    feed_stop: bool


@canonical
class DigitalOutput(Block):
    """Set a digital output (M62 to M65): with the start of the next move, or at once."""

    number: int
    on: bool
    with_motion: bool


@canonical
class AnalogOutput(Block):
    """Set an analogue output (M67, M68): with the start of the next move, or at once.

    The motion rests for neither.
    """

    number: int
    value: float
    with_motion: bool


class Answer:
    """Values that the board returned for a block.

    Attributes:
        values: None before the block is carried out, and in a run without a board.
        of_joints: Whether the position in it is that of the joints, as a board counts it.
    """

    __slots__ = ("of_joints", "values")

    def __init__(self) -> None:
        self.values: tuple[float, ...] | None = None
        self.of_joints = False


WaitMode = Literal["immediate", "rise", "fall", "high", "low"]


@canonical
class WaitInput(Block):
    """Read an input, or wait for a change of it (M66).

    Attributes:
        number: Number of the input.
        analog: Whether it is an analogue input.
        mode: Event to wait for.
        timeout: Longest wait, s.
        answer: Value of the input, -1 after the timeout.
    """

    number: int
    analog: bool
    mode: WaitMode
    timeout: float
    answer: Answer = field(default_factory=Answer, compare=False)

    @property
    def expected(self) -> tuple[float, ...]:
        """Answer in a run without a board: awaited events occur, other inputs are off."""
        return (1.0 if self.mode in ("rise", "high") else 0.0,)


@canonical
class Probe(Block):
    """A straight probing move (G38.2 to G38.5).

    Attributes:
        end: End point (axes,), mm.
        feed: Feed, mm/s.
        towards: Whether the move ends when the probe makes contact; else when it loses contact.
        must: Whether it is an error to reach the end point without that.
        answer: 1 for contact or 0 for none, then its position (axes,).
    """

    end: NDArray[np.float64]
    feed: float
    towards: bool
    must: bool
    answer: Answer = field(default_factory=Answer, compare=False)

    @property
    def expected(self) -> tuple[float, ...]:
        """Answer in a run without a board: contact at the end of the move."""
        return (1.0, *self.end.tolist())


@canonical
class SwitchMove(Probe):
    """A homing move, which ends when the limit switch of column ``switch`` closes or opens.

    Programs do not contain this block.

    Attributes:
        switch: Column of the axis.
        motor: Motor of the axis whose own switch is meant; None for any switch of the axis.
    """

    switch: int = 0
    motor: int | None = None


@canonical
class BoardCommand(Block):
    """A line for the board itself, such as GRBL's ``$H``. It is sent unchanged.

    Attributes:
        text: The line.
        answer: Position of each axis after a command that homes, mm.
    """

    text: str
    answer: Answer = field(default_factory=Answer, compare=False)

    @property
    def homes(self) -> bool:
        """Whether the board homes: it stands elsewhere afterwards."""
        return self.text.replace(" ", "").upper().startswith("$H")

    @property
    def expected(self) -> tuple[float, ...]:
        """Answer in a run without a board: none, so that the position stays."""
        return ()


@canonical
class Held(Block):
    """The motion rests here, on its path to the end of ``line``, until the operator resumes it.

    Programs do not contain this block. ``reason`` is text for the operator.
    """

    reason: str = ""


Moves = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]
"""End points, feeds and lines of straight moves, as in :class:`cnc.model.blocks.Polyline`."""


def polylines_of(
    file: str, moves: Moves, begins: list[int], ends: list[int], *, timed: bool = False
) -> Iterator[Polyline]:
    """Yield polylines of some parts of straight moves, none of which is empty.

    Args:
        file: File of the moves.
        moves: The moves. Their arrays are kept, not copied.
        begins: The first move of each part.
        ends: The move behind each part.
        timed: Whether F was the time of each block (G93).
    """
    points, feeds, lines = moves
    spans = list(map(slice, begins, ends))
    return map(
        Polyline,
        repeat(file),
        lines[begins].tolist(),
        map(points.__getitem__, spans),
        map(feeds.__getitem__, spans),
        map(lines.__getitem__, spans),
        repeat(None),
        repeat(timed),
    )
