"""Cycles of Klartext: drilling, reaming and tapping, datum shift, mirror image and rotation.

A cycle acts at the place of the tool, from the surface Q203: set-up clearance Q200, depth Q201,
second set-up clearance Q204. Its Q parameters are read when it is called. Cycles, and modes of
cycles, of which the manuals of the controls differ are refused. Source: HEIDENHAIN, "TNC 640 User's
Manual for Cycle Programming", "Fixed cycles: drilling", "Tapping", "Coordinate transformations".
"""

from __future__ import annotations

from collections.abc import Iterator

from cnc.gcode.geometry.figure import Figure
from cnc.gcode.klartext.reader import Block
from cnc.gcode.klartext.state import Session
from cnc.model.diagnostics import GcodeError

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
    none = Figure.none(len(coordinates.axes))
    factors = tuple(-1.0 if axis.upper() in mirrored else 1.0 for axis in coordinates.axes)
    if angle and not column.keys() >= {"X", "Y"}:
        raise block.head.fault("axis-missing", "a rotation needs the axes X and Y")
    plane = (column["X"], column["Y"]) if angle else None
    coordinates.figure = Figure(factors, none.fixed, plane, (0.0, 0.0), angle)
    interpreter.update_plain()
