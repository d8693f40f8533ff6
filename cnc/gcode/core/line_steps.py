"""Steps of lines: a run of plain lines, a control line, or ``%``.

All other lines are executed as statements and have no step class.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np

from cnc.gcode import dialects
from cnc.gcode.core import block_matching, control_flow, subprograms
from cnc.gcode.core.builder_codes import file_of
from cnc.gcode.core.call_stack import NOTHING, Flow, Frame, Maker, Page, Step
from cnc.gcode.core.compiled_program import CompiledProgram
from cnc.gcode.core.interpreter import Interpreter
from cnc.gcode.core.line_machine import MOST_ROWS, LineMachine
from cnc.gcode.core.line_trace import Bulk
from cnc.gcode.kernels.line import execute_lines
from cnc.gcode.klartext import steps as klartext
from cnc.gcode.klartext.moves import Session
from cnc.gcode.macro_b import subprograms as numbered_programs
from cnc.gcode.reader.lines import KLARTEXT
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.source_text import Place, Text, Window, lines_from
from cnc.gcode.reader.statements import Control, Statement
from cnc.gcode.reader.words import Word, fault
from cnc.machine.program_codes import CodeAction, RunFile
from cnc.model.diagnostics import Fix, GcodeError

# The ``%`` that begins and ends a program.

_COMMENT = re.compile(r"\([^)]*\)?|;.*", re.DOTALL)
_CODE = re.compile(r"[A-Za-z#][ \t]*[-+#\[<]?[ \t]*[0-9.]")
_WORD = re.compile(r"(?<![A-Za-z])[A-Za-z#][ \t]*[-+#\[<]?[ \t]*[0-9.]")
_NUMBER = re.compile(r"[ \t]*O[ \t]*[0-9]{1,8}[ \t]*(?:[(;].*)?$", re.IGNORECASE | re.DOTALL)


LEADER = 20
"""Most lines before the first %."""


def leader(text: Text, syntax: Syntax) -> int:
    """Return the number of lines before the program that are no G-code; 0 for none.

    FANUC's and Haas' controls ignore what precedes the first ``%`` or the first end of line: the
    leader of a tape. A line that can be read is none: a file whose first ``%`` is missing would
    lose a program. So the one line before the number of a program must have no word of G-code.

    Source: FANUC Series 16i, "Operator's Manual", file format of memory cards.
    """
    unreadable, is_text, lines = False, False, text.first_lines()
    for count, line in enumerate(lines):
        if count == 1 and is_text and _NUMBER.match(line.rstrip("\r\n")):
            return count
        if line.strip() == "%":
            begins = unreadable and any(_CODE.search(_COMMENT.sub("", behind)) for behind in lines)
            return count if begins else 0
        if count == LEADER:
            break
        try:
            statement = parse_line(line.rstrip("\r\n"), syntax)
        except GcodeError:
            unreadable = True
            is_text = count == 0 and not _WORD.search(_COMMENT.sub("", line))
            continue
        if statement.words or statement.computed or statement.control:
            break
    return 0


class PercentStep:
    """``%``. The first one, before any word, begins the program; any other ends it."""

    def run(self, flow: Flow, line: int) -> int:
        """Begin or end the program."""
        interpreter, frame = flow.interpreter, flow.frame
        if frame.kind != "main":
            if line == frame.first and not frame.scope:  # of a file without an O line
                return line + 1
            raise control_flow.not_ended(flow, f"before the % in line {line}")
        if interpreter.begun and not flow.percent:
            self._check_unopened(flow, line)
        if interpreter.begun or flow.percent:
            self._check_behind(flow, line)
            interpreter.end_of_file()
            interpreter.ended = True
        flow.percent = True
        return line + 1

    @staticmethod
    def _check_unopened(flow: Flow, line: int) -> None:
        """Refuse a % that would end a program without a first one.

        As the last line it is what other controllers leave of a pair of %.
        """
        at = Place(line, 1)
        message = "this % ends the program, and no % begins it"
        hint = "begin the program with %, or end it with M2 or M30"
        if not flow.interpreter.dialect.lenient or _has_code(flow, line + 1):
            raise flow.listing.fault(at, "percent-place", message, hint)
        _warn_of_percent("percent-unopened", flow, line, message, hint)

    @staticmethod
    def _check_behind(flow: Flow, line: int) -> None:
        """Report code behind the % that ends the program: GRBL would execute it."""
        behind = _next_words(flow, line + 1)
        if behind is None:
            return
        message = f"this % ends the program, and the code from line {behind} on is not executed"
        hint = "remove this %, or the lines behind it"
        if flow.interpreter.dialect.lenient:
            raise flow.listing.fault(Place(line, 1), "percent-place", message, hint)
        _warn_of_percent("percent-code-behind", flow, line, message, hint)


def _warn_of_percent(code: str, flow: Flow, line: int, message: str, hint: str) -> None:
    flow.interpreter.here.line = line
    flow.interpreter.here.report_warning(code, message, Word("%", 0.0, "%", 1, 1), hint)


def _has_code(flow: Flow, line: int) -> bool:
    """Whether a line from here on is not empty."""
    return any(text.strip(" \t\0\x1a") for _, text in lines_from(flow.listing, line))


def _next_words(flow: Flow, line: int) -> int | None:
    """Return the first line from here on that has a word of G-code outside of comments."""
    for number, text in lines_from(flow.listing, line):
        if _CODE.search(_COMMENT.sub("", text)):
            return number
    return None


# Runs of plain lines, executed by compiled code (:mod:`cnc.gcode.kernels.line`).
#
# A program of a million lines makes no Python object for a line, only for its blocks. The result is
# the same as that of the interpreter.

SHORTEST = 6
"""Lines. A shorter run is no faster in compiled code."""
ROWS_OF_LINE = 5
"""Rows for which there is space for each line of a run: a hole has as many."""

_IS_DISTANCE = np.zeros(256, np.bool_)
_IS_DISTANCE[list(b"XYZABCUVWIJKR")] = True
"""Letters whose numbers are distances, or may be."""
_POINT = ord(".")


class PlainLines:
    """Executes runs of plain lines in place of an interpreter."""

    def __init__(
        self, interpreter: Interpreter, machine: LineMachine, bulk: Bulk | None = None
    ) -> None:
        self._interpreter = interpreter
        self._machine = machine
        self._bulk = bulk
        self._searched: tuple[Window | None, range, int] = (None, range(0), 0)

    def leaves(self, window: Window, index: int) -> bool:
        """Return whether compiled code does not know a word of a line, in whatever mode."""
        return self._machine.leaves(*window.line_words(index))

    def run(self, window: Window, index: int) -> int:
        """Execute consecutive plain lines.

        Stops before a line that needs the interpreter. Does nothing while a mode is in effect that
        the compiled code does not support.

        Args:
            window: The text.
            index: The first line.

        Returns:
            The number of lines executed.
        """
        interpreter = self._interpreter
        if not self._machine.ready():
            return 0
        end = index + int(window.simple[index])
        if self._bulk is not None:
            end = index + self._bulk(window, index, end)
            if end < index + SHORTEST:
                return 0
        if window.language == KLARTEXT:
            # The block behind the last move may be its corner, and may need its direction.
            end -= 1
        if interpreter.points_wanted:
            end = self._without_point(window, index, end)
        job = self._machine.begin(min(MOST_ROWS, ROWS_OF_LINE * (end - index)))
        first, words = window.sorted.lines.first, window.sorted.words
        setup, state, position, rows, _ = job
        count = int(
            execute_lines(
                first, words, index, end, window.first + index, setup, state, position, rows
            )
        )
        if first[index + count] > first[index]:
            interpreter.begun = True
            last = int(first[index : index + count].searchsorted(first[index + count])) - 1
            interpreter.here.line = window.first + index + last
        if count:
            self._machine.finish(job)
        return count

    def _without_point(self, window: Window, index: int, end: int) -> int:
        """Return the first line with a distance without a decimal point; ``end`` for none.

        The last search is kept: if many runs are short, each would search the rest of the window.
        """
        where, lines, missing = self._searched
        if where is not window or index not in lines or end > lines.stop or missing < index:
            missing = _first_without_point(window, index, end)
            self._searched = window, range(index, end), missing
        return min(missing, end)


def _first_without_point(window: Window, index: int, end: int) -> int:
    """Return the first line from ``index`` to before ``end`` with such a distance, or ``end``."""
    lines, words, *_ = window.sorted
    begins, ends = window.places
    some = slice(lines.first[index], lines.first[end])
    numbers = words.number[some]
    # A number that is not whole has a decimal point.
    whole = (numbers == np.trunc(numbers)) & (numbers != 0.0) & _IS_DISTANCE[words.letter[some]]
    if not whole.any():
        return end
    places = np.flatnonzero(whole) + some.start
    of_line = np.searchsorted(lines.first, places, side="right") - 1
    text = np.frombuffer(window.data, np.uint8)[begins[index] : ends[end - 1]]
    points = np.cumsum(text == _POINT, dtype=np.int32)
    first = begins[of_line] - begins[index] + words.column[places] - 1
    missing = points[first] == points[first + words.length[places] - 1]
    return int(of_line[np.argmax(missing)]) if missing.any() else end


# Builder's M-codes that execute a file: ``M31 = { file = "m31.ngc" }`` in the machine file.


class FileCall:
    """A line with such a code: its other words are executed, then the lines of the file."""

    __slots__ = ("at", "code", "file", "rest")

    def __init__(self, line: int, statement: Statement, code: Word, file: RunFile) -> None:
        self.at = Place(line, code.column, code.length)
        self.code = code
        self.file = file.file
        self.rest = statement.with_words(
            index for index, word in enumerate(statement.words) if word is not code
        )

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, then enter the file."""
        flow.interpreter.begun = True
        if self.rest != Statement():
            flow.interpreter.execute(self.rest, line)
        if any(frame.listing.name == str(self.file) for frame in (flow.frame, *flow.frames)):
            message = f"{self.code.written} is in the file that it executes, {self.file}"
            raise flow.listing.placed(fault("call-too-deep", message, self.code), line)
        listing = flow.library.open(self.file, self.at)
        frame = Frame("program", self.code.written, listing, 0, flow.listing, self.at, line + 1)
        frame.ends_with_file = True
        return flow.enter(frame)


def file_call(line: int, statement: Statement, codes: Mapping[int, CodeAction]) -> FileCall | None:
    """Return the step of a line with a code that executes a file; None for another line."""
    for word in statement.words:
        if word.letter == "M" and word.number == word.number:
            file = file_of(codes.get(int(word.number)))
            if file is not None and word.number.is_integer():
                return FileCall(line, statement, word, file)
    return None


MANY_LINES = 500
"""Lines of a window, or executed lines, from which on compiled code is worth its start."""
_JUMPS = ("goto", "if-goto", "s-goto")
_PROFILE_CODES = frozenset((70.0, 71.0, 71.1, 71.2, 72.0, 72.1, 72.2))


CodeStep = Callable[[Flow, int, Statement], Step | None]
"""Makes the step of a line with codes that change the flow's state; None for another line."""


def _makers(flavour: str) -> tuple[Mapping[str, Maker], CodeStep | None]:
    """Return the functions that make the step of a control line of a language, by keyword.

    The second result makes the steps of lines with certain codes; None where there are none.
    """
    if flavour == "siemens":
        # Most programs are in another language.
        from cnc.gcode.sinumerik import cycles, flow

        makers = cycles.MAKERS | flow.MAKERS | {"s-turn": _turning_cycle}
        return makers, flow.step_of_code
    if flavour == "klartext":
        return klartext.MAKERS, None
    return block_matching.MAKERS | subprograms.MAKERS, None


def _turning_cycle(flow: Flow, line: int, control: Control) -> Step:
    """Return the step of a turning cycle of SINUMERIK."""
    from cnc.gcode.sinumerik.turning import TurningCycle  # most programs have none

    return TurningCycle(flow, line, control)


class StepMaker:
    """Makes the steps of lines when they are reached for the first time."""

    def __init__(
        self,
        flow: Flow,
        dialect: dialects.Dialect,
        codes: Mapping[int, CodeAction],
        bulk: Bulk | None = None,
    ) -> None:
        self._flow = flow
        self._builder_codes = codes
        self._dialect = dialect
        self._macro = dialect.flavour == "macro-b"
        self._makers, self._step_of_code = _makers(dialect.flavour)
        machine = LineMachine(flow.interpreter)
        self._runs = PlainLines(flow.interpreter, machine, bulk)
        is_compiled = dialect.flavour in ("ngc", "siemens") and bulk is None
        self._compiled = CompiledProgram(flow, machine) if is_compiled else None
        self._is_long = False

    def compile_from_here(self, executed: int) -> bool:
        """Return whether compiled code is worth its start from now on, and was not before.

        Args:
            executed: Number of lines executed so far.
        """
        if self._compiled is None or self._is_long or executed < MANY_LINES:
            return False
        self._is_long = True
        return True

    def step(self, page: Page, index: int) -> Step | Statement:
        """Return the step of a line, and keep it if the line is likely to be executed again.

        Raises:
            GcodeError: The line is faulty, or the block that it opens.
        """
        listing, line = self._flow.listing, page.first + index
        step = self._make(page.window, line, index)
        if line in listing.section_ends:
            end = listing.section_ends[line]
            step = end(_Alone(step) if isinstance(step, Statement) else step)
        # Few lines of a long program are executed again. If their statements were kept, the garbage
        # collector would take much time.
        if line <= listing.last_executed or step.__class__ is not Statement:
            page.steps[index] = step
        if line > listing.last_executed:
            listing.last_executed = line
            self._flow.new += 1
        return step

    def end_of_file(self, line: int) -> int | None:
        """End the program, or the file of a builder's code, at the end of the text.

        Args:
            line: The line after the last one.

        Returns:
            The line of the caller to continue at; None at the end of the program.

        Raises:
            GcodeError: The program is not complete.
        """
        flow = self._flow
        if flow.frame.ends_with_file:
            return flow.leave()
        if flow.frame.kind != "main":
            raise control_flow.not_ended(flow, "before the end of the file")
        klartext.end_of_file(flow, line)
        flow.interpreter.end_of_file()
        if self._dialect.lines.program_end:
            source = flow.listing.source
            numbers = (number for number in range(line - 1, 0, -1) if source(number).strip())
            last = next(numbers, 1)
            text = source(last)
            at = Place(last, 1 if text else 0, max(len(text), 1))
            message = (
                "the program begins with % and has no second one"
                if flow.percent
                else "the program ends without M2 or M30"
            )
            hint = "end it with M2 or M30, or put it between two lines of %"
            end = "%" if flow.percent else "M30"
            fix = Fix.replace(f"end the program with {end}", len(text) + 1, 0, f"\n{end}")
            raise flow.listing.fault(at, "program-end-missing", message, hint, fix)
        return None

    def _make(self, window: Window, line: int, index: int) -> Step | Statement:
        if self._flow.has_modal or self._flow.listing.section_ends:
            return self.single(window, line, index)
        if (
            self._compiled is not None
            and (self._is_long or window.count >= MANY_LINES)
            and window.has_expressions
            and not self._flow.interpreter.points_wanted
            and self._compiled.knows(window, index)
        ):
            return _Compiled(self._compiled, self, window)
        if window.simple[index] >= SHORTEST and not self._runs.leaves(window, index):
            return _Run(self._runs, self, window)
        return self.single(window, line, index)

    def single(self, window: Window, line: int, index: int) -> Step | Statement:
        """Return the step of a line that is executed on its own.

        Raises:
            GcodeError: The line is faulty, or the block that it opens.
        """
        flow = self._flow
        statement = flow.listing.statement(window, index)
        if statement is None:
            return NOTHING
        if statement.control is None:
            found = self._of_words(line, statement)
            if flow.has_modal and isinstance(found, Statement):
                return _Followed(found)
            return found
        step = self._of_control(line, statement.control)
        if self._compiled is not None and (self._is_long or window.count >= MANY_LINES):
            self._compiled.register(window, index, step)
        return _Announced(statement, step) if statement.remarks else step

    def _of_control(self, line: int, control: Control) -> Step:
        flow = self._flow
        step = flow.listing.steps.get(line)
        if step is None:
            step = self._makers[control.keyword](flow, line, control)
            # A jump knows its loop, so it must be kept. Calls are not kept: a program may have a
            # million of them.
            if control.keyword in _JUMPS:
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
                return numbered_programs.call_or_return(
                    line,
                    statement,
                    word,
                    macro=self._macro,
                    packed=self._dialect.calls.repeats_in_number,
                    sequence=self._dialect.calls.by_sequence,
                )
        lathe = self._dialect.turning.lathe
        by_subroutine = self._dialect.calls.profiles and any(
            word.letter == "G" and word.number in _PROFILE_CODES for word in statement.words
        )
        if lathe or by_subroutine:
            from cnc.gcode.turning.profiles import profile_cycle, subroutine_cycle

            if by_subroutine and (profile := subroutine_cycle(line, statement)):
                return profile
            if lathe and (cycle := profile_cycle(line, statement, self._dialect)):
                return cycle
        if self._step_of_code is not None and (
            step := self._step_of_code(self._flow, line, statement)
        ):
            return step
        if self._builder_codes and (step := file_call(line, statement, self._builder_codes)):
            return step
        if statement.words or statement.assignments or statement.remarks or statement.board:
            return statement
        return NOTHING


def run_alone(flow: Flow, step: Step | Statement, line: int) -> int:
    """Execute a line on its own; return the line to continue at."""
    if isinstance(step, Statement):
        flow.interpreter.execute(step, line)
        return line + 1
    return step.run(flow, line)


class _Run:
    """The first line of a run of plain lines."""

    __slots__ = ("_maker", "_runs", "_window")

    def __init__(self, runs: PlainLines, maker: StepMaker, window: Window) -> None:
        self._runs = runs
        self._maker = maker
        self._window = window

    def run(self, flow: Flow, line: int) -> int:
        """Execute the run in compiled code, or else its first line on its own."""
        window, listing = self._window, flow.listing
        session = flow.state(Session)
        is_plain = session.has_plain_moves if session else window.language != KLARTEXT
        count = self._runs.run(window, line - window.first) if is_plain else 0
        if not count:
            return run_alone(flow, self._maker.single(window, line, line - window.first), line)
        last = line + count - 1
        flow.executed += count - 1
        flow.new += max(0, last - listing.last_executed)
        listing.last_executed = max(last, listing.last_executed)
        return last + 1


class _Compiled:
    """A line that compiled code may execute, with those after it."""

    __slots__ = ("_maker", "_program", "_single", "_window")

    def __init__(self, program: CompiledProgram, maker: StepMaker, window: Window) -> None:
        self._program = program
        self._maker = maker
        self._window = window
        self._single: Step | Statement | None = None

    def run(self, flow: Flow, line: int) -> int:
        """Execute lines in compiled code, or else the line on its own."""
        after = self._program.run(self._window, line)
        if after is not None:
            return after
        step = self._single
        if step is None:
            step = self._single = self._maker.single(self._window, line, line - self._window.first)
        return run_alone(flow, step, line)


class _Followed:
    """A line after which the macro of G66 is called if it moved."""

    __slots__ = ("_statement",)

    def __init__(self, statement: Statement) -> None:
        self._statement = statement

    def run(self, flow: Flow, line: int) -> int:
        """Execute the line, then the macro."""
        motion = flow.interpreter.motion
        before = motion.position
        flow.interpreter.execute(self._statement, line)
        return line + 1 if motion.position is before else flow.call_after(line)


class _Alone:
    """A statement as a step."""

    __slots__ = ("_statement",)

    def __init__(self, statement: Statement) -> None:
        self._statement = statement

    def run(self, flow: Flow, line: int) -> int:
        """Execute the statement."""
        flow.interpreter.execute(self._statement, line)
        return line + 1


class _Announced:
    """A control line with a message in a comment."""

    def __init__(self, statement: Statement, step: Step) -> None:
        self._remarks = Statement(remarks=statement.remarks)
        self._step = step

    def run(self, flow: Flow, line: int) -> int:
        """Give the message, then run the control line."""
        flow.interpreter.execute(self._remarks, line)
        return self._step.run(flow, line)


_PERCENT = PercentStep()
