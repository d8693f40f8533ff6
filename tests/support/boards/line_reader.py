"""Effects of lines, read from their text: the counterpart of lines that carry their effects."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator

from cnc.model.line_effects import ARCS, MODES, MOTIONS, REST, LineEffect, LineKind
from cnc.model.streams import GcodeLine

WORD = re.compile(r"([A-Z])([-+]?[0-9]*\.?[0-9]+|[-+]?[0-9]+\.)")
REMARK = re.compile(r"\([^)]*\)|;.*|\s+")
MOTION_CODES = {
    0.0: LineKind.RAPID,
    1.0: LineKind.FEED,
    2.0: LineKind.CLOCKWISE,
    3.0: LineKind.COUNTERCLOCKWISE,
    **dict.fromkeys((38.2, 38.3, 38.4, 38.5), LineKind.PROBE),
}
PLANES = {17.0: 0, 18.0: 1, 19.0: 2}
CENTERS = ("IJ", "KI", "JK")
MODE_CODES = (21.0, 40.0, 49.0, 54.0, 61.0, 80.0, 90.0, 94.0)


class LineReader:
    """Reads lines in absolute mm, G54 and units per minute, and keeps their modes."""

    def __init__(self) -> None:
        self._motion: LineKind | None = None
        self._plane = 0
        self._feed = 0.0

    def read(self, text: str, line: int) -> GcodeLine:
        """Return a line with its effect; without one where the text is not understood."""
        return GcodeLine(text, line, self._effect(REMARK.sub("", text).upper()))

    def _effect(self, text: str) -> LineEffect | None:
        if text.startswith("$"):
            return None
        words = [(letter, float(value)) for letter, value in WORD.findall(text)]
        if sum(1 + len(value) for _, value in WORD.findall(text)) != len(text):
            return None
        values = dict(words)
        kind = LineKind.MODES
        for letter, value in words:
            if letter == "G" and value in MOTION_CODES:
                self._motion = MOTION_CODES[value]
            elif letter == "G" and value in PLANES:
                self._plane = PLANES[value]
            elif letter == "G" and value == 4.0:
                kind = LineKind.DWELL
            elif letter == "G" and value not in MODE_CODES:
                return None
            elif letter == "M":
                kind = LineKind.REST
                if value in (2.0, 30.0):
                    self._motion, self._plane = LineKind.FEED, 0
            elif letter == "F":
                self._feed = value / 60.0
        if kind is LineKind.DWELL:
            return LineEffect(kind, seconds=values.get("P", 0.0))
        if not set(values) & set("XYZIJK"):
            return REST if kind is LineKind.REST else MODES
        if self._motion is None or self._motion not in MOTIONS or "R" in values:
            return None
        x, y, z = (values.get(letter, math.nan) for letter in "XYZ")
        first, second = (values.get(letter, 0.0) for letter in CENTERS[self._plane])
        center = (first, second) if self._motion in ARCS else (0.0, 0.0)
        return LineEffect(self._motion, (x, y, z), self._feed, self._plane, center)


def lines_with_effects(texts: Iterable[str], first: int = 1) -> Iterator[GcodeLine]:
    """Yield lines with their effects, numbered from ``first``."""
    reader = LineReader()
    for number, text in enumerate(texts, start=first):
        yield reader.read(text, number)
