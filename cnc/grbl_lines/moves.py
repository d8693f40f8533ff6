"""Moves of a program for a GRBL board: lines and arcs, before they become text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from cnc.model.blocks import Block

Point = tuple[float, ...]
"""Position of each axis of the board: x, y, z, and the rotary axes that the machine has; mm or
degrees.
"""


@dataclass(frozen=True, slots=True)
class PlaneArc:
    """An arc or helix in one of the planes XY, ZX, YZ.

    Attributes:
        plane: Number of the plane: 0 for XY, 1 for ZX, 2 for YZ.
        center: Centre along the two axes of the plane, mm.
        sweep: Angle in rad, positive for counter-clockwise.
        fitted: Whether the arc replaces a stretch of path within the tolerance. Otherwise it is an
            arc of the program.
    """

    plane: int
    center: tuple[float, float]
    sweep: float
    fitted: bool = False


class Move(NamedTuple):
    """A line or an arc to ``end``.

    Attributes:
        end: End point (machine coordinates).
        arc: The arc; None for a straight move.
        first: Index of the interval of the path samples where the move begins.
        speed: Highest speed along the move, mm/s, by its length in all axes.
        feed: Programmed feed by the same length, mm/s; NaN for a traverse.
        line: Source line of the end.
        rests: Whether the motion comes to rest at the end.
        commands: Commands that take effect at the begin of the move, in motion.
    """

    end: Point
    arc: PlaneArc | None
    first: int
    speed: float
    feed: float
    line: int
    rests: bool
    commands: tuple[Block, ...] = ()
