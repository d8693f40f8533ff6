"""Letters of single strokes, for engraving. The file ``letters.txt`` has them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib import resources
from math import ceil, cos, radians, sin
from typing import NamedTuple

CAPITAL = 12.0
"""Height of a capital letter in the units of the file."""
STEP = 15.0
"""Degrees of an arc between two points, at most."""
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
            points = [list(_points(stroke)) for stroke in strokes]
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


def _points(stroke: str) -> Iterator[Point]:
    """Yield the points of a stroke of the file."""
    for part in stroke.split(";"):
        if not part.startswith("@"):
            x, y = map(float, part.split(","))
            yield x, y
            continue
        x, y, rx, ry, begin, end = map(float, part[1:].split(","))
        steps = ceil(abs(end - begin) / STEP)
        for k in range(steps + 1):
            angle = radians(begin + (end - begin) * k / steps)
            yield x + rx * cos(angle), y + ry * sin(angle)
