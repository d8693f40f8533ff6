"""Steps of control lines: O-words (if, while, do, repeat) and FANUC's macro B.

Macro B has GOTO, IF .. THEN, WHILE .. DO and END. Sources: LinuxCNC, "O codes"; FANUC operator's
manual, "Custom macro", branch and repetition.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from cnc.compiled.jit import interpreted
from cnc.gcode.core.call_stack import ControlStep, Flow, Listing, Loop
from cnc.gcode.kernels.rules import END_REPEAT, END_WHILE, IF, JUMP, REPEAT, asks_value, line_after
from cnc.gcode.reader.source_text import Place
from cnc.gcode.reader.statements import Control, Value
from cnc.model.diagnostics import CncError, GcodeError

_asks_value, _line_after = interpreted(asks_value), interpreted(line_after)

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
        case keyword if keyword.startswith("s-"):
            return keyword[2:].upper()
        case _:
            return f"o{label} {control.keyword}"


@dataclass(slots=True, eq=False)
class ControlLine:
    """A line of a branch or loop: an entry of the table of flow, which compiled code copies.

    Attributes:
        line: Its number.
        action: What it does (:mod:`cnc.gcode.kernels.rules`).
        target: The line to which it leads, but to the next one.
        value: Its condition or count.
        other: The next elseif of an if, or the first line of the loop that this line ends.
        loop: The loop that it begins.
    """

    line: int
    action: int
    target: int
    value: Value | None = None
    other: ControlLine | None = None
    loop: Loop | None = None

    def run(self, flow: Flow, line: int) -> int:
        """Return the line to continue at."""
        action, target, counts = self.action, self.target, flow.frame.counts
        if self.loop is not None:
            self.loop.since = flow.executed
        # The end of a loop that has no condition of its own has that of its first line.
        asked = self.other if action == END_WHILE and self.other else self
        value = asked.evaluate(flow, line) if _asks_value(action) else 0.0
        counted = self.other or self
        after, rounds = _line_after(action, value, counts.get(counted, 0), line, target)
        while action == IF and after == target and asked.other is not None:
            asked = asked.other
            after, _ = _line_after(IF, asked.evaluate(flow, line), 0, asked.line, target)
        if action in (REPEAT, END_REPEAT):
            counts[counted] = int(rounds)
        return int(after)

    def evaluate(self, flow: Flow, line: int) -> float:
        """Return condition or count while ``line`` is executed."""
        assert self.value is not None
        try:
            return self.value(flow.parameters)
        except GcodeError as error:
            raise (error if line == self.line else flow.listing.placed(error, self.line)) from None


def enter_branch(
    listing: Listing, chain: Sequence[tuple[int, Value]], otherwise: int, last: int
) -> None:
    """Enter the lines of an if.

    Args:
        listing: The text.
        chain: Line and condition of the if and of each elseif.
        otherwise: Line of the else; 0 for none.
        last: Its last line.
    """
    steps, alternative = listing.steps, None
    for line, condition in reversed(chain[1:]):
        alternative = steps[line] = ControlLine(line, JUMP, last + 1, condition, alternative)
    first, condition = chain[0]
    steps[first] = ControlLine(first, IF, (otherwise or last) + 1, condition, alternative)
    for line in filter(None, (otherwise, last)):
        steps[line] = ControlLine(line, JUMP, last + 1)


def enter_loop(
    listing: Listing, loop: Loop, actions: tuple[int, int], *values: Value | None
) -> None:
    """Enter the first and the last line of a loop, with their actions and values."""
    first, last, (value, last_value) = loop.first, loop.last, values
    begin = ControlLine(first, actions[0], last + 1, value, loop=loop)
    listing.steps[first] = begin
    listing.steps[last] = ControlLine(last, actions[1], first + 1, last_value, begin)
    listing.loops.append(loop)


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


class Goto(ControlStep):
    """``GOTO n``, with or without a condition.

    The target is the first line with ``N n`` after this one in the same program, or else from the
    beginning of the program.
    """

    __slots__ = ("back", "found")

    def __init__(self, flow: Flow, line: int, control: Control) -> None:
        super().__init__(flow, line, control)
        self.found: dict[float, int] = {}
        self.back = BackwardJump("this GOTO", self.at)

    def run(self, flow: Flow, line: int) -> int:
        """Jump if there is no condition or it holds."""
        *condition, target = self.control.values
        if condition and not _holds(condition[0], flow):
            return line + 1
        number = target(flow.parameters)
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


def _holds(condition: Value, flow: Flow) -> bool:
    """Return whether a condition holds: its value is not 0, and not vacant."""
    value = condition(flow.parameters)
    return value == value and value != 0.0


class Conditional(ControlStep):
    """``IF [..] THEN`` with its assignments."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Execute the assignments if the condition holds."""
        if _holds(self.control.values[0], flow):
            assert self.control.then is not None
            flow.interpreter.execute(self.control.then, line)
        return line + 1


class Border(ControlStep):
    """The first line of a program: O and a number alone."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Continue if the main program begins here.

        Raises:
            CncError: ``subprogram-not-ended``, ``program-end-missing``.
        """
        name = shown(self.control)
        if flow.frame.kind != "main":
            raise not_ended(flow, f"before {name} begins in line {line}")
        if flow.interpreter.begun or flow.main_border:
            message = f"{name} begins before the program above it has ended"
            hint = "end the main program with M30 or M2, a subprogram with M99"
            raise flow.listing.fault(self.at, "program-end-missing", message, hint)
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
