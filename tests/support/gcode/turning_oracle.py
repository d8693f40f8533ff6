"""A second reader of lathe programs (FANUC system A and Haas): ends of lines, parts, threads.

It shares no code with the interpreter. It knows what a line must lead to, not the passes of its
cycles: the end point of each line, the profile that G70 to G73 leave, and the depths of threads by
the formulas of the manuals. Source: FANUC, "Operator's Manual for Lathe System", "Canned cycle" and
"Multiple repetitive cycle"; Haas, "Lathe Operator's Manual".
"""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from tests.support.gcode.turning_cases import Move

Point = tuple[float, float]
"""z and x (a radius), mm, in program coordinates."""

_WORD = re.compile(r",?([A-Z])([-+]?[0-9.]+)")
_CLOSE = 2e-3
"""mm: rounding of programs."""
_HOME = frozenset((28, 30, 53))
_MODAL = frozenset((0, 1, 2, 3, 32, 90, 92, 94, 80, 81, 82, 83, 84, 85, 87, 88, 89))
_CYCLES = frozenset((70, 71, 72, 73, 74, 75, 76))


@dataclass
class Profile:
    """A profile between two lines.

    Attributes:
        line: Line of the cycle.
        code: 70 to 73.
        lines: First and last line of the profile.
        points: From the start point, the ends of the lines.
        arcs: Points between, by the index of the end of the arc.
        shift: Allowance in z and x.
    """

    line: int
    code: int
    lines: tuple[int, int]
    points: list[Point]
    arcs: dict[int, list[Point]]
    shift: Point

    @property
    def ends(self) -> list[Point]:
        """The points without a last one that goes back along the passes: it is in the air."""
        axis = 1 if self.code == 72 else 0
        along = [point[axis] for point in self.points]
        back = len(along) > 3 and (along[-1] - along[-2]) * (along[-2] - along[0]) < 0.0
        return self.points[:-1] if back else self.points

    @property
    def surface(self) -> list[Point]:
        """The points behind the start point, with those of arcs."""
        ends = self.ends
        return [
            point
            for index in range(1, len(ends))
            for point in (*self.arcs.get(index, ()), ends[index])
        ]


@dataclass
class ThreadPasses:
    """A thread: the line, where it ends, and the x of each pass from the first to the last."""

    line: int
    end: float
    places: list[float]


@dataclass
class Reading:
    """What a program must lead to.

    Attributes:
        ends: Position after each line that moves, by line; None after a return to the reference.
        profiles: Profiles of G70 to G73.
        threads: G76 and G92 (G78).
    """

    ends: dict[int, Point | None] = field(default_factory=dict)
    profiles: list[Profile] = field(default_factory=list)
    threads: list[ThreadPasses] = field(default_factory=list)


class Unread(Exception):
    """The program has a part that this reader does not know."""


class _Reader:
    def __init__(self, text: str, increments: bool) -> None:
        self.lines = [self._words(line) for line in text.upper().splitlines()]
        self.increments = increments
        self.scale, self.motion = 1.0, 0
        self.place: Point | None = None
        self.staying: dict[str, str] = {}  # words of G92
        # Of the first line of G76: passes at full depth, least depth, allowance.
        self.form = (1, 0.0, 0.0)
        self.reading = Reading()

    @staticmethod
    def _words(line: str) -> list[tuple[str, str]]:
        code = re.sub(r"\(.*?\)|\(.*|;.*|\s", "", line)
        if re.search(r"#|\[|=|WHILE|GOTO|^/|M98|M99|G65", code):
            return [("?", line)]
        return _WORD.findall(code) if not code.startswith(("%", "O")) else []

    def length(self, text: str) -> float:
        if self.increments and "." not in text:
            return self.least(text)
        return float(text) * self.scale

    def least(self, text: str) -> float:
        """P, Q and D of FANUC's cycles: thousandths without a point."""
        unit = 0.001 if self.scale == 1.0 else 0.00254
        return float(text) * (self.scale if "." in text else unit)

    def target(self, words: dict[str, str]) -> Point:
        if self.place is None and not (("X" in words) and ("Z" in words)):
            raise Unread("a position after the reference point")
        z, x = self.place or (0.0, 0.0)
        if "X" in words:
            x = self.length(words["X"]) / 2.0
        if "U" in words:
            x += self.length(words["U"]) / 2.0
        if "Z" in words:
            z = self.length(words["Z"])
        if "W" in words:
            z += self.length(words["W"])
        return z, x

    def run(self) -> Reading:
        index = 0
        while index < len(self.lines):
            words = self.lines[index]
            if words and words[0][0] == "?":
                raise Unread(words[0][1])
            codes = [round(float(v), 1) for c, v in words if c == "G"]
            stops = [v for c, v in words if c == "M" and float(v) in (2.0, 30.0)]
            index = self._line(index, dict(words), codes)
            if stops:
                break
        return self.reading

    def _line(self, index: int, words: dict[str, str], codes: list[float]) -> int:
        number = index + 1
        for code in codes:
            if code in (20, 21):
                self.scale = 25.4 if code == 20 else 1.0
            elif code in _MODAL:
                self.motion = int(code)
        cycle = next((int(code) for code in codes if code in _CYCLES), None)
        moves = not {"X", "Z", "U", "W"}.isdisjoint(words)
        if _HOME & set(codes):
            self.place = None
            if 53 not in codes or moves:
                self.reading.ends[number] = None
            return index + 1
        if {4, 10, 50, 52} & set(codes):
            if 50 in codes and moves:
                raise Unread("G50 with coordinates")
            return index + 1
        if cycle in (70, 71, 72, 73) and "P" in words and "Q" in words:
            return self._profile(index, cycle, words)
        if cycle == 76:
            self._thread(number, words, moves)
        elif cycle in (71, 72, 73):
            return index + 1
        elif cycle in (74, 75) or (self.motion in (90, 92, 94) and moves):
            if self.motion == 92 and cycle is None:
                if 92 in codes:
                    self.staying = {}
                self.staying |= {axis: words[axis] for axis in "XZUW" if axis in words}
                z, x = self.target(self.staying)
                self.reading.threads.append(ThreadPasses(number, z, [x]))
            self.reading.ends[number] = self.place
        elif self.motion > 85 and moves:
            raise Unread(f"line {number}: a drilling cycle along X")
        elif self.motion > 80 and moves:
            # The cycle ends at the level before it.
            self.place = self.place and (self.place[0], self.target(words)[1])
            self.reading.ends[number] = self.place
        elif moves:
            self.place = self.target(words)
            self.reading.ends[number] = self.place
        return index + 1

    def _profile(self, index: int, cycle: int, words: dict[str, str]) -> int:
        numbers = [float(dict(line).get("N", "-1")) for line in self.lines]
        after = range(index, len(self.lines))
        order = [*after, *range(index)]
        first = next(i for i in order if numbers[i] == float(words["P"]))
        last = next(i for i in range(first, len(self.lines)) if numbers[i] == float(words["Q"]))
        if self.place is None:
            raise Unread("a cycle after the reference point")
        start, motion = self.place, self.motion
        points, arcs, corner = [start], {}, None
        for line in range(first, last + 1):
            given = dict(self.lines[line])
            if "A" in given and self._is_straight(line):
                raise Unread("an angle")
            if not {"X", "Z", "U", "W"}.isdisjoint(given):
                here, self.place = self.place, self.target(given)
                if corner is not None:
                    self._cut(points, arcs, corner, self.place)
                letter = next((one for one in "RCIK" if one in given), None)
                is_corner = letter is not None and self._is_straight(line)
                corner = (letter, abs(self.length(given[letter]))) if is_corner else None
                if not self._is_straight(line):
                    arcs[len(points)] = self._arc(here, self.place, given, line)
                points.append(self.place)
        self.place, self.motion = start, motion
        shift = (
            self.length(words.get("W", "0")), self.length(words.get("U", "0")) / 2.0
        )  # fmt: skip
        lines = first + 1, last + 1
        self.reading.profiles.append(Profile(index + 1, cycle, lines, points, arcs, shift))
        self.reading.ends[index + 1] = start
        return last + 1 if index < first and cycle != 70 else index + 1

    @staticmethod
    def _cut(
        points: list[Point], arcs: dict[int, list[Point]], corner: tuple[str, float], to: Point
    ) -> None:
        """Cut the last point, between two moves at right angles, by a chamfer or a round."""
        letter, size = corner
        before, middle, after = (complex(*point) for point in (points[-2], points[-1], to))
        inwards = (middle - before) / abs(middle - before)
        outwards = (after - middle) / abs(after - middle)
        begin = middle - size * inwards
        turns = [math.radians(angle) for angle in range(3, 90, 3)] if letter == "R" else []
        way = [
            begin + size * (outwards * (1.0 - math.cos(turn)) + inwards * math.sin(turn))
            for turn in turns
        ]
        end = begin + size * (inwards + outwards)
        points[-1] = (begin.real, begin.imag)
        arcs[len(points)] = [(point.real, point.imag) for point in way]
        points.append((end.real, end.imag))

    def _arc(self, here: Point, end: Point, words: dict[str, str], line: int) -> list[Point]:
        """Points of an arc: G3 turns from z to x, which is anticlockwise for z right and x up."""
        a, b = complex(*here), complex(*end)
        if a == b:
            return []
        spin = 1 if self._motion_of(line) == 3 else -1
        if "R" in words:
            middle, half = (a + b) / 2.0, abs(b - a) / 2.0
            rise = math.sqrt(max(self.length(words["R"]) ** 2 - half**2, 0.0))
            center = middle + spin * rise * 1j * (b - a) / abs(b - a)
        else:
            i, k = (self.length(words.get(letter, "0")) for letter in "IK")
            center = a + complex(k, i)
        turn = cmath.phase((b - center) / (a - center))
        if turn * spin < 0.0:
            turn += spin * math.tau
        around = [center + (a - center) * cmath.rect(1.0, turn * n / 64) for n in range(1, 64)]
        return [(point.real, point.imag) for point in around]

    def _is_straight(self, line: int) -> bool:
        return self._motion_of(line) < 2

    def _motion_of(self, line: int) -> int:
        for index in range(line, -1, -1):
            for letter, value in reversed(self.lines[index]):
                if letter == "G" and float(value) in (0, 1, 2, 3):
                    return int(float(value))
        return 0

    def _thread(self, number: int, words: dict[str, str], moves: bool) -> None:
        if not moves:
            digits = int(words["P"])
            least = self.least(words["Q"]) if "Q" in words else self.form[1]
            allowance = self.length(words["R"]) if "R" in words else self.form[2]
            self.form = (max(1, digits // 10000), least, allowance)
            return
        z, x = self.target(words)
        assert self.place is not None
        inward = math.copysign(1.0, x - self.place[1])
        if "K" in words:
            height, first, form = self.length(words["K"]), self.least(words["D"]), (1, 0.0, 0.0)
        else:
            height, first, form = self.least(words["P"]), self.least(words["Q"]), self.form
        passes, least, allowance = form
        rough, depth, n, places = height - allowance, 0.0, 0, []
        while depth < rough - 1e-9:
            n += 1
            depth = min(max(first * math.sqrt(n), depth + least), rough)
            places.append(x - inward * (height - depth))
        places += [x] * (passes if allowance else passes - 1)
        self.reading.threads.append(ThreadPasses(number, z, places))
        self.reading.ends[number] = self.place


def reading_of(text: str, *, increments: bool = False) -> Reading:
    """Read a program.

    Args:
        text: The program.
        increments: Lengths without a decimal point count 0.001 mm or 0.0001 inch.

    Raises:
        Unread: The program has a part that this reader does not know.
    """
    return _Reader(text, increments).run()


def differences(reading: Reading, moves: list[Move]) -> Iterator[str]:
    """Yield what moves do that a program does not say; positions are those of the part's zero."""
    by_line: dict[int, list[Move]] = {}
    for move in moves:
        by_line.setdefault(move.line, []).append(move)
    finished = {
        line
        for profile in reading.profiles
        if profile.code == 70
        for line in range(profile.lines[0], profile.lines[1] + 1)
    }
    for line, end in reading.ends.items():
        if end is not None and line in by_line and line not in finished:
            x, z = by_line[line][-1].points[-1]
            if math.dist((z, x), end) > _CLOSE:
                yield f"line {line} ends at z {z:.4f} x {x:.4f}, not {end}"
    for profile in reading.profiles:
        own = by_line.get(profile.line, [])
        if profile.code == 70:
            first, last = profile.lines
            own = [move for move in moves if first <= move.line <= last] + own
        yield from _missed(profile, own)
        yield from _rapids_in_the_part(profile, own)
    for thread in reading.threads:
        cuts = [move.points[-1] for move in by_line.get(thread.line, []) if not move.rapid]
        places = [x for x, z in cuts if abs(z - thread.end) < _CLOSE]
        if len(places) != len(thread.places) or not np.allclose(places, thread.places, atol=_CLOSE):
            yield f"line {thread.line}: passes at {places}, not {thread.places}"


def _missed(profile: Profile, moves: list[Move]) -> Iterator[str]:
    """Yield the points of a profile that no move ends at."""
    z, x = profile.shift if profile.code != 70 else (0.0, 0.0)
    for along, across in (profile.points if profile.code == 70 else profile.ends)[1:]:
        expected = across + x, along + z
        if not any(math.dist(move.points[-1], expected) < _CLOSE for move in moves):
            yield f"line {profile.line}: no move ends at x {expected[0]:.4f} z {expected[1]:.4f}"


def _rapids_in_the_part(profile: Profile, moves: list[Move]) -> Iterator[str]:
    """Yield the traverses of a cycle that go through the part."""
    facing = profile.code == 72
    points, start = np.array(profile.surface), np.array(profile.points[0])
    if facing:
        points, start = points[:, ::-1], start[::-1]
    heights = start[1] - points[:, 1]
    side = math.copysign(1.0, heights[np.flatnonzero(np.abs(heights) > _CLOSE)[0]])
    for move in moves:
        if not move.rapid:
            continue
        path = move.points if facing else move.points[:, ::-1]
        for a, b in pairwise(points):
            if abs(a[0] - b[0]) < _CLOSE:
                continue
            low, high = sorted((a[0], b[0]))
            inside = path[(path[:, 0] > low + _CLOSE) & (path[:, 0] < high - _CLOSE)]
            surface = a[1] + (inside[:, 0] - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
            if ((inside[:, 1] - surface) * side < -_CLOSE).any():
                yield f"line {move.line}: a traverse goes through the part of line {profile.line}"
