"""Numbered programs: calls with M98, G65, G66 and M97 (of lines), return with M99.

Sources: LinuxCNC, "O codes", FANUC-style numbered programs; FANUC operator's manual, "Subprogram
(M98, M99)", the call of a sequence number, and "Custom macro", macro call and modal call; Haas,
"Mill Operator's Manual", M97.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Literal

from cnc.gcode.program.call_arguments import Argument, repeated, split_arguments
from cnc.gcode.program.call_stack import Flow, Frame, Listing, Step
from cnc.gcode.program.control_flow import BackwardJump, jump_target
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.missing_programs import skips_missing
from cnc.gcode.program.uncalled_programs import check_main
from cnc.gcode.state.modal_groups import Code
from cnc.gcode.syntax.code_numbers import G, M
from cnc.gcode.syntax.parameters import LOCAL_MACRO, Parameters
from cnc.gcode.syntax.statement import Statement, Value
from cnc.gcode.syntax.words import Word, fault

MAX_PROGRAM = 99_999_999
MAX_REPEATS = 999_999_999
LONGEST_NUMBER = 9999
"""FANUC's M98 reads a larger P as repeats followed by four digits of program number."""

BUILDERS = range(8000, 10_000)
"""Programs that FANUC's parameter 3202 protects: a builder's and those of probes are among them."""


class _CallWords:
    """The words of a call, apart from the rest of its line, which is executed before the call."""

    def __init__(self, statement: Statement, letters: str, code: Word) -> None:
        computed = dict(statement.computed)
        self.values: dict[str, tuple[Word, Value | None]] = {}
        words: list[Word] = []
        left: list[tuple[int, Value]] = []
        for index, word in enumerate(statement.words):
            if word is code:
                continue
            if word.letter in letters:
                if word.letter in self.values:
                    raise repeated(word)
                self.values[word.letter] = word, computed.get(index)
                continue
            if index in computed:
                left.append((len(words), computed[index]))
            words.append(word)
        self._empty = not words and not statement.assignments and not statement.remarks
        self._rest = Statement(tuple(words), tuple(left), statement.assignments, statement.remarks)

    def execute_rest(self, flow: Flow, line: int) -> None:
        """Execute the rest of the line."""
        flow.interpreter.begun = True
        if not self._empty:
            flow.interpreter.execute(self._rest, line)

    def whole(self, letter: str, parameters: Parameters, meaning: str, highest: int) -> int | None:
        """Return the whole number of a word.

        Args:
            letter: The letter of the word.
            parameters: The parameters to compute it with.
            meaning: The meaning of the number, for the message.
            highest: Largest number that is allowed.

        Returns:
            The number; None if the word is missing or vacant.

        Raises:
            GcodeError: ``value-out-of-range``.
        """
        if letter not in self.values:
            return None
        word, value = self.values[letter]
        number = word.number if value is None else value(parameters)
        if number != number:
            return None
        if not 0 <= number <= highest or number != int(number):
            message = f"{word.written}: {meaning} must be a whole number from 0 to {highest}"
            raise fault("value-out-of-range", message, word)
        return int(number)


class ProgramCall:
    """``M98 P L``, ``M97 P L`` and ``M98 Q L`` of lines, and ``G65 P L`` with arguments."""

    __slots__ = ("arguments", "at", "code", "letter", "local", "packed", "words")

    def __init__(
        self, line: int, statement: Statement, code: Word, *, packed: bool, lines: bool = False
    ) -> None:
        """Read the words of a call.

        Args:
            line: The line.
            statement: Its words.
            code: The code of the call.
            packed: Whether P of M98 over 9999 has the repeats before its last four digits.
            lines: Whether M98 calls the lines from the N number of its Q on.
        """
        self.at = Place(line, code.column, code.length)
        self.code, self.packed = code, packed
        self.letter: Literal["P", "Q"] = "Q" if lines else "P"
        self.local = lines or (code.letter == "M" and code.number == M.M97)
        self.arguments: list[Argument] | None = None
        if code.letter == "G":
            statement, self.arguments = split_arguments(statement, code)
        self.words = _CallWords(statement, self.letter + "L", code)

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, then enter the program."""
        parameters = flow.parameters
        number, repeats = self._number_and_repeats(flow)
        arguments = None if self.arguments is None else self._locals(self.arguments, parameters)
        self.words.execute_rest(flow, line)
        if flow.interpreter.ended or repeats == 0:
            return line + 1
        return self.enter(flow, line, (number, repeats), arguments)

    def enter(
        self,
        flow: Flow,
        line: int,
        called: tuple[int, int],
        arguments: list[float] | None,
    ) -> int:
        """Enter the program.

        Args:
            flow: The flow of control.
            line: The line of the call, or the line after which a modal call is made.
            called: The number of the program, and how often it is executed.
            arguments: Values of the local variables of a macro.
        """
        number, repeats = called
        found = (
            self._look_up_line(flow, number) if self.local else self._look_up(flow, number, line)
        )
        if found is None:
            return line + 1
        listing, scope = found
        if listing is flow.main:
            flow.entered.add(scope)
        kind: Literal["program", "macro"] = "program" if arguments is None else "macro"
        name, caller = f"{'N' if self.local else 'O'}{number}", flow.listing
        frame = Frame(kind, name, listing, scope, caller, self.at, line + 1, repeats)
        return flow.enter(frame, arguments)

    def _number_and_repeats(self, flow: Flow) -> tuple[int, int]:
        """Return the number of the program, and how often it is called.

        P has no repeats before the number if the text has a program of all its digits: the control
        has numbers of eight digits (or, as Haas, of five).
        """
        parameters = flow.parameters
        meaning = "the N number" if self.local else "the program number"
        number = self.words.whole(self.letter, parameters, meaning, MAX_PROGRAM)
        if number is None:
            written = self.code.written
            message = f"{written} needs P, the program number"
            raise fault("program-number-missing", message, self.code, f"such as {written} P100")
        repeats = self.words.whole("L", parameters, "the number of repeats", MAX_REPEATS)
        packed = self.packed and self.arguments is None and not self.local
        if (
            repeats is None
            and packed
            and number > LONGEST_NUMBER
            and not self._begins(flow, number)
        ):
            return number % (LONGEST_NUMBER + 1), number // (LONGEST_NUMBER + 1)
        return number, 1 if repeats is None else repeats

    @staticmethod
    def _begins(flow: Flow, number: int) -> bool:
        """Return whether a program of this number begins in the text of the call or of the main."""
        texts = (flow.listing, flow.main)
        return any(number in listing.definitions().programs for listing in texts)

    def _locals(self, arguments: list[Argument], parameters: Parameters) -> list[float]:
        """Return the values of #1 to #33; NaN for those without an argument."""
        found = [math.nan] * LOCAL_MACRO
        for argument in arguments:
            found[argument.number - 1] = argument.result(parameters)
        return found

    def _look_up_line(self, flow: Flow, number: int) -> tuple[Listing, int]:
        """Find the lines that M97 P or M98 Q calls, in the program of the call."""
        listing = flow.listing
        begin, end = listing.program_around(self.at.line)
        line = listing.numbered(number, begin, end)
        if line is None:
            word = self.words.values[self.letter][0]
            hint = f"give the first line of them N{number}"
            raise fault("block-unknown", f"there is no line N{number}", word, hint)
        return listing, line - 1

    def _look_up(self, flow: Flow, number: int, line: int) -> tuple[Listing, int] | None:
        """Find a program in this text, in the main program, or in a file of its own.

        Returns:
            The text and the line of the O number; 0 for a file without O lines. None if a check
            continues without the program.
        """
        for listing in (flow.listing, flow.main):
            if found := self._in(listing, number):
                return listing, found
        file = flow.library.find(str(number), self.at)
        if file is not None:
            if found := self._in(file, number):
                return file, found
            if not file.definitions().programs and not file.definitions().subs:
                return file, 0
        word = self.words.values["P"][0]
        for listing in (flow.listing, flow.main, *([file] if file else [])):
            if str(number) in listing.definitions().subs:
                message = f"o{number} is a subroutine, not a program"
                raise fault("call-style-mixed", message, word, f"call it with o{number} call")
        hint = ""
        if end := flow.main.definitions().behind.get(number):
            hint = f"O{number} stands behind the % in line {end}, which ends the text: remove it"
        repeats, short = divmod(number, LONGEST_NUMBER + 1)
        if repeats and any(self._in(listing, short) for listing in (flow.listing, flow.main)):
            hint = f"FANUC reads it as O{short}, {repeats} times: write P{short} L{repeats}"
        if not hint:
            # A file with subprograms has all of them, but for a builder's: the number is mistyped.
            begins = flow.main.definitions().programs.values()
            alone = all(begin == flow.main_border for begin in begins)
            if (alone or number in BUILDERS) and skips_missing(flow, f"O{number}", word, line):
                return None
            hint = f"there is no O{number} in this file, and no {number}.ngc in the folders"
        raise fault("program-unknown", f"there is no program O{number}", word, hint)

    def _in(self, listing: Listing, number: int) -> int | None:
        definitions = listing.definitions()
        if repeated := definitions.repeated_programs.get(number):
            message = f"O{number} begins in line {definitions.programs[number]} already"
            control = listing.control(repeated)
            hint = "use another number"
            raise listing.control_fault(repeated, control, "program-repeated", message, hint)
        return definitions.programs.get(number)


class ProgramReturn:
    """``M99``, and ``M99 P n`` in FANUC's language."""

    __slots__ = ("at", "backs", "code", "words")

    def __init__(self, line: int, statement: Statement, code: Word, *, macro: bool) -> None:
        self.at = Place(line, code.column, code.length)
        self.code = code
        self.words = _CallWords(statement, "P" if macro else "", code)
        self.backs: dict[tuple[str, int], BackwardJump] = {}

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, then return to the caller, or to its block P."""
        block = self.words.whole("P", flow.parameters, "a block number", MAX_PROGRAM)
        self.words.execute_rest(flow, line)
        if flow.interpreter.ended:
            return line + 1
        frame = flow.frame
        if frame.kind == "sub":
            message = f"{self.code.written} in subroutine {frame.name} of line {frame.scope}"
            hint = f"return with {frame.name} endsub or {frame.name} return"
            raise fault("call-style-mixed", message, self.code, hint)
        if frame.kind == "main":
            if block is None:
                _end_once(flow, self.code, line)
                return line + 1
            jump = BackwardJump("this M99", self.at)
            return self._jump(flow, flow.listing, block, line, jump)
        if frame.rounds > 1 or block is None:
            return flow.finish()
        jump = BackwardJump(f"the call of {frame.name}", frame.at)
        to = self._jump(flow, frame.caller, block, frame.at.line, jump)
        flow.leave()
        return to

    def _jump(self, flow: Flow, listing: Listing, block: int, line: int, jump: BackwardJump) -> int:
        to = jump_target(listing, block, line, partial(flow.listing.fault, self.at))
        if to <= line:
            self.backs.setdefault((listing.name, line), jump).record(flow, listing, to)
        return to


def _end_once(flow: Flow, code: Word, line: int) -> None:
    """End a main program that its M99 would repeat for ever.

    Raises:
        GcodeError: ``program-endless``, ``main-program-later``.
    """
    check_main(flow, code, line)
    message, interpreter = f"{code.written} repeats the main program for ever", flow.interpreter
    if not interpreter.dialect.lenient:
        raise fault("program-endless", message, code, "end it with M30")
    interpreter.here.line = line
    message += " on its controller; here it ends"
    interpreter.here.report_warning("program-ends-once", message, code, "write M30")
    interpreter.stop(Code(M.M30, code))


class ModalCall(ProgramCall):
    """``G66 P L`` with arguments: the macro is executed after each move, until ``G67``."""

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, and keep the call."""
        parameters = flow.parameters
        if flow.modal is not None:
            message = f"{self.code.written} under another G66"
            raise fault("macro-active", message, self.code, "give G67 before")
        called = self._number_and_repeats(flow)
        assert self.arguments is not None
        arguments = self._locals(self.arguments, parameters)
        self.words.execute_rest(flow, line)
        if self._look_up(flow, called[0], line) is not None:
            flow.begin_modal(lambda after: self.enter(flow, after, called, arguments.copy()))
        return line + 1


class ModalEnd:
    """``G67``: the end of G66."""

    __slots__ = ("words",)

    def __init__(self, statement: Statement, code: Word) -> None:
        self.words = _CallWords(statement, "", code)

    def run(self, flow: Flow, line: int) -> int:
        """End the modal call, then execute the rest of the line."""
        flow.modal = None
        self.words.execute_rest(flow, line)
        return line + 1


CODES = {
    *(("M", float(code)) for code in (M.M97, M.M98, M.M99)),
    *(("G", code.code) for code in (G.G65, G.G66, G.G67)),
}
"""Letters and numbers of the words that call and return."""


def call_or_return(
    line: int, statement: Statement, code: Word, *, macro: bool, packed: bool, sequence: bool
) -> Step:
    """Return the step of a line with one of the codes.

    Args:
        line: The line.
        statement: Its words.
        code: The code.
        macro: Whether the language is FANUC's macro B.
        packed: Whether P of M98 over 9999 has the repeats before its last four digits.
        sequence: Whether M98 without P calls the lines from the N number of its Q on.
    """
    if code.letter == "G" and code.number == G.G66.code:
        return ModalCall(line, statement, code, packed=packed)
    if code.letter == "G" and code.number == G.G67.code:
        return ModalEnd(statement, code)
    if code.letter == "M" and code.number == M.M99:
        return ProgramReturn(line, statement, code, macro=macro)
    letters = {word.letter for word in statement.words}
    lines = sequence and code.letter == "M" and code.number == M.M98
    lines = lines and "Q" in letters and "P" not in letters
    return ProgramCall(line, statement, code, packed=packed, lines=lines)
