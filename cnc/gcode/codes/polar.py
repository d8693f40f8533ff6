"""Polar coordinates: ``@`` is the distance and ``^`` the angle of a point from the zero of the
coordinate system, in X and Y.

Under G91 both count from those of the present position. What is not given stays. Source: LinuxCNC,
"G-code overview", polar coordinates.
"""

from __future__ import annotations

import math

from cnc.gcode.syntax.arithmetic import cosine, sine
from cnc.gcode.syntax.words import POLAR, LineWords, Word, fault


def first_polar(words: LineWords) -> Word | None:
    """The leftmost polar word left."""
    return min(
        (word for letter, word in words.rest.items() if letter in POLAR),
        key=lambda word: word.column,
        default=None,
    )


def point(
    words: LineWords, user: str, here: tuple[float, float], scale: float, *, absolute: bool
) -> tuple[float, float]:
    """Takes the polar words of a line: the X and Y that they mean, absolute or incremental as the
    line is. mm.

    ``here`` is the present position in the coordinate system, mm; ``scale`` is millimetres a unit.
    GcodeError ``polar-at-origin``.
    """
    radius, angle = math.hypot(*here), math.degrees(math.atan2(here[1], here[0]))
    at = first_polar(words)
    if not absolute and radius == 0:
        raise fault(
            "polar-at-origin",
            "an increment of polar coordinates means nothing at the zero point",
            at,
            "give G90, or X and Y",
        )
    if word := words.take("@", user):
        radius = word.number * scale + (0.0 if absolute else radius)
    if word := words.take("^", user):
        angle = word.number + (0.0 if absolute else angle)
    x, y = radius * cosine(angle), radius * sine(angle)
    return (x, y) if absolute else (x - here[0], y - here[1])
