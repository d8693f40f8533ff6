"""SINUMERIK's drilling cycles CYCLE81 to CYCLE89, once or after each move (MCALL), and patterns.

All heights are absolute, whatever the distance mode. HOLES1 has its holes on a line, HOLES2 on a
circle. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Cycles", drilling and drilling
pattern cycles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from cnc.gcode.core.call_stack import ControlStep, Flow, Maker
from cnc.gcode.reader.source_text import Place
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import Word
from cnc.model.blocks import Plane
from cnc.model.diagnostics import CncError

MOST_PECKS = 10_000
"""Most pecks of a hole. More are a typing error."""
_END, _TAPPING, _BORING = 0, 84, 89
_ROUNDING = 1e-9
_HEIGHTS = "RTP RFP SDIS DP DPR"
_NAMES = {
    81: f"{_HEIGHTS} DTB GMODE DMODE AMODE",
    82: f"{_HEIGHTS} DTB GMODE DMODE AMODE",
    83: f"{_HEIGHTS} FDEP FDPR DAM DTB DTS FRF VARI AXN MDEP VRT DTD DIS1 GMODE DMODE AMODE83",
    84: f"{_HEIGHTS} DTB SDAC MPIT PIT POSS SST SST1 AXN PTAB TECHNO VARI DAM VRT PITM PTABN PTABA"
    " GMODE DMODE AMODE84",
    85: f"{_HEIGHTS} DTB FFR RFF GMODE DMODE AMODE",
    86: f"{_HEIGHTS} DTB SDIR RPA RPO RPAP POSS GMODE DMODE AMODE",
    87: f"{_HEIGHTS} SDIR GMODE DMODE AMODE",
    88: f"{_HEIGHTS} DTB SDIR GMODE DMODE AMODE",
    89: f"{_HEIGHTS} DTB GMODE DMODE AMODE",
}
"""Arguments of each cycle in their order: return plane, reference plane, safety distance, depth and
depth from the reference plane; then those of the cycle. Later ones must be 0 or left out."""
_LEFT_HAND = 1002002
_MODES = {
    "GMODE": (0,), "AMODE": (0, 2, 10, 12), "AMODE83": (0, 1001110),
    "AMODE84": (0, 1001002, _LEFT_HAND),
}  # fmt: skip
"""Values of modes: the depth is absolute and of the tip, dwells are in s.

Of CYCLE84's AMODE the fourth digit from the right is the direction of the thread: that of the
pitch's sign (0), right (1) or left (2).
"""
_PLANE_MODES: dict[Plane, dict[str, tuple[int, ...]]] = {
    "XY": {"AXN": (0, 3), "DMODE": (0, 1, 10, 11)},
    "ZX": {"AXN": (0,), "DMODE": (0, 2, 10, 12)},
    "YZ": {"AXN": (0,), "DMODE": (0, 3, 10, 13)},
}
"""Values of modes by plane: the tool axis is perpendicular to the plane in effect, which is the
last digit of DMODE.
"""
_IN_PLANE: dict[Plane, dict[str, str]] = {
    "XY": {},
    "ZX": {"X": "Z", "Y": "X", "Z": "Y"},
    "YZ": {"X": "Y", "Y": "Z", "Z": "X"},
}
"""Letter of an axis in each plane, by its letter in G17."""
COARSE = dict(
    zip(
        (3, 4, 5, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 42, 45, 48),
        (
            0.5, 0.7, 0.8, 1, 1.25, 1.5, 1.75, 2, 2, 2.5, 2.5, 2.5, 3, 3, 3.5, 3.5, 4, 4, 4.5, 4.5,
            5,
        ),
        strict=True,
    )
)  # fmt: skip
"""Pitch of metric threads by size, mm (MPIT). Source: ISO 261, coarse pitches."""

MOST_HOLES = 100_000
"""Most holes of a pattern. More are a typing error."""
_PATTERNS = {1: "SPCA SPCO STA1 FDIS DBH NUM", 2: "CPA CPO RAD STA1 INDA NUM"}
"""Arguments in their order. HOLES1: a point of the line, its angle, distance of the first hole from
the point, distance between holes, number. HOLES2: centre, radius, angle of the first hole, angle
between holes (0 divides the circle), number."""

Point = tuple[float, float]
Move = tuple[tuple[str, float], ...]
"""Letters and numbers of the words of a line."""
_LIFT = 1.0
"""Retraction of a turning cycle without VRT, mm."""


class CycleStep(ControlStep):
    """A line with a cycle. Its arguments are computed when the line is executed."""

    __slots__ = ("flow", "values")

    def compute(self, flow: Flow, names: str) -> None:
        """Compute the arguments, whose names are given in their order.

        Raises:
            CncError: ``code-not-supported``: a later one is not 0.
        """
        self.flow = flow
        given = [value(flow.parameters) for value in self.control.values]
        self.values = dict(zip(names.split(), given, strict=False))
        for index, value in enumerate(given[len(self.values) :], len(self.values) + 1):
            if value == value and value != 0.0:
                raise self.fault("code-not-supported", f": argument {index} is not supported")

    def get(self, name: str, default: float = math.nan) -> float:
        """Return an argument; ``default`` if it is left out."""
        value = self.values.get(name, math.nan)
        return default if value != value else value

    def needs(self, name: str, meaning: str, above: float = -math.inf) -> float:
        """Return an argument that must be given, and be more than ``above``."""
        value = self.get(name)
        if not value > above:
            raise self.fault("cycle-word-missing", f" needs {name}, {meaning}")
        return value

    def fault(self, code: str, message: str, hint: str = "") -> CncError:
        """Return an error at the name of the cycle."""
        message = f"CYCLE{self.control.label}{message}"
        return self.flow.listing.fault(self.at, code, message, hint)


class TurningValues(CycleStep):
    """A line with a turning cycle: lengths and counts among its arguments."""

    __slots__ = ()

    @property
    def word(self) -> Word:
        """The name of the cycle, for messages."""
        name = f"CYCLE{self.control.label}"
        return Word(name, 0.0, name, self.at.column, self.at.length)

    def size(self, name: str, default: float = 0.0) -> float:
        """Return a length in mm, whose sign says nothing."""
        return abs(self.get(name, default)) * self.scale

    def whole(self, name: str, least: int, most: int, default: float = math.nan) -> int:
        """Return a whole number within limits."""
        value = self.get(name, default)
        if value != value or value != int(value) or not least <= value <= most:
            message = f": {name} must be a whole number from {least} to {most}"
            raise self.fault("value-out-of-range", message)
        return int(value)

    @property
    def scale(self) -> float:
        """Length of a unit of the program, mm."""
        return self.flow.interpreter.modal.scale

    @property
    def lift(self) -> float:
        """The retraction (VRT), mm."""
        return self.size("VRT") or _LIFT


class Cycle(CycleStep):
    """A line with a drilling cycle."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Make the cycle, or keep it for the moves after this line."""
        assert isinstance(self.control.label, str)
        kind = int(self.control.label)
        flow.interpreter.begun = True
        if kind == _END:
            flow.modal = None
            return line + 1
        self.compute(flow, _NAMES[kind])
        modal = flow.interpreter.modal
        if kind == _TAPPING and modal.feed_scale != modal.scale:
            message = " under G70: write G700, as its pitch gives the feed"
            raise self.fault("code-not-supported", message)
        plane = modal.plane
        moves = list(_Hole(kind, self, plane).moves())
        if self.control.keyword == "cycle":
            return self._perform(moves, line)
        flow.modal = None

        def again(after: int) -> int:
            if flow.interpreter.modal.plane != plane:
                message = f"CYCLE{kind} of MCALL in another plane than that of its line"
                hint = "write MCALL and the cycle again after the plane"
                raise flow.listing.fault(Place(after, 1), "code-not-supported", message, hint)
            return self._perform(moves, after)

        flow.begin_modal(again)
        return line + 1

    def _perform(self, moves: list[Move], line: int) -> int:
        """Make the moves, written for G17, in the plane; restore the modes that they change."""
        interpreter = self.flow.interpreter
        modal = interpreter.modal
        if modal.diameter and any(
            in_plane(letter, modal.plane) == "X" and number
            for move in moves
            for letter, number in move
        ):
            message = " moves X, and its arguments may be diameters or radii"
            raise self.fault("code-not-supported", message)
        before = modal.motion, modal.absolute, modal.feed, modal.feed_mode, modal.speed
        try:
            for move in ((("G", 90.0),), *moves):
                words = tuple(
                    Word(in_plane(letter, modal.plane), float(number), f"{letter}{number:g}", 1, 1)
                    for letter, number in move
                )
                interpreter.execute(Statement(words), line)
        finally:
            modal = interpreter.modal
            modal.motion, modal.absolute, modal.feed, modal.feed_mode, speed = before
            if modal.speed != speed and speed is not None:
                interpreter.execute(Statement((Word("S", speed, "S", 1, 1),)), line)
            interpreter.update_plain()
        return line + 1


class _Hole:
    """A hole of a cycle."""

    def __init__(self, kind: int, cycle: CycleStep, plane: Plane) -> None:
        self.kind, self.get, self.needs, self.fault = kind, cycle.get, cycle.needs, cycle.fault
        for name, known in (_MODES | _PLANE_MODES[plane]).items():
            if (mode := self.get(name, 0.0)) not in known:
                message = f": {name} {mode:g} is not supported"
                raise self.fault("code-not-supported", message)
        back, top, safe = (self.get(name) for name in ("RTP", "RFP", "SDIS"))
        depth = self.get("DP", top - abs(self.get("DPR")))
        if any(value != value for value in (back, top, safe, depth)):
            raise self.fault("cycle-word-missing", " needs RTP, RFP, SDIS, and DP or DPR")
        self.back, self.top, self.depth = back, top, depth
        self.start = top + abs(safe)
        if depth > self.start or back < self.start - _ROUNDING:
            message = ": the return plane, start and depth are not in this order"
            raise self.fault("cycle-retract-below-bottom", message)

    def moves(self) -> Iterator[Move]:
        """Yield the words of each line of the cycle: codes, heights, feeds and dwells."""
        yield ("G", 0), ("Z", self.start)
        match self.kind:
            case 83:
                yield from self._pecks()
            case 84:
                yield from self._tap()
            case 85:
                yield from self._ream()
            case 86:
                yield from self._bore()
            case 87 | 88:
                yield from self._bore_and_stop()
            case _:
                yield ("G", 1), ("Z", self.depth)
                yield from self._wait("DTB")
                if self.kind == _BORING:
                    yield ("G", 1), ("Z", self.start)
        yield ("G", 0), ("Z", self.back)

    def _wait(self, name: str) -> Iterator[Move]:
        time = self.get(name, 0.0)
        if time < 0.0:
            raise self.fault("code-not-supported", f": {name} in turns of the spindle")
        if time > 0.0:
            yield ("G", 4), ("F", time)

    def _pecks(self) -> Iterator[Move]:
        """Yield the pecks of CYCLE83: chips are broken (VARI 0) or brought out of the hole (1)."""
        out = self.get("VARI", 0.0)
        factor = self.get("FRF", 1.0) or 1.0
        if out not in (0.0, 1.0) or factor != 1.0 or self.get("DTD", 0.0) != 0.0:
            message = ": VARI other than 0 and 1, FRF other than 1, or DTD"
            raise self.fault("code-not-supported", message)
        ahead = self.get("DIS1", 0.0) or min(max(0.6, (self.top - self.depth) / 50.0), 7.0)
        back = self.get("VRT", 0.0) or 1.0
        reached = self.top
        for stroke in self._strokes():
            if reached < self.top and out:
                yield ("G", 0), ("Z", self.start)
                yield from self._wait("DTS")
                yield ("G", 0), ("Z", min(reached + ahead, self.start))
            elif reached < self.top:
                yield ("G", 1), ("Z", min(reached + back, self.start))
            reached -= stroke
            yield ("G", 1), ("Z", reached)
            yield from self._wait("DTB")

    def _strokes(self) -> Iterator[float]:
        """Yield the depth of each stroke.

        A stroke is shorter than the one before by DAM, but not shorter than DAM and MDEP. What is
        left at the end, if more than this least stroke and less than twice as much, is divided into
        two equal strokes.
        """
        first = self.get("FDEP", self.top - abs(self.get("FDPR")))
        less = self.get("DAM", 0.0)
        if first != first or first >= self.top:
            raise self.fault("cycle-word-missing", " needs FDEP or FDPR, the first depth")
        if less < 0.0 or first < self.depth - _ROUNDING:
            message = ": DAM below 0, or a first depth below the last one"
            raise self.fault("code-not-supported", message)
        left, stroke = self.top - self.depth, self.top - first
        least = min(max(less, self.get("MDEP", 0.0)), stroke)
        for _ in range(MOST_PECKS):
            if less and stroke <= least and least < left - _ROUNDING and left <= 2.0 * least:
                stroke = left / 2.0
            stroke = left if stroke > left - _ROUNDING else stroke
            yield stroke
            left -= stroke
            if left <= _ROUNDING:
                return
            stroke = max(stroke - less, least) if less else stroke
        raise self.fault("cycle-too-long", f" makes more than {MOST_PECKS} pecks")

    def _tap(self) -> Iterator[Move]:
        """Yield the thread of CYCLE84; a negative pitch is a left-hand thread."""
        size, pitch = self.get("MPIT", 0.0), self.get("PIT", 0.0)
        if self.get("VARI", 0.0) not in (0.0, 1.0, 2.0) or self.get("PTAB", 0.0) not in (0.0, 1.0):
            message = ": VARI other than 0, 1 and 2, or a pitch in inches (PTAB)"
            raise self.fault("code-not-supported", message)
        if not pitch and abs(size) in COARSE:
            pitch = math.copysign(COARSE[int(abs(size))], size)
        if self.get("AMODE84", 0.0):
            pitch = -abs(pitch) if self.get("AMODE84") == _LEFT_HAND else abs(pitch)
        if not pitch:
            raise self.fault("cycle-word-missing", " needs PIT, the pitch, or MPIT, the size")
        speed = self.needs("SST", "the speed of the spindle", 0.0)
        out = self.get("SST1", 0.0) or speed
        turn, back = (3, 4) if pitch > 0.0 else (4, 3)
        yield (("G", 94),)
        for depth, height in self._tapped():
            yield ("S", speed), ("M", turn)
            yield ("G", 1), ("Z", depth), ("F", abs(pitch) * speed)
            if depth == self.depth:
                yield from self._wait("DTB")
            yield ("S", out), ("M", back)
            yield ("G", 1), ("Z", height), ("F", abs(pitch) * out)
        after = self.get("SDAC", 5.0)
        if after not in (3.0, 4.0, 5.0):
            raise self.fault("code-not-supported", ": SDAC other than 3, 4 and 5")
        yield (("M", after),)

    def _tapped(self) -> Iterator[tuple[float, float]]:
        """Yield the strokes of CYCLE84: the depth of each, and the height to which it returns.

        VARI 1 goes DAM deeper each time and breaks the chip, back by VRT or 1 mm; VARI 2 returns to
        the start.
        """
        kind, reached = self.get("VARI", 0.0), self.top
        step = self.top - self.depth
        if kind:
            step = self.needs("DAM", "the depth of a stroke", 0.0)
        if (self.top - self.depth) > MOST_PECKS * step:
            raise self.fault("cycle-too-long", f" makes more than {MOST_PECKS} strokes")
        back = self.get("VRT", 0.0) or 1.0
        while reached - step > self.depth + _ROUNDING:
            reached -= step
            yield reached, min(reached + back, self.start) if kind == 1.0 else self.start
        yield self.depth, self.start

    def _bore_and_stop(self) -> Iterator[Move]:
        """Yield the moves of CYCLE87 and CYCLE88: spindle and program stop at the bottom."""
        turn = self.get("SDIR")
        if turn not in (3.0, 4.0):
            raise self.fault("cycle-word-missing", " needs SDIR, 3 or 4")
        yield (("M", turn),)
        yield ("G", 1), ("Z", self.depth)
        yield from self._wait("DTB")
        yield (("M", 5),)
        yield (("M", 0),)

    def _ream(self) -> Iterator[Move]:
        """Yield the moves of CYCLE85: in and out, each at a feed of its own."""
        yield ("G", 1), ("Z", self.depth), ("F", self.needs("FFR", "the feed", 0.0))
        yield from self._wait("DTB")
        out = self.needs("RFF", "the feed out of the hole", 0.0)
        yield ("G", 1), ("Z", self.start), ("F", out)

    def _bore(self) -> Iterator[Move]:
        """Yield the moves of CYCLE86: the spindle stops oriented, and the tool leaves the wall."""
        turn = self.get("SDIR")
        if turn not in (3.0, 4.0):
            raise self.fault("cycle-word-missing", " needs SDIR, 3 or 4")
        away = [self.get(name, 0.0) for name in ("RPA", "RPO", "RPAP")]
        yield (("M", turn),)
        yield ("G", 1), ("Z", self.depth)
        yield from self._wait("DTB")
        yield ("M", 19), ("R", self.get("POSS", 0.0))
        away_from_wall = zip("XYZ", away, strict=True)
        yield ("G", 91), ("G", 0), *away_from_wall
        yield ("G", 90), ("G", 0), ("Z", max(self.start, self.depth + away[2]))
        yield ("G", 91), ("G", 0), ("X", -away[0]), ("Y", -away[1])
        yield ("G", 90), ("M", turn)


def in_plane(letter: str, plane: Plane) -> str:
    """Return the letter that a word of G17 has in a plane."""
    return _IN_PLANE[plane].get(letter, letter)


class Pattern(ControlStep):
    """A line with a pattern. Its arguments are computed when the line is executed.

    Each hole is a traverse in the plane, after which the cycle of MCALL is made.
    """

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Drill the holes."""
        interpreter = flow.interpreter
        interpreter.begun = True
        if flow.modal is None:
            raise self._fault(flow, "cycle-not-active", " without MCALL and a cycle before it")
        modal = interpreter.modal
        if modal.diameter:
            message = " under DIAMON: its places may be diameters or radii"
            raise self._fault(flow, "code-not-supported", message)
        before = modal.motion, modal.absolute
        after = line + 1
        for x, y in self._holes(flow):
            first, second = (in_plane(letter, modal.plane) for letter in "XY")
            numbers = (("G", 90.0), ("G", 0.0), (first, x), (second, y))
            words = tuple(Word(letter, number, letter, 1, 1) for letter, number in numbers)
            interpreter.execute(Statement(words), line)
            after = flow.call_after(line)
        interpreter.modal.motion, interpreter.modal.absolute = before
        interpreter.update_plain()
        return after

    def _holes(self, flow: Flow) -> Iterator[Point]:
        """Yield the places of the holes."""
        kind = int(str(self.control.label))
        given = [value(flow.parameters) for value in self.control.values]
        names = _PATTERNS[kind].split()
        values = dict.fromkeys(names, 0.0)
        values |= {name: value for name, value in zip(names, given, strict=False) if value == value}
        count = values["NUM"]
        if len(given) > len(names) or not 1.0 <= count <= MOST_HOLES or count != int(count):
            message = f": its arguments are {', '.join(names)}; NUM is the number of holes"
            raise self._fault(flow, "cycle-word-missing", message)
        places = _on_line(values) if kind == 1 else _on_circle(values)
        if kind == 1:
            axes = (in_plane(letter, flow.interpreter.modal.plane) for letter in "XY")
            here = [flow.parameters.name(f"_{axis.lower()}", 1) for axis in axes]
            if math.dist(here, places[-1]) < math.dist(here, places[0]):
                places.reverse()
        yield from places

    def _fault(self, flow: Flow, code: str, message: str) -> CncError:
        return flow.listing.fault(self.at, code, f"HOLES{self.control.label}{message}")


def _on_line(values: dict[str, float]) -> list[Point]:
    angle = math.radians(values["STA1"])
    steps = (values["FDIS"] + values["DBH"] * index for index in range(int(values["NUM"])))
    return [
        (values["SPCA"] + step * math.cos(angle), values["SPCO"] + step * math.sin(angle))
        for step in steps
    ]


def _on_circle(values: dict[str, float]) -> list[Point]:
    between = values["INDA"] or 360.0 / values["NUM"]
    angles = (math.radians(values["STA1"] + between * index) for index in range(int(values["NUM"])))
    return [
        (
            values["CPA"] + values["RAD"] * math.cos(angle),
            values["CPO"] + values["RAD"] * math.sin(angle),
        )
        for angle in angles
    ]


MAKERS: dict[str, Maker] = {"cycle": Cycle, "mcall": Cycle, "s-holes": Pattern}
"""Classes of the steps of control lines, by keyword."""
