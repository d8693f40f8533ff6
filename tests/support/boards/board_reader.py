"""A small reader of what GRBL 1.1 is sent, written from its documentation: lines to moves, moves to
dense points.

It knows the modes G0 to G3, G17 to G19, G21, G38 and G90, arcs by I J K and what chords GRBL makes
of them, the feed, and the rules by which it refuses an arc; of the rest, which codes there are.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np

WORD = re.compile(r"([A-Z])([-+]?[0-9]*\.?[0-9]+)")
KNOWN_G = {
    4,
    10,
    17,
    18,
    19,
    20,
    21,
    28,
    30,
    53,
    54,
    55,
    56,
    57,
    58,
    59,
    80,
    90,
    91,
    92,
    93,
    94,
    43.1,
    49,
    40,
    61,
    0,
    1,
    2,
    3,
    38.2,
    38.3,
    38.4,
    38.5,
}
KNOWN_M = {0, 1, 2, 3, 4, 5, 7, 8, 9, 30}
PLANES = {
    17: ("X", "Y", "I", "J", "Z"),
    18: ("Z", "X", "K", "I", "Y"),
    19: ("Y", "Z", "J", "K", "X"),
}


@dataclass
class Move:
    """One move: text, points along it (k, 3) with both ends, mode (0 to 3, 38), feed mm/min (None:
    traverse), radius of an arc.
    """

    text: str
    points: np.ndarray
    mode: float
    feed: float | None
    radius: float | None = None


@dataclass
class Reader:
    at: dict[str, float] = field(default_factory=lambda: {"X": 0.0, "Y": 0.0, "Z": 0.0})
    mode: float = 0
    plane: int = 17
    feed: float = 0.0
    stops: int = 0
    arc_tolerance: float = 0.002

    def read(self, text: str) -> Move | None:
        """One line; AssertionError for what GRBL would refuse."""
        assert len(text) < 80, text
        assert all(" " <= c < "\x7f" and c not in "?!~" for c in text), text
        if text.startswith("$"):
            return None
        bare = re.sub(r"\([^)]*\)", "", text).replace(" ", "")
        words = WORD.findall(bare)
        assert "".join(letter + value for letter, value in words) == bare, text
        given = {}
        dwell = False
        for letter, value in words:
            number = float(value)
            if letter == "G":
                assert number in KNOWN_G, text
                if number in (0, 1, 2, 3) or 38 <= number < 39:
                    self.mode = number
                elif number in PLANES:
                    self.plane = int(number)
                elif number == 4:
                    dwell = True
            elif letter == "M":
                assert number in KNOWN_M, text
            else:
                assert letter not in given, text
                given[letter] = number
        if dwell:
            assert "P" in given and not set("XYZ") & set(given), text
            self.stops += 1
            return None
        if "F" in given:
            self.feed = given["F"]
            assert self.feed > 0, text
        if not set("XYZIJK") & set(given):
            return None
        return self.move(text, given)

    def move(self, text: str, given: dict[str, float]) -> Move:
        start = dict(self.at)
        end = {axis: given.get(axis, start[axis]) for axis in "XYZ"}
        self.at = end
        ends = np.array([[each[axis] for axis in "XYZ"] for each in (start, end)])
        if self.mode in (0, 1) or self.mode >= 38:
            assert not set("IJK") & set(given), text
            assert self.mode == 0 or self.feed > 0, text
            return Move(text, ends, self.mode, None if self.mode == 0 else self.feed)
        first, second, i, j, across = PLANES[self.plane]
        assert self.feed > 0, text
        assert {first, second} & set(given), f"error:26 {text}"
        assert {i, j} & set(given) and not (set("IJK") - {i, j}) & set(given), f"error:35 {text}"
        center = start[first] + given.get(i, 0.0), start[second] + given.get(j, 0.0)
        r0 = math.hypot(start[first] - center[0], start[second] - center[1])
        r1 = math.hypot(end[first] - center[0], end[second] - center[1])
        assert abs(r1 - r0) <= 0.005 or (abs(r1 - r0) <= 0.5 and abs(r1 - r0) <= 0.001 * r0), (
            f"error:33 {text}"
        )
        a0 = math.atan2(start[second] - center[1], start[first] - center[0])
        a1 = math.atan2(end[second] - center[1], end[first] - center[0])
        sweep = math.remainder(a1 - a0, math.tau)
        if self.mode == 3 and sweep <= 5e-7:
            sweep += math.tau
        if self.mode == 2 and sweep >= -5e-7:
            sweep -= math.tau
        # chords as in mc_arc of GRBL's motion_control.c
        chord = min(self.arc_tolerance, r0)
        count = max(1, math.floor(0.5 * abs(sweep) * r0 / math.sqrt(chord * (2.0 * r0 - chord))))
        part = np.linspace(0.0, 1.0, count + 1)
        radius, angle = r0 + (r1 - r0) * part, a0 + sweep * part
        points = np.zeros((count + 1, 3))
        points[:, "XYZ".index(first)] = center[0] + radius * np.cos(angle)
        points[:, "XYZ".index(second)] = center[1] + radius * np.sin(angle)
        points[:, "XYZ".index(across)] = start[across] + (end[across] - start[across]) * part
        points[0], points[-1] = ends
        return Move(text, points, self.mode, self.feed, r0)


def moves_of(texts: list[str], start: tuple[float, float, float]) -> list[Move]:
    """The moves of a program that begins at ``start``."""
    reader = Reader(at=dict(zip("XYZ", start, strict=True)))
    return [move for move in map(reader.read, texts) if move is not None]
