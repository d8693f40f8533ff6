"""Polar coordinates: ``@`` is the distance and ``^`` the angle of a point in X and Y.

They count from the zero of the coordinate system, and under G91 from those of the present position.
A missing word leaves its value as it is. Source: LinuxCNC, "G-code overview", polar coordinates.
"""

from __future__ import annotations

import math

from cnc.gcode.syntax.arithmetic import cosine, sine
from cnc.gcode.syntax.words import POLAR, LineWords, Word, fault


def first_polar(words: LineWords) -> Word | None:
    """The leftmost remaining polar word."""
    return min(
        (word for letter, word in words.rest.items() if letter in POLAR),
        key=lambda word: word.column,
        default=None,
    )


def point(
    words: LineWords, user: str, here: tuple[float, float], scale: float, *, absolute: bool
) -> tuple[float, float]:
    """Take the polar words of a line and return X and Y in mm, incremental if the line is.

    Args:
        words: The words of the line.
        user: Code that takes them, for messages.
        here: Present X and Y in the coordinate system, mm.
        scale: mm of a program unit.
        absolute: Whether G90 is in effect.

    Raises:
        GcodeError: ``polar-at-origin``.
    """
    radius, angle = math.hypot(*here), math.degrees(math.atan2(here[1], here[0]))
    at = first_polar(words)
    if not absolute and radius == 0:
        raise fault(
            "polar-at-origin",
            "at the zero point a polar increment has no direction",
            at,
            "give G90, or X and Y",
        )
    if word := words.take("@", user):
        radius = word.number * scale + (0.0 if absolute else radius)
    if word := words.take("^", user):
        angle = word.number + (0.0 if absolute else angle)
    x, y = radius * cosine(angle), radius * sine(angle)
    return (x, y) if absolute else (x - here[0], y - here[1])
