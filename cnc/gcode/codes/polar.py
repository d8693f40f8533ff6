"""Polar coordinates: ``@`` is the distance and ``^`` the angle of a point in X and Y.

They count from the zero of the coordinate system, and under G91 from those of the present position.
A missing word leaves its value as it is. SINUMERIK keeps the words of the last polar point (AP, RP)
instead, so both are needed where the position is another one. Sources: LinuxCNC, "G-code overview",
polar coordinates; Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", AP and RP.
"""

from __future__ import annotations

import math

from cnc.gcode.syntax.arithmetic import cosine, sine
from cnc.gcode.syntax.words import POLAR, LineWords, Word, fault

_SAME = 1e-6
"""Distance of two equal places, mm."""
_NO_ANGLE = 1e-9
"""Distance from the zero within which the angle of a place is rounding, mm."""


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
    if math.hypot(*here) < _NO_ANGLE and "^" not in words.rest:
        hint = "give ^ too, or X and Y"
        raise fault("polar-at-origin", "the zero point has no angle", first_polar(words), hint)
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
    if math.hypot(*here) < _NO_ANGLE:
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


def refuse_other_start(
    words: LineWords, here: tuple[float, float], last: tuple[float, float] | None
) -> None:
    """Refuse a radius or an angle alone where the position is not the last polar point.

    Raises:
        GcodeError: ``polar-word-missing``.
    """
    if words.rest.keys() >= set(POLAR):
        return
    if last is None or math.dist(here, last) > _SAME:
        message = "AP or RP alone, and the position is not the last polar point"
        hint = "give AP and RP: the control keeps the last values of both"
        raise fault("polar-word-missing", message, first_polar(words), hint)
