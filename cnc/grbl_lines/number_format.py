"""Words and lines as GRBL 1.1 reads them: numbers with the digits they need, and no word that says
what the board knows already.

GRBL keeps of a number what fits a 32-bit float (about 7 digits), takes lines of at most 80
characters, and picks the characters ``?`` ``!`` ``~`` and every byte from 0x80 on out of the stream
wherever they stand, in a comment too: they are orders (GRBL 1.1 wiki, Interface, "Real-Time
CommandLines"). Text of the program's must not contain any.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

LONGEST = 79
"""Characters of a line without its end: GRBL's line buffer holds 80 with the end of the string
(``LINE_BUFFER_SIZE``).
"""

LETTERS = "XYZ"
PLANE_WORDS = ("G17", "G18", "G19")
"""By the number of the plane: XY, ZX, YZ."""
PLANE_COLUMNS = ((0, 1, 2), (2, 0, 1), (1, 2, 0))
"""First and second axis of each plane, and the one across it; counter-clockwise turns the first
towards the second.
"""
CENTER_LETTERS = "IJK"

FEED_STEP = 0.05
"""Relative: a planned speed that differs from the feed in effect by less is not worth a word."""

_TAKEN_OUT = str.maketrans({"!": ".", "?": ".", "~": "-", "(": "[", ")": "]", ";": ",", "%": " "})


def number(value: float, digits: int) -> str:
    """``value`` with at most so many digits behind the point, and none that say nothing."""
    text = f"{value:.{digits}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def feed_word(per_minute: float) -> str:
    """F with four digits or more that count, and never F0, which GRBL refuses (error:22)."""
    digits = 1 if per_minute >= 100.0 else 3 - math.floor(math.log10(max(per_minute, 1e-3)))
    return "F" + number(max(per_minute, 1e-3), digits)


def plain(text: str) -> str:
    """Text of the program's without what the board would take for an order."""
    return (
        "".join(c if " " <= c <= "\x7e" else " " if c.isspace() else "." for c in text)
        .translate(_TAKEN_OUT)
        .strip()
    )


def message_lines(text: str) -> Iterator[str]:
    """``(MSG, text)`` for who shows comments, in as many lines as it takes; the board skips it."""
    room = LONGEST - len("(MSG, )")
    rest = plain(text)
    while True:
        cut = len(rest) if len(rest) <= room else max(rest.rfind(" ", 0, room + 1), 0) or room
        yield f"(MSG, {rest[:cut]})"
        rest = rest[cut:].strip()
        if not rest:
            return
