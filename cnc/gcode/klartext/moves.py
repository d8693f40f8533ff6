"""Moves of Klartext: straight lines, arcs, polar coordinates, rounds, chamfers and splines.

A move becomes G0 to G3 with absolute words; the interpreter does the rest. The pole, the tangent of
an arc and the angles of polar coordinates exist here only. Source: HEIDENHAIN, "TNC 640 User's
Manual Klartext Programming", "Programming contours"; for M functions "Miscellaneous functions".
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cnc.gcode.core import splines as curves
from cnc.gcode.core.call_stack import Flow
from cnc.gcode.core.control_flow import BackwardJump
from cnc.gcode.core.coordinates import Transform
from cnc.gcode.klartext.reader import Block, Item
from cnc.gcode.reader.statements import NOTED, Remark, Statement
from cnc.gcode.reader.words import MAX_NUMBER, G, LineWords, Word, under_compensation
from cnc.model.blocks import ROTARY_LETTERS, NurbsFeed
from cnc.model.diagnostics import GcodeError

# What Klartext keeps from block to block, and the way of its blocks to the interpreter.

Point = tuple[float, float]


class Session:
    """A program of Klartext that is being executed. Lengths are in units of the program.

    Attributes:
        pole: Centre of circles and of polar coordinates (CC).
        polar: Radius, angle and place of the last polar position; None after another move.
        direction: Unit vector at the end of the last move in the plane; None if it has none.
        auto_feed: F of the last TOOL CALL; ``next_feed`` until a move has taken it or its own F.
        cycle: Number of the cycle that was defined last, 0 for none.
        given: Names of the parameters that its definition gave, which ``defines`` continues.
        after_moves: Whether M89 calls the cycle after each move.
        corner_line: Line of the RND or CHF that belongs to the last move.
        frame: Datum shift of X, Y and Z (cycle 7) in mm, mirrored axes (8), angle (10).
        labels: Line of each label; None before they were searched.
    """

    def __init__(self, flow: Flow) -> None:
        self.flow, self.line = flow, 0
        self.opened = self.inches = self.defines = self.after_moves = False
        self.pole: Point | None = None
        self.polar: tuple[float, float, Point] | None = None
        self.direction: Point | None = None
        self.auto_feed: float | None = None
        self.next_feed: float | None = None
        self.cycle, self.corner_line = 0, 0
        self.given: set[str] = set()
        self.frame: tuple[tuple[float, ...], frozenset[str], float]
        self.frame = (0.0, 0.0, 0.0), frozenset(), 0.0
        self.labels: dict[str, int] | None = None
        self.jumps: dict[int, BackwardJump] = {}
        flow.parameters.written = lambda name: name[1:].upper()

    @property
    def has_plain_moves(self) -> bool:
        """Whether L is G1 with the same numbers: the feed is in effect, and no cycle follows."""
        return not (self.inches or self.after_moves or self.next_feed is not None)

    def value(self, item: Item) -> float:
        """Return the value of a word."""
        assert item.value is not None
        number = item.value(self.flow.parameters)
        if abs(number) > MAX_NUMBER:
            message = f"{item.text} is larger than {MAX_NUMBER:.0f}"
            raise item.fault("number-too-large", message)
        return number

    def feed(self, item: Item) -> float:
        """Return a feed as F of G-code. In inches Klartext counts tenths: F100 is 10 in/min."""
        return self.value(item) * (0.1 if self.inches else 1.0)

    def position(self) -> dict[str, float]:
        """Return the position in coordinates of the program, by letter of the axis."""
        motion, scale = self.flow.interpreter.motion, self.flow.interpreter.modal.scale
        place = motion.coordinates.to_program(motion.position)
        return {"X": 0.0, "Y": 0.0} | {
            letter: place[column] / (1.0 if letter.lower() in ROTARY_LETTERS else scale)
            for letter, column in motion.column.items()
        }

    def do(self, *words: Word) -> None:
        """Execute words of G-code at the current line."""
        if words:
            self.flow.interpreter.execute(Statement(words), self.line)

    def refuse_compensation(self, at: Word) -> None:
        """Refuse a block under RL or RR."""
        if self.flow.interpreter.motion.compensated:
            raise under_compensation(at, "give R0 and a move before")

    def note(self, block: Block, what: str) -> None:
        """Report a block without effect, once."""
        remark = Remark(NOTED, f"{what} has no effect here", block.column, block.length)
        self.flow.interpreter.execute(Statement(remarks=(remark,)), self.line)


# Cycles of Klartext: drilling, reaming and tapping, datum shift, mirror image and rotation.
#
# A cycle acts at the place of the tool, from the surface Q203: set-up clearance Q200, depth Q201,
# second set-up clearance Q204. Its Q parameters are read when it is called. Cycles, and modes of
# cycles, of which the manuals of the controls differ are refused. Source: HEIDENHAIN, "TNC 640
# User's Manual for Cycle Programming", "Fixed cycles: drilling", "Tapping", "Coordinate
# transformations".

MOST_PECKS = 10_000
"""Most pecks of a hole. More are a typing error."""
_ROUNDING = 1e-9
_NEEDED = {
    200: (206, 202, 210, 211), 201: (206, 208, 211), 203: (206, 202, 210, 212, 213, 205, 211, 208),
    205: (206, 202, 212, 205, 258, 259, 257, 211, 208), 206: (206, 211), 207: (239,),
}  # fmt: skip
"""Q parameters that each cycle needs besides Q200, Q201, Q203 and Q204."""
_ZERO = {213: 203, 257: 205, 379: 205, 395: 0, 373: 0}
"""Parameters that must be 0, by cycle: chip breaking, a deeper start, depth of the cylinder."""
_REFUSED = {"202": "boring", "204": "back boring", "208": "bore milling", "209": "tapping in steps"}
_TRANSFORMATIONS = {"7": ("X", "Y", "Z"), "8": ("X", "Y", "Z"), "10": ("ROT",)}
"""Words of the cycles of transformations."""


def define(session: Session, block: Block) -> None:
    """Execute CYCL DEF: keep a cycle, or put a transformation into effect."""
    number = block.items[0]
    kind, _, step = number.text.partition(".")
    if kind in _TRANSFORMATIONS and step:
        if step != "0":
            _transform(session, block, kind)
        return
    if kind not in map(str, _NEEDED) or step or session.inches:
        what = f" ({_REFUSED[kind]})" if kind in _REFUSED else ""
        what += " in inches" if session.inches else ""
        message = f"cycle {number.text}{what} is not supported"
        raise number.fault("code-not-supported", message, "let the CAM system write its moves")
    session.cycle, session.given = int(kind), set()
    session.defines, session.after_moves = True, False
    assign(session, block)


def assign(session: Session, block: Block) -> None:
    """Set the Q parameters of a block. Behind CYCL DEF they are those of the cycle."""
    for item in block.items:
        if item.key.startswith("_q"):
            session.flow.parameters.set_name(item.key, session.value(item), item.begin + 1)
            if session.defines:
                session.given.add(item.key)


def call_cycle(session: Session, block: Block) -> None:
    """Make the cycle that was defined last, at the position."""
    interpreter = session.flow.interpreter
    if not session.cycle:
        raise block.head.fault("cycle-not-active", "no cycle is defined", "write CYCL DEF before")
    session.refuse_compensation(block.head.word("", 0.0))
    feed, at = interpreter.modal.feed, block.head._replace(text=f"cycle {session.cycle}")
    for line in _Hole(session, block).moves():
        session.do(*(at.word(text[0], float(text[1:])) for text in line.split()))
    interpreter.modal.feed = feed
    session.direction = session.polar = None
    interpreter.update_plain()


class _Hole:
    """A hole of a cycle."""

    def __init__(self, session: Session, block: Block) -> None:
        self._session, self._block, self._kind = session, block, session.cycle
        for number in (200, 201, 203, 204, *_NEEDED[session.cycle]):
            if f"_q{number}" not in session.given:
                raise self._fault("cycle-word-missing", f"needs Q{number}")
        for number, kind in _ZERO.items():
            if kind in (0, session.cycle) and f"_q{number}" in session.given and self._q(number):
                raise self._fault("code-not-supported", f"with Q{number} other than 0")
        if self._q(201) > 0.0:
            raise self._fault("cycle-retract-below-bottom", "with a depth Q201 above 0")
        self.top, self.depth = self._q(203), self._q(203) + self._q(201)
        self.start = self.top + self._size(200)
        self.back = max(self.start, self.top + self._size(204))

    def _q(self, number: int) -> float:
        return self._session.flow.parameters.name(f"_q{number}", self._block.column)

    def _size(self, number: int, *, zero: bool = True) -> float:
        """Return a parameter that must not be negative, nor 0 without ``zero``."""
        value = self._q(number)
        if value < 0.0 or (value == 0.0 and not zero):
            raise self._fault("value-out-of-range", f"with Q{number} = {value:g}")
        return value

    def _fault(self, code: str, message: str) -> GcodeError:
        text = f"cycle {self._kind} {message}"
        return self._block.head.fault(code, text, "correct the last CYCL DEF")

    def moves(self) -> Iterator[str]:
        """Yield the lines of the cycle: moves, feeds, dwells. A depth of 0 makes none."""
        if self.depth == self.top:
            return
        feed = 0.0 if self._kind == 207 else self._size(206, zero=False)
        yield f"G0 Z{self.start:.9f}"
        if self._kind == 201:
            yield f"G1 Z{self.depth:.9f} F{feed:.9f}"
        else:
            yield from self._tap(feed) if self._kind in (206, 207) else self._pecks(feed)
        if self._kind not in (206, 207):
            yield from self._dwell(211)
            yield self._out(feed if self._kind != 200 else 0.0)
        if self.back > self.start:
            yield f"G0 Z{self.back:.9f}"

    def _dwell(self, number: int) -> Iterator[str]:
        if seconds := self._size(number):
            yield f"G4 P{seconds:.9f}"

    def _out(self, feed: float) -> str:
        """Return the move to the set-up clearance: at Q208, or ``feed`` if that is 0; 0 is FMAX."""
        out = feed and (self._size(208) or feed)
        return f"G1 Z{self.start:.9f} F{out:.9f}" if out else f"G0 Z{self.start:.9f}"

    def _pecks(self, feed: float) -> Iterator[str]:
        """Yield the pecks of 200, 203 and 205: each time out to the set-up clearance."""
        kind, stroke, ahead = self._kind, self._size(202, zero=False), self.start - self.top
        less, least = (0.0, 0.0) if kind == 200 else (self._size(212), self._size(205))
        if kind == 205:
            ahead = self._size(258)
            if ahead != self._q(259) or not self._q(208):
                raise self._fault("code-not-supported", "with Q258 other than Q259, or Q208 = 0")
        reached = self.top
        for _ in range(MOST_PECKS):
            reached = self.depth if reached - stroke < self.depth + _ROUNDING else reached - stroke
            yield f"G1 Z{reached:.9f} F{feed:.9f}"
            if reached == self.depth:
                return
            yield self._out(feed if kind == 203 else 0.0)
            if kind != 205:
                yield from self._dwell(210)
            if reached + ahead < self.start:
                yield f"G0 Z{reached + ahead:.9f}"
            # The decrement does not make a stroke shorter than Q205.
            stroke = max(stroke - less, min(least, stroke))
            if stroke <= 0.0:
                raise self._fault("value-out-of-range", "with Q212 and Q205 that leave no depth")
        raise self._fault("cycle-too-long", f"makes more than {MOST_PECKS} pecks")

    def _tap(self, feed: float) -> Iterator[str]:
        """Yield a thread: in, the spindle turns back, and out. 207 starts and stops the spindle."""
        modal = self._session.flow.interpreter.modal
        turn = 3 if modal.spindle == "cw" else 4
        if self._kind == 207:
            pitch = self._q(239)
            if not pitch or not modal.speed:
                raise self._fault("cycle-word-missing", "needs a pitch Q239, and S of TOOL CALL")
            turn, feed = (3 if pitch > 0.0 else 4), abs(pitch) * modal.speed
            yield f"M{turn}"
        elif modal.spindle not in ("cw", "ccw"):
            raise self._fault("spindle-stopped", "needs a turning spindle")
        yield f"G1 Z{self.depth:.9f} F{feed:.9f}"
        if self._kind == 206:
            yield from self._dwell(211)
        yield f"M{7 - turn}"
        yield f"G1 Z{self.start:.9f} F{feed:.9f}"
        yield f"M{turn}" if self._kind == 206 else "M5"


def _transform(session: Session, block: Block, kind: str) -> None:
    """Change the datum shift, the mirror image or the rotation.

    A transformation depends on those before it. So a shift comes first, and a mirror image and a
    rotation exclude each other; other orders are refused.
    """
    interpreter = session.flow.interpreter
    session.refuse_compensation(block.head.word("", 0.0))
    shift, mirrored, angle = session.frame
    words = [item for item in block.items[1:] if item.value or len(item.letter) == 1]
    for item in words:
        if item.letter not in _TRANSFORMATIONS[kind] or (item.value is None) != (kind == "8"):
            raise item.fault("code-not-supported", f"{item.text} in cycle {kind} is not supported")
    if kind == "7":
        new = dict(zip("XYZ", shift, strict=True))
        for item in words:
            old = new[item.letter] if item.key.startswith("I") else 0.0
            new[item.letter] = old + session.value(item) * interpreter.modal.scale
        if shift != (shift := tuple(new.values())) and (mirrored or angle):
            message = "a datum shift under a mirror image or rotation is not supported"
            hint = "end those before: CYCL DEF 8.1, CYCL DEF 10.1 ROT+0"
            raise block.head.fault("code-not-supported", message, hint)
    elif kind == "8":
        mirrored = frozenset(item.key for item in words)
    elif words:
        angle = session.value(words[0]) + (angle if words[0].key == "IROT" else 0.0)
    if mirrored and angle:
        message = "a mirror image and a rotation at once are not supported"
        raise block.head.fault("code-not-supported", message, "end one of them before")
    session.frame = shift, mirrored, angle
    session.pole = session.polar = session.direction = None
    column, coordinates = interpreter.motion.column, interpreter.coordinates
    shifts = zip("XYZ", shift, strict=True)
    coordinates.set_local({column[axis]: value for axis, value in shifts if axis in column})
    none = Transform.none(len(coordinates.axes))
    factors = tuple(-1.0 if axis.upper() in mirrored else 1.0 for axis in coordinates.axes)
    if angle and not column.keys() >= {"X", "Y"}:
        raise block.head.fault("axis-missing", "a rotation needs the axes X and Y")
    plane = (column["X"], column["Y"]) if angle else None
    coordinates.transform = Transform(factors, none.fixed, plane, (0.0, 0.0), angle)
    interpreter.update_plain()


_AXES = "XYZABCUVW"
ALLOWED = {
    "L": (*_AXES,), "C": (*"XYZ", "DR"), "CR": (*"XYZ", "R", "DR"), "CT": (*"XY",), "M": (),
    "LP": ("Z", "PR", "PA"), "CP": ("Z", "PA", "DR"),
}  # fmt: skip
"""Words of each move besides feed, side and M functions."""
_SIDES = {"R0": G.G40, "RL": G.G41, "RR": G.G42}
_FEEDS = ("F", "FMAX", "FAUTO")
_BEFORE = {3: (3,), 4: (4,), 7: (7,), 8: (8,), 13: (3, 8), 14: (4, 8)}
_AFTER: dict[int, tuple[int, ...]] = {5: (5,), 9: (9,)}
_LAST = {0: (5, 0), 1: (1,), 2: (2,), 30: (30,)}
"""M-codes of M functions before the move, behind it, and at the end. M0 stops the spindle, too."""
_CYCLE_AFTER_MOVES, _MACHINE, _CYCLE = 89, 91, 99
_ENDS = {107: 108, 111: 109, 117: 116, 127: 126, 129: 128, 137: 136, 145: 144}
_IDLE = {6: "M6 (TOOL CALL changes the tool)", 90: "M90 (constant feed at corners)"} | {
    end: f"M{end} (the end of M{begin})" for end, begin in _ENDS.items()
}
"""M functions without effect. Those that they end are refused."""
_NEAR = 1e-9
"""Degrees or mm that are rounding only."""
_SPLINE_START = 0.01
"""Largest distance of a spline's start from the position, mm."""


def move(session: Session, block: Block) -> None:
    """Execute L, C, CR, CT, LP, CP, or M functions alone."""
    _check_words(block)
    functions = {item: session.value(item) for item in block.items if item.key == "M"}
    for item, number in functions.items():
        if number in _IDLE:
            session.note(block, _IDLE[int(number)])
        elif number not in {*_BEFORE, *_AFTER, *_LAST, _CYCLE_AFTER_MOVES, _MACHINE, _CYCLE}:
            raise item.fault("code-not-supported", f"M{number:g} is not supported")

    def codes(table: dict[int, tuple[int, ...]]) -> list[Word]:
        return [
            item.word("M", code) for item, number in functions.items()
            for code in table.get(int(number), ())
        ]  # fmt: skip

    words, numbers = codes(_BEFORE), set(functions.values())
    side = block.find(*_SIDES)
    if side is not None and _SIDES[side.key] != session.flow.interpreter.modal.compensation:
        words.append(side.word("G", _SIDES[side.key] / 10.0))
    moves = block.head.key not in "LM" or any(item.letter in _AXES for item in block.items)
    if moves:
        _place(session, block, words, machine=_MACHINE in numbers)
    else:
        feed = block.find("F", "FAUTO")
        session.do(*words, *([_feed_word(session, feed)] if feed else []))
    session.do(*codes(_AFTER))
    session.after_moves = session.after_moves or _CYCLE_AFTER_MOVES in numbers
    if _CYCLE in numbers or (session.after_moves and moves):
        call_cycle(session, block)
    session.after_moves = session.after_moves and _CYCLE not in numbers
    session.do(*codes(_LAST))


def _check_words(block: Block) -> None:
    """Refuse words that the move does not have, and words given twice."""
    kind, seen = block.head.key, set()
    for item in block.items:
        name = "F" if item.key in _FEEDS else "R0" if item.key in _SIDES else item.letter
        if name not in (*ALLOWED[kind], "F", "R0", "M"):
            raise item.fault("klartext-word", f"{item.text} does not belong to {kind}")
        if name in seen and name != "M":
            raise item.fault("word-repeated", f"{item.text}: {name} is given twice in this block")
        seen.add(name)


def _feed_word(session: Session, item: Item) -> Word:
    """Return the F word of ``F`` or ``F AUTO``."""
    if item.key == "F":
        return item.word("F", session.feed(item))
    if session.auto_feed is None:
        raise item.fault("feed-missing", "the last TOOL CALL has no F for F AUTO", "give F here")
    return item.word("F", session.auto_feed)


def _place(session: Session, block: Block, words: list[Word], *, machine: bool) -> None:
    """Make the move of a block."""
    kind, head, start = block.head.key, block.head, session.position()
    end = _target(session, block, start)
    feed = block.find(*_FEEDS)
    rapid = feed is not None and feed.key == "FMAX"
    here = start["X"], start["Y"]
    there = end.get("X", here[0]), end.get("Y", here[1])
    more: list[Word] = []
    code, direction = 0 if rapid else 1, _unit(there[0] - here[0], there[1] - here[1])
    if kind not in ("L", "LP"):
        if feed is not None and rapid:
            raise feed.fault("code-not-supported", f"FMAX in {kind}: an arc needs a feed")
        code, more, direction = _arc(session, block, here, there)
        end |= {"X": there[0], "Y": there[1]}
    if machine:
        if kind != "L" or any(item.key.startswith("I") for item in block.items):
            raise head.fault("code-not-supported", "M91 goes with L and absolute coordinates only")
        words.append(head.word("G", 53))
    if not rapid:
        if feed is not None:
            words.append(_feed_word(session, feed))
        elif session.next_feed is not None:
            words.append(head.word("F", session.next_feed))
        session.next_feed = None
    given = {item.letter: item for item in block.items}
    words.append(head._replace(text=kind).word("G", code))
    words += [given.get(letter, head).word(letter, number) for letter, number in end.items()]
    session.do(*words, *more, *_corner_word(session, block, rapid=rapid))
    session.direction = None if machine else direction
    if kind not in ("LP", "CP"):
        session.polar = None


def _target(session: Session, block: Block, start: dict[str, float]) -> dict[str, float]:
    """Return the end of a move, by letter."""
    target: dict[str, float] = {}
    for item in block.items:
        if len(item.letter) != 1 or item.letter not in _AXES:
            continue
        target[item.letter] = session.value(item)
        if item.key.startswith("I"):
            if item.letter not in start:
                raise item.fault("axis-missing", f"the machine has no {item.letter} axis")
            target[item.letter] += start[item.letter]
    if block.head.key in ("LP", "CP"):
        target |= dict(zip("XY", _polar_end(session, block, (start["X"], start["Y"])), strict=True))
    return target


def _polar_end(session: Session, block: Block, here: Point) -> Point:
    """Return the end of LP or CP in the plane."""
    pole, last = _pole(session, block), session.polar
    angle, radius = block.find("PA", "IPA"), block.find("PR", "IPR")
    x, y = here[0] - pole[0], here[1] - pole[1]
    before, length = math.degrees(math.atan2(y, x)), math.hypot(x, y)
    if block.head.key == "CP":
        if angle is None:
            raise block.head.fault("klartext-incomplete", "CP needs the angle: PA or IPA")
        if length < _NEAR:
            raise block.head.fault("polar-at-origin", "CP begins at the pole")
    else:
        if last is not None and math.dist(last[2], here) < _NEAR:
            length, before, _ = last
        elif not (angle and radius and angle.key == "PA" and radius.key == "PR"):
            message = "LP without PR and PA, and the block before is not polar"
            raise block.head.fault("polar-at-origin", message, "give PR and PA")
        if radius is not None:
            length = session.value(radius) + (length if radius.key == "IPR" else 0.0)
    degrees = before if angle is None else session.value(angle) + before * (angle.key == "IPA")
    radians = math.radians(math.fmod(degrees, 360.0))
    end = pole[0] + length * math.cos(radians), pole[1] + length * math.sin(radians)
    if block.head.key == "CP" and abs(math.remainder(degrees - before, 360.0)) < _NEAR:
        end = here
    session.polar = length, degrees, end
    return end


def _pole(session: Session, block: Block) -> Point:
    if session.pole is None:
        hint = "write CC X.. Y.. before; a datum shift, mirror image or rotation ends it"
        raise block.head.fault("arc-center-missing", f"{block.head.key} without a CC", hint)
    return session.pole


def _arc(
    session: Session, block: Block, here: Point, there: Point
) -> tuple[int, list[Word], Point | None]:
    """Return the code of an arc, its words, and its direction at the end."""
    turn, angle, radius = block.find("DR"), block.find("IPA"), block.find("R")
    left = turn is not None and session.value(turn) > 0.0
    if block.head.key == "CT":
        centre, left = _tangent_arc(session, block, here, there)
    elif turn is None:
        raise block.head.fault("klartext-incomplete", "DR+ or DR-, the direction, is missing")
    elif radius is not None:
        size = session.value(radius)
        direction = _end_of_radius(here, there, size, left=left)
        return 3 if left else 2, [radius.word("R", size)], direction
    else:
        centre = _pole(session, block)
    offsets = zip("IJ", centre, here, strict=True)
    words = [block.head.word(letter, to - at) for letter, to, at in offsets]
    if angle is not None:
        degrees = session.value(angle)
        if degrees == 0.0 or (degrees > 0.0) != left:
            raise angle.fault("arc-angle", f"{angle.text} and DR must turn in the same direction")
        words.append(angle.word("P", math.ceil(abs(degrees) / 360.0 - _NEAR)))
    x, y = there[0] - centre[0], there[1] - centre[1]
    return 3 if left else 2, words, _unit(-y, x) if left else _unit(y, -x)


def _tangent_arc(session: Session, block: Block, here: Point, there: Point) -> tuple[Point, bool]:
    """Return the centre of an arc that continues the move before, and whether it turns left."""
    if session.direction is None:
        message, hint = "CT needs a move in the plane directly before it", "write that move before"
        raise block.head.fault("arc-tangent-missing", message, hint)
    x, y = there[0] - here[0], there[1] - here[1]
    normal = -session.direction[1], session.direction[0]
    across = x * normal[0] + y * normal[1]
    if abs(across) <= _NEAR * max(math.hypot(x, y), 1.0):
        message = "CT ends on the straight line through the move before: this is no arc"
        raise block.head.fault("arc-tangent-missing", message, "write L for a straight line")
    radius = (x * x + y * y) / (2.0 * across)
    return (here[0] + radius * normal[0], here[1] + radius * normal[1]), radius > 0.0


def _end_of_radius(here: Point, there: Point, radius: float, *, left: bool) -> Point | None:
    """Return the direction at the end of an arc by its radius; one below 0 is more than half."""
    x, y = there[0] - here[0], there[1] - here[1]
    half = math.asin(min(1.0, math.hypot(x, y) / (2.0 * abs(radius)))) if radius else 0.0
    turned = half if radius > 0.0 else math.pi - half
    angle = math.atan2(y, x) + (turned if left else -turned)
    return math.cos(angle), math.sin(angle)


def _unit(x: float, y: float) -> Point | None:
    length = math.hypot(x, y)
    return (x / length, y / length) if length else None


def centre(session: Session, block: Block) -> None:
    """Execute CC: the pole is a place, a distance from the position, or the position."""
    start = session.position()
    if block.items and sorted(item.letter for item in block.items) != ["X", "Y"]:
        raise block.head.fault("code-not-supported", "CC takes X and Y, or no word")
    pole = start | _target(session, block, start)
    session.pole, session.polar = (pole["X"], pole["Y"]), None


def _corner_word(session: Session, block: Block, *, rapid: bool) -> list[Word]:
    """Return the word of an RND or CHF behind a move; none if another block follows."""
    listing, line = session.flow.listing, session.line + 1
    corner: Block | None = None
    while corner is None and (window := listing.window(line)) is not None:
        statement = listing.statement(window, line - window.first)
        if statement is not None and isinstance(statement.control, Block):
            corner = statement.control
        line += 1
    if corner is None or corner.head.key not in ("RND", "CHF"):
        return []
    session.corner_line = line - 1
    if rapid or corner.find(*_FEEDS):
        message = f"{corner.head.text} behind FMAX, or with a feed of its own"
        raise block.head.fault("corner-next", message, "give the feed in the moves")
    letter, size = ",R" if corner.head.key == "RND" else ",C", corner.items[0]
    return [block.head._replace(text=corner.head.text).word(letter, session.value(size))]


def corner(session: Session, block: Block) -> None:
    """Check that an RND or CHF belongs to the move before it, which has made it."""
    if session.corner_line != session.line:
        raise block.head.fault("corner-next", f"{block.head.key} needs a move directly before it")
    session.corner_line, session.direction = 0, None


def spline(session: Session, block: Block) -> None:
    """Execute SPL as a Bezier curve: X(t) = K3X t^3 + K2X t^2 + K1X t + X, from t = 1 to 0."""
    motion, here = session.flow.interpreter.motion, session.flow.interpreter.here
    at, scale = block.head.word("", 0.0), session.flow.interpreter.modal.scale
    given: dict[str, float] = {}
    for item in block.items:
        if item.key in given or item.key[-1] not in "XYZFO" or item.key.startswith("I"):
            message = f"{item.text} does not belong to SPL, or is given twice"
            raise item.fault("klartext-word", message)
        if item.key.startswith("F"):
            session.do(_feed_word(session, item))
        else:
            given[item.key] = session.value(item) * scale
    session.refuse_compensation(at)
    motion.compensation.refuse_curve(at)
    start = motion.coordinates.to_program(motion.position)
    control = [start.copy() for _ in range(4)]
    for letter, column in [pair for pair in motion.column.items() if pair[0] in "XYZ"]:
        end = given.get(letter, start[column])
        k1, k2, k3 = (given.get(f"K{power}{letter}", 0.0) for power in (1, 2, 3))
        if abs(end + k1 + k2 + k3 - start[column]) > _SPLINE_START:
            message = f"SPL does not begin at the position of the tool in {letter}"
            hint = "the coordinate and K3, K2 and K1 of an axis must add up to its position"
            raise block.head.fault("nurbs-start", message, hint)
        control[1][column] = end + (2.0 * k1 + k2) / 3.0
        control[2][column], control[3][column] = end + k1 / 3.0, end
    points = np.array([motion.position, *map(motion.coordinates.to_machine, control[1:])])
    feed = motion.feed(LineWords(), points[-1].tolist(), 0.0, at)
    weights, knots = np.ones(4), curves.bezier_knots(3)
    motion.spline(NurbsFeed(here.file, here.line, 3, knots, points, weights, feed))
    session.polar = None
    session.direction = _unit(-given.get("K1X", 0.0), -given.get("K1Y", 0.0))
