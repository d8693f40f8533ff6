"""Steps of control lines: O-words (if, while, do, repeat) and FANUC's macro B.

Macro B has GOTO, IF .. THEN, WHILE .. DO and END. Sources: LinuxCNC, "O codes"; FANUC operator's
manual, "Custom macro", branch and repetition.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cnc.gcode.program.call_stack import Flow, Listing, Loop
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Control, Statement, Value
from cnc.gcode.syntax.words import fault
from cnc.kernels.gcode.rules import rounds_of
from cnc.kernels.jit import interpreted
from cnc.model.diagnostics import CncError, GcodeError

_rounds_of = interpreted(rounds_of)

MAX_SEQUENCE = 99_999_999
"""Highest block number that can be jumped to."""


def shown(control: Control) -> str:
    """Return a control line as messages call it."""
    label = control.label if isinstance(control.label, str) else "[..]"
    match control.keyword:
        case "while-do":
            return f"DO{label}"
        case "end":
            return f"END{label}"
        case "program":
            return f"O{label}"
        case _:
            return f"o{label} {control.keyword}"


class If:
    """``o1 if``.

    Attributes:
        branches: Line and condition of each elseif.
        otherwise: The line to continue at if no condition holds.
    """

    __slots__ = ("branches", "condition", "otherwise", "parameters")

    def __init__(
        self,
        parameters: Parameters,
        condition: Value,
        branches: list[tuple[int, Value]],
        otherwise: int,
    ) -> None:
        self.parameters = parameters
        self.condition = condition
        self.branches = branches
        self.otherwise = otherwise

    def run(self, flow: Flow, line: int) -> int:
        """Enter the first branch whose condition holds."""
        if self.condition(self.parameters):
            return line + 1
        for branch, condition in self.branches:
            if _value_at(flow, branch, condition):
                return branch + 1
        return self.otherwise


class Jump:
    """A line after which the program always continues at the same line."""

    __slots__ = ("to",)

    def __init__(self, to: int) -> None:
        self.to = to

    def run(self, flow: Flow, line: int) -> int:
        """Continue at the target."""
        return self.to


class While:
    """``o1 while``, ``WHILE [..] DO1`` and ``DO1`` alone, whose condition always holds."""

    __slots__ = ("condition", "loop", "parameters")

    def __init__(self, parameters: Parameters, condition: Value, loop: Loop) -> None:
        self.parameters, self.condition, self.loop = parameters, condition, loop

    def run(self, flow: Flow, line: int) -> int:
        """Enter the loop or pass it."""
        self.loop.since = flow.executed
        value = self.condition(self.parameters)
        return line + 1 if value and value == value else self.loop.last + 1


class EndWhile:
    """The last line of a while loop. It evaluates the condition of the first line again."""

    __slots__ = ("begin", "condition", "first", "parameters")

    def __init__(self, begin: While) -> None:
        self.first, self.begin = begin.loop.first, begin.loop.first + 1
        self.condition, self.parameters = begin.condition, begin.parameters

    def run(self, flow: Flow, line: int) -> int:
        """Repeat the loop or leave it."""
        try:
            value = self.condition(self.parameters)
        except GcodeError as error:
            raise flow.listing.placed(error, self.first) from None
        return self.begin if value and value == value else line + 1


class Do:
    """The first line of do .. while."""

    __slots__ = ("loop",)

    def __init__(self, loop: Loop) -> None:
        self.loop = loop

    def run(self, flow: Flow, line: int) -> int:
        """Enter the loop."""
        self.loop.since = flow.executed
        return line + 1


class DoWhile:
    """The last line of do .. while."""

    __slots__ = ("begin", "condition", "parameters")

    def __init__(self, parameters: Parameters, condition: Value, loop: Loop) -> None:
        self.parameters, self.condition, self.begin = parameters, condition, loop.first + 1

    def run(self, flow: Flow, line: int) -> int:
        """Repeat the loop or leave it."""
        return self.begin if self.condition(self.parameters) else line + 1


class Repeat:
    """``o1 repeat [n]``.

    The count is rounded to a whole number, halves to the even one. Below 1 the loop is passed.
    """

    __slots__ = ("count", "loop", "parameters")

    def __init__(self, parameters: Parameters, count: Value, loop: Loop) -> None:
        self.parameters, self.count, self.loop = parameters, count, loop

    def run(self, flow: Flow, line: int) -> int:
        """Enter the loop or pass it."""
        self.loop.since = flow.executed
        count = int(_rounds_of(self.count(self.parameters)))
        if count < 1:
            return self.loop.last + 1
        flow.frame.counts[self] = count
        return line + 1


class EndRepeat:
    """The last line of a repeat loop. It counts the rounds down."""

    __slots__ = ("begin", "repeat")

    def __init__(self, repeat: Repeat) -> None:
        self.repeat, self.begin = repeat, repeat.loop.first + 1

    def run(self, flow: Flow, line: int) -> int:
        """Repeat the loop or leave it."""
        counts = flow.frame.counts
        counts[self.repeat] = left = counts[self.repeat] - 1
        return self.begin if left else line + 1


class BackwardJump:
    """A loop that consists of a jump back, such as GOTO or M99 P.

    Args:
        name: The jump as messages call it.
        at: The place of the jump.
    """

    __slots__ = ("at", "loop", "name")

    def __init__(self, name: str, at: Place) -> None:
        self.name, self.at = name, at
        self.loop: Loop | None = None

    def record(self, flow: Flow, listing: Listing, to: int) -> None:
        """Record a jump to a line of the listing."""
        if self.loop is None:
            self.loop = Loop(self.name, self.at, to, self.at.line, flow.executed)
            listing.loops.append(self.loop)
        self.loop.first = min(self.loop.first, to)


class Goto:
    """``GOTO n``, with or without a condition.

    The target is the first line with ``N n`` after this one in the same program, or else from the
    beginning of the program.
    """

    __slots__ = ("at", "back", "condition", "found", "parameters", "target")

    def __init__(
        self, parameters: Parameters, condition: Value | None, target: Value, at: Place
    ) -> None:
        self.parameters, self.condition, self.target, self.at = parameters, condition, target, at
        self.found: dict[float, int] = {}
        self.back = BackwardJump("this GOTO", at)

    def run(self, flow: Flow, line: int) -> int:
        """Jump if there is no condition or it holds."""
        if self.condition is not None:
            value = self.condition(self.parameters)
            if not value or value != value:
                return line + 1
        number = self.target(self.parameters)
        to = self.found.get(number)
        if to is None:
            listing = flow.listing
            to = self.found[number] = jump_target(
                listing, number, line, partial(listing.fault, self.at)
            )
        if to <= line:
            self.back.record(flow, flow.listing, to)
        return to


def jump_target(
    listing: Listing, number: float, line: int, error_of: Callable[[str, str, str], CncError]
) -> int:
    """Find the line of a block number.

    Args:
        listing: The text to search.
        number: The block number.
        line: Search from after this line to the end of its program, then from its beginning.
        error_of: Makes an error at the jump from code, message and hint.

    Returns:
        The line number of the target.

    Raises:
        CncError: ``jump-target-bad``, ``jump-target-missing``, ``jump-into-loop``.
    """
    if not (0 < number <= MAX_SEQUENCE and number == int(number)):
        raise error_of(
            "jump-target-bad",
            f"{number:g} is not a block number to jump to",
            f"block numbers are whole numbers from 1 to {MAX_SEQUENCE}",
        )
    begin, end = listing.program_around(line)
    to = listing.numbered(int(number), line + 1, end) or listing.numbered(
        int(number), begin, line + 1
    )
    if to is None:
        raise error_of(
            "jump-target-missing",
            f"there is no block N{number:.0f} in this program",
            "put this N word at the start of the target block",
        )
    for loop in listing.loops:
        if (
            loop.name.startswith("DO")
            and loop.first < to <= loop.last
            and not loop.first <= line <= loop.last
        ):
            message = f"N{number:.0f} is inside the loop {loop.name} of line {loop.first}"
            raise error_of("jump-into-loop", message, "jump to the first line of the loop")
    return to


class Conditional:
    """``IF [..] THEN`` with its assignments."""

    __slots__ = ("condition", "parameters", "then")

    def __init__(self, parameters: Parameters, condition: Value, then: Statement) -> None:
        self.parameters, self.condition, self.then = parameters, condition, then

    def run(self, flow: Flow, line: int) -> int:
        """Execute the assignments if the condition holds."""
        value = self.condition(self.parameters)
        if value and value == value:
            flow.interpreter.execute(self.then, line)
        return line + 1


class Border:
    """The first line of a program: O and a number alone."""

    __slots__ = ("at", "name")

    def __init__(self, at: Place, name: str) -> None:
        self.at, self.name = at, name

    def run(self, flow: Flow, line: int) -> int:
        """Continue if the main program begins here.

        Raises:
            CncError: ``subprogram-not-ended``, ``program-end-missing``.
        """
        if flow.frame.kind != "main":
            raise not_ended(flow, f"before {self.name} begins in line {line}")
        if flow.interpreter.begun or flow.main_border:
            message = f"{self.name} begins before the program above it has ended"
            hint = "end the main program with M30 or M2, a subprogram with M99"
            raise fault(
                "program-end-missing",
                message,
                column=self.at.column,
                length=self.at.length,
                hint=hint,
            )
        flow.main_border = line
        return line + 1


def not_ended(flow: Flow, where: str) -> CncError:
    """Return the error for a subprogram that continues into lines of another."""
    frame = flow.frame
    at = (
        Place(frame.scope, 1, len(flow.listing.source(frame.scope).rstrip()))
        if frame.scope
        else Place(frame.first)
    )
    return frame.listing.fault(
        at, "subprogram-not-ended", f"{frame.name} does not end {where}", "M99 is missing"
    )


def _value_at(flow: Flow, line: int, value: Value) -> float:
    """Compute a value that stands in another line than the one that is executed."""
    try:
        return value(flow.parameters)
    except GcodeError as error:
        raise flow.listing.placed(error, line) from None
