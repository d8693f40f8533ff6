"""Polar coordinates: ``@`` is the distance and ``^`` the angle of a point in X and Y.

They count from the zero of the coordinate system, and under G91 from those of the present position.
A missing word leaves its value as it is. Source: LinuxCNC, "G-code overview", polar coordinates.
"""

from __future__ import annotations

import math

from cnc.gcode.syntax.words import POLAR, LineWords, Word, fault
from cnc.kernels.gcode.arithmetic import cosine, sine


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
    if not absolute:
        x, y = stepped(here, *steps(words, user, here, scale))
        return x - here[0], y - here[1]
    radius, angle = math.hypot(*here), math.degrees(math.atan2(here[1], here[0]))
    if word := words.take("@", user):
        radius = word.number * scale
    if word := words.take("^", user):
        angle = word.number
    return radius * cosine(angle), radius * sine(angle)


def steps(
    words: LineWords, user: str, here: tuple[float, float], scale: float
) -> tuple[float, float]:
    """Take the polar words of a line under G91: increments of the radius (mm) and of the angle.

    Raises:
        GcodeError: ``polar-at-origin``.
    """
    if here == (0.0, 0.0):
        raise fault(
            "polar-at-origin",
            "at the zero point a polar increment has no direction",
            first_polar(words),
            "give G90, or X and Y",
        )
    distance, angle = words.take("@", user), words.take("^", user)
    return (distance.number * scale if distance else 0.0), (angle.number if angle else 0.0)


def stepped(
    here: tuple[float, float], radius: float, angle: float, count: int = 1
) -> tuple[float, float]:
    """Return the point after a number of equal polar steps from a point, mm and degrees."""
    reached = math.hypot(*here) + count * radius
    turned = math.degrees(math.atan2(here[1], here[0])) + count * angle
    return reached * cosine(turned), reached * sine(turned)
