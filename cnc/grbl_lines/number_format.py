"""Axes, moves, numbers, words and comments as GRBL 1.1 reads them.

GRBL keeps about 7 digits of a number (a 32-bit float) and takes lines of at most 80 characters. It
takes the characters ``?`` ``!`` ``~`` and every byte from 0x80 on out of the stream wherever they
stand, even in a comment: they are real-time commands (GRBL 1.1 wiki, Interface, "Real-Time
Commands"). Text of a program must not contain them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from cnc.model.blocks import AXIS_LETTERS, AxisLetter, Block
from cnc.model.units import decimal_text

LONGEST = 79
"""Characters of a line without its end: GRBL's line buffer holds 80 with the end of the string
(``LINE_BUFFER_SIZE``).
"""

LETTERS = "XYZ"
BOARD_LETTERS = "XYZABC"
"""Axes of a board in the order of its settings and reports. GRBL 1.1 has the first three."""
PLANE_WORDS = ("G17", "G18", "G19")
"""By the number of the plane: XY, ZX, YZ."""
PLANE_COLUMNS = ((0, 1, 2), (2, 0, 1), (1, 2, 0))
"""First and second axis of each plane, and the axis across it. Counter-clockwise turns from the
first to the second.
"""
CENTER_LETTERS = "IJK"

FEED_STEP = 0.05
"""Relative difference between planned speed and feed in effect below which no F word is sent."""

_REPLACED = str.maketrans({"!": ".", "?": ".", "~": "-", "(": "[", ")": "]", ";": ",", "%": " "})


def board_letters(axes: Iterable[str]) -> str:
    """Return the axes of a board that can move a machine with these axes: XYZ at least."""
    last = max((BOARD_LETTERS.find(letter.upper()) for letter in axes), default=-1)
    return BOARD_LETTERS[: max(last + 1, len(LETTERS))]


def board_axes(axes: Iterable[str]) -> tuple[AxisLetter, ...]:
    """Return the same axes in small letters."""
    return AXIS_LETTERS[: len(board_letters(axes))]


def feed_word(per_minute: float) -> str:
    """Return an F word with at least four significant digits; never F0 (error:22 in GRBL)."""
    digits = 1 if per_minute >= 100.0 else 3 - math.floor(math.log10(max(per_minute, 1e-3)))
    return "F" + decimal_text(max(per_minute, 1e-3), digits)


def plain_text(text: str) -> str:
    """Return text of a program without characters that are commands to the board."""
    return (
        "".join(c if " " <= c <= "\x7e" else " " if c.isspace() else "." for c in text)
        .translate(_REPLACED)
        .strip()
    )


def message_lines(text: str) -> Iterator[str]:
    """Yield ``(MSG, text)`` in as many lines as it takes; the board skips them."""
    longest = LONGEST - len("(MSG, )")
    rest = plain_text(text)
    while True:
        cut = (
            len(rest)
            if len(rest) <= longest
            else max(rest.rfind(" ", 0, longest + 1), 0) or longest
        )
        yield f"(MSG, {rest[:cut]})"
        rest = rest[cut:].strip()
        if not rest:
            return


# Moves of a program for a GRBL board: lines and arcs, before they become text.

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
