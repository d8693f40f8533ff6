"""What Klartext keeps from block to block, and the way of its blocks to the interpreter."""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc.gcode.klartext.reader import Block, Item
from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.control_flow import BackwardJump
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.statement import NOTED, Remark, Statement
from cnc.gcode.syntax.words import MAX_NUMBER, Word
from cnc.model.diagnostics import CncError

Point = tuple[float, float]

_LINEAR = "XYZUVW"


@dataclass(slots=True)
class Polar:
    """The last polar position: radius, angle in degrees, and its place in the plane."""

    radius: float
    angle: float
    place: Point


@dataclass(slots=True)
class Cycle:
    """The cycle that was defined last: its number, and the names of its parameters."""

    number: int
    item: Item
    given: set[str] = field(default_factory=set)


class Session:
    """A program of Klartext that is being executed.

    Attributes:
        flow: The flow of control.
        line: Number of the current line.
        inches: Whether the program is in inches.
        pole: Centre of circles and of polar coordinates (CC), in units of the program.
        polar: The last polar position; None after another move.
        direction: Unit vector at the end of the last move in the plane; None if it has none.
        auto_feed: F of the last TOOL CALL.
        next_feed: The same until a move has taken it or its own F.
        cycle: The cycle that was defined last.
        defines: Whether the lines before belong to its definition.
        after_moves: Whether M89 calls the cycle after each move.
        corner_line: Line of the RND or CHF that belongs to the last move.
        shift: Datum shift of X, Y and Z (cycle 7), mm.
        mirrored: Mirrored axes (cycle 8).
        angle: Rotation of the plane (cycle 10), degrees.
        labels: Line of each label, by text and label.
        repeats: Rounds left of each CALL LBL REP, by number of calls and line.
        jumps: The jumps back, by line.
        opened: Whether a BEGIN PGM was executed.
    """

    def __init__(self, flow: Flow) -> None:
        self.flow = flow
        self.line = 0
        self.inches = self.opened = self.defines = self.after_moves = False
        self.pole: Point | None = None
        self.polar: Polar | None = None
        self.direction: Point | None = None
        self.auto_feed: float | None = None
        self.next_feed: float | None = None
        self.cycle: Cycle | None = None
        self.corner_line = 0
        self.shift = [0.0, 0.0, 0.0]
        self.mirrored: frozenset[str] = frozenset()
        self.angle = 0.0
        self.labels: dict[str, int] | None = None
        self.repeats: dict[tuple[int, int], int] = {}
        self.jumps: dict[int, BackwardJump] = {}
        flow.parameters.written = _written

    # Values

    def value(self, item: Item) -> float:
        """Return the value of a word.

        Raises:
            GcodeError: ``number-too-large``, and the errors of its expression.
        """
        assert item.value is not None
        number = item.value(self.flow.parameters)
        if abs(number) > MAX_NUMBER:
            message = f"{item.text} is larger than {MAX_NUMBER:.0f}"
            raise item.fault("number-too-large", message)
        return number

    def feed(self, item: Item) -> float:
        """Return a feed as F of G-code. In inches Klartext counts tenths: F 100 is 10 in/min."""
        return self.value(item) * (0.1 if self.inches else 1.0)

    def position(self) -> dict[str, float]:
        """Return the position in coordinates and units of the program, by letter of the axis."""
        motion = self.flow.interpreter.motion
        scale = self.flow.interpreter.modal.scale
        place = motion.coordinates.to_program(motion.position)
        return {
            letter: place[column] / (scale if letter in _LINEAR else 1.0)
            for letter, column in motion.column.items()
        }

    # Effects

    def do(self, *words: Word) -> None:
        """Execute words of G-code at the current line."""
        self.flow.interpreter.execute(Statement(words), self.line)

    def note(self, block: Block, what: str) -> None:
        """Report a block without effect, once."""
        remark = Remark(NOTED, what, block.column, block.length)
        self.flow.interpreter.execute(Statement(remarks=(remark,)), self.line)
        self.flow.interpreter.begun = True

    def fault(self, block: Block, code: str, message: str, hint: str = "") -> CncError:
        """Return an error at a block."""
        at = Place(self.line, block.column, block.length)
        return self.flow.listing.fault(at, code, message, hint)

    def forget_place(self) -> None:
        """Forget the pole and the direction, which belong to other coordinates from here on."""
        self.pole = self.polar = self.direction = None


def _written(name: str) -> str:
    """Return the name of a parameter as Klartext writes it."""
    return name[1:].upper()
