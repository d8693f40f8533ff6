"""Where each line leaves the tool: straight moves, arcs, cycles, offsets and figures.

Lengths are mm. A position is that of the machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from tests.support.plain_reader.lines import NotRead
from tests.support.plain_reader.special_codes import CYCLES, SPECIAL

Point = tuple[float, float, float]
Words = list[tuple[str, float]]

_PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
_IDLE = {
    0, 1, 2, 3, 5, 5.1, 8, 9, 15, 16, 17, 18, 19, 20, 21, 40, 43, 49, 50, 54, 55, 56, 57, 58, 59,
    61, 61.1, 64, 69, 70, 71, 80, 90, 90.1, 91, 91.1, 93, 94, 95, 98, 99, 103, 154, 187, 700, 710,
}  # fmt: skip


@dataclass(frozen=True)
class Moved:
    """The moves of one line.

    Attributes:
        line: Source line, from 1.
        points: Ends of the moves, and the middle of each arc.
        rapid: Whether all of them are traverses.
        feed: Feed of the last feed move, mm/min; NaN where this reader does not follow it.
        is_whole: Whether the points show how far the moves go, and not only where they end.
    """

    line: int
    points: tuple[Point, ...]
    rapid: bool
    feed: float = math.nan
    is_whole: bool = True

    @property
    def box(self) -> tuple[Point, Point]:
        columns = list(zip(*self.points, strict=True))
        return tuple(map(min, columns)), tuple(map(max, columns))


@dataclass
class Figure:
    """Scaling or mirroring about a point, then rotation in XY about another one."""

    factors: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])
    about: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    angle: float = 0.0
    pivot: tuple[float, float] = (0.0, 0.0)

    def forward(self, point: list[float]) -> list[float]:
        x, y, z = (c + f * (p - c) for p, f, c in zip(point, self.factors, self.about, strict=True))
        return [*_turned(x, y, self.angle, self.pivot), z]

    def back(self, point: list[float]) -> list[float]:
        turned = [*_turned(point[0], point[1], -self.angle, self.pivot), point[2]]
        return [c + (p - c) / f for p, f, c in zip(turned, self.factors, self.about, strict=True)]


def _turned(x: float, y: float, angle: float, pivot: tuple[float, float]) -> tuple[float, float]:
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    dx, dy = x - pivot[0], y - pivot[1]
    return pivot[0] + c * dx - s * dy, pivot[1] + s * dx + c * dy


@dataclass
class Corner:
    """A chamfer or round that waits for the next move."""

    index: int
    start: Point
    end: Point
    size: float
    is_round: bool


class Mover:
    """The state of a control, and the moves that it made."""

    def __init__(self, *, dialect: str) -> None:
        self.dialect = dialect
        self.moved: list[Moved] = []
        self.at: Point = (0.0, 0.0, 0.0)
        self.unit, self.absolute, self.plane = 1.0, True, 17
        self.motion = 0.0
        self.modal_feed = math.nan
        self.feed = math.nan
        self.systems: dict[int, list[float]] = {}
        self.system = 1
        self.shift = [0.0, 0.0, 0.0]
        self.local = [0.0, 0.0, 0.0]
        self.figure = Figure()
        self.centres_absolute = self.polar = False
        self.pole = [0.0, 0.0]
        self.initial = dialect not in ("linuxcnc", "mach3")
        self.level: float | None = None
        self.hole: dict[str, float] = {}
        self.corner: Corner | None = None
        self.siemens_cycle: tuple[float, float, float] | None = None

    @property
    def origin(self) -> list[float]:
        own = self.systems.get(self.system, [0.0, 0.0, 0.0])
        return [a + b + c for a, b, c in zip(own, self.shift, self.local, strict=True)]

    @property
    def programmed(self) -> list[float]:
        """The position in the coordinates of the program, mm."""
        return self.figure.back([a - b for a, b in zip(self.at, self.origin, strict=True)])

    def machine(self, point: list[float]) -> Point:
        x, y, z = (a + b for a, b in zip(self.figure.forward(point), self.origin, strict=True))
        return x, y, z

    # One line

    def line(self, number: int, words: Words) -> None:
        """Carry out the words of a line."""
        codes = [value for letter, value in words if letter == "G"]
        given = {letter: value for letter, value in words if letter not in ("G", "M")}
        self._modes(codes, given)
        for code in codes:
            special = SPECIAL.get(code)
            if special is not None and not (code in (70, 71) and not given.keys() & set("IJL")):
                special(self, number, given, codes)
                return
        unknown = [code for code in codes if code not in _IDLE | CYCLES and not 110 <= code <= 129]
        if unknown:
            raise NotRead(f"G{unknown[0]}")
        motions = [code for code in codes if code in (0, 1, 2, 3) or code in CYCLES]
        if motions:
            self.choose(motions[-1])
        if 80 in codes:
            self.choose(80)
        if self.motion in CYCLES:
            self._cycle(number, given)
        elif given.keys() & {*"XYZ", "AP", "RP"} or (
            self.motion in (2, 3) and given.keys() & set("IJK")
        ):
            self._move(number, given)

    def _modes(self, codes: list[float], given: dict[str, float]) -> None:
        for code in codes:
            if code in (20, 21, 700, 710) or (code in (70, 71) and not given.keys() & set("PIJL")):
                self.unit = 25.4 if code in (20, 70, 700) else 1.0
            elif code in (17, 18, 19):
                self.plane = int(code)
            elif code in (90, 91):
                self.absolute = code == 90
            elif code in (90.1, 91.1):
                self.centres_absolute = code == 90.1
            elif code in (98, 99):
                self.initial = code == 98
            elif 54 <= code <= 59 and code == int(code):
                self.system = int(code) - 53
            elif code == 154 or 110 <= code <= 129:
                self.system = 100 + int(given["P"] if code == 154 else code - 109)
            elif code in (93, 95):
                self.feed = math.nan
            elif code in (15, 16):
                self.polar, self.pole = code == 16, [0.0, 0.0]
            elif code == 50 and not given.keys() & set("S"):
                self.figure = replace(self.figure, factors=[1.0, 1.0, 1.0])
            elif code == 69:
                self.figure.angle = 0.0
        if "F" in given and not set(codes) & {4, 65}:
            self.modal_feed = self.feed = given["F"] * self.unit
        if set(codes) & {93, 95}:
            self.feed = math.nan

    def choose(self, code: float) -> None:
        if code in CYCLES:
            if self.motion not in CYCLES:
                self.level, self.before = self.at[2], self.motion
                self.hole = {}
        elif code == 80:
            code = self.before if self.motion in CYCLES else self.motion
        self.motion = code

    def target(self, given: dict[str, float]) -> list[float]:
        """The programmed point of the words X, Y and Z."""
        point = self.programmed
        if "AP" in given or (self.polar and given.keys() & set("XY")):
            return self._polar_point(point, given)
        for axis, letter in enumerate("XYZ"):
            if letter in given:
                length = given[letter] * self.unit
                point[axis] = length if self.absolute else point[axis] + length
        return point

    def _polar_point(self, point: list[float], given: dict[str, float]) -> list[float]:
        if "X" in given:
            self.pole[0] = given["X"] * self.unit
        if "Y" in given:
            self.pole[1] = given["Y"]
        if not self.absolute or self.plane != 17:
            raise NotRead("G16 under G91")
        angle = math.radians(self.pole[1])
        z = given["Z"] * self.unit if "Z" in given else point[2]
        return [self.pole[0] * math.cos(angle), self.pole[0] * math.sin(angle), z]

    # Moves

    def record(self, line: int, *points: Point, rapid: bool) -> None:
        self.at = points[-1]
        self.moved.append(Moved(line, points, rapid, math.nan if rapid else self.feed))

    def _move(self, number: int, given: dict[str, float]) -> None:
        start, point = self.programmed, self.target(given)
        if ",A" in given or "ANG" in given:
            self._by_angle(start, point, given)
        points = [self.machine(point)]
        if self.motion in (2, 3):
            points.insert(0, self.machine(self._middle(start, point, given)))
        begin = self.at
        self.record(number, *points, rapid=self.motion == 0)
        self._trim(begin, points[-1])
        sizes = {name: given[name] for name in (",C", ",R", "RND", "CHR") if name in given}
        for name, size in sizes.items():
            if self.motion != 1:
                raise NotRead(name)
            self.corner = Corner(
                len(self.moved) - 1, begin, self.at, size * self.unit, name in (",R", "RND")
            )
        if self.siemens_cycle is not None:
            x, y, _ = self.at
            top, depth, out = self.siemens_cycle
            self.record(number, (x, y, top), (x, y, depth), (x, y, out), rapid=False)
            self.moved[-1] = replace(self.moved[-1], feed=math.nan)

    def _by_angle(self, start: list[float], point: list[float], given: dict[str, float]) -> None:
        slope = math.tan(math.radians(given.get(",A", given.get("ANG", 0.0))))
        if "X" in given:
            point[1] = start[1] + (point[0] - start[0]) * slope
        else:
            point[0] = start[0] + (point[1] - start[1]) / slope

    def _trim(self, begin: Point, end: Point) -> None:
        """Put the waiting chamfer or round between its move and the one from ``begin``."""
        corner, self.corner = self.corner, None
        if corner is None:
            return
        before = [a - b for a, b in zip(corner.start, corner.end, strict=True)]
        after = [a - b for a, b in zip(end, begin, strict=True)]
        before = [each / math.hypot(*before) for each in before]
        after = [each / math.hypot(*after) for each in after]
        half = math.acos(sum(a * b for a, b in zip(before, after, strict=True))) / 2
        leg = corner.size / math.tan(half) if corner.is_round else corner.size
        points = [tuple(c + leg * d for c, d in zip(begin, way, strict=True))
                  for way in (before, after)]  # fmt: skip
        if corner.is_round:
            middle = [a + b for a, b in zip(before, after, strict=True)]
            away = (corner.size / math.sin(half) - corner.size) / math.hypot(*middle)
            points.insert(1, tuple(c + away * m for c, m in zip(begin, middle, strict=True)))
        moved = self.moved[corner.index]
        self.moved[corner.index] = replace(moved, points=tuple(points))  # type: ignore[arg-type]

    def _middle(self, start: list[float], end: list[float], given: dict[str, float]) -> list[float]:
        """The point halfway along an arc, in coordinates of the program."""
        first, second, across = _PLANES[self.plane]
        ax, ay, bx, by = start[first], start[second], end[first], end[second]
        radius = given.get("R", given.get("CR"))
        if radius is None:
            i, j = (given.get("IJK"[axis], 0.0) * self.unit for axis in (first, second))
            cx, cy = (i, j) if self.centres_absolute else (ax + i, ay + j)
            if math.hypot(ax - cx, ay - cy) == 0:
                raise NotRead("an arc without a centre")
        else:
            radius *= self.unit
            chord = math.hypot(bx - ax, by - ay)
            height = math.sqrt(max(0.0, radius**2 - chord**2 / 4))
            side = (1 if self.motion == 3 else -1) * (1 if radius > 0 else -1)
            cx = (ax + bx) / 2 - side * height * (by - ay) / chord
            cy = (ay + by) / 2 + side * height * (bx - ax) / chord
        begin, finish = math.atan2(ay - cy, ax - cx), math.atan2(by - cy, bx - cx)
        sweep = (finish - begin) % math.tau
        if self.motion == 2:
            sweep -= math.tau
        if math.hypot(bx - ax, by - ay) < 1e-9:
            sweep = math.tau if self.motion == 3 else -math.tau
        r = (math.hypot(ax - cx, ay - cy) + math.hypot(bx - cx, by - cy)) / 2
        middle = list(start)
        middle[first] = cx + r * math.cos(begin + sweep / 2)
        middle[second] = cy + r * math.sin(begin + sweep / 2)
        middle[across] = (start[across] + end[across]) / 2
        return middle

    # Cycles

    def _cycle(self, number: int, given: dict[str, float]) -> None:
        if self.plane != 17:
            raise NotRead("a cycle in another plane than XY")
        self.hole |= {k: v for k, v in given.items() if k in "RZ"}
        if not given.keys() & set("XYZR"):
            return
        if not self.absolute and given.keys() & set("RZ"):
            base = self.programmed[2]
            self.hole["r"] = base + self.hole["R"] * self.unit
            self.hole["z"] = self.hole["r"] + self.hole["Z"] * self.unit
        elif self.absolute and given.keys() & set("RZ"):
            self.hole["r"] = self.hole["R"] * self.unit
            self.hole["z"] = self.hole["Z"] * self.unit
        points: list[Point] = []
        place = {k: v for k, v in given.items() if k in "XY"}
        for _ in range(int(given.get("L", given.get("K", 1)))):
            points += self.hole_points(self.target(place))
            self.at = points[-1]
        if points:
            self.record(number, *points, rapid=False)

    def hole_points(self, place: list[float]) -> list[Point]:
        x, y, z = place
        r, depth = self.hole["r"], self.hole["z"]
        above = max(r, z)
        level = self.level if self.level is not None else z
        out = max(self.machine([x, y, r])[2], level) if self.initial else self.machine([x, y, r])[2]
        top, low, bottom = (self.machine([x, y, each]) for each in (above, r, depth))
        return [(self.at[0], self.at[1], top[2]), top, low, bottom, (bottom[0], bottom[1], out)]
