"""Cycles of Klartext: drilling, reaming and tapping, datum shift, mirror image and rotation.

A cycle acts at the place where the tool is, from the surface Q203: set-up clearance Q200, depth Q201,
second set-up clearance Q204. Its parameters are Q parameters that are read when it is called.
Cycles, and modes of cycles, of which the manuals of the controls differ are refused. Source:
HEIDENHAIN, "TNC 640 User's Manual for Cycle Programming", "Fixed cycles: drilling", "Tapping",
"Coordinate transformations".
"""

from __future__ import annotations

from collections.abc import Iterator

from cnc.gcode.geometry.figure import Figure
from cnc.gcode.klartext.reader import Block, Item
from cnc.gcode.klartext.state import Cycle, Session
from cnc.gcode.syntax.words import Word, under_compensation
from cnc.model.diagnostics import CncError

MOST_PECKS = 10_000
"""Most pecks of a hole. More are a typing error."""
_ROUNDING = 1e-9
_HEIGHTS = (200, 201, 203, 204)
PARAMETERS = {
    200: (*_HEIGHTS, 206, 202, 210, 211), 201: (*_HEIGHTS, 206, 208, 211),
    203: (*_HEIGHTS, 206, 202, 210, 212, 213, 205, 211, 208),
    205: (*_HEIGHTS, 206, 202, 212, 205, 258, 259, 257, 211, 208),
    206: (*_HEIGHTS, 206, 211), 207: (*_HEIGHTS, 239),
}  # fmt: skip
"""Q parameters that each cycle needs."""
_IDLE = {213: 203, 257: 205, 379: 205, 395: 0, 373: 0}
"""Parameters that must be 0: chip breaking, a deeper start, depth of the cylinder; by cycle."""
_REFUSED = {
    202: "boring", 204: "back boring", 208: "bore milling", 209: "tapping with chip breaking",
}  # fmt: skip
_FRAMES = ("7", "8", "10")


def define(session: Session, block: Block) -> None:
    """Execute CYCL DEF: keep a cycle, or put a transformation into effect."""
    number = next(item for item in block.items if not item.key)
    kind, _, step = number.text.partition(".")
    if kind in _FRAMES and step:
        if step != "0":
            _transform(session, block, int(kind))
        return
    if not kind.isdigit() or int(kind) not in PARAMETERS or step:
        named = _REFUSED.get(int(kind)) if kind.isdigit() else None
        name = f"cycle {number.text}" + (f" ({named})" if named else "")
        hint = "let the CAM system write its moves"
        raise number.fault("code-not-supported", f"{name} is not supported", hint)
    if session.inches:
        message = f"cycle {kind} in inches is not supported: its feeds have units of their own"
        raise number.fault("code-not-supported", message)
    session.cycle, session.defines, session.after_moves = Cycle(int(kind), number), True, False
    assign(session, block)


def assign(session: Session, block: Block) -> None:
    """Set the Q parameters of a block. Behind CYCL DEF they are those of the cycle."""
    for item in block.items:
        if item.key.startswith("_q"):
            session.flow.parameters.set_name(item.key, session.value(item), item.begin + 1)
            if session.defines and session.cycle is not None:
                session.cycle.given.add(item.key)


def call_cycle(session: Session, block: Block) -> None:
    """Make the cycle that was defined last, at the position."""
    cycle, interpreter = session.cycle, session.flow.interpreter
    if cycle is None:
        message = "no cycle is defined"
        raise session.fault(block, "cycle-not-active", message, "write CYCL DEF before")
    if interpreter.motion.compensated:
        raise under_compensation(block.head.word("", 0.0), "give R0 and a move before")
    modal = interpreter.modal
    before = modal.feed
    for line in _Hole(session, block, cycle).moves():
        session.do(
            *(
                Word(text[0], float(text[1:]), f"cycle {cycle.number}", block.column, block.length)
                for text in line.split()
            )
        )
    modal.feed = before
    session.direction = session.polar = None
    interpreter.update_plain()


class _Hole:
    """A hole of a cycle."""

    def __init__(self, session: Session, block: Block, cycle: Cycle) -> None:
        self._session, self._block, self._cycle = session, block, cycle
        for number in PARAMETERS[cycle.number]:
            if f"_q{number}" not in cycle.given:
                raise self._fault("cycle-word-missing", f"needs Q{number}")
        for number, kind in _IDLE.items():
            is_given = kind in (0, cycle.number) and f"_q{number}" in cycle.given
            if is_given and self._q(number) != 0.0:
                raise self._fault("code-not-supported", f"with Q{number} other than 0")
        top = self._q(203)
        self.start = top + self._positive(200)
        self.depth = top + self._q(201)
        self.back = max(self.start, top + self._positive(204))
        self.top = top
        if self._q(201) > 0.0:
            raise self._fault("cycle-retract-below-bottom", "with a depth Q201 above 0")

    def _q(self, number: int) -> float:
        return self._session.flow.parameters.name(f"_q{number}", self._block.column)

    def _positive(self, number: int, *, zero: bool = True) -> float:
        value = self._q(number)
        if value < 0.0 or (value == 0.0 and not zero):
            raise self._fault("value-out-of-range", f"with Q{number} = {value:g}")
        return value

    def _fault(self, code: str, message: str) -> CncError:
        text = f"cycle {self._cycle.number} {message}"
        hint = f"the cycle is defined by {self._cycle.item.text} of the last CYCL DEF"
        return self._session.fault(self._block, code, text, hint)

    def moves(self) -> Iterator[str]:
        """Yield the lines of the cycle: moves, feeds, dwells. A depth of 0 makes none."""
        if self.depth == self.top:
            return
        kind = self._cycle.number
        feed = 0.0 if kind == 207 else self._positive(206, zero=False)
        yield f"G0 Z{self.start:.9f}"
        if kind in (200, 203, 205):
            yield from self._pecks(feed)
        elif kind == 201:
            yield f"G1 Z{self.depth:.9f} F{feed:.9f}"
        else:
            yield from self._tap(feed)
        if kind not in (206, 207):
            yield from self._dwell(211)
            out = self._positive(208) or feed if kind != 200 else 0.0
            yield f"G1 Z{self.start:.9f} F{out:.9f}" if out else f"G0 Z{self.start:.9f}"
        if self.back > self.start:
            yield f"G0 Z{self.back:.9f}"

    def _dwell(self, number: int) -> Iterator[str]:
        if seconds := self._positive(number):
            yield f"G4 P{seconds:.9f}"

    def _pecks(self, feed: float) -> Iterator[str]:
        """Yield the pecks of 200, 203 and 205: each time out to the set-up clearance."""
        kind = self._cycle.number
        stroke = self._positive(202, zero=False)
        less, least = (0.0, 0.0) if kind == 200 else (self._positive(212), self._positive(205))
        ahead = self.start - self.top
        if kind == 205:
            ahead = self._positive(258)
            if ahead != self._q(259) or not self._q(208):
                raise self._fault("code-not-supported", "with Q258 other than Q259, or Q208 = 0")
        reached = self.top
        for _ in range(MOST_PECKS):
            reached = max(reached - stroke, self.depth)
            if reached - self.depth < _ROUNDING:
                reached = self.depth
            yield f"G1 Z{reached:.9f} F{feed:.9f}"
            if reached == self.depth:
                return
            out = 0.0 if kind != 203 else self._positive(208) or feed
            yield f"G1 Z{self.start:.9f} F{out:.9f}" if out else f"G0 Z{self.start:.9f}"
            if kind != 205:
                yield from self._dwell(210)
            if reached + ahead < self.start:
                yield f"G0 Z{reached + ahead:.9f}"
            # The decrement does not make a stroke shorter than Q205, nor than it was.
            stroke = max(stroke - less, min(least, stroke)) if less else stroke
            if stroke <= 0.0:
                raise self._fault("value-out-of-range", "with Q212 and Q205 that leave no depth")
        raise self._fault("cycle-too-long", f"makes more than {MOST_PECKS} pecks")

    def _tap(self, feed: float) -> Iterator[str]:
        """Yield a thread: in, the spindle turns back, and out. 207 starts and stops the spindle."""
        modal = self._session.flow.interpreter.modal
        turn = 3 if modal.spindle == "cw" else 4
        if self._cycle.number == 207:
            pitch = self._q(239)
            if not pitch or not modal.speed:
                raise self._fault("cycle-word-missing", "needs a pitch Q239, and S of TOOL CALL")
            turn, feed = (3 if pitch > 0.0 else 4), abs(pitch) * modal.speed
            yield f"M{turn}"
        elif modal.spindle not in ("cw", "ccw"):
            raise self._fault("spindle-off", "needs a turning spindle")
        yield f"G1 Z{self.depth:.9f} F{feed:.9f}"
        if self._cycle.number == 206:
            yield from self._dwell(211)
        yield f"M{7 - turn}"
        yield f"G1 Z{self.start:.9f} F{feed:.9f}"
        yield f"M{turn}" if self._cycle.number == 206 else "M5"


def _transform(session: Session, block: Block, kind: int) -> None:
    """Change the datum shift, the mirror image or the rotation.

    A transformation depends on those before it. So a shift comes first, and a mirror image and a
    rotation exclude each other; other orders are refused.
    """
    interpreter = session.flow.interpreter
    if interpreter.motion.compensated:
        raise under_compensation(block.head.word("", 0.0), "give R0 and a move before")
    shift, mirrored, angle = list(session.shift), session.mirrored, session.angle
    words = [item for item in block.items if item.key not in ("DEF", "") and not _is_name(item)]
    for item in words:
        letter = item.key.lstrip("I")
        if (letter if letter in ("ROT", "X", "Y", "Z") else "") not in _words_of(kind):
            raise item.fault("code-not-supported", f"{item.text} in cycle {kind} is not supported")
        if (item.value is None) != (kind == 8):
            raise item.fault("klartext-word", f"{item.text} does not belong to cycle {kind}")
    if kind == 7:
        for item in words:
            index = "XYZ".index(item.key[-1])
            old = shift[index] if item.key.startswith("I") else 0.0
            shift[index] = old + session.value(item) * interpreter.modal.scale
        if shift != session.shift and (mirrored or angle):
            message = "a datum shift under a mirror image or rotation is not supported"
            hint = "end those before: CYCL DEF 8.1, CYCL DEF 10.1 ROT+0"
            raise session.fault(block, "code-not-supported", message, hint)
    elif kind == 8:
        mirrored = frozenset(item.key for item in words)
    elif words:
        angle = session.value(words[0]) + (angle if words[0].key == "IROT" else 0.0)
    if mirrored and angle:
        message = "a mirror image and a rotation at once are not supported"
        raise session.fault(block, "code-not-supported", message, "end one of them before")
    session.shift, session.mirrored, session.angle = shift, mirrored, angle
    session.forget_place()
    column, coordinates = interpreter.motion.column, interpreter.coordinates
    coordinates.set_local(
        {column[axis]: shift["XYZ".index(axis)] for axis in "XYZ" if axis in column}
    )
    none = Figure.none(len(coordinates.axes))
    factors = tuple(-1.0 if axis.upper() in mirrored else 1.0 for axis in coordinates.axes)
    plane = (column["X"], column["Y"]) if angle else None
    coordinates.figure = Figure(factors, none.fixed, plane, (0.0, 0.0), angle)
    interpreter.begun = True
    interpreter.update_plain()


def _words_of(kind: int) -> tuple[str, ...]:
    return ("ROT",) if kind == 10 else ("X", "Y", "Z")


def _is_name(item: Item) -> bool:
    """Whether an item is a word of the cycle's name."""
    return item.value is None and len(item.key.lstrip("I")) > 1
