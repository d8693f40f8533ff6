"""Canonical blocks: what a program means, whatever dialect it was written in.

Positions are machine coordinates in mm (degrees for rotary axes), after units, offsets and plane;
feeds are mm/s. Axis arrays have one column an axis of the machine, in the machine's order. The text
floor makes these blocks, the path floor turns the moving ones into curves, and the executor carries
out the rest.

A finishing program is a million short moves, so straight moves travel in runs: one
:class:`Polyline` holds arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Plane = Literal["XY", "ZX", "YZ"]
PathControl = Literal["exact-stop", "exact-path", "blend"]

PLANE_AXES: dict[Plane, tuple[str, str]] = {"XY": ("x", "y"), "ZX": ("z", "x"), "YZ": ("y", "z")}
"""First and second axis of each plane; counter-clockwise turns the first towards the second."""

AXIS_LETTERS = ("x", "y", "z", "a", "b", "c", "u", "v", "w")
ROTARY_LETTERS = frozenset("abc")


@dataclass(frozen=True, slots=True)
class Block:
    """A canonical block and the source line (from 1) that it comes from."""

    file: str
    line: int


@dataclass(frozen=True, slots=True)
class Polyline(Block):
    """A run of straight moves from the current position.

    points (n, axes): end point of each move. feeds (n,) mm/s; NaN marks a traverse (G0), which goes
    as fast as the axes allow. lines (n,): source line of each move. ``line`` is that of the first.
    """

    points: NDArray[np.float64]
    feeds: NDArray[np.float64]
    lines: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class ArcFeed(Block):
    """A circular or helical move in a plane.

    ``center`` (first, second plane axis), ``end`` (axes,), ``radius`` at the start, ``turns``
    signed full turns, counter-clockwise positive. The end may lie off the circle by the dialect's
    arc tolerance: the radius then changes evenly along the arc, so that both end points are exact.
    """

    plane: Plane
    center: tuple[float, float]
    end: NDArray[np.float64]
    radius: float
    turns: float
    feed: float


@dataclass(frozen=True, slots=True)
class NurbsFeed(Block):
    """A NURBS move: degree, knots (points + degree + 1,), control points (points, axes), weights
    (points,).

    The first control point is the position where the block starts.
    """

    degree: int
    knots: NDArray[np.float64]
    control_points: NDArray[np.float64]
    weights: NDArray[np.float64]
    feed: float


@dataclass(frozen=True, slots=True)
class CallBoundary(Block):
    """Where the main program goes into a call at this line (``inside``), or is back from it; only
    who asks for these sees them.
    """

    inside: bool


@dataclass(frozen=True, slots=True)
class PathMode(Block):
    """G61.1 (exact-stop), G61 (exact-path) or G64 (blend) from here on; ``tolerance`` in mm for
    blend (0: the machine's own).
    """

    control: PathControl
    tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class Dwell(Block):
    seconds: float


@dataclass(frozen=True, slots=True)
class Spindle(Block):
    """``rpm`` of the spindle; under constant surface speed (G96) the most that is allowed (0: no
    limit), ``surface_speed`` being mm/s.
    """

    state: Literal["cw", "ccw", "off"]
    rpm: float
    surface_speed: float = 0.0


@dataclass(frozen=True, slots=True)
class Orient(Block):
    """M19: turn the spindle to ``angle`` degrees by the way named and hold it there; ``timeout`` s
    for that, 0 for none.
    """

    angle: float
    direction: Literal["shortest", "cw", "ccw"] = "shortest"
    timeout: float = 0.0


@dataclass(frozen=True, slots=True)
class SpindleSync(Block):
    """From here on moves follow the spindle, ``pitch`` mm a turn; 0 ends that."""

    pitch: float


@dataclass(frozen=True, slots=True)
class Coolant(Block):
    mist: bool
    flood: bool


@dataclass(frozen=True, slots=True)
class Tool(Block):
    """Tool change (M6) to ``number``; without ``change`` (M61) that tool is in the spindle
    already.
    """

    number: int
    change: bool = True


@dataclass(frozen=True, slots=True)
class Stop(Block):
    """M0, M1 with ``optional``, or M60 with ``pallet``: wait for the operator."""

    optional: bool = False
    pallet: bool = False


@dataclass(frozen=True, slots=True)
class End(Block):
    """M2 or M30: the program is over."""


@dataclass(frozen=True, slots=True)
class Message(Block):
    """``(MSG, text)`` for the operator; motion goes on."""

    text: str


@dataclass(frozen=True, slots=True)
class Abort(Block):
    """``(ABORT, text)``: the motion before it is made and rests.

    Whoever asks for the next block gets the fault.
    """


@dataclass(frozen=True, slots=True)
class Overrides(Block):
    """What the operator may change while the program runs, from here on (M48 to M53)."""

    feed: bool
    spindle: bool
    adaptive_feed: bool
    feed_stop: bool


@dataclass(frozen=True, slots=True)
class DigitalOutput(Block):
    """M62 to M65: set an output; ``with_motion`` at the start of the next move, else at once."""

    number: int
    on: bool
    with_motion: bool


@dataclass(frozen=True, slots=True)
class AnalogOutput(Block):
    """M67, M68: set an output to ``value``; ``with_motion`` at the start of the next move, else at
    once.
    """

    number: int
    value: float
    with_motion: bool


class Answer:
    """What the board found out when it carried a block out: None until then, and in a run without a
    board.
    """

    __slots__ = ("values",)

    def __init__(self) -> None:
        self.values: tuple[float, ...] | None = None


WaitMode = Literal["immediate", "rise", "fall", "high", "low"]


@dataclass(frozen=True, slots=True)
class WaitInput(Block):
    """M66: read an input, or wait until it does what ``mode`` says, at most ``timeout`` s. The
    answer: its value, or -1 after the time.
    """

    number: int
    analog: bool
    mode: WaitMode
    timeout: float
    answer: Answer = field(default_factory=Answer, compare=False)

    @property
    def expected(self) -> tuple[float, ...]:
        """The answer where nobody is there to ask: what is waited for comes, what is only looked at
        is off.
        """
        return (1.0 if self.mode in ("rise", "high") else 0.0,)


@dataclass(frozen=True, slots=True)
class Probe(Block):
    """G38: a straight move to ``end`` (axes,) at ``feed`` that stops when the probe makes contact,
    or loses it if not ``towards``.

    ``must``: it is an error to arrive without that. The answer is 1 for a contact and 0 for none,
    then the position (axes,) of it.
    """

    end: NDArray[np.float64]
    feed: float
    towards: bool
    must: bool
    answer: Answer = field(default_factory=Answer, compare=False)

    @property
    def expected(self) -> tuple[float, ...]:
        """The answer where nobody is there to ask: contact at the end of the move."""
        return (1.0, *self.end.tolist())


@dataclass(frozen=True, slots=True)
class SwitchMove(Probe):
    """Not of a program: a move that ends when the limit switch of column ``switch`` closes, or
    opens if not ``towards``.
    """

    switch: int = 0


@dataclass(frozen=True, slots=True)
class BoardCommand(Block):
    """A line for the board alone, such as GRBL's ``$H``: passed on as it stands, and refused where
    the board doesn't know it.
    """

    text: str


@dataclass(frozen=True, slots=True)
class Held(Block):
    """Not of a program: the motion rests here, on its way to the end of ``line``, until the
    operator resumes it. ``why``: what for.
    """

    why: str = ""
