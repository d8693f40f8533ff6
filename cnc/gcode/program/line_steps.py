"""Steps of lines: a run of plain lines, a control line, or ``%``.

All other lines are executed as statements and have no step class.
"""

from __future__ import annotations

from collections.abc import Mapping

from cnc.gcode import dialects
from cnc.gcode.klartext import steps as klartext
from cnc.gcode.program import (
    block_matching,
    control_flow,
    numbered_programs,
    subprograms,
)
from cnc.gcode.program.builder_files import file_call
from cnc.gcode.program.call_stack import NOTHING, Flow, Maker, Page, Step
from cnc.gcode.program.compiled_program import CompiledProgram
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.line_machine import LineMachine
from cnc.gcode.program.percent import PercentStep
from cnc.gcode.program.plain_lines import SHORTEST, PlainLines
from cnc.gcode.reader.lines import KLARTEXT
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.source_text import Window
from cnc.gcode.syntax.statement import Control, Statement
from cnc.machine.program_codes import CodeAction

MANY_LINES = 500
"""Lines of a window, or executed lines, from which on compiled code is worth its start."""
_JUMPS = ("goto", "if-goto", "s-goto")
_PROFILE_CODES = frozenset(code.code for code in (G.G70, G.G71, G.G72))


def _makers(flavour: str) -> Mapping[str, Maker]:
    """Return the functions that make the step of a control line of a language, by keyword."""
    if flavour == "siemens":
        # Most programs are in another language.
        from cnc.gcode.sinumerik import cycles, flow, frames
        from cnc.gcode.sinumerik import subprograms as called

        return {**cycles.MAKERS, **flow.MAKERS, **frames.MAKERS, **called.MAKERS}
    if flavour == "klartext":
        return klartext.MAKERS
    return block_matching.MAKERS | subprograms.MAKERS


class StepMaker:
    """Makes the steps of lines when they are reached for the first time."""

    def __init__(
        self, flow: Flow, dialect: dialects.Dialect, codes: Mapping[int, CodeAction]
    ) -> None:
        self._flow = flow
        self._builder_codes = codes
        self._dialect = dialect
        self._macro = dialect.flavour == "macro-b"
        self._makers = _makers(dialect.flavour)
        machine = LineMachine(flow.interpreter)
        self._runs = PlainLines(flow.interpreter, machine)
        is_compiled = dialect.flavour in ("ngc", "siemens")
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
            from cnc.gcode.sinumerik.flow import SectionEnd  # for its programs only

            step = SectionEnd(_Alone(step) if isinstance(step, Statement) else step)
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
        if self._dialect.program_end:
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
            raise flow.listing.fault(at, "program-end-missing", message, hint)
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
                    packed=self._dialect.repeats_in_call,
                    sequence=self._dialect.sequence_calls,
                )
        if self._dialect.profile_subroutines and any(
            word.letter == "G" and word.number in _PROFILE_CODES for word in statement.words
        ):
            from cnc.gcode.program.subroutine_profiles import subroutine_cycle

            if profile := subroutine_cycle(line, statement):
                return profile
        if self._dialect.lathe:
            from cnc.gcode.program.turning_profiles import profile_cycle

            if cycle := profile_cycle(line, statement, self._dialect):
                return cycle
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
        session = flow.klartext
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
