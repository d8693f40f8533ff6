"""Letters of single strokes, for engraving. The file ``letters.txt`` has them."""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import NamedTuple

CAPITAL = 21.0
"""Height of a capital letter in the units of the file."""
Point = tuple[float, float]


class Letter(NamedTuple):
    """A letter: its width, and its strokes as points from the left end of its base line."""

    width: float
    strokes: list[list[Point]]


@cache
def letters() -> dict[str, Letter]:
    """Return the letters of the file."""
    text = (resources.files("cnc.simple_jobs") / "letters.txt").read_text(encoding="utf-8")
    made = {}
    for line in text.splitlines():
        name, width, *strokes = line.split()
        if name != "//":
            points = [[_point(pair) for pair in stroke.split(";")] for stroke in strokes]
            made[" " if name == "space" else name] = Letter(float(width), points)
    return made


def strokes(text: str, height: float) -> tuple[list[list[Point]], float]:
    """Return the strokes of a text, and its width, mm.

    The text begins at the origin. ``height`` is that of a capital letter, mm. Raises KeyError for a
    letter that the file has not.
    """
    made, at, scale = [], 0.0, height / CAPITAL
    for name in text:
        letter = letters()[name]
        made += [[((at + x) * scale, y * scale) for x, y in stroke] for stroke in letter.strokes]
        at += letter.width
    return made, at * scale


def _point(pair: str) -> Point:
    x, y = pair.split(",")
    return float(x), float(y)
