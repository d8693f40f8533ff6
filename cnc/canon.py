"""Canonical blocks: what a program means, whatever dialect it was written in.

Positions are machine coordinates in mm (degrees for rotary axes), after units, offsets and plane; feeds are mm/s. Axis arrays have one
column an axis of the machine, in the machine's order. The text floor makes these blocks, the path floor turns the moving ones into curves,
and the executor carries out the rest.

A finishing program is a million short moves, so straight moves travel in runs: one :class:`Polyline` holds arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
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

    points (n, axes): end point of each move. feeds (n,) mm/s; NaN marks a traverse (G0), which goes as fast as the axes allow.
    lines (n,): source line of each move. ``line`` is that of the first.
    """

    points: NDArray[np.float64]
    feeds: NDArray[np.float64]
    lines: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class ArcFeed(Block):
    """A circular or helical move in a plane.

    ``center`` (first, second plane axis), ``end`` (axes,), ``radius`` at the start, ``turns`` signed full turns, counter-clockwise
    positive. The end may lie off the circle by the dialect's arc tolerance: the radius then changes evenly along the arc, so that both end
    points are exact.
    """

    plane: Plane
    center: tuple[float, float]
    end: NDArray[np.float64]
    radius: float
    turns: float
    feed: float


@dataclass(frozen=True, slots=True)
class NurbsFeed(Block):
    """A NURBS move: degree, knots (points + degree + 1,), control points (points, axes), weights (points,).

    The first control point is the position where the block starts.
    """

    degree: int
    knots: NDArray[np.float64]
    control_points: NDArray[np.float64]
    weights: NDArray[np.float64]
    feed: float


@dataclass(frozen=True, slots=True)
class PathMode(Block):
    """G61.1 (exact-stop), G61 (exact-path) or G64 (blend) from here on; ``tolerance`` in mm for blend (0: the machine's own)."""

    control: PathControl
    tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class Dwell(Block):
    seconds: float


@dataclass(frozen=True, slots=True)
class Spindle(Block):
    state: Literal["cw", "ccw", "off"]
    rpm: float


@dataclass(frozen=True, slots=True)
class Coolant(Block):
    mist: bool
    flood: bool


@dataclass(frozen=True, slots=True)
class Tool(Block):
    """Tool change (M6) to ``number``."""

    number: int


@dataclass(frozen=True, slots=True)
class Stop(Block):
    """M0, or M1 with ``optional``: wait for the operator."""

    optional: bool = False


@dataclass(frozen=True, slots=True)
class End(Block):
    """M2 or M30: the program is over."""


@dataclass(frozen=True, slots=True)
class Message(Block):
    """``(MSG, text)`` for the operator; motion goes on."""

    text: str
