"""What Klartext keeps from block to block, and the way of its blocks to the interpreter."""

from __future__ import annotations

from cnc.gcode.klartext.reader import Block, Item
from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.control_flow import BackwardJump
from cnc.gcode.syntax.statement import NOTED, Remark, Statement
from cnc.gcode.syntax.words import MAX_NUMBER, Word, under_compensation
from cnc.model.blocks import ROTARY_LETTERS

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
