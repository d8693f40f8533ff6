"""What control lines do: O-words (if, while, do, repeat) and FANUC's macro B (GOTO, IF .. THEN,
WHILE .. DO, END).

Source: LinuxCNC, "O codes"; FANUC operator's manual, "Custom macro", branch and repetition.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.listing import Listing, Loop, Mark
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Control, Statement, Value
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import CncError, GcodeError

MAX_SEQUENCE = 99_999_999
"""Highest block number that can be jumped to."""


def shown(control: Control) -> str:
    """A control line as messages call it."""
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
    """``branches``: line and condition of each elseif; ``otherwise``: where to go on if nothing
    holds.
    """

    __slots__ = ("branches", "condition", "otherwise", "parameters")

    def __init__(
        self,
        parameters: Parameters,
        condition: Value,
        branches: list[tuple[int, Value]],
        otherwise: int,
    ) -> None:
        self.parameters, self.condition, self.branches, self.otherwise = (
            parameters,
            condition,
            branches,
            otherwise,
        )

    def run(self, flow: Flow, line: int) -> int:
        """Into the first branch whose condition holds."""
        if self.condition(self.parameters):
            return line + 1
        for branch, condition in self.branches:
            if _at(flow, branch, condition):
                return branch + 1
        return self.otherwise


class Jump:
    """Go on elsewhere."""

    __slots__ = ("to",)

    def __init__(self, to: int) -> None:
        self.to = to

    def run(self, flow: Flow, line: int) -> int:
        """Go there."""
        return self.to


class While:
    """``o1 while``, ``WHILE [..] DO1`` and ``DO1`` alone, whose condition always holds."""

    __slots__ = ("condition", "loop", "parameters")

    def __init__(self, parameters: Parameters, condition: Value, loop: Loop) -> None:
        self.parameters, self.condition, self.loop = parameters, condition, loop

    def run(self, flow: Flow, line: int) -> int:
        """Into the loop or past it."""
        self.loop.since = flow.executed
        value = self.condition(self.parameters)
        return line + 1 if value and value == value else self.loop.last + 1


class EndWhile:
    """Asks the condition of the first line again."""

    __slots__ = ("begin", "condition", "first", "parameters")

    def __init__(self, begin: While) -> None:
        self.first, self.begin = begin.loop.first, begin.loop.first + 1
        self.condition, self.parameters = begin.condition, begin.parameters

    def run(self, flow: Flow, line: int) -> int:
        """Back or on."""
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
        """Go on."""
        self.loop.since = flow.executed
        return line + 1


class DoWhile:
    """The last line of do .. while."""

    __slots__ = ("begin", "condition", "parameters")

    def __init__(self, parameters: Parameters, condition: Value, loop: Loop) -> None:
        self.parameters, self.condition, self.begin = parameters, condition, loop.first + 1

    def run(self, flow: Flow, line: int) -> int:
        """Back or on."""
        return self.begin if self.condition(self.parameters) else line + 1


class Repeat:
    """``o1 repeat [n]``: the count is rounded to a whole number, halves to the even one; none below
    1.
    """

    __slots__ = ("count", "loop", "parameters")

    def __init__(self, parameters: Parameters, count: Value, loop: Loop) -> None:
        self.parameters, self.count, self.loop = parameters, count, loop

    def run(self, flow: Flow, line: int) -> int:
        """Into the loop or past it."""
        count = round(self.count(self.parameters))
        if count < 1:
            return self.loop.last + 1
        self.loop.since = flow.executed
        flow.frame.counts[self] = count
        return line + 1


class EndRepeat:
    """One time less."""

    __slots__ = ("begin", "repeat")

    def __init__(self, repeat: Repeat) -> None:
        self.repeat, self.begin = repeat, repeat.loop.first + 1

    def run(self, flow: Flow, line: int) -> int:
        """Back or on."""
        counts = flow.frame.counts
        counts[self.repeat] = left = counts[self.repeat] - 1
        return self.begin if left else line + 1


class Back:
    """Jumps that lead back make loops, too: this one is called ``name`` and stands ``at`` a
    place.
    """

    __slots__ = ("at", "loop", "name")

    def __init__(self, name: str, at: Mark) -> None:
        self.name, self.at = name, at
        self.loop: Loop | None = None

    def note(self, flow: Flow, listing: Listing, to: int) -> None:
        """It led to a line of the listing."""
        if self.loop is None:
            self.loop = Loop(self.name, self.at, to, self.at.line, flow.executed)
            listing.loops.append(self.loop)
        self.loop.first = min(self.loop.first, to)


class Goto:
    """``GOTO n``: to the first line with ``N n`` behind this one in the same program, else from the
    program's beginning.
    """

    __slots__ = ("at", "back", "condition", "found", "parameters", "target")

    def __init__(
        self, parameters: Parameters, condition: Value | None, target: Value, at: Mark
    ) -> None:
        self.parameters, self.condition, self.target, self.at = parameters, condition, target, at
        self.found: dict[float, int] = {}
        self.back = Back("this GOTO", at)

    def run(self, flow: Flow, line: int) -> int:
        """Jump, if there is no condition or it holds."""
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
            self.back.note(flow, flow.listing, to)
        return to


def jump_target(
    listing: Listing, number: float, line: int, wrong: Callable[[str, str, str], CncError]
) -> int:
    """The line of a block number, searched from behind ``line`` to the end of the program there,
    then from its beginning.

    ``wrong`` makes the error, of code, message and hint, if there is none or if it stands in a
    loop.
    """
    if not (0 < number <= MAX_SEQUENCE and number == int(number)):
        raise wrong(
            "jump-target-bad",
            f"{number:g} is no block number to jump to",
            f"they are whole numbers from 1 to {MAX_SEQUENCE}",
        )
    begin, end = listing.program_around(line)
    to = listing.numbered(int(number), line + 1, end) or listing.numbered(
        int(number), begin, line + 1
    )
    if to is None:
        raise wrong(
            "jump-target-missing",
            f"there is no block N{number:.0f} in this program",
            "give the block that is meant this N word",
        )
    for loop in listing.loops:
        if (
            loop.name.startswith("DO")
            and loop.first < to <= loop.last
            and not loop.first <= line <= loop.last
        ):
            message = f"N{number:.0f} stands inside the loop {loop.name} of line {loop.first}"
            raise wrong("jump-into-loop", message, "jump to the loop's first line")
    return to


class Conditional:
    """``IF [..] THEN`` and what it does."""

    __slots__ = ("condition", "parameters", "then")

    def __init__(self, parameters: Parameters, condition: Value, then: Statement) -> None:
        self.parameters, self.condition, self.then = parameters, condition, then

    def run(self, flow: Flow, line: int) -> int:
        """Do it if the condition holds."""
        value = self.condition(self.parameters)
        if value and value == value:
            flow.interpreter.execute(self.then, line)
        return line + 1


class Border:
    """The first line of a program."""

    __slots__ = ("at", "name")

    def __init__(self, at: Mark, name: str) -> None:
        self.at, self.name = at, name

    def run(self, flow: Flow, line: int) -> int:
        """Go on if the main program begins here. Whatever ran into it was not ended."""
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
    """The error for a subprogram that runs into what does not belong to it."""
    frame = flow.frame
    at = (
        Mark(frame.scope, 1, len(flow.listing.source(frame.scope).rstrip()))
        if frame.scope
        else Mark(frame.begin)
    )
    return frame.listing.fault(
        at, "subprogram-not-ended", f"{frame.name} does not end {where}", "M99 is missing"
    )


def _at(flow: Flow, line: int, value: Value) -> float:
    """A value that stands in another line than the one that is executed."""
    try:
        return value(flow.parameters)
    except GcodeError as error:
        raise flow.listing.placed(error, line) from None
