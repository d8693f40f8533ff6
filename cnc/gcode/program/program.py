"""A program from its first line to its end.

There is a line number and no tree of the program: each line becomes a step once, and is executed as
often as the flow of control comes by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.gcode import dialects
from cnc.gcode.codes.prepared_lines import QuickMove, kinds_of_letters, move_of
from cnc.gcode.program import block_matching, control_flow, numbered_programs, subprograms
from cnc.gcode.program.call_stack import Flow, Limits
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.program.listing import NOTHING, Listing, Mark, Page, Step
from cnc.gcode.program.plain_lines import SHORTEST, WITHOUT_POINT, StraightLane
from cnc.gcode.state.source_location import Warn
from cnc.gcode.state.tool_table import ToolTable
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.parser import Syntax
from cnc.gcode.syntax.source_text import Text, Window
from cnc.gcode.syntax.statement import Control, Statement
from cnc.model.blocks import Block
from cnc.model.diagnostics import GcodeError

TELL = 1024
"""Executed lines between two calls of ``on_line``."""


def interpret(
    text: Text,
    *,
    axes: tuple[str, ...] = ("x", "y", "z"),
    dialect: str = "auto",
    start: NDArray[np.float64] | None = None,
    block_delete: bool = False,
    warn: Warn | None = None,
    parameters: Parameters | None = None,
    tools: ToolTable | None = None,
    folders: Sequence[Path] = (),
    limits: Limits = Limits(),  # noqa: B008 it never changes
    on_line: Callable[[int], None] | None = None,
    mark_calls: bool = False,
) -> Iterator[Block]:
    """The canonical blocks of a program, as its lines are read.

    ``text`` names the program in blocks and errors. ``axes`` are the machine's, in the order of the
    columns of every position; ``start`` is the machine position (axes,) at the start, zeros by
    default. With ``block_delete`` lines that begin with ``/`` are skipped unread. ``warn`` is given
    what is legal but odd. ``parameters`` are what the program finds, and changes. ``folders`` are
    where subroutines in files are found, the program's own folder among them if it is to be.
    ``on_line`` is told the number of executed lines now and then. With ``mark_calls`` the calls of
    the main program stand among the blocks (:class:`cnc.model.blocks.CallBoundary`).

    Reading stops at M2, M30 or a second ``%``. Raises GcodeError at the first fault, with file,
    line, column, source text and hint; blocks of the lines before may have been handed on by then.
    Raises UsageError ``unknown-dialect``, ``unreadable-file``.
    """
    position = [0.0] * len(axes) if start is None else [float(value) for value in start]
    spoken = dialects.load(dialect)
    known = Parameters(macro=spoken.flavour == "macro-b") if parameters is None else parameters
    interpreter = Interpreter(text.name, axes, spoken, position, known, warn, tools)
    syntax = Syntax(
        spoken.flavour, siemens=spoken.siemens, dollar=spoken.dollar, dialect=spoken.name
    )
    listing = Listing(text, syntax, block_delete=block_delete)
    library = subprograms.Library(folders, syntax, block_delete=block_delete)
    flow = Flow(interpreter, listing, library, limits, mark_calls=mark_calls)
    yield from _run(flow, _Steps(flow, spoken), on_line)


def _run(flow: Flow, make: _Steps, on_line: Callable[[int], None] | None) -> Iterator[Block]:
    """Line by line. Everything that a line needs is a local variable: loops execute millions of
    them.
    """
    interpreter, listing = flow.interpreter, flow.listing
    execute, ready = interpreter.execute, interpreter.out.ready
    repeated_lines = flow.limits.repeated_lines
    line, first, count = 1, 1, 0
    page: Page | None = None
    steps: list[Step | Statement | None] = []
    executed = 0
    tell = check = min(TELL, repeated_lines)
    try:
        while not interpreter.ended:
            index = line - first
            if index < 0 or index >= count:
                page = listing.page(line)
                if page is None:
                    make.end_of_file(line)
                    break
                first, count, steps = page.first, page.count, page.steps
                index = line - first
            step = steps[index]
            if step is None:
                assert page is not None
                step = make.step(page, index)
                # Of a long program's lines few ever come again: what is kept would keep the garbage
                # collector busy.
                if line <= listing.high or step.__class__ not in (_Move, Statement):
                    steps[index] = step
                if line > listing.high:
                    listing.high = line
                    flow.new += 1
            executed += 1
            if executed > check:
                flow.executed = executed
                if executed - flow.new > repeated_lines:
                    raise flow.endless(line)
                if executed > tell:
                    tell = executed + TELL
                    if on_line is not None:
                        on_line(executed)
                check = min(tell, repeated_lines + flow.new)
            if step.__class__ is Statement:
                execute(step, line)
                line += 1
            else:
                flow.executed = executed
                line = step.run(flow, line)  # type: ignore[union-attr]
                executed = flow.executed
                if flow.listing is not listing:
                    listing, count = flow.listing, 0
            if ready:
                yield from ready
                ready.clear()
                interpreter.out.take_answers()
    except GcodeError as error:
        if interpreter.aborted:
            yield from ready
        raise listing.placed(error, line) from None
    flow.unwind()
    if on_line is not None:
        on_line(executed)
    yield from ready
    ready.clear()


class _Steps:
    """Makes the steps of lines, each when it is reached for the first time."""

    def __init__(self, flow: Flow, dialect: dialects.Dialect) -> None:
        self._flow = flow
        self._dialect = dialect
        self._macro = dialect.flavour == "macro-b"
        self._kinds = kinds_of_letters(dialect, flow.interpreter.motion.column)
        self._lane = StraightLane(flow.interpreter)

    def step(self, page: Page, index: int) -> Step | Statement:
        """What a line does. GcodeError if it makes no sense, or if the block that it opens does
        not.
        """
        listing, line, window = self._flow.listing, page.first + index, page.window
        if window.straight[index] >= SHORTEST:
            return _Run(self._lane, window)
        if window.plain[index] and not (
            self._flow.interpreter.points_wanted
            and window.find(WITHOUT_POINT, index, index + 1) == index
        ):
            letters, numbers = window.scan.words(index)
            if not letters:
                return NOTHING
            if move := move_of(letters, numbers, self._kinds):
                return _Move(move, window)
        statement = listing.statement(page.window, index)
        if statement is None:
            return NOTHING
        if statement.control is None:
            return self._of_words(line, statement)
        step = self._of_control(line, statement.control)
        return _Announced(statement, step) if statement.remarks else step

    def end_of_file(self, line: int) -> None:
        """The text ends before ``line``. GcodeError for what is not complete."""
        flow = self._flow
        if flow.frame.kind != "main":
            raise control_flow.not_ended(flow, "before the end of the file")
        flow.interpreter.end_of_file()
        if self._dialect.program_end:
            last = next(
                (
                    number
                    for number in range(line - 1, 0, -1)
                    if flow.listing.source(number).strip()
                ),
                1,
            )
            text = flow.listing.source(last)
            at = Mark(last, 1 if text else 0, max(len(text), 1))
            message = (
                "the program begins with % and has no second one"
                if flow.percent
                else "the program ends without M2 or M30"
            )
            raise flow.listing.fault(
                at,
                "program-end-missing",
                message,
                "end it with M2 or M30, or put it between two lines of %",
            )

    def _of_control(self, line: int, line_control: Control) -> Step:
        flow = self._flow
        step = flow.listing.steps.get(line)
        if step is None:
            if line_control.keyword == "if-then":
                assert line_control.then is not None
                step = control_flow.Conditional(
                    flow.parameters, line_control.values[0], line_control.then
                )
            else:
                step = _MAKERS[line_control.keyword](flow, line, line_control)
            # A jump knows the loop that it makes. Calls know nothing: a program may be a million of
            # them.
            if line_control.keyword in _JUMPS:
                flow.listing.steps[line] = step
        return step

    def _of_words(self, line: int, statement: Statement) -> Step | Statement:
        if statement.percent:
            return _PERCENT
        for word in statement.words:
            if (word.letter, word.number) in numbered_programs.CODES:
                if word.letter == "M":
                    self._dialect.check_m(word)
                else:
                    self._dialect.check_g(word)
                return numbered_programs.call_or_return(line, statement, word, macro=self._macro)
        if statement.words or statement.assignments or statement.remarks or statement.board:
            return statement
        return NOTHING


_JUMPS = ("goto", "if-goto")
_MAKERS: dict[str, Callable[[Flow, int, Control], Step]] = (
    block_matching.MAKERS | subprograms.MAKERS
)


class _Run:
    """A run of straight moves."""

    __slots__ = ("_lane", "_window")

    def __init__(self, lane: StraightLane, window: Window) -> None:
        self._lane = lane
        self._window = window

    def run(self, flow: Flow, line: int) -> int:
        """All of it at once, or its first line where that needs a closer look."""
        window, listing = self._window, flow.listing
        count = self._lane.run(window, line - window.first)
        if not count:
            return _executed(flow, window, line)
        last = line + count - 1
        flow.executed += count - 1
        flow.new += max(0, last - listing.high)
        listing.high = max(last, listing.high)
        return last + 1


class _Move:
    """A move of the plainest kind."""

    __slots__ = ("_move", "_window")

    def __init__(self, move: QuickMove, window: Window) -> None:
        self._move = move
        self._window = window

    def run(self, flow: Flow, line: int) -> int:
        """The quick way, or the long one where it needs a closer look."""
        return (
            line + 1
            if flow.interpreter.execute_move(self._move, line)
            else _executed(flow, self._window, line)
        )


def _executed(flow: Flow, window: Window, line: int) -> int:
    """Execute the statement of a plain line; the line to go on at."""
    statement = flow.listing.statement(window, line - window.first)
    assert statement is not None
    flow.interpreter.execute(statement, line)
    return line + 1


class _Announced:
    """A control line with a message in it."""

    def __init__(self, statement: Statement, step: Step) -> None:
        self._remarks = Statement(remarks=statement.remarks)
        self._step = step

    def run(self, flow: Flow, line: int) -> int:
        """The message first."""
        flow.interpreter.execute(self._remarks, line)
        return self._step.run(flow, line)


class _Percent:
    """``%``: a first one before any word opens the program, any other ends it."""

    def run(self, flow: Flow, line: int) -> int:
        """Open or end."""
        interpreter, frame = flow.interpreter, flow.frame
        if frame.kind != "main":
            if line == frame.begin and not frame.scope:  # of a file without an O line
                return line + 1
            raise control_flow.not_ended(flow, f"before the % in line {line}")
        if interpreter.begun or flow.percent:
            interpreter.end_of_file()
            interpreter.ended = True
        flow.percent = True
        return line + 1


_PERCENT = _Percent()
